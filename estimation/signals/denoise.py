"""Noise off the measured inputs without touching an edge.

Output error takes its inputs for truth, so jitter on a potentiometer becomes coloured residuals and false names. The
method: the signal is piecewise polynomial (straight for controls, parabolic for motion variables) with unknown break
points; the estimate is the mean over all segmentations weighted by their probability (exact forward and backward
recursions; Fearnhead 2006, Statistics and Computing 16, 203-213, with Gaussian noise of known variance), and draws are made by
running the recursion backwards. A sharp edge gets a break with probability near one and stays where it was; a quiet stretch is
averaged over its whole length.

The noise level comes from the signal itself (`noise_level`), so nothing need be known of the sensor.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST_PIECE = 80  # samples; longer quiet stretches are joined from pieces, at little cost in noise
LEAST = 5  # third differences, for a level to be told
IN_A_ROW = 40  # of them with nothing missing, for those across what is missing to be left out
QUIET = 3e-4  # of the range of a signal: noise below this is left alone
ROUNDING = 1e-12  # of its size: a constant behind a filter is no noisy signal, and takes no draws from those that are
BLOCK = 640  # samples of a long signal treated at once
RESCALE = 12  # steps between rescalings of the recursions
ROWS = 24  # blocks treated at once
BREAK_RATE = 1.0 / 25.0  # prior probability of a break at a sample


@dataclass(frozen=True, slots=True)
class Denoised:
    """values: (N,) the signal without its noise; noise: estimated standard deviation; removed: rms of what was taken.

    errors: (draws, N), what may still be wrong with `values`: draws from the posterior less its mean.
    """

    values: Array
    noise: float
    removed: float
    errors: Array = field(default_factory=lambda: np.zeros((0, 0)))


def noise_level(values: Array) -> float:
    """Standard deviation of the white part of a sampled signal, robust against edges and manoeuvres.

    Median of absolute third differences over samples in a row, scaled for Gaussian noise (sum of squares of
    1 -3 3 -1 is 20). Zero for a signal without noise. values: (N,), NaN where not measured: of four in a row where these are
    enough, or else of those that were measured, as if they were in a row.
    """
    third = np.abs(np.diff(values, 3))
    third = third[np.isfinite(third)]
    if third.size < IN_A_ROW and not np.isfinite(values).all():
        third = np.abs(np.diff(values[np.isfinite(values)], 3))
    if third.size < LEAST:
        return 0.0
    return float(np.median(third) / 0.6744897501960817 / np.sqrt(20.0))


def denoise(values: Array, *, order: int = 1, noise: float | None = None) -> Denoised:
    """Edge-preserving estimate of a signal in white noise. values: (N,) evenly sampled, finite; order: of the pieces."""
    return denoise_many([values], order=order, noise=noise)[0]


def denoise_many(
    signals: Sequence[Array],
    *,
    order: int = 1,
    noise: float | None = None,
    draws: int = 0,
    rng: np.random.Generator | None = None,
) -> list[Denoised]:
    """`denoise` of several signals; those of equal length cost together little more than one.

    draws: how many `errors` to draw with `rng`; all zero for a signal that is left alone.
    """
    sigmas = [noise_level(v) if noise is None else noise for v in signals]
    noisy = [i for i, (v, s) in enumerate(zip(signals, sigmas, strict=True)) if v.size >= 8 and s > _least_noise(v)]
    result = [Denoised(v.copy(), s, 0.0, np.zeros((draws, v.size))) for v, s in zip(signals, sigmas, strict=True)]
    smooth = _in_blocks([signals[i] / sigmas[i] for i in noisy], order, draws, rng or np.random.default_rng(0))
    for (row, errors), i in zip(smooth, noisy, strict=True):
        values = row * sigmas[i]
        removed = float(np.sqrt(np.mean((signals[i] - values) ** 2)))
        result[i] = Denoised(values, sigmas[i], removed, errors * sigmas[i])
    return result


def _least_noise(values: Array) -> float:
    """Standard deviation of noise from which a signal is made smooth. values: (N,) finite."""
    return max(QUIET * float(np.ptp(values)), ROUNDING * float(np.abs(values).max(initial=0.0)))


def _in_blocks(signals: Sequence[Array], order: int, draws: int, rng: np.random.Generator) -> list[tuple[Array, Array]]:
    """Piecewise means of signals of any lengths, and errors: long ones in overlapping blocks, equal blocks together."""
    result = [(np.empty_like(v), np.empty((draws, v.size))) for v in signals]
    blocks: dict[int, list[tuple[int, int, int, int]]] = {}  # length -> (signal, start, first kept, end kept)
    for i, v in enumerate(signals):
        for start, stop, first, end in _blocks(v.size):
            blocks.setdefault(stop - start, []).append((i, start, first, end))
    for length, rows in blocks.items():
        for k in range(0, len(rows), ROWS):
            batch = rows[k : k + ROWS]
            stretch = np.stack([signals[i][start : start + length] for i, start, _, _ in batch])
            smooth, errors = _piecewise_mean(stretch, order, draws, rng)
            for row, (i, start, first, end) in enumerate(batch):
                result[i][0][first:end] = smooth[row, first - start : end - start]
                result[i][1][:, first:end] = errors[:, row, first - start : end - start]
    return result


def _blocks(size: int) -> list[tuple[int, int, int, int]]:
    """(start, stop, first kept, end kept) of blocks that overlap by the longest piece on both sides."""
    if size <= 2 * BLOCK:
        return [(0, size, 0, size)]
    starts = [*range(0, size - BLOCK, BLOCK - 2 * LONGEST_PIECE), size - BLOCK]
    bounds = [s + LONGEST_PIECE if s else 0 for s in starts] + [size]
    return [(s, s + BLOCK, a, b) for s, a, b in zip(starts, bounds[:-1], bounds[1:], strict=True)]


def _piecewise_mean(y: Array, order: int, draws: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Posterior mean (signals, N) of piecewise polynomials in unit noise, and draws less the mean (draws, signals, N)."""
    signals, count = y.shape
    longest = min(LONGEST_PIECE, count)
    fits = Fits(y, order, longest)
    log_stay, log_break = np.log1p(-BREAK_RATE), np.log(BREAK_RATE)
    prior = log_break + np.arange(longest) * log_stay  # of a piece of each length, given that it begins
    # score[e, :, n-1]: of the piece of n samples that ends before e. `weight` has, behind it and backwards in time,
    # that of the one that begins there.
    # Raised by 1/2 per sample, the usual loss of a good fit, so that the recursions stay within double precision.
    score = fits.evidence + (prior + 0.5 * np.arange(1, longest + 1))
    weight = np.zeros((count, 2 * signals, longest))
    np.exp(score[1:], out=weight[:, :signals])
    for n in range(1, longest + 1):
        weight[n - 1 :, signals:, n - 1] = weight[n - 1 :, :signals, n - 1][::-1]
    sums = _recursion(weight)  # in one loop over the samples
    forward, backward = sums[:, :signals], sums[::-1, signals:]
    mean = fits.average(forward, backward, score)
    return mean, fits.draw(forward, score, draws, rng) - mean if draws else np.zeros((0, *mean.shape))


