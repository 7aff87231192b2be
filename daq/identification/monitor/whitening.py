"""Innovations made white: a vector autoregression of second order, fitted to simulated flights."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ORDER = 2


@dataclass(frozen=True)
class Whitening:
    """w(t) = shape (e(t) - first e(t-1) - second e(t-2)), covariance one. (5, 5) each."""

    first: Array
    second: Array
    shape: Array

    def applied(self, now: Array, before: Array, earlier: Array) -> Array:
        """Three in a row, channels first: the white one, same shape."""
        rest = now - np.tensordot(self.first, before, 1) - np.tensordot(self.second, earlier, 1)
        return np.asarray(np.tensordot(self.shape, rest, 1))


def fitted(runs: Iterable[Array]) -> Whitening:
    """From innovations (scans, 5, flights) of stretches without gaps: least squares over all of them."""
    channels, cross, own, total, count = 0, 0.0, 0.0, 0.0, 0
    kept = list(runs)
    for e in kept:
        channels = e.shape[1]
        lagged = np.concatenate([e[1:-1], e[:-2]], axis=1)  # (scans - 2, 10, flights)
        cross = cross + np.einsum("tif,tjf->ij", e[2:], lagged)
        own = own + np.einsum("tif,tjf->ij", lagged, lagged)
    both = np.linalg.solve(np.asarray(own), np.asarray(cross).T).T
    first, second = both[:, :channels], both[:, channels:]
    for e in kept:
        rest = e[2:] - np.einsum("ij,tjf->tif", first, e[1:-1]) - np.einsum("ij,tjf->tif", second, e[:-2])
        total = total + np.einsum("tif,tjf->ij", rest, rest)
        count += rest.shape[0] * rest.shape[2]
    shape = np.linalg.inv(np.linalg.cholesky(np.asarray(total) / count))
    return Whitening(first, second, shape)
