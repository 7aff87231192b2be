"""Alignment: the samples of each channel, taken at different instants and delayed by filters, interpolated at the scan's time.

Within a run of consecutive scans the value is interpolated through the neighbouring samples: a cubic through four of them for
smooth motion, a straight line for surfaces, whose edges a cubic would overshoot. A run ends at every missing scan or value, and
is extrapolated by at most half a sample interval, along a straight line. In a thinned stream, in which most scans are missing,
samples up to `BRIDGED` seconds apart are neighbours. A channel with rarer samples is not interpolated.
"""

import math

import numpy as np
from numpy.typing import NDArray

from groundstation.flight.flight import DATED_BACK

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

COMPLETE = 0.9
"""Share of the scan numbers that must be present for a recording to be aligned by default."""

BRIDGED = 0.21
"""Longest interval [s] between neighbouring scans of a thinned stream: a 5 Hz downlink, or 11 Hz with two scans lost in a row."""

SLOWEST_SCANS = 40
"""Largest number of scans between two samples of a channel that is interpolated."""

DERIVATIVE_HALF_WIDTH = 3
"""Samples on each side of the cubic whose slope is the derivative. It loses 0.2 % of a 1 Hz motion at 20 Hz; a parabola through
five samples loses 5 %, with little less noise."""


def completeness(number: NDArray[np.int64]) -> float:
    """Share of the scan numbers between the first and the last that are present."""
    return float(number.size / (number[-1] - number[0] + 1)) if number.size > 1 and number[-1] > number[0] else 1.0


def connectedness(time: Array) -> float:
    """Share of the intervals between scans, at `time` (N,) [s], that are no longer than BRIDGED; 0 for a single scan."""
    return float(np.mean(np.diff(time) <= BRIDGED)) if time.size > 1 else 0.0


def runs(number: NDArray[np.int64], finite: Mask) -> tuple[list[NDArray[np.int64]], int]:
    """Rows of the samples in each unbroken run of a channel, and its spacing in scans.

    A channel read in every k-th scan has spacing k; a run ends where the next sample is further away, because of a missing scan
    or value. number: (N,) scan counter; finite: (N,) scans with a sample.
    """
    rows = np.flatnonzero(finite)
    if rows.size < 2:
        return [rows] if rows.size else [], 1
    steps = np.diff(number[rows])
    positive = steps[steps > 0]
    spacing = int(np.median(positive)) if positive.size else 1
    if spacing > SLOWEST_SCANS:
        spacing = 1
    breaks = np.flatnonzero((steps > spacing) | (steps <= 0)) + 1
    return np.split(rows, breaks), spacing


