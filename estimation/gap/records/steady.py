"""What flight is about: a lateral motion is small about zero, a longitudinal one about a trimmed speed, angle and load.

Linear pictures of the motion (spectra of the noise, replies to steps of surfaces) and sizes of outputs are taken there.
"""

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment
from estimation.models.base import Model, Signal

STEADY = frozenset({"V", "alpha", "theta", "u", "w", "ax", "az"})
"""Quantities that have a value in straight and level flight; all others are zero there."""


def steady_state(model: Model, segment: Segment) -> Array:
    """(nx,) state about which a record moves: the median of what was measured, zero for states that level flight has none of.

    A state that no output shows (a lag of a vane or of the flow) rests where the signal that it starts from does.
    """
    known = {n: level for n, level in zip(model.output_names, steady_outputs(model, segment), strict=True) if level}
    return np.array([_rest(s, known, segment.x0[i]) for i, s in enumerate(model.states)])


def steady_outputs(model: Model, segment: Segment) -> Array:
    """(ny,) values of the outputs about which a record moves."""
    levels = np.zeros(len(model.outputs))
    for i, signal in enumerate(model.outputs):
        seen = segment.z[np.isfinite(segment.z[:, i]), i]
        if signal.name in STEADY and seen.size:
            levels[i] = np.median(seen)
    return levels


def _rest(state: Signal, known: dict[str, float], first: float) -> float:
    for name in (state.name, state.column, state.start):
        if isinstance(name, str) and name in known:
            return known[name]
    return float(first) if state.name in STEADY else 0.0
