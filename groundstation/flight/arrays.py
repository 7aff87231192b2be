"""Sampled arrays: runs of True, unwrapped angles, integrals, and the slope of one signal against another."""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

WINDOW = 4.0  # [s]: the drift of an integrated rate or acceleration is a straight line in it
FEWEST_IN_WINDOW = 10  # samples
ALTERNATING = -0.4  # lag-one correlation of third differences: -0.75 for white noise, positive for a smooth curve
MOST_WINDOWS = 300
"""Of one signal, even in a long record: 20 minutes determine a scale or a sign a hundred times better than needed."""

MAD_TO_SIGMA = 1.4826  # standard deviation of normal noise over its median absolute deviation
REPEATED = 0.3  # share of samples that repeat the last one: 0.27 where noise is one quantum, less where it is more
LONGEST_HOLD = 1.0
"""How long [s] a supply voltage, chip temperature or static pressure is used after it was read, if not in each scan."""


def hold_recent(time: Array, values: Array, longest: float = LONGEST_HOLD) -> Array:
    """A slowly changing auxiliary quantity, held from its last reading for at most `longest` seconds."""
    if not np.isnan(values).any():
        return values
    rows = np.arange(values.size)
    last = np.maximum.accumulate(np.where(np.isfinite(values), rows, -1))
    recent = (last >= 0) & (time - time[last] <= longest)
    return np.where(recent, values[last], np.nan)


def true_runs(mask: Mask, parts: Iterable[slice] | None = None) -> list[tuple[int, int]]:
    """[start, stop) of each run of True in a mask (N,), cut at the borders of parts (all of it is one part by default)."""
    runs: list[tuple[int, int]] = []
    for part in (slice(0, mask.size),) if parts is None else parts:
        edges = np.flatnonzero(np.diff(mask[part].astype(np.int8), prepend=0, append=0)) + part.start
        runs += zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return runs


def longest_run(mask: Mask) -> int:
    """Samples in the longest run of True."""
    return max((stop - start for start, stop in true_runs(mask)), default=0)


def integral(time: Array, rate: Array) -> Array:
    """Running integral of a rate (N,), or of the columns of one (N, m), by the trapezoidal rule, from 0."""
    steps = np.diff(time).reshape(-1, *[1] * (rate.ndim - 1))
    return np.concatenate([np.zeros((1, *rate.shape[1:])), np.cumsum(0.5 * (rate[1:] + rate[:-1]) * steps, axis=0)])


def unwrapped(angle: Array) -> Array:
    """An angle (N,) [rad] without jumps of a whole turn between its finite samples; NaN stays."""
    result, finite = angle.copy(), np.isfinite(angle)
    result[finite] = np.unwrap(angle[finite])
    return result


def windows(time: Array, *signals: Array) -> Iterator[tuple[Array, ...]]:
    """Time and signals in each WINDOW in which all are measured and time rises; in a long record in MOST_WINDOWS of them."""
    every = max(WINDOW, float(np.ptp(time)) / MOST_WINDOWS) if time.size else WINDOW
    start = 0
    while start < time.size - FEWEST_IN_WINDOW:
        stop = int(np.searchsorted(time, time[start] + WINDOW))
        window = [v[start:stop] for v in (time, *signals)]
        start = max(int(np.searchsorted(time, time[start] + every)), start + 1)
        measured = all(np.all(np.isfinite(v)) for v in window)
        if window[0].size >= FEWEST_IN_WINDOW and measured and np.all(np.diff(window[0]) > 0):
            yield tuple(window)


def slope_and_agreement(pairs: Iterable[tuple[Array, Array]]) -> tuple[float, float]:
    """Slope of y against x, and the share of y it explains, with a straight line in time removed from each window."""
    products = np.zeros((2, 2))
    for pair in pairs:
        straight = without_line(np.column_stack(pair))
        products += straight.T @ straight
    (xx, xy), (_, yy) = products.tolist()
    return slope_and_share(xx, xy, yy)


def slope_and_share(xx: float, xy: float, yy: float) -> tuple[float, float]:
    """Slope of y against x, and the share of y it explains, from their sums of products; zeros where one of them is constant."""
    return (xy / xx, xy * xy / (xx * yy)) if xx > 0.0 and yy > 0.0 else (0.0, 0.0)


def without_line(signals: Array) -> Array:
    """(n, m) signals of a window less the straight line in time that is nearest to each. signals: (n, m), n > 1."""
    line = np.linspace(-1.0, 1.0, len(signals))
    return np.asarray(signals - signals.mean(axis=0) - np.outer(line, line @ signals) / (line @ line))


def alternates(third: Array) -> bool:
    """Whether third differences are those of noise rather than of a curve. third: (n,)."""
    size = float(np.quantile(np.abs(third), 0.9))
    calm = np.clip(third, -size, size)  # else the edges of manoeuvres dominate
    calm = calm - calm.mean()
    power = float(calm @ calm)
    return power > 0.0 and float(calm[1:] @ calm[:-1]) / power < ALTERNATING
