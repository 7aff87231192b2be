"""Whether the edges of a control fall on the sampling clock, or were logged as steps: then how the surface moved between two
samples is the same at every edge, does not average out, and cannot be read off the samples.

A servo that lags takes some share of its way within the first interval after an edge. Where edges come at any time of an
interval that share scatters from nothing to all that the servo can do; where a sequencer steps on the sampling clock, or what
is logged is a command, it is the same at every edge.
"""

from collections.abc import Sequence

import numpy as np

from estimation.engine.kernel import Array
from estimation.models.base import Model
from estimation.prepare.flight_data import FlightData

FEWEST_EDGES = 4  # from which the scatter of a share says something: four at random are as alike in one of fifty
ALIKE = 0.2  # scatter of the share over its mean; 0.58 where edges come at any time of an interval
FAST = 0.15  # share of the way within one interval from which the way between samples matters
LARGE = 0.3  # of the largest edge of a control: smaller ones are steering, not an input made on purpose
REST = 0.05  # of an edge: a control that moves less was at rest before it
NOISY = 8.0  # noise levels that an edge has to stand out by
LONGEST = 8  # samples that one edge takes at most


def clocked_controls(model: Model, flights: Sequence[FlightData]) -> tuple[str, ...]:
    """Controls of a model whose edges are alike at the samples of these flights."""
    found = []
    for i, signal in enumerate(model.inputs):
        if not signal.control:
            continue
        noise = max((f.noise.get(signal.name, (0.0, 0.0))[0] for f in flights), default=0.0)
        edges = np.concatenate([_edges(s.u[:, i], noise) for f in flights for s in f.segments])
        if _alike(edges):
            found.append(signal.name)
    return tuple(found)


def _alike(edges: Array) -> bool:
    """edges: (n, 2) size of each and the share of it in its first interval."""
    if not len(edges):
        return False
    share = edges[edges[:, 0] >= LARGE * edges[:, 0].max(), 1]
    return share.size >= FEWEST_EDGES and bool(share.mean() >= FAST and share.std(ddof=1) <= ALIKE * share.mean())


def _edges(u: Array, noise: float) -> Array:
    """(n, 2) size and first share of each edge of a control (N,) that comes out of rest."""
    step = np.diff(u)
    found = []
    k = 2
    while k < step.size:
        after = step[k : k + LONGEST] * np.sign(step[k])
        way = after[: int(np.argmax(after <= 0.0)) if (after <= 0.0).any() else after.size]
        size = float(way.sum())
        if (
            size > NOISY * noise
            and size > 0.0
            and np.abs(step[k - 2 : k]).max() <= REST * size
            and way[0] > REST * size
        ):
            found.append((size, float(way[0]) / size))
            k += max(1, way.size)
        else:
            k += 1
    return np.array(found).reshape(-1, 2)
