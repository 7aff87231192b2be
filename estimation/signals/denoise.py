"""De-noising of measured signals that leaves edges sharp.

Output error takes its inputs for exact, so noise on a potentiometer becomes coloured residuals and false findings. Method: the
signal is piecewise polynomial (straight for controls, parabolic for motion variables) with unknown break points. The estimate
is the mean over all segmentations, weighted by their probability (exact forward and backward recursions; Fearnhead 2006,
Statistics and Computing 16, 203-213, with Gaussian noise of known variance). Running the recursion backwards gives draws. A sharp
edge gets a break with probability near one and stays where it was; a quiet stretch is averaged over its length.

The noise level is estimated from the signal (`noise_level`), so nothing need be known of the sensor. A signal that a converter of
few bits has rounded shows none from sample to sample, but has the errors of its rounding (`estimation.signals.rounding`).

A control that never rests (a multisine, a random sequence of steps) has curves and edges in most samples: its noise is overstated
by third differences, and smoothing takes more signal than noise (0.134 deg of error for 0.071, simulated multisine of up to
2.5 Hz at 20 Hz). `worth_denoising` tells, by an unbiased estimate of the risk; `wiener` filters such a control.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from math import comb, erf, exp, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from estimation.signals.rounding import rounding_noise

Array = NDArray[np.float64]

LONGEST_PIECE = 80  # samples; longer quiet stretches are joined from pieces, at little cost in noise
LEAST = 5  # third differences: fewer give no noise level
IN_A_ROW = 40  # third differences within gap-free samples: with so many, those across gaps are not used
SHORTEST = 8  # samples of a signal that is de-noised
QUIET = 3e-4  # of the range of a signal: noise below this stays
ROUNDING = 1e-12  # of the size of a signal: a filtered constant has only rounding, which must not use up random numbers
NORMAL_MEDIAN = 0.6744897501960817  # median of |x| of a standard normal x
THIRD_DIFFERENCE = 20.0  # variance of the third difference of unit white noise: squares of 1 -3 3 -1
ORDERS = range(1, 9)
"""Of differences: first ones see through many edges, eighth ones through a sine of an eighth of the rate."""
CLIP = 2.5  # standard deviations: one in 80 differences of noise alone is larger; edges mostly are
CLIPPED_VARIANCE = 1.0 - 2.0 * CLIP * exp(-0.5 * CLIP**2) / sqrt(2.0 * pi) / erf(CLIP / sqrt(2.0))
"""Of a standard normal variable within CLIP."""
MOVES, NEAR_MOVE = 4.0, 3  # times the noise, samples: of `moving_share`
TINY = 1e-30  # power of a signal that is zero
NEIGHBOURS = 3  # cosines to either side, whose mean power counts: a line of a multisine is as wide
CLIPPINGS = 30  # usual: 5 to 10
BLOCK = 640  # samples of a long signal treated at once
RESCALE = 12  # steps between rescalings of the recursions
ROWS = 24  # blocks treated at once
BREAK_RATE = 1.0 / 25.0  # prior probability of a break at a sample


@dataclass(frozen=True, slots=True)
class Denoised:
    """values: (N,) the de-noised signal; noise: estimated standard deviation; removed: rms of measured less de-noised values.

    errors: (draws, N) draws of the remaining error of `values`, from the posterior about its mean.
    """

    values: Array
    noise: float
    removed: float
    errors: Array = field(default_factory=lambda: np.zeros((0, 0)))


def noise_level(values: Array) -> float:
    """Standard deviation of the white part of a sampled signal, robust against edges and manoeuvres; at least its rounding.

    Median of absolute third differences, scaled for Gaussian noise; zero for a signal without noise. values: (N,), NaN where
    not measured. Where too few third differences are free of gaps, the measured samples count as consecutive.
    """
    third = np.abs(np.diff(values, 3))
    third = third[np.isfinite(third)]
    if third.size < IN_A_ROW and not np.isfinite(values).all():
        third = np.abs(np.diff(values[np.isfinite(values)], 3))
    if third.size < LEAST:
        return 0.0
    return max(float(np.median(third) / NORMAL_MEDIAN / np.sqrt(THIRD_DIFFERENCE)), rounding_noise(values))


def finest_noise_level(values: Array) -> float:
    """Standard deviation of the white part of a signal that may move all the time: the smallest of what differences of several
    orders say without those that a signal has enlarged. values: (N,) finite."""
    levels = [_clipped_level(np.diff(values, k)) / sqrt(comb(2 * k, k)) for k in ORDERS if values.size >= k + LEAST]
    return max(min(levels, default=0.0), rounding_noise(values))


def _clipped_level(values: Array) -> float:
    """Standard deviation of Gaussian values about zero among larger ones, by those within CLIP times itself."""
    size = np.abs(values)
    level = float(np.median(size)) / NORMAL_MEDIAN
    for _ in range(CLIPPINGS):
        inside = size[size <= CLIP * level]
        before, level = level, sqrt(float(np.mean(inside**2)) / CLIPPED_VARIANCE)
        if abs(level - before) <= 1e-3 * before:
            break
    return level


def moving_share(values: Array, level: float) -> float:
    """Share of the samples of a signal (N,) within three of a change of more than four times its noise `level`."""
    moves = np.abs(np.diff(values, append=values[-1:])) > MOVES * level
    return float(np.mean(np.convolve(moves, np.ones(2 * NEAR_MOVE + 1), "same") > 0.5))


def worth_denoising(denoised: Denoised, level: float) -> bool:
    """Whether a de-noised signal is nearer the truth than the measured one.

    By Stein's unbiased estimate of its mean squared error (C. M. Stein, Annals of Statistics 9 (1981), 1135-1151, theorem 1); the
    derivative of a posterior mean by the measurement is the posterior variance over that of the noise. denoised: with draws of
    its error; level: standard deviation of the noise.
    """
    if denoised.removed == 0.0 or not denoised.errors.size:
        return True
    follows = float(np.mean(denoised.errors**2)) / denoised.noise**2
    return denoised.removed**2 + 2.0 * level**2 * follows < 2.0 * level**2


def wiener(values: Array, level: float, draws: int = 0, rng: np.random.Generator | None = None) -> Denoised:
    """Estimate of a signal that never rests, (N,), in white noise of standard deviation `level`, by Wiener's filter in cosines.

    Each cosine keeps the share of its power that is not noise, so that the error of the estimate is not correlated with it: an
    input with such an error biases no derivative by it, as one with its noise does.
    """
    from scipy.fft import dct, idct

    cosines = dct(values, norm="ortho")
    nearby = np.full(2 * NEIGHBOURS + 1, 1.0 / (2 * NEIGHBOURS + 1))
    power = np.convolve(np.pad(cosines**2, NEIGHBOURS, mode="reflect"), nearby, "valid")
    share = np.maximum(1.0 - level**2 / np.maximum(power, TINY), 0.0)
    share[0] = 1.0  # the mean
    smooth = idct(share * cosines, norm="ortho")
    white = (rng or np.random.default_rng(0)).standard_normal((draws, values.size))
    errors = idct(np.sqrt(share) * level * white, norm="ortho", axis=1)
    return Denoised(smooth, level, float(np.sqrt(np.mean((values - smooth) ** 2))), errors)


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
    """`denoise` of several signals; signals of equal length together cost little more than one.

    draws: how many `errors` to draw with `rng`; all zero for a signal too quiet to be de-noised.
    """
    sigmas = [noise_level(v) if noise is None else noise for v in signals]
    noisy = [
        i for i, (v, s) in enumerate(zip(signals, sigmas, strict=True)) if v.size >= SHORTEST and s > _least_noise(v)
    ]
    result = [Denoised(v.copy(), s, 0.0, np.zeros((draws, v.size))) for v, s in zip(signals, sigmas, strict=True)]
    smooth = _in_blocks([signals[i] / sigmas[i] for i in noisy], order, draws, rng or np.random.default_rng(0))
    for (row, errors), i in zip(smooth, noisy, strict=True):
        values = row * sigmas[i]
        removed = float(np.sqrt(np.mean((signals[i] - values) ** 2)))
        result[i] = Denoised(values, sigmas[i], removed, errors * sigmas[i])
    return result


def _least_noise(values: Array) -> float:
    """Standard deviation of noise from which a signal is de-noised. values: (N,) finite."""
    return max(QUIET * float(np.ptp(values)), ROUNDING * float(np.abs(values).max(initial=0.0)))


def _in_blocks(signals: Sequence[Array], order: int, draws: int, rng: np.random.Generator) -> list[tuple[Array, Array]]:
    """Posterior mean (N,) and errors (draws, N) of each signal: long ones in overlapping blocks, blocks of equal length
    together."""
    result = [(np.empty_like(v), np.empty((draws, v.size))) for v in signals]
    # length of the block -> (signal, start of the block, first and end of the samples used)
    blocks: dict[int, list[tuple[int, int, int, int]]] = {}
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
    """(start, stop, first and end of the samples used) of blocks that overlap by the longest piece on both sides."""
    if size <= 2 * BLOCK:
        return [(0, size, 0, size)]
    starts = [*range(0, size - BLOCK, BLOCK - 2 * LONGEST_PIECE), size - BLOCK]
    bounds = [s + LONGEST_PIECE if s else 0 for s in starts] + [size]
    return [(s, s + BLOCK, a, b) for s, a, b in zip(starts, bounds[:-1], bounds[1:], strict=True)]


def _piecewise_mean(y: Array, order: int, draws: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Posterior mean (signals, N) of piecewise polynomials in unit noise, and draws about it (draws, signals, N)."""
    signals, count = y.shape
    longest = min(LONGEST_PIECE, count)
    fits = _PieceFits(y, order, longest)
    log_stay, log_break = np.log1p(-BREAK_RATE), np.log(BREAK_RATE)
    prior = log_break + np.arange(longest) * log_stay  # log prior of a piece of each length, given its start
    # score[e, :, n-1] belongs to the piece of n samples that ends before e. `weight` has the same for the forward recursion, and
    # behind it, backwards in time, for the backward one. 1/2 per sample, the mean loss of a good fit, is added so that the
    # recursions stay within double precision.
    score = fits.evidence + (prior + 0.5 * np.arange(1, longest + 1))
    weight = np.zeros((count, 2 * signals, longest))
    np.exp(score[1:], out=weight[:, :signals])
    for n in range(1, longest + 1):
        weight[n - 1 :, signals:, n - 1] = weight[n - 1 :, :signals, n - 1][::-1]
    sums = _recursion(weight)
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


