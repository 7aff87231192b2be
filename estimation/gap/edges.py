"""How a surface moved between two samples is not recorded: an uncertainty that belongs to the edges, not to all time.

A servo's edge falls anywhere within an interval. Which way the surface went through the middle of that interval moves
the aircraft as much as many a hidden effect does, and no stationary spectrum describes it. The middle of every interval
in which a control moves much is given a prior displacement in proportion to the step; the proportion is estimated from
the flights. All of it is marginalised over by a correction of low rank behind the whitener.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment
from estimation.gap.whitening import Linear, Slack, Whitener
from estimation.models.base import Model

MOST = 48  # edges per record; the rest are small
LEAST_STEP = 4.0  # times the sample-to-sample scatter of a control: smaller steps are no edges
START = 0.2  # of the step
LIMITS = (0.03, 0.6)
RUNAWAY = 1e6  # a motion that grows so far is no small motion any more


@dataclass(frozen=True)
class Edges:
    """The edges of one record. control: (m,) name of each; interval: (m,) index of the sample before; step: (m,) [rad];
    response: (N, ny, m) change of the outputs when the middle moves by one step."""

    control: tuple[str, ...]
    interval: Array
    step: Array
    response: Array

    def spread(self, freedom: Mapping[str, float]) -> Array:
        """(m,) prior standard deviations in steps."""
        return np.array([freedom.get(c, START) for c in self.control])


def find_edges(model: Model, linear: Linear, segment: Segment) -> Edges:
    """The largest steps of all controls in a record and what a displacement half-way does to the outputs."""
    found: list[tuple[float, str, int, float]] = []
    for j, signal in enumerate(model.inputs):
        if not signal.control or signal.name not in linear.controls:
            continue
        step = np.diff(segment.u[:, j])
        scatter = 1.4826 * float(np.median(np.abs(step)))
        power = float(np.abs(linear.C @ linear.B[:, linear.controls.index(signal.name)] / linear.scale).max())
        for k in np.flatnonzero(np.abs(step) > LEAST_STEP * scatter):
            found.append((power * abs(float(step[k])), signal.name, int(k), float(step[k])))
    found = sorted(sorted(found, reverse=True)[:MOST], key=lambda e: (e[1], e[2]))
    names = tuple(e[1] for e in found)
    interval = np.array([e[2] for e in found], dtype=int)
    step = np.array([e[3] for e in found])
    N = len(segment)
    replies = {c: _reply(linear, linear.controls.index(c), N) for c in set(names)}
    response = np.zeros((N, linear.C.shape[0], len(found)))
    for i, (c, k, s) in enumerate(zip(names, interval, step, strict=True)):
        response[k + 1 :, :, i] = s * replies[c][: N - k - 1]
    return Edges(names, interval, step, response)


def _reply(linear: Linear, control: int, count: int) -> Array:
    """(count, ny) outputs at the samples after an interval in whose middle the control stood 1 off a straight line."""
    h = linear.dt
    x = expm(linear.A * (0.5 * h)) @ linear.B[:, control] * (0.5 * h)  # a triangle of width h: its area, at its middle
    advance = expm(linear.A * h)
    out = np.zeros((count, linear.C.shape[0]))
    for k in range(count):
        if not np.abs(x).max() < RUNAWAY:
            break
        out[k] = linear.C @ x
        x = advance @ x
    return out


def loosened(whitener: Whitener, edges: Edges, freedom: Mapping[str, float]) -> Whitener:
    """`whitener` that also marginalises over the edges."""
    if not edges.control:
        return whitener
    block = edges.response * edges.spread(freedom)
    rows = whitener.rows(block)
    values, vectors = np.linalg.eigh(rows.T @ rows)
    good = values > 1e-8 * max(float(values.max()), 1e-30)
    values, vectors = values[good], vectors[:, good]
    turn = vectors / np.sqrt(values)
    series = np.stack([whitener.series(block[:, :, i]).ravel() for i in range(block.shape[2])], axis=1)
    return Whitener(whitener.root, whitener.count, Slack(rows @ turn, series @ turn, 1.0 - 1.0 / np.sqrt(1.0 + values)))


def displaced(whitener: Whitener, edges: Edges, freedom: Mapping[str, float], residual: Array
              ) -> tuple[Array, Array]:  # fmt: skip
    """(mean (m,), variance (m,)) of the displacements [steps] that a residual (N, ny) tells; `whitener` without slack."""
    spread = edges.spread(freedom)
    rows = whitener.rows(np.concatenate([edges.response, residual[:, :, None]], axis=2))
    E, r = rows[:, :-1], rows[:, -1]
    inverse = np.linalg.inv(E.T @ E + np.diag(1.0 / spread**2))
    return inverse @ (E.T @ r), np.diag(inverse).copy()


def freedom_of(edges: Sequence[Edges], told: Sequence[tuple[Array, Array]]) -> dict[str, float]:
    """Typical displacement of every control in steps, from what all records tell."""
    squares: dict[str, list[float]] = {}
    for e, (mean, variance) in zip(edges, told, strict=True):
        for c, m, v in zip(e.control, mean, variance, strict=True):
            squares.setdefault(c, []).append(float(m * m + v))
    return {c: float(np.clip(np.sqrt(np.mean(s)), *LIMITS)) for c, s in squares.items()}