def _recursion(weight: Array) -> Array:
    """log a[k] of a[k] = sum over n of weight[k-1, :, n-1] a[k-n], a[0] = 1; weight (N, signals, L), result (N+1, signals)."""
    count, signals, longest = weight.shape
    # newest value last, so that a window of the past is a plain slice; rescaled before it can leave double precision
    values = np.zeros((signals, count + longest))
    values[:, longest - 1] = 1.0
    scale = np.zeros(signals)
    result = np.zeros((count + 1, signals))
    flipped = np.ascontiguousarray(weight[:, :, ::-1])
    for k in range(count):
        value = np.einsum("sn,sn->s", flipped[k], values[:, k : k + longest])
        values[:, k + longest] = value
        result[k + 1] = value
        if k % RESCALE == RESCALE - 1 or k == count - 1:
            first = k - k % RESCALE
            result[first + 1 : k + 2] = np.log(result[first + 1 : k + 2]) + scale
            values[:, k + 1 : k + longest + 1] /= value[:, None]
            scale += np.log(value)
    return result


class Fits:
    """Least-squares polynomials on every stretch y[:, e-n:e] up to `longest` samples, from running sums.

    y: (signals, N) in units of the noise. evidence: (N+1, signals, longest), log evidence of the stretch of n samples that
    ends before e at [e, :, n-1].
    """

    def __init__(self, y: Array, order: int, longest: int) -> None:
        self.order, self.longest = order, longest
        signals, count = y.shape
        terms = order + 1
        self.offset = np.median(y, axis=1, keepdims=True)
        w = y - self.offset
        # amplitude prior: coefficients wide compared with the data, so that its size hardly matters
        width = float(np.max(np.maximum(10.0, 3.0 * np.std(w, axis=1))))
        time = np.arange(count) - 0.5 * count
        zero = np.zeros((signals, 1))
        sums = [np.concatenate([zero, np.cumsum(w * time**k, axis=1)], axis=1) for k in range(terms)]
        square = np.concatenate([zero, np.cumsum(w**2, axis=1)], axis=1)
        self.evidence = by_length(count + 1, signals, longest)
        self.moments: list[list[Array]] = []  # of every length: terms of (signals, stretches)
        self.local: list[list[Array]] = []  # coefficients, alike
        grams = _grams(longest, order) + np.eye(terms) / width**2
        self.inverses: Array = np.asarray(np.linalg.inv(grams), np.float64)
        constants = -0.5 * np.linalg.slogdet(grams)[1] - terms * np.log(width)
        for n in range(1, longest + 1):
            inverse = self.inverses[n - 1]
            moments = _centred([c[:, n:] - c[:, :-n] for c in sums], time[: count - n + 1] + 0.5 * (n - 1), n)
            local = [sum(inverse[i, j] * moments[j] for j in range(terms)) for i in range(terms)]
            explained = sum(m * c for m, c in zip(moments, local, strict=True))
            energy = square[:, n:] - square[:, :-n]
            self.evidence[n:, :, n - 1] = (constants[n - 1] - 0.5 * (energy - explained)).T
            self.moments.append(moments)
            self.local.append(local)

    def average(self, forward: Array, backward: Array, score: Array) -> Array:
        """Mean over segmentations of the fitted curves, (signals, N).

        Each stretch adds its polynomial between its ends: coefficients in common time, entered at one end and taken
        out at the other, summed up once.
        """
        count, signals = forward.shape[0] - 1, forward.shape[1]
        change = np.zeros((self.order + 2, signals, count + 1))
        evidence = forward[count]
        time = np.arange(count) - 0.5 * count
        for n in range(1, self.longest + 1):
            log_p = forward[: count - n + 1] + score[n:, :, n - 1] + backward[n:] - evidence
            p = np.exp(np.minimum(log_p, 0.0)).T
            centre = time[: count - n + 1] + 0.5 * (n - 1)
            common = _common(self.local[n - 1], centre, 0.5 * (n - 1) if n > 1 else 1.0)
            for k, entry in enumerate([p, *(p * c for c in common)]):
                change[k, :, : count - n + 1] += entry
                change[k, :, n:] -= entry
        running = np.cumsum(change[:, :, :-1], axis=2)
        value = sum(running[k + 1] * time**k for k in range(self.order + 1))
        return np.asarray(value / running[0] + self.offset)

    def draw(self, forward: Array, score: Array, draws: int, rng: np.random.Generator) -> Array:
        """Curves drawn from the posterior, (draws, signals, N): break points backwards from the end, then a polynomial
        for each stretch.

        forward: (N+1, signals) log weight of all segmentations of the samples before e; score: as `evidence`, with the
        prior of the stretch.
        """
        count, signals, terms = forward.shape[0] - 1, forward.shape[1], self.order + 1
        moments = np.zeros((self.longest, count, signals, terms))
        for n in range(1, self.longest + 1):
            moments[n - 1, : count - n + 1] = np.array(self.moments[n - 1]).transpose(2, 1, 0)
        inverses, roots = self.inverses, np.linalg.cholesky(self.inverses)
        padded = np.concatenate([np.full((self.longest, signals), -np.inf), forward])
        lengths = np.arange(1, self.longest + 1)
        time = np.arange(count) - 0.5 * count
        change = np.zeros((count + 1, draws * signals, terms))
        signal, end = np.tile(np.arange(signals), draws), np.full(draws * signals, count)
        live = np.arange(end.size)
        while live.size:
            e, s = end[live], signal[live]
            log_p = padded[e[:, None] + self.longest - lengths, s[:, None]] + score[e, s] - forward[e, s][:, None]
            cumulative = np.cumsum(np.exp(log_p), axis=1)
            n = 1 + np.sum(cumulative < rng.random(live.size)[:, None] * cumulative[:, -1:], axis=1)
            n = np.minimum(n, self.longest)
            begin = e - n
            white = rng.standard_normal((live.size, terms))
            local = np.einsum("rij,rj->ri", inverses[n - 1], moments[n - 1, begin, s])
            local += np.einsum("rij,rj->ri", roots[n - 1], white)
            entry = np.stack(_common(local.T, time[begin] + 0.5 * (n - 1), np.where(n > 1, 0.5 * (n - 1), 1.0)), axis=1)
            change[begin, live] += entry
            change[e, live] -= entry
            end[live] = begin
            live = live[begin > 0]
        running = np.cumsum(change[:-1], axis=0)
        value = sum(running[:, :, k] * time[:, None] ** k for k in range(terms))
        return np.asarray(value).T.reshape(draws, signals, count) + self.offset


