"""Inputs between two samples of a record: through the middle of every interval on a monotone cubic.

Surfaces driven by servos round their steps, and straight lines through the samples bias the control and damping derivatives by
some 2 % at 20 Hz.
"""

from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment
from estimation.signals.curves import half_way, inner_slopes


@dataclass(frozen=True)
class MidSampleGrid:
    """A segment with mid-interval samples, and how far its inputs there lie from a straight line, (2N - 1, nu)."""

    segment: Segment
    rounding: Array

    def with_inputs(self, u: Array) -> "MidSampleGrid":
        """The same with other inputs (N, nu) at the samples; only columns that differ are worked out."""
        moved = np.flatnonzero((u != self.segment.u[::2]).any(axis=0))
        values, rounding = self.segment.u.copy(), self.rounding.copy()
        _fill(self.segment.time[::2], u, values, rounding, moved)
        return MidSampleGrid(replace(self.segment, u=values), rounding)


def fine_grid(segment: Segment) -> MidSampleGrid:
    """Time and inputs with one more sample in the middle of each interval."""
    time, u = segment.time, segment.u
    fine = np.empty(2 * time.size - 1)
    fine[::2], fine[1::2] = time, 0.5 * (time[1:] + time[:-1])
    values, rounding = np.empty((fine.size, u.shape[1])), np.zeros((fine.size, u.shape[1]))
    _fill(time, u, values, rounding, np.arange(u.shape[1]))
    z = np.full((fine.size, segment.z.shape[1]), np.nan)
    return MidSampleGrid(replace(segment, time=fine, u=values, z=z), rounding)


def _fill(time: Array, u: Array, values: Array, rounding: Array, columns: np.ndarray) -> None:  # type: ignore[type-arg]
    """Write columns of the inputs u (N, nu) and of their middles into values and rounding (2N - 1, nu)."""
    chosen = u[:, columns]
    between = middles(time, chosen)
    values[::2, columns] = chosen
    values[1::2, columns] = between
    rounding[1::2, columns] = between - 0.5 * (chosen[1:] + chosen[:-1])


def middles(time: Array, u: Array) -> Array:
    """(N - 1, columns) values half-way between samples (N, columns) of the monotone cubic of Fritsch and Butland (1984), at the
    ends with the three-point slopes of Moler (Numerical Computing with MATLAB, 2004, section 3.6)."""
    step = np.diff(time)[:, None]
    if len(u) < 3:
        return np.asarray(0.5 * (u[1:] + u[:-1]))
    chord = np.diff(u, axis=0) / step
    slope = np.empty_like(u)
    slope[1:-1] = inner_slopes(chord, step)
    slope[0] = _end_slope(step[0], step[1], chord[0], chord[1])
    slope[-1] = _end_slope(step[-1], step[-2], chord[-1], chord[-2])
    return half_way(u, slope, step)


def _end_slope(h0: Array, h1: Array, m0: Array, m1: Array) -> Array:
    """Slope at an end from the two chords next to it, kept to the side of the first and within three times of it."""
    d = ((2.0 * h0 + h1) * m0 - h0 * m1) / (h0 + h1)
    kept = np.where(np.sign(d) == np.sign(m0), d, 0.0)
    steepest = 3.0 * m0  # of a cubic that is monotone there (Fritsch and Carlson 1980)
    return np.where((np.sign(m0) != np.sign(m1)) & (np.abs(d) > np.abs(steepest)), steepest, kept)
