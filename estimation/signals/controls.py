"""What de-noising takes off a control besides noise: the part that follows the motion, and the corners of its steps.

The hand of a pilot or an autopilot steers against the motion. De-noising a control by itself takes such small motion for noise
where it is no larger than that. It is not: it goes with a rate or an angle, and an estimate finds what is missing of it among the
derivatives of that motion (a c172p whose elevator holds its attitude, 0.05 deg of noise: a quarter of the feedback of pitch rate
taken off, and `Cm_q` 13 % too large for it). Between steps a control is a straight line in every stretch, the motion times gains,
and noise: linear regression. What follows the motion is then taken off before de-noising and put back after it.

Taking noise off also rounds the corners of steps a little: there the smoothed course is no nearer the truth than the
measured one (0.077 against 0.069 deg rms on flights of the second truth, away from steps 0.033 against 0.070), and it errs to
one side, late by a hundredth of a sample. An elevator turns so light a body so fast that pitch rate shows even that, and it
looks like a lag of the elevator or a moment that goes with the rate of angle of attack. From three samples before a step to
six behind it, 0.15 and 0.3 s at the most, the measured value is taken; everywhere would be too much: the noise of a quiet control
looks like play, which takes it off (with as many samples at 5 Hz three sets in seven of nothing hidden were named so).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.signals.denoise import denoise_many
from groundstation.flight.arrays import true_runs

Array = NDArray[np.float64]
FEWEST = 100  # differences that tell a level to a tenth
CORNER, TAIL = (
    3,
    6,
)  # samples before and behind the one before a step, that its rounding and the tail of a servo reach at the most
BEFORE, BEHIND = 0.15, 0.3  # s: the same of a servo of 35 ms


def step_reach(interval: float) -> range:
    """Samples of so many seconds, from the one before a step: its rounded corner, and the tail of a servo."""
    samples_before, samples_behind = (math.ceil(seconds / interval - 1e-6) for seconds in (BEFORE, BEHIND))
    return range(-min(samples_before, CORNER), min(samples_behind, TAIL) + 1)


def near_steps(values: Array, noise: float, step: float, around: range) -> NDArray[np.bool_]:
    """(N,) whether a sample of a de-noised control (N,) lies by a change of more than `step` times its noise: `around` the one
    before it."""
    moves = np.flatnonzero(np.abs(np.diff(values)) > step * noise)
    mask = np.zeros(values.size, dtype=bool)
    for shift in around:
        mask[np.clip(moves + shift, 0, values.size - 1)] = True
    return mask


def noise_between_steps(values: Array, step_mask: NDArray[np.bool_], level: float) -> float:
    """Standard deviation of the noise of a control (N,) away from its steps, by its third differences; `level`, by all of them,
    where that leaves too few. Steps and servo make up to a third of all of them large, and their median a fifth too large."""
    third = np.diff(values, 3)
    calm = ~(step_mask[:-3] | step_mask[1:-2] | step_mask[2:-1] | step_mask[3:]) & np.isfinite(third)
    return float(np.sqrt(np.mean(third[calm] ** 2) / 20.0)) if np.count_nonzero(calm) >= FEWEST else level


def with_raw_steps(
    smooth: Array, measured: Array, noise: float, step: float, interval: float
) -> tuple[Array, NDArray[np.bool_]]:
    """The de-noised control with its measured values by its steps, and where they were taken. All (N,), measured NaN where
    nothing was. interval: of the samples [s]."""
    step_mask = near_steps(smooth, noise, step, step_reach(interval)) & np.isfinite(measured)
    return np.where(step_mask, np.nan_to_num(measured), smooth), step_mask


STRETCH = 40  # samples that a straight line covers at most: 20 tell half as much of slow feedback, 60 no more
SHORTEST = 6  # samples between steps that say anything of a gain
STEP = 4.0  # noises: one in 15 000 samples of noise alone is a larger change
AROUND = range(-2, 5)  # samples from the one before a step: corner and tail of a servo belong to the step
CHANCE = 1e-3  # an F ratio that chance makes so seldom is feedback
DEPENDENT = 1e-6  # of the largest: directions of the motion that are told apart


@dataclass(frozen=True)
class Gains:
    """gains: (2 motions,) of the motion now and a sample before; roots: (2 motions, k), whose products with normal numbers are
    the errors of the gains."""

    gains: Array
    roots: Array


@dataclass(frozen=True)
class ControlStretch:
    """A stretch of one record. values: (N,) the control with its noise; smooth: (N,) without; motion: (N, motions) without."""

    values: Array
    smooth: Array
    motion: Array

    def regressors(self) -> Array:
        """(N, 2 motions): now and one sample before, for a servo is late."""
        return np.column_stack([self.motion, np.concatenate([self.motion[:1], self.motion[:-1]])])

    def following(self, fitted: Gains) -> Array:
        """(N,) what of the control follows the motion, about its mean."""
        x = self.regressors()
        return np.asarray((x - x.mean(axis=0)) @ fitted.gains)


def feedback_gains(pieces: Sequence[ControlStretch], noise: float) -> Gains | None:
    """Gains by which a control follows the motion in all pieces of a record; None where that may be chance. noise: of it."""
    from scipy.special import fdtrc

    stretches = [stretch for piece in pieces for stretch in _stretches(piece, noise)]
    if not stretches:
        return None
    y, x = np.concatenate([v for v, _ in stretches]), np.concatenate([m for _, m in stretches])
    size = np.sqrt(np.mean(x**2, axis=0))
    size[size == 0.0] = 1.0
    u, s, vt = np.linalg.svd(x / size, full_matrices=False)
    resolved = s > DEPENDENT * s[0] if s[0] > 0.0 else np.zeros(s.size, bool)
    u, s, vt = u[:, resolved], s[resolved], vt[resolved]
    freedom = y.size - 2 * len(stretches) - s.size
    if s.size == 0 or freedom < s.size:
        return None
    projections = u.T @ y
    variance = float(y @ y - projections @ projections) / freedom
    if not variance > 0.0 or fdtrc(s.size, freedom, float(projections @ projections) / s.size / variance) > CHANCE:
        return None
    roots = vt.T / s * np.sqrt(max(variance, noise**2))
    return Gains(vt.T @ (projections / s) / size, roots / size[:, None])


def with_feedback(
    piece: ControlStretch, fitted: Gains, noise: float, draws: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """The control of a piece (N,) without its noise, with what follows the motion; and (draws, N) what may be wrong with it."""
    x = piece.regressors()
    x = x - x.mean(axis=0)
    follows = x @ fitted.gains
    rest = denoise_many([piece.values - follows], noise=noise, draws=draws, rng=rng)[0]
    if not draws:
        return rest.values + follows, rest.errors
    gain_errors = (
        x @ fitted.roots
    ).T  # what another gain adds, less what de-noising makes of the rest that this leaves
    denoised = denoise_many([piece.values - follows - o for o in gain_errors], noise=noise)
    by_gains = np.array([o + a.values - rest.values for o, a in zip(gain_errors, denoised, strict=True)])
    return rest.values + follows, rest.errors + rng.standard_normal((draws, len(gain_errors))) @ by_gains


def _stretches(piece: ControlStretch, noise: float) -> Iterator[tuple[Array, Array]]:
    """Control (n,) and regressors (n, 2 motions) of each stretch between steps, less their straight lines."""
    x = piece.regressors()
    for a, b in true_runs(~near_steps(piece.smooth, noise, STEP, AROUND)):
        if b - a < SHORTEST:
            continue
        ends = np.linspace(a, b, max(1, round((b - a) / STRETCH)) + 1).round().astype(int)
        for first, end in zip(ends[:-1], ends[1:], strict=True):
            line = np.vander(np.linspace(-1.0, 1.0, end - first), 2)
            basis = np.linalg.qr(line)[0]
            y, m = piece.values[first:end], x[first:end]
            yield y - basis @ (basis.T @ y), m - basis @ (basis.T @ m)
