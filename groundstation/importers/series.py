"""Time series of a foreign log, each with its own times, and their resampling to a common time base."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from groundstation.flight.arrays import Array, Mask, integral
from groundstation.flight.contradictions import Contradiction
from groundstation.flight.flight import DATED_BACK
from groundstation.flight.marks import Marks
from groundstation.importers.errors import ImportDataError

LONGEST_GRID = 4_000_000  # samples of a common time base, at most: eleven hours at 100 Hz
SHORT_GRID = 100_000  # samples of a common time base that is accepted even if almost empty: half an hour at 50 Hz
EMPTIEST = 10
"""Samples of a longer time base for each recorded one, at most: damaged stamps cause more, pauses do not."""
LONGEST_STEP = 3.5  # median intervals; a longer step is a gap of a series and is not interpolated
PAUSE = 5.0  # [s]; a longer step is a pause in recording, not late delivery
AVERAGING_RATIO = 2.0  # rate of a series over that of the time base, from which its samples are averaged
BURSTY = 2.0  # ratio of median to mean rate, from which samples are delivered in bursts
CLOCK_BACK_S = 1.0
"""[s] by which an autopilot's clock goes back after a restart only: messages out of order differ by some tenths of a second."""
RECORD_GAP = 1.0  # [s] put between two records whose clocks overlap or were restarted
LONGEST_ARRAY = 32
"""Elements of an array that become series, at most (32 outputs of an autopilot): longer arrays are images and binary data."""
SAME_INSTANT = 1e-9  # [s] between two stamps of one instant: stamps have a resolution of a microsecond at best
_ROUNDING = 1e-6  # of an interval, for a time base that ends with the series
MESSAGE = "message"  # key of `Log.detail`: kind of the messages in a table
SETTLED = 4.0  # time constants after which a servo's initial position counts for 2 %
MOST_INSTANCES = 256  # of one sensor: ArduPilot numbers them in one byte
TIME_QUANTILES, TIME_MARGIN = (2, 98), 60.0
"""Percentiles of all times, and [s] which, with their distance, a time may lie outside them before it counts as damaged."""


@dataclass(frozen=True)
class TimeSeries:
    """Samples of one quantity: time (n,) [s], in order, and values (n,).

    command: whether it is commanded, not measured, and so holds between samples (`held_at`); lag: time constant [s] of the servo
    that follows it.
    """

    time: Array
    values: Array
    command: bool = False
    lag: float = 0.0


Series = TimeSeries
"""Name of `TimeSeries` in packages that add formats (docs/extending.md)."""


