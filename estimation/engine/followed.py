"""Controls of a model that pitches, after their noise was taken off: what follows the motion put back, steps as measured.

An elevator acts on a light and little damped motion. What de-noising takes off it besides noise goes into pitch damping and the
derivatives by the elevator (`estimation.signals.feedback`, `estimation.signals.raw_steps`), far beyond their bounds. A lateral
motion forgives both: there the noise that measured values bring costs as much as the rounding does.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.engine.conditioned import Conditioned
from estimation.engine.kernel import Array
from estimation.models.base import Model
from estimation.signals.feedback import STEP, ControlStretch, following, gains
from estimation.signals.preprocess import QUIET
from estimation.signals.raw_steps import around, near_steps

PITCHES = "q"  # the column of a state: pitch rate
SEED = 22


def pitches(model: Model) -> bool:
    """Whether a model has a state of its own for pitch rate."""
    return any(s.source == PITCHES for s in model.states)


def keep_what_follows(
    model: Model,
    told: Conditioned,
    pieces: Sequence[tuple[int, int]],
    u: Array,
    errors: NDArray[np.float32],
    states: Array,
    noise: dict[str, tuple[float, float]],
) -> None:
    """Change the controls in `u` (samples, nu), and `errors` with them, in place, where the model pitches.

    states: (samples, nx) without noise, NaN where not measured. noise: of each input, as found. A piece in which a control was
    not measured at every sample stays as it is.
    """
    if not pitches(model):
        return
    for i, signal in enumerate(model.inputs):
        level = noise.get(signal.name, (0.0, 0.0))[0]
        if not signal.control or signal.computed or not told.flight.measured(signal.source):
            continue
        column = told.flight[signal.source]
        missing = ~np.isfinite(column) | (told.found[signal.source].held if signal.source in told.found else False)
        whole = [(a, b) for a, b in pieces if not missing[a:b].any() and level > QUIET * np.ptp(column[a:b])]
        if not whole:
            continue
        known = [j for j in range(states.shape[1]) if all(np.isfinite(states[a:b, j]).all() for a, b in whole)]
        parts = [
            ControlStretch(np.asarray(column[a:b], float), u[a:b, i].copy(), states[a:b][:, known]) for a, b in whole
        ]
        found = gains(parts, level) if known else None
        rng = np.random.default_rng([SEED, i])
        draws, reach = errors.shape[2], around(told.flight.sample_interval)
        for (a, b), part in zip(whole, parts, strict=True):
            if found is not None:
                u[a:b, i], drawn = following(part, found, level, draws, rng)
                errors[a:b, i] = drawn.T
            near = np.flatnonzero(near_steps(part.smooth, level, STEP, reach))
            u[a + near, i] = part.values[near]
            errors[a + near, i] = level * rng.standard_normal((near.size, draws))
        removed = np.concatenate([part.values - u[a:b, i] for (a, b), part in zip(whole, parts, strict=True)])
        noise[signal.name] = (level, float(np.sqrt(np.mean(removed**2))))