def to_scan_time(
    values: Array,
    sampled_at: Array,
    target_times: Array,
    number: NDArray[np.int64],
    *,
    smooth: bool,
    furthest: float = math.inf,
) -> Array:
    """`values` (N,), sampled at `sampled_at` (N,) [s], interpolated at `target_times` (N,) [s], run by run.

    number: (N,) scan counter. smooth: cubic instead of linear. A channel read in every k-th scan gets a value in each scan of its
    runs; one whose samples are further apart than `furthest` [s] or SLOWEST_SCANS keeps its values unchanged. NaN in runs of one
    sample or without increasing instants, and further outside a run than half its sample interval.
    """
    finite = np.isfinite(values) & np.isfinite(sampled_at)
    if _too_sparse(finite, target_times, number, furthest):
        return np.where(finite, values, np.nan)
    aligned_values = np.full_like(values, np.nan)
    row_runs, spacing = runs(number, finite)
    for rows in row_runs:
        t, y = sampled_at[rows], values[rows]
        if t.size >= 2 and np.all(np.diff(t) > 0):
            span = slice(max(0, rows[0] - spacing // 2), min(values.size, rows[-1] + 1 + spacing // 2))
            aligned = _interpolated(t, y, target_times[span], smooth and t.size >= 4)
            aligned_values[span] = np.where(np.isnan(aligned), aligned_values[span], aligned)
    return aligned_values


def _too_sparse(finite: Mask, time: Array, number: NDArray[np.int64], furthest: float) -> bool:
    """Whether the samples of a channel are too rare to interpolate between them."""
    if np.sum(finite) < 2:
        return False
    return (
        float(np.median(np.diff(number[finite]))) > SLOWEST_SCANS or float(np.median(np.diff(time[finite]))) > furthest
    )


SAME_STAMP = 1e-3
"""Largest difference [s] of two stamps of one sample: stamps are rounded to microseconds, and senders are slower than 1 kHz."""

FRAME = 0.022
"""Period of a servo's frames [s], 50 Hz with jitter. Pulses reported this often or oftener hold until the next report."""


def by_stamp(
    values: Array, stamped_at: Array, target_times: Array, *, smooth: bool, lag: float = 0.0, pulse: bool = False
) -> Array:
    """`values` (N,), with the time stamps `stamped_at` (N,) [s] of their sender, interpolated at `target_times` (N,) [s].

    A sample repeats in each scan until a newer one is received; it counts once, at its stamp. Samples up to BRIDGED seconds apart
    are neighbours. lag: time constant [s] of a first-order low pass that is removed; a negative one is added, as the lag of a
    surface behind its pulses (`_lagged_pulses`). smooth: cubic instead of linear. pulse: whether the values are pulse widths,
    which hold between reports no longer than FRAME apart.
    """
    rows = np.flatnonzero(np.isfinite(values) & np.isfinite(stamped_at))
    rows = rows[np.argsort(stamped_at[rows], kind="stable")]
    rows = rows[np.diff(stamped_at[rows], prepend=-np.inf) > SAME_STAMP]
    t, y = stamped_at[rows], values[rows]
    aligned = np.full_like(values, np.nan)
    number = np.cumsum(np.where(np.diff(t, prepend=-np.inf) <= BRIDGED, 1, 2)).astype(np.int64)
    if lag > 0:
        y = undo_lag(y, t, number, lag)
    for run in np.split(np.arange(t.size), np.flatnonzero(np.diff(number) > 1) + 1):
        if run.size >= 2:
            if lag < 0:
                in_run = _lagged_pulses(t[run], y[run], -lag, target_times)
            else:
                in_run = _interpolated(t[run], y[run], target_times, smooth and run.size >= 4)
            if pulse and not lag and float(np.median(np.diff(t[run]))) <= FRAME:
                newest = np.clip(np.searchsorted(t[run], target_times, side="right") - 1, 0, None)
                in_run = np.where(np.isnan(in_run), in_run, y[run][newest])
            aligned = np.where(np.isnan(in_run), aligned, in_run)
    return aligned


def _lagged_pulses(t: Array, y: Array, lag: float, target_times: Array) -> Array:
    """Response (N,) of a first-order lag [s] to pulses `y` (n,) reported at `t` (n,) [s], from rest at the first. Each pulse
    begins DATED_BACK of an interval before its report. NaN outside the reports."""
    interval = float(np.median(np.diff(t)))
    starts = t - DATED_BACK * interval
    error = np.zeros_like(y)  # pulse less response, at the beginning of each pulse
    for i in range(1, t.size):
        error[i] = y[i] - y[i - 1] + error[i - 1] * math.exp((starts[i - 1] - starts[i]) / lag)
    k = np.clip(np.searchsorted(starts, target_times, side="right") - 1, 0, t.size - 1)
    response = y[k] - error[k] * np.exp(-np.maximum(target_times - starts[k], 0.0) / lag)
    return np.where((target_times < starts[0]) | (target_times > t[-1] + DATED_BACK * interval), np.nan, response)


def hold(values: Array, number: NDArray[np.int64]) -> Array:
    """`values` (N,) of a quantity that holds between samples (a pulse width), with the last one in each scan of its runs."""
    row_runs, spacing = runs(number, np.isfinite(values))
    held_values = np.full_like(values, np.nan)
    for rows in row_runs:
        span = np.arange(rows[0], min(values.size, rows[-1] + spacing))
        span = span[number[span] - number[rows[-1]] < spacing]
        held_values[span] = values[rows[np.searchsorted(rows, span, side="right") - 1]]
    return held_values


def _interpolated(t: Array, y: Array, target_times: Array, cubic: bool) -> Array:
    """The samples `y` (n,) at increasing `t` (n,) [s], interpolated at the target times; NaN beyond half an interval outside."""
    i = np.clip(np.searchsorted(t, target_times) - 1, 0, t.size - 2)
    interpolated = y[i] + (target_times - t[i]) * ((y[i + 1] - y[i]) / (t[i + 1] - t[i]))
    if cubic:
        j = np.clip(i - 1, 0, t.size - 4)
        within = (target_times >= t[0]) & (target_times <= t[-1])
        interpolated = np.where(within, _lagrange(t, y, target_times, j), interpolated)
    exact = target_times == t[i]
    interpolated = np.where(exact, y[i], interpolated)
    reach = 0.5 * float(np.median(np.diff(t)))
    return np.where((target_times < t[0] - reach) | (target_times > t[-1] + reach), np.nan, interpolated)


def _lagrange(t: Array, y: Array, target_times: Array, first: NDArray[np.int64]) -> Array:
    """(N,) at each target time the cubic through four samples, the first at the index `first` (N,)."""
    total = np.zeros_like(target_times)
    for a in range(4):
        weight = np.ones_like(target_times)
        for b in range(4):
            if a != b:
                weight = weight * (target_times - t[first + b]) / (t[first + a] - t[first + b])
        total = total + weight * y[first + a]
    return total


def undo_lag(values: Array, time: Array, number: NDArray[np.int64], lag: float) -> Array:
    """Input of a first-order low pass of time constant `lag` [s] with output `values` (N,): x = y + lag dy/dt, run by run.

    The slope is that of a quartic through five samples: at 20 Hz it has 97 % of the slope of a 3 Hz motion. Near the ends of a
    run it is that of `derivative`, with less noise.
    """
    slope = derivative(values, time, number)
    row_runs, _ = runs(number, np.isfinite(values))
    for rows in row_runs:
        if rows.size >= 5:
            slope[rows[2:-2]] = _local_slope(time[rows], values[rows], 5, 4)[2:-2]
    return np.where(np.isfinite(slope), values + lag * slope, values)


def derivative(values: Array, time: Array, number: NDArray[np.int64], half_width: int = DERIVATIVE_HALF_WIDTH) -> Array:
    """Time derivative [1/s] of `values` (N,), by a cubic fitted to the neighbouring samples of the run; one-sided at its ends,
    NaN in a run of fewer than three samples."""
    rate = np.full_like(values, np.nan)
    row_runs, _ = runs(number, np.isfinite(values))
    for rows in row_runs:
        if rows.size >= 3:
            width = min(2 * half_width + 1, rows.size)
            rate[rows] = _local_slope(time[rows], values[rows], width, 3 if width >= 5 else 2)
    return rate


def _local_slope(t: Array, y: Array, width: int, order: int) -> Array:
    """Slope (n,) at each t of the polynomial of degree `order` fitted to the `width` samples around it."""
    windows = np.arange(width)[None, :] + np.clip(np.arange(t.size) - width // 2, 0, t.size - width)[:, None]
    unit = float(np.median(np.diff(t)))
    x = (t[windows] - t[:, None]) / unit
    powers = np.stack([x**k for k in range(order + 1)], axis=2)
    level = y[windows].mean(axis=1, keepdims=True)
    normal = np.einsum("nwi,nwj->nij", powers, powers)
    right = np.einsum("nwi,nw->ni", powers, y[windows] - level)
    return np.asarray(np.linalg.solve(normal, right[:, :, None])[:, 1, 0] / unit)