@dataclass(frozen=True)
class Log:
    """The content of a foreign file.

    kind: of the format. series: by name, all on one clock [s]. common: whether all share one time column (a table), so that
    nothing needs interpolation. text_columns: columns of a table that are not numbers. detail: for the provenance. units: series
    -> unit as the file spells it. parameters: of the autopilot, last values. kinds: series -> 'measured', 'computed' or
    'assumed', where the file shows it. origin: [s] that was subtracted from the file's times. marks: modes, events and messages.
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

    def with_notes(self, *notes: str) -> "Log":
        """A copy with notes added."""
        return replace(self, notes=(*self.notes, *notes))


def instance_rows(topic: str, number: Array) -> dict[str, Mask]:
    """Name of each sensor of a topic (`GPS`, further ones `GPS[1]`) -> its messages (N,). number: (N,) number of the sensor."""
    numbers = np.unique(number[np.isfinite(number)])
    if not 0 < numbers.size <= MOST_INSTANCES:
        return {topic: np.ones(number.size, bool)}
    return {topic if n == numbers[0] else f"{topic}[{n:g}]": number == n for n in numbers}


def without_damaged_times(series: Mapping[str, TimeSeries]) -> tuple[dict[str, TimeSeries], int]:
    """The series without samples whose time is far from all others (damaged stamps), and the largest number removed from one
    series."""
    clocks = {id(s.time): s.time for s in series.values()}  # fields of one message share their time
    times = np.concatenate(list(clocks.values())) if clocks else np.zeros(0)
    times = times[np.isfinite(times)]
    if not times.size:
        return dict(series), 0
    low, high = np.percentile(times, TIME_QUANTILES)
    reach = TIME_MARGIN + (high - low)
    cleaned, outliers = {}, 0
    for name, item in series.items():
        plausible = np.isfinite(item.time) & (item.time > low - reach) & (item.time < high + reach)
        outliers = max(outliers, int(np.sum(~plausible)))
        cleaned[name] = replace(item, time=item.time[plausible], values=item.values[plausible])
    return cleaned, outliers


def even_time_base(series: Mapping[str, TimeSeries], rate_hz: float) -> Array:
    """Even time base (n,) [s] from the earliest to the latest sample. Raises ImportDataError where it would be too long or mostly
    empty, or there are no times."""
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
    expected_samples = (stop - start) * min(rate_hz, max(native_rate(s) for s in series.values()) or rate_hz)
    if expected_samples > max(EMPTIEST * recorded, SHORT_GRID):
        raise ImportDataError(
            f"{recorded} samples spread over {stop - start:.4g} s: most of that time is empty, so the time is damaged or of "
            "another unit"
        )
    return start + np.arange(int(np.floor((stop - start) * rate_hz + 1e-9)) + 1) / rate_hz


def native_rate(series: TimeSeries) -> float:
    """Median rate of a series [Hz], or the mean rate where samples are delivered in bursts; 0 for fewer than two samples."""
    steps = np.diff(series.time[np.isfinite(series.time)])
    steps = steps[steps > SAME_INSTANT]
    if not steps.size:
        return 0.0
    typical = float(1 / np.median(steps))
    running = steps[steps <= PAUSE]
    mean = running.size / float(running.sum()) if running.size else typical
    return mean if typical > BURSTY * mean else typical


def resample(series: TimeSeries, time: Array, *, hold: bool = False) -> Array:
    """Values of a series at `time` (n,) [s]; NaN outside the series and in its gaps.

    A series faster than `time` by AVERAGING_RATIO is averaged over each interval, against aliasing of vibration. A slower one is
    linearly interpolated; with `hold` each value holds until the next, as of a command.
    """
    t, y = _finite_samples(series)
    rate = native_rate(TimeSeries(t, y))
    if not rate:  # fewer than two samples, or all at one instant
        return np.full_like(time, np.nan)
    interval = 1.0 / rate
    step = float(np.median(np.diff(time))) if time.size > 1 else interval
    average = AVERAGING_RATIO * interval <= step
    if hold and (series.lag or not average):
        return held_at(series, time)
    index = np.clip(np.searchsorted(t, time, side="right") - 1, 0, t.size - 2)
    edge = _ROUNDING * interval
    valid = (time >= t[0] - edge) & (time <= t[-1] + edge) & (t[index + 1] - t[index] <= LONGEST_STEP * interval)
    values = _mean_over(t, y, time, step) if average else np.interp(time, t, y)
    return np.where(valid, values, np.nan)


def _finite_samples(series: TimeSeries) -> tuple[Array, Array]:
    """Increasing times and values of the finite samples, the first of each time."""
    finite = np.isfinite(series.values) & np.isfinite(series.time)
    t, first = np.unique(series.time[finite], return_index=True)
    return t, series.values[finite][first]


def held_at(series: TimeSeries, time: Array) -> Array:
    """A command at `time` (n,) [s], after its servo's lag: each sample holds from DATED_BACK of an interval before its record
    until the same before the next. NaN outside the series, in its gaps, and until a lagging servo has settled at its
    beginning."""
    t, target = _finite_samples(series)
    if t.size < 2:
        return np.full_like(time, np.nan)
    interval = 1.0 / native_rate(TimeSeries(t, target))
    begins = t - DATED_BACK * interval
    latest = np.searchsorted(begins, time + _ROUNDING * interval, side="right") - 1
    k = np.clip(latest, 0, t.size - 1)
    following = np.append(begins[1:], begins[-1] + interval)
    valid = (latest >= 0) & (time <= following[-1]) & (following[k] - begins[k] <= LONGEST_STEP * interval)
    values = target[k]
    if series.lag:
        begin = lagged(begins, target, series.lag)[k]
        values = values + (begin - values) * np.exp(-np.maximum(time - begins[k], 0.0) / series.lag)
        valid &= time >= begins[0] + SETTLED * series.lag
    return np.where(valid, values, np.nan)


def lagged(time: Array, commanded: Array, lag: float) -> Array:
    """(n,) response of a first-order servo of time constant `lag` [s] to commands (n,) that hold until the next; it starts again
    at the command where time (n,) [s] goes back."""
    response = np.empty_like(commanded)
    angle, last, previous_time = math.nan, math.nan, math.nan
    for k, (current_time, target) in enumerate(zip(time.tolist(), commanded.tolist(), strict=True)):
        if math.isnan(angle) or not current_time >= previous_time:
            angle = target
        elif not math.isnan(last):
            angle = last + (angle - last) * math.exp(-(current_time - previous_time) / lag)
        response[k], last, previous_time = angle, target, current_time
    return response


def _mean_over(t: Array, y: Array, time: Array, step: float) -> Array:
    """(n,) mean over time +- step/2 [s] of the straight lines through (t, y)."""
    area = integral(t, y)

    def area_until(instant: Array) -> Array:
        i = np.clip(np.searchsorted(t, instant, side="right") - 1, 0, t.size - 2)
        dt = instant - t[i]
        return np.asarray(area[i] + dt * (y[i] + 0.5 * dt * (y[i + 1] - y[i]) / (t[i + 1] - t[i])))

    low, high = np.maximum(time - step / 2, t[0]), np.minimum(time + step / 2, t[-1])
    width = np.where(high > low, high - low, np.nan)
    return np.asarray(np.where(np.isfinite(width), (area_until(high) - area_until(low)) / width, np.interp(time, t, y)))
