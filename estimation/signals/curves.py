"""Curves through samples: Fourier transforms of sampled histories on any grid of frequencies, and monotone cubics.

X(w) = integral from 0 to T of x(t) exp(-j w t) dt. A curve through the samples is evaluated on a finer even grid and
integrated by the trapezoidal rule, at evenly spaced frequencies by the chirp z transform (L. R. Rabiner, R. W. Schafer,
C. M. Rader, IEEE Trans. Audio Electroacoust. 17(2), 1969; E. A. Morelli, Journal of Aircraft 34(3), 1997, for flight
data). The samples need not be evenly spaced. A cubic spline through 20 Hz samples is off by (w h)^4 / 720, 0.1 % at 3 Hz. A
monotone cubic never overshoots, so that an edge stays where it is (slopes after Fritsch and Butland, SIAM J. Sci. Stat. Comput.
5, 1984).
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FINER = 6
"""Points of the fine grid per sample: the trapezoidal rule errs by (w h / 6)^2 / 12 of the value at each end, 0.2 % at 3 Hz and
20 Hz."""
FEWEST = 4  # samples that a cubic needs


def fine_times(time: Array) -> Array:
    """Even times from the first to the last of `time` (N,) s, FINER of them to a median step."""
    span = float(time[-1] - time[0])
    count = max(FINER * round(span / float(np.median(np.diff(time)))), 2)
    return np.asarray(time[0] + span / count * np.arange(count + 1))


def curve_through(time: Array, values: Array, times: Array, *, edges: bool = False) -> Array:
    """Values at `times` (M,) of the curve through the finite samples of `values` (N,).

    edges: a monotone cubic that never overshoots (a control surface), else a cubic spline. All NaN for fewer than FEWEST samples.
    """
    measured = np.isfinite(values)
    if measured.sum() < FEWEST:
        return np.full(times.shape, np.nan)
    from scipy.interpolate import CubicSpline, PchipInterpolator  # here: every simulation imports this module

    interpolator = PchipInterpolator if edges else CubicSpline
    return np.asarray(
        interpolator(time[measured], values[measured])(np.clip(times, time[measured][0], time[measured][-1])), float
    )


def finite_transform(values: Array, step: float, first: float, spacing: float, count: int) -> Complex:
    """(count, columns) transforms of `values` (M, columns), one every `step` [s] from time zero on.

    Frequencies first + k spacing [rad/s]; unit: that of the values times s.
    """
    from scipy.signal import czt

    weighted = values.astype(float)
    weighted[[0, -1]] *= 0.5
    if count == 0 or weighted.shape[1] == 0:
        return np.zeros((count, weighted.shape[1]), complex)
    ratio, start = np.exp(-1j * spacing * step), np.exp(1j * first * step)
    return np.asarray(step * czt(weighted, m=count, w=ratio, a=start, axis=0), np.complex128)


def longest_hole(time: Array, values: Array) -> float:
    """Longest time [s] without a finite sample, ends included; infinite where there is none at all."""
    measured = time[np.isfinite(values)]
    if not measured.size:
        return float("inf")
    return float(np.diff(measured, prepend=time[0], append=time[-1]).max())


def inner_slopes(chord: Array, step: Array) -> Array:
    """(N - 2, n) slopes at the inner samples, zero at a peak. chord: (N - 1, n) slope of each interval; step: (N - 1, 1) its
    length."""
    chord_in, chord_out = chord[:-1], chord[1:]
    same_sign = chord_in * chord_out > 0.0
    w1, w2 = 2.0 * step[1:] + step[:-1], step[1:] + 2.0 * step[:-1]
    mean = w1 / np.where(same_sign, chord_in, 1.0) + w2 / np.where(same_sign, chord_out, 1.0)
    return np.asarray(np.where(same_sign, (w1 + w2) / mean, 0.0))


def half_way(values: Array, slope: Array, step: Array) -> Array:
    """(N - 1, n) values in the middle of each interval. values, slope: (N, n) at the samples; step: (N - 1, 1)."""
    return np.asarray(0.5 * (values[1:] + values[:-1]) + 0.125 * step * (slope[:-1] - slope[1:]))
