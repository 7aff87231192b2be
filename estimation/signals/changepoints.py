"""Piecewise polynomials with unknown break points: every stretch fitted, averaged over and drawn from.

The arithmetic behind `estimation.signals.preprocess` (Fearnhead 2006, Statistics and Computing 16, 203-213): sums over all
segmentations by recursion, and exact draws of segmentations by running it backwards.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
        at = np.arange(count) - 0.5 * count
        zero = np.zeros((signals, 1))
        sums = [np.concatenate([zero, np.cumsum(w * at**k, axis=1)], axis=1) for k in range(terms)]
        square = np.concatenate([zero, np.cumsum(w**2, axis=1)], axis=1)
        self.evidence = by_length(count + 1, signals, longest)
        self.moments: list[list[Array]] = []  # of every length: terms of (signals, stretches)
        self.local: list[list[Array]] = []  # coefficients, alike
        self.inverses: list[Array] = []
        for n in range(1, longest + 1):
            basis = _basis(n, order)
            gram = basis.T @ basis + np.eye(terms) / width**2
            inverse: Array = np.linalg.inv(gram).astype(np.float64)
            moments = _centred([c[:, n:] - c[:, :-n] for c in sums], at[: count - n + 1] + 0.5 * (n - 1), n)
            local = [sum(inverse[i, j] * moments[j] for j in range(terms)) for i in range(terms)]
            explained = sum(m * c for m, c in zip(moments, local, strict=True))
            energy = square[:, n:] - square[:, :-n]
            constant = -0.5 * np.linalg.slogdet(gram)[1] - terms * np.log(width)
            self.evidence[n:, :, n - 1] = (constant - 0.5 * (energy - explained)).T
            self.moments.append(moments)
            self.local.append(local)
            self.inverses.append(inverse)

    def average(self, forward: Array, backward: Array, score: Array) -> Array:
        """Mean over segmentations of the fitted curves, (signals, N).

        Each stretch adds its polynomial between its ends: coefficients in common time, entered at one end and taken
        out at the other, summed up once.
        """
        count, signals = forward.shape[0] - 1, forward.shape[1]
        change = np.zeros((self.order + 2, signals, count + 1))
        evidence = forward[count]
        at = np.arange(count) - 0.5 * count
        for n in range(1, self.longest + 1):
            log_p = forward[: count - n + 1] + score[n:, :, n - 1] + backward[n:] - evidence
            p = np.exp(np.minimum(log_p, 0.0)).T
            centre = at[: count - n + 1] + 0.5 * (n - 1)
            common = _common(self.local[n - 1], centre, 0.5 * (n - 1) if n > 1 else 1.0)
            for k, entry in enumerate([p, *(p * c for c in common)]):
                change[k, :, : count - n + 1] += entry
                change[k, :, n:] -= entry
        running = np.cumsum(change[:, :, :-1], axis=2)
        value = sum(running[k + 1] * at**k for k in range(self.order + 1))
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
        inverses = np.stack(self.inverses)
        roots = np.linalg.cholesky(inverses)
        before = np.concatenate([np.full((self.longest, signals), -np.inf), forward])
        back = np.arange(1, self.longest + 1)
        at = np.arange(count) - 0.5 * count
        change = np.zeros((count + 1, draws * signals, terms))
        signal, end = np.tile(np.arange(signals), draws), np.full(draws * signals, count)
        live = np.arange(end.size)
        while live.size:
            e, s = end[live], signal[live]
            log_p = before[e[:, None] + self.longest - back, s[:, None]] + score[e, s] - forward[e, s][:, None]
            reached = np.cumsum(np.exp(log_p), axis=1)
            n = 1 + np.sum(reached < rng.random(live.size)[:, None] * reached[:, -1:], axis=1)
            n = np.minimum(n, self.longest)
            begin = e - n
            white = rng.standard_normal((live.size, terms))
            local = np.einsum("rij,rj->ri", inverses[n - 1], moments[n - 1, begin, s])
            local += np.einsum("rij,rj->ri", roots[n - 1], white)
            entry = np.stack(_common(local.T, at[begin] + 0.5 * (n - 1), np.where(n > 1, 0.5 * (n - 1), 1.0)), axis=1)
            change[begin, live] += entry
            change[e, live] -= entry
            end[live] = begin
            live = live[begin > 0]
        running = np.cumsum(change[:-1], axis=0)
        value = sum(running[:, :, k] * at[:, None] ** k for k in range(terms))
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


def _basis(n: int, order: int) -> Array:
    t = np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1)
    return np.stack([t**k for k in range(order + 1)], axis=1)
