"""Noise off the measured inputs without touching an edge.

Output error takes its inputs for truth, so jitter on a potentiometer becomes coloured residuals and false names. The
method: the signal is piecewise polynomial (straight for controls, parabolic for motion variables) with unknown break
points; the estimate is the mean over all segmentations weighted by their probability (exact forward and backward
recursions; Fearnhead 2006, Statistics and Computing 16, 203-213, with Gaussian noise of known variance). A sharp edge
gets a break with probability near one and stays where it was; a quiet stretch is averaged over its whole length.

The noise level comes from the signal itself (`noise_level`), so nothing need be known of the sensor.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST_PIECE = 80  # samples; longer quiet stretches are joined from pieces, at little cost in noise
BREAK_RATE = 1.0 / 25.0  # prior probability of a break at a sample


@dataclass(frozen=True, slots=True)
class Denoised:
    """values: (N,) the signal without its noise; noise: estimated standard deviation; removed: rms of what was taken."""

    values: Array
    noise: float
    removed: float


def noise_level(values: Array) -> float:
    """Standard deviation of the white part of a sampled signal, robust against edges and manoeuvres.

    Median of absolute third differences over samples in a row, scaled for Gaussian noise (sum of squares of
    1 -3 3 -1 is 20). Zero for a signal without noise. values: (N,), finite.
    """
    if values.size < 8:
        return 0.0
    third = np.abs(np.diff(values, 3))
    return float(np.median(third) / 0.6744897501960817 / np.sqrt(20.0))


def denoise(values: Array, *, order: int = 1, noise: float | None = None) -> Denoised:
    """Edge-preserving estimate of a signal in white noise. values: (N,) evenly sampled, finite; order: of the pieces."""
    return denoise_many([values], order=order, noise=noise)[0]


def denoise_many(signals: Sequence[Array], *, order: int = 1, noise: float | None = None) -> list[Denoised]:
    """`denoise` of several signals of equal length at little more than the cost of one."""
    sigmas = [noise_level(v) if noise is None else noise for v in signals]
    noisy = [i for i, (v, s) in enumerate(zip(signals, sigmas, strict=True)) if v.size >= 8 and s > 1e-9 * np.ptp(v)]
    result = [Denoised(v.copy(), s, 0.0) for v, s in zip(signals, sigmas, strict=True)]
    if noisy:
        smooth = _piecewise_mean(np.stack([signals[i] / sigmas[i] for i in noisy]), order)
        for row, i in enumerate(noisy):
            values = smooth[row] * sigmas[i]
            removed = float(np.sqrt(np.mean((signals[i] - values) ** 2)))
            result[i] = Denoised(values, sigmas[i], removed)
    return result


def _piecewise_mean(y: Array, order: int) -> Array:
    """Posterior mean of piecewise polynomials in unit noise. y: (signals, N)."""
    signals, count = y.shape
    longest = min(LONGEST_PIECE, count)
    fits = _Fits(y, order, longest)
    log_stay, log_break = np.log1p(-BREAK_RATE), np.log(BREAK_RATE)
    prior = log_break + np.arange(longest) * log_stay  # of a piece of each length, given that it begins
    # score[e, n-1]: of the piece of n samples that ends before e; begin[s, n-1]: of the piece that begins at s
    score = fits.evidence + prior
    begin = np.full((count, signals, longest), -np.inf)
    for n in range(1, longest + 1):
        begin[: count - n + 1, :, n - 1] = score[n:, :, n - 1]
    forward = np.full((count + 1, signals), -np.inf)  # log evidence of y[:k] with a break at k
    forward[0] = 0.0
    for k in range(1, count + 1):
        n = min(k, longest)
        forward[k] = _log_sum(forward[k - n : k][::-1].T + score[k, :, :n])
    backward = np.full((count + 1, signals), -np.inf)
    backward[count] = 0.0
    for k in range(count - 1, -1, -1):
        n = min(count - k, longest)
        backward[k] = _log_sum(backward[k + 1 : k + n + 1].T + begin[k, :, :n])
    return fits.average(forward, backward, score)


def _log_sum(terms: Array) -> Array:
    top = terms.max(axis=1)
    return np.asarray(top + np.log(np.exp(terms - top[:, None]).sum(axis=1)))


class _Fits:
    """Least-squares polynomials on every stretch y[:, e-n:e] up to `longest` samples, from running sums."""

    def __init__(self, y: Array, order: int, longest: int) -> None:
        self.order, self.longest = order, longest
        signals, count = y.shape
        terms = order + 1
        self.offset = np.median(y, axis=1, keepdims=True)
        w = y - self.offset
        # amplitude prior: coefficients wide compared with the data, so that its size hardly matters
        width = np.maximum(10.0, 3.0 * np.std(w, axis=1))
        self.evidence = np.full((count + 1, signals, longest), -np.inf)
        self.moments: list[Array] = []
        self.bases, self.inverses = [], []
        square = np.concatenate([np.zeros((signals, 1)), np.cumsum(w**2, axis=1)], axis=1)
        common = float(np.median(width))  # one width for all signals: one inverse for each length
        for n in range(1, longest + 1):
            basis = _basis(n, order)
            gram = basis.T @ basis + np.eye(terms) / common**2
            inverse = np.linalg.inv(gram)
            windows = np.lib.stride_tricks.sliding_window_view(w, n, axis=1)
            moments = windows @ basis  # (signals, count - n + 1, terms), of the stretch ending at n, n+1, ...
            explained = np.einsum("sij,jk,sik->is", moments, inverse, moments, optimize=["einsum_path", (0, 1), (0, 1)])
            energy = (square[:, n:] - square[:, :-n]).T
            constant = -0.5 * np.linalg.slogdet(gram)[1] - terms * np.log(common)
            self.evidence[n:, :, n - 1] = constant - 0.5 * (energy - explained)
            self.moments.append(moments)
            self.bases.append(basis)
            self.inverses.append(inverse)

    def average(self, forward: Array, backward: Array, score: Array) -> Array:
        """Mean over segmentations of the fitted curves, (signals, N)."""
        count, signals = forward.shape[0] - 1, forward.shape[1]
        total, weight = np.zeros(signals * count), np.zeros(signals * count)
        evidence = forward[count]
        for n in range(1, self.longest + 1):
            log_p = forward[: count - n + 1] + score[n:, :, n - 1] + backward[n:] - evidence
            begins, which = np.nonzero(log_p > -16.0)
            if not begins.size:
                continue
            p = np.exp(np.minimum(log_p[begins, which], 0.0))
            moments = self.moments[n - 1][which, begins]
            curves = (moments * p[:, None]) @ self.inverses[n - 1] @ self.bases[n - 1].T
            where = (which * count + begins)[:, None] + np.arange(n)[None, :]
            total += np.bincount(where.ravel(), curves.ravel(), total.size)
            weight += np.bincount(where.ravel(), np.repeat(p, n), total.size)
        return (total / weight).reshape(signals, count) + self.offset


def _basis(n: int, order: int) -> Array:
    t = np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1)
    return np.stack([t**k for k in range(order + 1)], axis=1)
