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
QUIET = 3e-4  # of the range of a signal: noise below this is left alone
BLOCK = 640  # samples of a long signal treated at once
RESCALE = 12  # steps between rescalings of the recursions
ROWS = 24  # blocks treated at once
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
    """`denoise` of several signals; those of equal length cost together little more than one."""
    sigmas = [noise_level(v) if noise is None else noise for v in signals]
    noisy = [i for i, (v, s) in enumerate(zip(signals, sigmas, strict=True)) if v.size >= 8 and s > QUIET * np.ptp(v)]
    result = [Denoised(v.copy(), s, 0.0) for v, s in zip(signals, sigmas, strict=True)]
    smooth = _in_blocks([signals[i] / sigmas[i] for i in noisy], order)
    for row, i in zip(smooth, noisy, strict=True):
        values = row * sigmas[i]
        removed = float(np.sqrt(np.mean((signals[i] - values) ** 2)))
        result[i] = Denoised(values, sigmas[i], removed)
    return result


def _in_blocks(signals: Sequence[Array], order: int) -> list[Array]:
    """Piecewise means of signals of any lengths: long ones in overlapping blocks, equal blocks together."""
    result = [np.empty_like(v) for v in signals]
    blocks: dict[int, list[tuple[int, int, int, int]]] = {}  # length -> (signal, start, first kept, end kept)
    for i, v in enumerate(signals):
        for start, stop, first, end in _blocks(v.size):
            blocks.setdefault(stop - start, []).append((i, start, first, end))
    for length, rows in blocks.items():
        for k in range(0, len(rows), ROWS):
            batch = rows[k : k + ROWS]
            smooth = _piecewise_mean(np.stack([signals[i][start : start + length] for i, start, _, _ in batch]), order)
            for (i, start, first, end), values in zip(batch, smooth, strict=True):
                result[i][first:end] = values[first - start : end - start]
    return result


def _blocks(size: int) -> list[tuple[int, int, int, int]]:
    """(start, stop, first kept, end kept) of blocks that overlap by the longest piece on both sides."""
    if size <= 2 * BLOCK:
        return [(0, size, 0, size)]
    starts = [*range(0, size - BLOCK, BLOCK - 2 * LONGEST_PIECE), size - BLOCK]
    kept = [s + LONGEST_PIECE if s else 0 for s in starts] + [size]
    return [(s, s + BLOCK, a, b) for s, a, b in zip(starts, kept[:-1], kept[1:], strict=True)]


def _piecewise_mean(y: Array, order: int) -> Array:
    """Posterior mean of piecewise polynomials in unit noise. y: (signals, N)."""
    signals, count = y.shape
    longest = min(LONGEST_PIECE, count)
    fits = _Fits(y, order, longest)
    log_stay, log_break = np.log1p(-BREAK_RATE), np.log(BREAK_RATE)
    prior = log_break + np.arange(longest) * log_stay  # of a piece of each length, given that it begins
    # score[e, :, n-1]: of the piece of n samples that ends before e; begin[s, :, n-1]: of the one that begins at s.
    # Raised by 1/2 per sample, the usual loss of a good fit, so that the recursions stay within double precision.
    score = fits.evidence + (prior + 0.5 * np.arange(1, longest + 1))
    begin = np.full((count, signals, longest), -np.inf)
    for n in range(1, longest + 1):
        begin[: count - n + 1, :, n - 1] = score[n:, :, n - 1]
    forward = _recursion(np.exp(score[1:, :, :]))
    backward = _recursion(np.exp(begin[::-1]))[::-1]
    return fits.average(forward, backward, score)


def _recursion(weight: Array) -> Array:
    """log a[k] of a[k] = sum over n of weight[k-1, :, n-1] a[k-n], a[0] = 1; weight (N, signals, L), result (N+1, signals)."""
    count, signals, longest = weight.shape
    # newest value last, so that a window of the past is a plain slice; rescaled before it can leave double precision
    past = np.zeros((signals, count + longest))
    past[:, longest - 1] = 1.0
    scale = np.zeros(signals)
    result = np.zeros((count + 1, signals))
    flipped = np.ascontiguousarray(weight[:, :, ::-1])
    for k in range(count):
        value = np.einsum("sn,sn->s", flipped[k], past[:, k : k + longest])
        past[:, k + longest] = value
        result[k + 1] = value
        if k % RESCALE == RESCALE - 1 or k == count - 1:
            first = k - k % RESCALE
            result[first + 1 : k + 2] = np.log(result[first + 1 : k + 2]) + scale
            past[:, k + 1 : k + longest + 1] /= value[:, None]
            scale += np.log(value)
    return result