class _PieceFits:
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
        # prior of the coefficients: wide compared with the data, so that its width hardly matters
        width = float(np.max(np.maximum(10.0, 3.0 * np.std(w, axis=1))))
        time = np.arange(count) - 0.5 * count
        zero = np.zeros((signals, 1))
        sums = [np.concatenate([zero, np.cumsum(w * time**k, axis=1)], axis=1) for k in range(terms)]
        square = np.concatenate([zero, np.cumsum(w**2, axis=1)], axis=1)
        self.evidence = _by_length(count + 1, signals, longest)
        self.moments: list[list[Array]] = []  # by length, then by term: (signals, stretches)
        self.local: list[list[Array]] = []  # coefficients, in the same order
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

        Each stretch adds its polynomial between its ends: its coefficients, in common time, are added at one end and
        subtracted at the other; one cumulative sum then gives all values.
        """
        count, signals = forward.shape[0] - 1, forward.shape[1]
        change = np.zeros((self.order + 2, signals, count + 1))
        evidence = forward[count]
        time = np.arange(count) - 0.5 * count
        for n in range(1, self.longest + 1):
            log_p = forward[: count - n + 1] + score[n:, :, n - 1] + backward[n:] - evidence
            p = np.exp(np.minimum(log_p, 0.0)).T
            centre = time[: count - n + 1] + 0.5 * (n - 1)
            common = _in_common_time(self.local[n - 1], centre, 0.5 * (n - 1) if n > 1 else 1.0)
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
        unfinished = np.arange(end.size)  # draws that have not reached the first sample
        while unfinished.size:
            e, s = end[unfinished], signal[unfinished]
            log_p = padded[e[:, None] + self.longest - lengths, s[:, None]] + score[e, s] - forward[e, s][:, None]
            cumulative = np.cumsum(np.exp(log_p), axis=1)
            n = 1 + np.sum(cumulative < rng.random(unfinished.size)[:, None] * cumulative[:, -1:], axis=1)
            n = np.minimum(n, self.longest)
            begin = e - n
            white = rng.standard_normal((unfinished.size, terms))
            local = np.einsum("rij,rj->ri", inverses[n - 1], moments[n - 1, begin, s])
            local += np.einsum("rij,rj->ri", roots[n - 1], white)
            entry = np.stack(
                _in_common_time(local.T, time[begin] + 0.5 * (n - 1), np.where(n > 1, 0.5 * (n - 1), 1.0)), axis=1
            )
            change[begin, unfinished] += entry
            change[e, unfinished] -= entry
            end[unfinished] = begin
            unfinished = unfinished[begin > 0]
        running = np.cumsum(change[:-1], axis=0)
        value = sum(running[:, :, k] * time[:, None] ** k for k in range(terms))
        return np.asarray(value).T.reshape(draws, signals, count) + self.offset


def _in_common_time(local: Sequence[Array] | Array, centre: Array, half: float | Array) -> list[Array]:
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


def _by_length(rows: int, signals: int, longest: int) -> Array:
    """(rows, signals, longest) of -inf, in memory by length."""
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
