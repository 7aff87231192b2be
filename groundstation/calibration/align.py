"""One time base: samples taken at their own instants, and delayed by their filters, brought to the scan's time.

Within a run of consecutive scans the value at the scan's time is interpolated through the neighbouring samples: a cubic
through four of them for smooth motion, a straight line for surfaces, whose edges a cubic would overshoot. Runs end at
every missing scan and every missing value: nothing is ever interpolated across, and at the ends of a run at most half
a sample interval is extrapolated along the last straight line. Of a thinned stream most scans are missing: there samples up
to `BRIDGED` seconds apart are neighbours, and a channel whose samples are further apart stays in its own scans.
"""

import math

import numpy as np
from numpy.typing import NDArray

from groundstation.flight.flight import DATED_BACK

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

COMPLETE = 0.9
"""A recording with at least this part of its scan numbers present is aligned by default."""

BRIDGED = 0.21
"""Scans of a thinned stream up to so far apart [s] are neighbours: those of a 5 Hz downlink, or two lost in a row of 11 Hz."""

SLOWEST = 40
"""A channel with fewer samples than one in so many scans is left where it is."""

DERIVATIVE_HALF_WIDTH = 3
"""Rates are differentiated by a cubic through this many samples to each side: with hardly more noise than a parabola through
five, it loses 0.2 % of a 1 Hz motion at 20 Hz where that loses 5 %."""


def completeness(number: NDArray[np.int64]) -> float:
    """Part of the scan numbers between first and last that are present."""
    return float(number.size / (number[-1] - number[0] + 1)) if number.size > 1 and number[-1] > number[0] else 1.0


def connectedness(time: Array) -> float:
    """Part of the intervals between scans at `time` (N,) [s] that are no longer than BRIDGED; of a lone scan 0."""
    return float(np.mean(np.diff(time) <= BRIDGED)) if time.size > 1 else 0.0


def runs(number: NDArray[np.int64], finite: Mask) -> tuple[list[NDArray[np.int64]], int]:
    """Row numbers of the samples of each unbroken run of a channel, and its spacing in scans.

    A channel read in every k-th scan has spacing k; a run ends where the next sample is further away than that, be it
    for a missing scan or a missing value.
    """
    rows = np.flatnonzero(finite)
    if rows.size < 2:
        return [rows] if rows.size else [], 1
    steps = np.diff(number[rows])
    positive = steps[steps > 0]
    spacing = int(np.median(positive)) if positive.size else 1
    if spacing > SLOWEST:
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
    """`values` (N,) sampled at `sampled_at` (N,) [s], brought to `target_times` (N,) [s], run by run.

    number: (N,) scan counter. smooth: cubic instead of linear. A channel whose samples are further apart than `furthest` [s]
    or SLOWEST scans stays in its own scans; one read in every k-th scan gets a value in each scan of its runs. A run of one
    sample, or one whose instants do not increase, cannot be aligned and becomes NaN, as does a wanted time further outside
    a run than half its sample interval.
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
            aligned = _in_run(t, y, target_times[span], smooth and t.size >= 4)
            aligned_values[span] = np.where(np.isnan(aligned), aligned_values[span], aligned)
    return aligned_values


def _too_sparse(finite: Mask, time: Array, number: NDArray[np.int64], furthest: float) -> bool:
    """Whether a channel is read so seldom that nothing can be said of what lies between."""
    if np.sum(finite) < 2:
        return False
    return float(np.median(np.diff(number[finite]))) > SLOWEST or float(np.median(np.diff(time[finite]))) > furthest


REPEATED = 1e-3
"""Stamps no further apart [s] are those of one sample: scans have them in whole microseconds, senders send none so close."""


FRAME = 0.022
"""Period of a servo's frames [s], 50 Hz, with jitter: a pulse reported as often is shown as it was reported last."""


def by_stamp(
    values: Array, stamped_at: Array, target_times: Array, *, smooth: bool, lag: float = 0.0, pulse: bool = False
) -> Array:
    """`values` (N,) dated by their sender at `stamped_at` (N,) [s], brought to `target_times` (N,) [s].

    A sample stands in each scan until a newer one comes, and came when it came: it counts once, at its own time. Samples up to
    BRIDGED seconds apart are neighbours. lag: of a first-order low pass, taken out [s], or where it is negative put in: what
    follows a pulse is not there yet, and the pulse came at any time since the report before. smooth: cubic instead of linear.
    pulse: a width, which holds where it is reported with each frame of the servo.
    """
    rows = np.flatnonzero(np.isfinite(values) & np.isfinite(stamped_at))
    rows = rows[np.argsort(stamped_at[rows], kind="stable")]
    rows = rows[np.diff(stamped_at[rows], prepend=-np.inf) > REPEATED]
    t, y = stamped_at[rows], values[rows]
    aligned = np.full_like(values, np.nan)
    number = np.cumsum(np.where(np.diff(t, prepend=-np.inf) <= BRIDGED, 1, 2)).astype(np.int64)
    if lag > 0:
        y = undo_lag(y, t, number, lag)
    for run in np.split(np.arange(t.size), np.flatnonzero(np.diff(number) > 1) + 1):
        if run.size >= 2:
            if lag < 0:
                in_run = _followed(t[run], y[run], -lag, target_times)
            else:
                in_run = _in_run(t[run], y[run], target_times, smooth and run.size >= 4)
            if pulse and not lag and float(np.median(np.diff(t[run]))) <= FRAME:
                newest = np.clip(np.searchsorted(t[run], target_times, side="right") - 1, 0, None)
                in_run = np.where(np.isnan(in_run), in_run, y[run][newest])
            aligned = np.where(np.isnan(in_run), aligned, in_run)
    return aligned


