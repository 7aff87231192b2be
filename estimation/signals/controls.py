"""What de-noising removes from a control besides noise: feedback from the motion, and the corners of its steps.

A pilot or an autopilot steers against the motion. De-noising a control by itself removes this feedback wherever it is no larger
than the noise. The estimates then make up for it in the derivatives of that motion (a c172p whose elevator holds its attitude,
with 0.05 deg of noise: a quarter of the feedback from pitch rate was lost, and `Cm_q` came out 13 % too large). Between steps a
control is, in every stretch, a straight line plus gains times the motion plus noise, so linear regression finds the gains. The
feedback is subtracted before de-noising and added again after it.

De-noising also rounds the corners of steps. There the smoothed control is no nearer the truth than the measured one (0.077
against 0.069 deg rms on simulated flights, away from steps 0.033 against 0.070), and it is late by a hundredth of a sample. An
elevator turns so light a body so fast that pitch rate shows even that: it looks like a lag of the elevator, or like a moment due
to the rate of angle of attack. So measured values are used from three samples before a step to six behind it, at most 0.15 and
0.3 s. They are not used everywhere, because the noise of a quiet control looks like play (with six samples at 5 Hz, three of
seven simulated sets of flights without play were said to have it).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimation.signals.denoise import THIRD_DIFFERENCE, denoise_many
from estimation.signals.rounding import rounding_noise
from groundstation.flight.arrays import true_runs

Array = NDArray[np.float64]
FEWEST = 100  # third differences: they give a noise level to a tenth of itself
# Reach around the sample before a step: its rounding by de-noising, and the settling of a servo of 35 ms; the shorter counts.
CORNER, TAIL = 3, 6  # samples
BEFORE, BEHIND = 0.15, 0.3  # s


def step_reach(interval: float) -> range:
    """Offsets from the sample before a step to those that its rounded corner and the servo's settling reach. interval: [s]."""
    samples_before, samples_behind = (math.ceil(seconds / interval - 1e-6) for seconds in (BEFORE, BEHIND))
    return range(-min(samples_before, CORNER), min(samples_behind, TAIL) + 1)


def near_steps(values: Array, noise: float, step: float, around: range) -> NDArray[np.bool_]:
    """(N,) samples of a de-noised control (N,) near a step, a change between two samples of more than `step` times `noise`.

    around: offsets from the sample before the step.
    """
    moves = np.flatnonzero(np.abs(np.diff(values)) > step * noise)
    mask = np.zeros(values.size, dtype=bool)
    for shift in around:
        mask[np.clip(moves + shift, 0, values.size - 1)] = True
    return mask


def noise_between_steps(values: Array, step_mask: NDArray[np.bool_], level: float) -> float:
    """Standard deviation of the noise of a control (N,) by its third differences away from steps; `level` where too few are left.

    Steps and servo enlarge up to a third of all third differences, and so their median (`level`) by a fifth.
    """
    third = np.diff(values, 3)
    calm = ~(step_mask[:-3] | step_mask[1:-2] | step_mask[2:-1] | step_mask[3:]) & np.isfinite(third)
    if np.count_nonzero(calm) < FEWEST:
        return level
    return max(float(np.sqrt(np.mean(third[calm] ** 2) / THIRD_DIFFERENCE)), rounding_noise(values))


def with_raw_steps(
    smooth: Array, measured: Array, noise: float, step: float, interval: float
) -> tuple[Array, NDArray[np.bool_]]:
    """The de-noised control with its measured values near steps, and where those were used. All (N,); measured: NaN where
    missing; interval: of the samples [s]."""
    step_mask = near_steps(smooth, noise, step, step_reach(interval)) & np.isfinite(measured)
    return np.where(step_mask, np.nan_to_num(measured), smooth), step_mask


STRETCH = 40  # samples under one straight line: 20 would show half as much of slow feedback, 60 no more
SHORTEST = 6  # samples between steps from which a gain can be estimated
STEP = 4.0  # times the noise: noise alone makes a larger change in one of 15 000 samples
AROUND = range(-2, 5)  # samples from the one before a step: corner and settling belong to the step
CHANCE = 1e-3  # probability: feedback is accepted where noise alone would make so large an F ratio less often
DEPENDENT = 1e-6  # of the largest singular value: directions of the motion below this cannot be separated


@dataclass(frozen=True)
class Gains:
    """gains: (2 motions,) by which a control follows the motion now and one sample before; roots: (2 motions, k) a factor of
    their covariance, roots @ roots.T."""

    gains: Array
    roots: Array


@dataclass(frozen=True)
class ControlStretch:
    """A stretch of one record. values: (N,) the measured control; smooth, motion: (N,) and (N, motions) de-noised."""

    values: Array
    smooth: Array
    motion: Array

    def regressors(self) -> Array:
        """(N, 2 motions): the motion now and one sample before, because a servo is late."""
        return np.column_stack([self.motion, np.concatenate([self.motion[:1], self.motion[:-1]])])

    def following(self, fitted: Gains) -> Array:
        """(N,) the part of the control that follows the motion, about its mean."""
        x = self.regressors()
        return np.asarray((x - x.mean(axis=0)) @ fitted.gains)


def feedback_gains(pieces: Sequence[ControlStretch], noise: float) -> Gains | None:
    """Gains by which a control follows the motion in all pieces of a record; None where noise explains it. noise: of the
    control."""
    from scipy.special import fdtrc

    stretches = [stretch for piece in pieces for stretch in _stretches(piece, noise)]
    if not stretches:
        return None
    y, x = (np.concatenate(parts) for parts in zip(*stretches, strict=True))
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
    """(N,) the de-noised control of a piece with its feedback, and (draws, N) draws of its remaining error."""
    x = piece.regressors()
    x = x - x.mean(axis=0)
    follows = x @ fitted.gains
    remainder = denoise_many([piece.values - follows], noise=noise, draws=draws, rng=rng)[0]
    if not draws:
        return remainder.values + follows, remainder.errors
    # what a change of a gain adds to the feedback, and how it changes the de-noised remainder
    feedback_changes = (x @ fitted.roots).T
    denoised = denoise_many([piece.values - follows - change for change in feedback_changes], noise=noise)
    by_gains = np.array([c + d.values - remainder.values for c, d in zip(feedback_changes, denoised, strict=True)])
    return remainder.values + follows, remainder.errors + rng.standard_normal((draws, len(by_gains))) @ by_gains


def _stretches(piece: ControlStretch, noise: float) -> Iterator[tuple[Array, Array]]:
    """Control (n,) and regressors (n, 2 motions) of each stretch between steps, their straight lines subtracted."""
    x = piece.regressors()
    for a, b in true_runs(~near_steps(piece.smooth, noise, STEP, AROUND)):
        if b - a < SHORTEST:
            continue
        ends = np.linspace(a, b, max(1, round((b - a) / STRETCH)) + 1).round().astype(int)
        for first, end in pairwise(ends):
            line = np.vander(np.linspace(-1.0, 1.0, end - first), 2)
            basis = np.linalg.qr(line)[0]
            y, m = piece.values[first:end], x[first:end]
            yield y - basis @ (basis.T @ y), m - basis @ (basis.T @ m)