class _Fits:
    """Least-squares polynomials on every stretch y[:, e-n:e] up to `longest` samples, from running sums."""

    def __init__(self, y: Array, order: int, longest: int) -> None:
        self.order, self.longest = order, longest
        signals, count = y.shape
        terms = order + 1
        self.offset = np.median(y, axis=1, keepdims=True)
        w = y - self.offset
        # amplitude prior: coefficients wide compared with the data, so that its size hardly matters
        width = float(np.max(np.maximum(10.0, 3.0 * np.std(w, axis=1))))
        at = np.arange(count) - 0.5 * count
        zero = np.zeros((signals, 1))
        sums = [np.concatenate([zero, np.cumsum(w * at**k, axis=1)], axis=1) for k in range(terms)]
        square = np.concatenate([zero, np.cumsum(w**2, axis=1)], axis=1)
        self.evidence = np.full((count + 1, signals, longest), -np.inf)
        self.moments: list[Array] = []
        self.inverses: list[Array] = []
        for n in range(1, longest + 1):
            basis = _basis(n, order)
            gram = basis.T @ basis + np.eye(terms) / width**2
            inverse: Array = np.linalg.inv(gram).astype(np.float64)
            moments = _centred([c[:, n:] - c[:, :-n] for c in sums], at[: count - n + 1] + 0.5 * (n - 1), n)
            explained = np.sum((moments @ inverse) * moments, axis=2).T
            energy = (square[:, n:] - square[:, :-n]).T
            constant = -0.5 * np.linalg.slogdet(gram)[1] - terms * np.log(width)
            self.evidence[n:, :, n - 1] = constant - 0.5 * (energy - explained)
            self.moments.append(moments)
            self.inverses.append(inverse)

    def average(self, forward: Array, backward: Array, score: Array) -> Array:
        """Mean over segmentations of the fitted curves, (signals, N).

        Each stretch adds its polynomial between its ends: coefficients in common time, entered at one end and taken
        out at the other, summed up once.
        """
        count, signals = forward.shape[0] - 1, forward.shape[1]
        change = np.zeros((count + 1, signals, self.order + 2))
        evidence = forward[count]
        at = np.arange(count) - 0.5 * count
        for n in range(1, self.longest + 1):
            log_p = forward[: count - n + 1] + score[n:, :, n - 1] + backward[n:] - evidence
            p = np.exp(np.minimum(log_p, 0.0))
            centre = at[: count - n + 1] + 0.5 * (n - 1)
            local = self.moments[n - 1] @ self.inverses[n - 1]
            terms = [p, *(p * c for c in _common(local.transpose(2, 1, 0), centre[:, None], n))]
            entry = np.stack(terms, axis=2)
            change[: count - n + 1] += entry
            change[n:] -= entry
        running = np.cumsum(change[:-1], axis=0)
        value = sum(running[:, :, k + 1] * at[:, None] ** k for k in range(self.order + 1))
        return np.asarray((value / running[:, :, 0]).T + self.offset)


def _common(local: Array, centre: Array, n: int) -> list[Array]:
    """Coefficients in common time of polynomials in (t - centre) / half. local: (terms, stretches, signals)."""
    half = 0.5 * (n - 1) if n > 1 else 1.0
    shift = centre / half
    if len(local) == 1:
        return [local[0]]
    if len(local) == 2:
        return [local[0] - local[1] * shift, local[1] / half]
    return [
        local[0] - local[1] * shift + local[2] * shift**2,
        (local[1] - 2.0 * local[2] * shift) / half,
        local[2] / half**2,
    ]


def _centred(sums: Sequence[Array], centre: Array, n: int) -> Array:
    """Moments (signals, stretches, terms) about the centres in units of half a stretch, from moments about the origin."""
    half = 0.5 * (n - 1) if n > 1 else 1.0
    moments = [sums[0]]
    if len(sums) > 1:
        moments.append((sums[1] - centre * sums[0]) / half)
    if len(sums) > 2:
        moments.append((sums[2] - 2.0 * centre * sums[1] + centre**2 * sums[0]) / half**2)
    return np.stack(moments, axis=2)


def _basis(n: int, order: int) -> Array:
    t = np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1)
    return np.stack([t**k for k in range(order + 1)], axis=1)