def _common(local: Sequence[Array] | Array, centre: Array, half: float | Array) -> list[Array]:
    """Coefficients in common time of polynomials in (t - centre) / half. local: (terms, stretches, ...)."""
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


def by_length(rows: int, signals: int, longest: int) -> Array:
    """(rows, signals, longest) of -inf, laid out so that all stretches of one length lie together."""
    return np.moveaxis(np.full((longest, rows, signals), -np.inf), 0, 2)


def _centred(sums: Sequence[Array], centre: Array, n: int) -> list[Array]:
    """Moments, each (signals, stretches), about the centres in units of half a stretch, from moments about the origin."""
    half = 0.5 * (n - 1) if n > 1 else 1.0
    moments = [sums[0]]
    if len(sums) > 1:
        moments.append((sums[1] - centre * sums[0]) / half)
    if len(sums) > 2:
        moments.append((sums[2] - 2.0 * centre * sums[1] + centre**2 * sums[0]) / half**2)
    return moments


@cache
def _grams(longest: int, order: int) -> Array:
    """(longest, terms, terms) inner products of the powers on pieces of 1, 2, ... samples, from -1 to 1."""
    bases = [_basis(n, order) for n in range(1, longest + 1)]
    return np.stack([basis.T @ basis for basis in bases])


def _basis(n: int, order: int) -> Array:
    t = np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1)
    return np.stack([t**k for k in range(order + 1)], axis=1)
