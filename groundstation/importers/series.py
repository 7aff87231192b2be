"""Named series with times of their own, and bringing them to one time base."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.flight.contradictions import Contradiction
from groundstation.flight.marks import Marks
from groundstation.importers.errors import ImportDataError

Array = NDArray[np.float64]

LONGEST_GRID = 4_000_000
"""Most samples of a common time base: eleven hours at 100 Hz."""

SHORT_GRID = 100_000
"""Samples of a common time base that cost nothing, however empty: half an hour at 50 Hz."""

EMPTIEST = 10
"""Times as many samples in a common time base as were recorded: more come from damaged stamps, not from pauses."""

LONGEST_STEP = 3.5
"""A step longer than this many median intervals of a series is a gap in it: nothing is interpolated across."""


@dataclass(frozen=True)
class TimeSeries:
    """Samples of one quantity: time (n,) [s], values (n,), both in order.

    command: what was asked of a servo, not what a sensor saw: it holds between samples, see `held_at`; lag: of the first-order
    servo that follows it [s].
    """

    time: Array
    values: Array
    command: bool = False
    lag: float = 0.0


@dataclass(frozen=True)
class Log:
    """What a foreign file holds: series by name, all on one clock [s].

    common: whether all series share one time column (a table), so that nothing needs to be interpolated. units: of series whose
    file states one, as it spells them. parameters: the autopilot's own, as the log last states them.
    """

    kind: str
    series: Mapping[str, TimeSeries]
    common: bool = False
    notes: tuple[str, ...] = ()
    text_columns: tuple[str, ...] = ()
    detail: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    kinds: Mapping[str, str] = field(default_factory=dict)
    contradictions: tuple[Contradiction, ...] = ()
    origin: float = 0.0
    marks: Marks = field(default_factory=Marks)

    def extended(self, series: Mapping[str, TimeSeries], units: Mapping[str, str]) -> "Log":
        """The same with further series."""
        return replace(self, series={**self.series, **series}, units=units)


def credible(series: Mapping[str, TimeSeries]) -> tuple[dict[str, TimeSeries], int]:
    """The series without samples whose time is far from all others (damaged stamps), and how many were left out."""
    clocks = {id(s.time): s.time for s in series.values()}  # fields of one message share their time
    times = np.concatenate(list(clocks.values())) if clocks else np.zeros(0)
    times = times[np.isfinite(times)]
    if not times.size:
        return dict(series), 0
    low, high = np.percentile(times, [2, 98])
    reach = 60.0 + (high - low)
    out, dropped = {}, 0
    for name, item in series.items():
        good = np.isfinite(item.time) & (item.time > low - reach) & (item.time < high + reach)
        dropped = max(dropped, int(np.sum(~good)))
        out[name] = item if good.all() else TimeSeries(item.time[good], item.values[good])
    return out, dropped


def grid(series: Mapping[str, TimeSeries], rate_hz: float) -> Array:
    """Even time base from the earliest start to the latest end. Raises ImportDataError when that is too long."""
    if not rate_hz > 0:
        raise ImportDataError(
            "all samples have one and the same time; name another time column, or the rate: [time] rate_hz = 50"
        )
    start = min(float(np.min(s.time, initial=np.inf, where=np.isfinite(s.time))) for s in series.values())
    stop = max(float(np.max(s.time, initial=-np.inf, where=np.isfinite(s.time))) for s in series.values())
    if not start <= stop:
        raise ImportDataError("no sample has a time; name another time column")
    if (stop - start) * rate_hz > LONGEST_GRID:
        raise ImportDataError(
            f"{stop - start:.4g} s at {rate_hz:g} Hz are more than {LONGEST_GRID} samples; check the time unit or lower --rate"
        )
    recorded = max(s.time.size for s in series.values())
    expected = (stop - start) * min(rate_hz, max(native_rate(s) for s in series.values()) or rate_hz)
    if expected > max(EMPTIEST * recorded, SHORT_GRID):
        raise ImportDataError(
            f"{recorded} samples spread over {stop - start:.4g} s: most of that time is empty, so the time is damaged or of "
            "another unit"
        )
    return start + np.arange(int(np.floor((stop - start) * rate_hz + 1e-9)) + 1) / rate_hz


PAUSE = 5.0
"""A step longer than this [s] is a pause in recording, no late delivery."""
BURSTY = 2.0
"""A series whose samples, over its whole length, come so many times slower than from one to the next comes in bursts."""


def native_rate(series: TimeSeries) -> float:
    """Median rate of a series [Hz], or how many samples come in a second where they come in bursts; 0 for fewer than two."""
    steps = np.diff(series.time[np.isfinite(series.time)])
    steps = steps[steps > 1e-9]  # stamps are of a microsecond at best: what is closer is the same instant
    if not steps.size:
        return 0.0
    typical = float(1 / np.median(steps))
    running = steps[steps <= PAUSE]
    mean = running.size / float(running.sum()) if running.size else typical
    return mean if typical > BURSTY * mean else typical


def resample(series: TimeSeries, time: Array, *, hold: bool = False) -> Array:
    """Values of a series at `time` (n,): NaN outside the series and inside its gaps.

    A series at least twice as fast as the grid is averaged over each grid interval, which keeps vibration from folding
    into the motion; a slower one is interpolated along straight lines, with `hold` kept until the next as a command is.
    """
    good = np.isfinite(series.values) & np.isfinite(series.time)
    t, y = series.time[good], series.values[good]
    t, first = np.unique(t, return_index=True)
    y = y[first]
    if t.size < 2:
        return np.full_like(time, np.nan)
    rate = native_rate(TimeSeries(t, y))
    if not rate:  # all at one instant
        return np.full_like(time, np.nan)
    interval = 1.0 / rate
    step = float(np.median(np.diff(time))) if time.size > 1 else interval
    if hold and (series.lag or interval > 0.5 * step):
        return held_at(replace(series, command=True), time)
    before = np.clip(np.searchsorted(t, time, side="right") - 1, 0, t.size - 2)
    edge = 1e-6 * interval  # rounding of a grid that ends with the series
    inside = (time >= t[0] - edge) & (time <= t[-1] + edge) & (t[before + 1] - t[before] <= LONGEST_STEP * interval)
    if interval <= 0.5 * step:
        out = _mean_over(t, y, time, step)
    else:
        out = np.interp(time, t, y)
    return np.where(inside, out, np.nan)


DATED_BACK = 0.5
"""Of its interval, by which a logged command is dated back: it changed at any time since the last record, half in the mean."""


def held_at(series: TimeSeries, time: Array) -> Array:
    """Commands at `time` (n,), as the servo behind them shows them: each holds from half an interval before its record until half
    an interval before the next. NaN outside the series and inside its gaps."""
    good = np.isfinite(series.values) & np.isfinite(series.time)
    t, first = np.unique(series.time[good], return_index=True)
    target = series.values[good][first]
    if t.size < 2:
        return np.full_like(time, np.nan)
    interval = 1.0 / native_rate(TimeSeries(t, target))
    since = t - DATED_BACK * interval
    at = np.searchsorted(since, time + 1e-6 * interval, side="right") - 1
    k = np.clip(at, 0, t.size - 1)
    following = np.append(since[1:], since[-1] + interval)
    inside = (at >= 0) & (time <= following[-1]) & (following[k] - since[k] <= LONGEST_STEP * interval)
    values = target[k]
    if series.lag:
        begin = lagged(since, target, series.lag)[k]
        values = values + (begin - values) * np.exp(-np.maximum(time - since[k], 0.0) / series.lag)
    return np.where(inside, values, np.nan)


def lagged(time: Array, commanded: Array, lag: float) -> Array:
    """What a first-order servo makes of commands that hold until the next; exact between samples."""
    out = np.empty_like(commanded)
    angle, last, before = math.nan, math.nan, math.nan
    for k, (now, target) in enumerate(zip(time.tolist(), commanded.tolist(), strict=True)):
        if math.isnan(angle) or not now >= before:
            angle = target
        elif not math.isnan(last):
            angle = last + (angle - last) * math.exp(-(now - before) / lag)
        out[k], last, before = angle, target, now
    return out


def _mean_over(t: Array, y: Array, time: Array, step: float) -> Array:
    """Mean of the piecewise straight line through (t, y) over time +- step/2."""
    area = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t))])

    def integral(at: Array) -> Array:
        i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
        dt = at - t[i]
        return np.asarray(area[i] + dt * (y[i] + 0.5 * dt * (y[i + 1] - y[i]) / (t[i + 1] - t[i])))

    low, high = np.maximum(time - step / 2, t[0]), np.minimum(time + step / 2, t[-1])
    width = np.where(high > low, high - low, np.nan)
    return np.asarray(np.where(np.isfinite(width), (integral(high) - integral(low)) / width, np.interp(time, t, y)))
