"""Signals between their samples on a monotone cubic, which never overshoots: an edge stays where it is.

Slopes after Fritsch and Butland, SIAM J. Sci. Stat. Comput. 5 (1984). Those at the two ends are the caller's.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def inner_slopes(chord: Array, step: Array) -> Array:
    """(N - 2, n) slopes at the samples but the first and the last, zero at a peak. chord: (N - 1, n) of each interval; step:
    (N - 1, 1) its length."""
    before, after = chord[:-1], chord[1:]
    same = before * after > 0.0
    w1, w2 = 2.0 * step[1:] + step[:-1], step[1:] + 2.0 * step[:-1]
    mean = w1 / np.where(same, before, 1.0) + w2 / np.where(same, after, 1.0)
    return np.asarray(np.where(same, (w1 + w2) / mean, 0.0))


def half_way(values: Array, slope: Array, step: Array) -> Array:
    """(N - 1, n) values in the middle of each interval. values, slope: (N, n) at the samples; step: (N - 1, 1)."""
    return np.asarray(0.5 * (values[1:] + values[:-1]) + 0.125 * step * (slope[:-1] - slope[1:]))
