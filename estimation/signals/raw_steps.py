"""Controls at their steps as they were measured.

Taking noise off a control rounds the corners of its steps a little: there the smoothed course is no nearer the truth than the
measured one (0.077 against 0.069 deg rms on flights of the second truth, away from steps 0.033 against 0.070), and it errs to
one side, late by a hundredth of a sample. An elevator turns so light a body so fast that pitch rate shows even that, and it
looks like a lag of the elevator or a moment that goes with the rate of angle of attack. From three samples before a step to
six behind it, 0.15 and 0.3 s at the most, the measured value is taken; everywhere would be too much: the noise of a quiet control
looks like play, which takes it off (with as many samples at 5 Hz three sets in seven of nothing hidden were named so).
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FEWEST = 100  # differences that tell a level to a tenth
CORNER, TAIL = (
    3,
    6,
)  # samples before and behind the one before a step, that its rounding and the tail of a servo reach at the most
BEFORE, BEHIND = 0.15, 0.3  # s: the same of a servo of 35 ms


def around(interval: float) -> range:
    """Samples of so many seconds, from the one before a step: its rounded corner, and the tail of a servo."""
    before, behind = (math.ceil(seconds / interval - 1e-6) for seconds in (BEFORE, BEHIND))
    return range(-min(before, CORNER), min(behind, TAIL) + 1)


def near_steps(values: Array, noise: float, step: float, around: range) -> NDArray[np.bool_]:
    """(N,) whether a sample of a de-noised control (N,) lies by a change of more than `step` times its noise: `around` the one
    before it."""
    moves = np.flatnonzero(np.abs(np.diff(values)) > step * noise)
    near = np.zeros(values.size, dtype=bool)
    for shift in around:
        near[np.clip(moves + shift, 0, values.size - 1)] = True
    return near


def noise_between_steps(values: Array, near: NDArray[np.bool_], found: float) -> float:
    """Standard deviation of the noise of a control (N,) away from its steps, by its third differences; `found`, by all of them,
    where that leaves too few. Steps and servo make up to a third of all of them large, and their median a fifth too large."""
    third = np.diff(values, 3)
    calm = ~(near[:-3] | near[1:-2] | near[2:-1] | near[3:]) & np.isfinite(third)
    return float(np.sqrt(np.mean(third[calm] ** 2) / 20.0)) if np.count_nonzero(calm) >= FEWEST else found


def with_raw_steps(
    smooth: Array, measured: Array, noise: float, step: float, interval: float
) -> tuple[Array, NDArray[np.bool_]]:
    """The de-noised control with its measured values by its steps, and where they were taken. All (N,), measured NaN where
    nothing was. interval: of the samples [s]."""
    near = near_steps(smooth, noise, step, around(interval)) & np.isfinite(measured)
    return np.where(near, np.nan_to_num(measured), smooth), near
