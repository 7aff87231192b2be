"""Stretches of a flight over which slow errors are straight lines, and how one signal follows another in them."""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WINDOW = 4.0
"""Length [s]: the drift of an integrated rate or acceleration is a straight line in it."""


def summed(time: Array, values: Array) -> Array:
    """Integral by the trapezoidal rule, from 0."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])


def windows(time: Array, *values: Array) -> Iterator[tuple[Array, ...]]:
    """Stretches of WINDOW seconds in which all is measured and time rises."""
    start = 0
    while start < time.size - 10:
        stop = int(np.searchsorted(time, time[start] + WINDOW))
        part = [v[start:stop] for v in (time, *values)]
        start = max(stop, start + 1)
        if part[0].size >= 10 and all(np.all(np.isfinite(v)) for v in part) and np.all(np.diff(part[0]) > 0):
            yield tuple(part)


def line(pairs: Iterable[tuple[Array, Array]]) -> tuple[float, float]:
    """Slope of y against x, and the share of y it explains, with a straight line in time removed from each window."""
    top = bottom = rest = 0.0
    for x, y in pairs:
        trend = np.vander(np.linspace(-1.0, 1.0, x.size), 2)
        x, y = (v - trend @ np.linalg.lstsq(trend, v, rcond=None)[0] for v in (x, y))
        top, bottom, rest = top + float(x @ y), bottom + float(x @ x), rest + float(y @ y)
    if bottom <= 0 or rest <= 0:
        return 0.0, 0.0
    return top / bottom, top * top / (bottom * rest)