def _followed(t: Array, y: Array, lag: float, target_times: Array) -> Array:
    """How a first-order lag [s] follows pulses `y` (n,) reported at `t`, each dated back by half an interval of the reports; it
    begins settled. NaN outside the reports."""
    interval = float(np.median(np.diff(t)))
    begins = t - DATED_BACK * interval
    behind = np.zeros_like(y)  # of each pulse, where it begins
    for i in range(1, t.size):
        behind[i] = y[i] - y[i - 1] + behind[i - 1] * math.exp((begins[i - 1] - begins[i]) / lag)
    k = np.clip(np.searchsorted(begins, target_times, side="right") - 1, 0, t.size - 1)
    shown = y[k] - behind[k] * np.exp(-np.maximum(target_times - begins[k], 0.0) / lag)
    return np.where((target_times < begins[0]) | (target_times > t[-1] + DATED_BACK * interval), np.nan, shown)


def hold(values: Array, number: NDArray[np.int64]) -> Array:
    """A quantity that holds from one sample to the next (a pulse width): the last value in each scan of its runs."""
    row_runs, spacing = runs(number, np.isfinite(values))
    held_values = np.full_like(values, np.nan)
    for rows in row_runs:
        span = np.arange(rows[0], min(values.size, rows[-1] + spacing))
        span = span[number[span] - number[rows[-1]] < spacing]
        held_values[span] = values[rows[np.searchsorted(rows, span, side="right") - 1]]
    return held_values


def _in_run(t: Array, y: Array, target_times: Array, cubic: bool) -> Array:
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
    total = np.zeros_like(target_times)
    for a in range(4):
        weight = np.ones_like(target_times)
        for b in range(4):
            if a != b:
                weight = weight * (target_times - t[first + b]) / (t[first + a] - t[first + b])
        total = total + weight * y[first + a]
    return total


def undo_lag(values: Array, time: Array, number: NDArray[np.int64], lag: float) -> Array:
    """What a first-order low pass of time constant `lag` [s] was shown: x = y + lag dy/dt, run by run.

    The slope is that of a quartic through five samples, which a motion near the band edge needs: at 20 Hz and 3 Hz it
    has 97 % of the true one. Near the ends of a run the quieter slope of `derivative` is taken.
    """
    slope = derivative(values, time, number)
    row_runs, _ = runs(number, np.isfinite(values))
    for rows in row_runs:
        if rows.size >= 5:
            slope[rows[2:-2]] = _local_slope(time[rows], values[rows], 5, 4)[2:-2]
    return np.where(np.isfinite(slope), values + lag * slope, values)


def derivative(values: Array, time: Array, number: NDArray[np.int64], half_width: int = DERIVATIVE_HALF_WIDTH) -> Array:
    """Rate of change of `values` (N,) by a cubic fitted through the neighbouring samples of the run [per s].

    At the ends of a run the window is one-sided; a run shorter than three samples has none (NaN).
    """
    rate = np.full_like(values, np.nan)
    row_runs, _ = runs(number, np.isfinite(values))
    for rows in row_runs:
        if rows.size >= 3:
            width = min(2 * half_width + 1, rows.size)
            rate[rows] = _local_slope(time[rows], values[rows], width, 3 if width >= 5 else 2)
    return rate


def _local_slope(t: Array, y: Array, width: int, order: int) -> Array:
    """Slope at each t of the polynomial of `order` through the `width` samples around it."""
    windows = np.arange(width)[None, :] + np.clip(np.arange(t.size) - width // 2, 0, t.size - width)[:, None]
    unit = float(np.median(np.diff(t)))
    x = (t[windows] - t[:, None]) / unit
    powers = np.stack([x**k for k in range(order + 1)], axis=2)
    level = y[windows].mean(axis=1, keepdims=True)
    normal = np.einsum("nwi,nwj->nij", powers, powers)
    right = np.einsum("nwi,nw->ni", powers, y[windows] - level)
    return np.asarray(np.linalg.solve(normal, right[:, :, None])[:, 1, 0] / unit)
