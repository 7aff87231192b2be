"""Innovations made white: a vector autoregression of second order, fitted to simulated flights.

What a prediction over a long interval gets wrong, or over one in which a surface moves, is larger than elsewhere, so every kind
of interval has a covariance of its own. With one for all, the edges between the scans of a link make the tails of every score.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.identification.monitor.intervals import BLIND, KINDS, Kinds

Array = NDArray[np.float64]

ORDER = 2
AS_IF = 100.0  # scans of the usual covariance that are added to those of a kind: seldom ones are like all others
PASSES = 3  # weights and covariances need each other


@dataclass(frozen=True)
class Whitening:
    """w(t) = shape[kind] (e(t) - first e(t-1) - second e(t-2)), covariance one; nothing where the kind is blind.
    first, second: (5, 5); shape: (kinds, 5, 5)."""

    first: Array
    second: Array
    shape: Array

    def applied(self, now: Array, before: Array, earlier: Array, kind: Kinds) -> Array:
        """Three in a row, (5, ..., flights): the white one, same shape. kind: (flights,)."""
        rest = now - np.tensordot(self.first, before, 1) - np.tensordot(self.second, earlier, 1)
        return np.einsum("fij,j...f->i...f", self.shape[kind], rest)


Run = tuple[Array, Kinds]
"""Innovations (scans, 5, flights), and of each the kind of its interval (scans, flights)."""


def fitted(runs: Iterable[Run]) -> Whitening:
    """From stretches without gaps: least squares over all of them, each scan with the weight of its kind, whose covariance
    comes from what that leaves."""
    kept = list(runs)
    weight = np.ones(KINDS)
    for _ in range(PASSES):
        weight[BLIND] = 0.0
        first, second = _autoregression(kept, weight)
        covariance, usual = _covariances(kept, first, second)
        weight = len(usual) / np.einsum("ij,kji->k", np.linalg.inv(usual), covariance)
    shape = np.linalg.inv(np.linalg.cholesky(covariance))
    shape[BLIND] = 0.0
    return Whitening(first, second, shape)


def _autoregression(runs: Iterable[Run], weight: Array) -> tuple[Array, Array]:
    cross: Array | float = 0.0
    own: Array | float = 0.0
    for e, kind in runs:
        lagged = np.concatenate([e[1:-1], e[:-2]], axis=1)  # (scans - 2, 10, flights)
        weighted = lagged * weight[kind[2:]][:, None, :]
        cross = cross + np.einsum("tif,tjf->ij", e[2:], weighted)
        own = own + np.einsum("tif,tjf->ij", lagged, weighted)
    both = np.linalg.solve(np.asarray(own), np.asarray(cross).T).T
    channels = both.shape[0]
    return both[:, :channels], both[:, channels:]


def _covariances(runs: Iterable[Run], first: Array, second: Array) -> tuple[Array, Array]:
    """(kinds, 5, 5) of each kind, and the usual one."""
    channels = first.shape[0]
    sums, counts = np.zeros((KINDS, channels, channels)), np.zeros(KINDS)
    for e, kinds in runs:
        rest = e[2:] - np.einsum("ij,tjf->tif", first, e[1:-1]) - np.einsum("ij,tjf->tif", second, e[:-2])
        flat, kind = rest.transpose(0, 2, 1).reshape(-1, channels), kinds[2:].ravel()
        for k in set(np.unique(kind).tolist()) - {BLIND}:
            mine = flat[kind == k]
            sums[k] += mine.T @ mine
            counts[k] += len(mine)
    usual = sums.sum(axis=0) / counts.sum()
    return (sums + AS_IF * usual) / (counts + AS_IF)[:, None, None], usual
