"""What of a control follows the measured motion: the hand of a pilot or an autopilot that steers against it.

De-noising a control by itself takes such small motion for noise where it is no larger than that. It is not: it goes with a rate
or an angle, and an estimate finds what is missing of it among the derivatives of that motion (a c172p whose elevator holds its
attitude, 0.05 deg of noise: a quarter of the feedback of pitch rate taken off, and `Cm_q` 13 % too large for it).

Between steps a control is a straight line in every stretch, the motion times gains, and noise: linear regression. What follows
the motion is then taken off before de-noising and put back after it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.signals.preprocess import denoise_many
from estimation.signals.raw_steps import near_steps

Array = NDArray[np.float64]

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


def gains(pieces: Sequence[ControlStretch], noise: float) -> Gains | None:
    """Gains by which a control follows the motion in all pieces of a record; None where that may be chance. noise: of it."""
    from scipy.special import fdtrc

    left = [stretch for piece in pieces for stretch in _stretches(piece, noise)]
    if not left:
        return None
    y, x = np.concatenate([v for v, _ in left]), np.concatenate([m for _, m in left])
    size = np.sqrt(np.mean(x**2, axis=0))
    size[size == 0.0] = 1.0
    u, s, vt = np.linalg.svd(x / size, full_matrices=False)
    told = s > DEPENDENT * s[0] if s[0] > 0.0 else np.zeros(s.size, bool)
    u, s, vt = u[:, told], s[told], vt[told]
    freedom = y.size - 2 * len(left) - s.size
    if s.size == 0 or freedom < s.size:
        return None
    along = u.T @ y
    variance = float(y @ y - along @ along) / freedom
    if not variance > 0.0 or fdtrc(s.size, freedom, float(along @ along) / s.size / variance) > CHANCE:
        return None
    roots = vt.T / s * np.sqrt(max(variance, noise**2))
    return Gains(vt.T @ (along / s) / size, roots / size[:, None])


def following(
    piece: ControlStretch, found: Gains, noise: float, draws: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """The control of a piece (N,) without its noise, with what follows the motion; and (draws, N) what may be wrong with it."""
    x = piece.regressors()
    x = x - x.mean(axis=0)
    follows = x @ found.gains
    rest = denoise_many([piece.values - follows], noise=noise, draws=draws, rng=rng)[0]
    if not draws:
        return rest.values + follows, rest.errors
    others = (x @ found.roots).T  # what another gain adds, less what de-noising makes of the rest that this leaves
    again = denoise_many([piece.values - follows - o for o in others], noise=noise)
    by_gains = np.array([o + a.values - rest.values for o, a in zip(others, again, strict=True)])
    return rest.values + follows, rest.errors + rng.standard_normal((draws, len(others))) @ by_gains


def _stretches(piece: ControlStretch, noise: float) -> Iterator[tuple[Array, Array]]:
    """Control (n,) and regressors (n, 2 motions) of each stretch between steps, less their straight lines."""
    near = np.concatenate([[True], near_steps(piece.smooth, noise, STEP, AROUND), [True]])
    x = piece.regressors()
    edges = np.flatnonzero(np.diff(near.astype(int)))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        if b - a < SHORTEST:
            continue
        ends = np.linspace(a, b, max(1, round((b - a) / STRETCH)) + 1).round().astype(int)
        for first, end in zip(ends[:-1], ends[1:], strict=True):
            line = np.vander(np.linspace(-1.0, 1.0, end - first), 2)
            basis = np.linalg.qr(line)[0]
            y, m = piece.values[first:end], x[first:end]
            yield y - basis @ (basis.T @ y), m - basis @ (basis.T @ m)
