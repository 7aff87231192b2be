"""Named series with times of their own, and bringing them to one time base."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from groundstation.flight.arrays import Array, Mask, integral
from groundstation.flight.contradictions import Contradiction
from groundstation.flight.flight import DATED_BACK
from groundstation.flight.marks import Marks
from groundstation.importers.errors import ImportDataError

LONGEST_GRID = 4_000_000  # most samples of a common time base: eleven hours at 100 Hz
SHORT_GRID = 100_000  # samples of a common time base that cost nothing, however empty: half an hour at 50 Hz
EMPTIEST = 10  # times as many samples in a common time base as recorded: more come from damaged stamps, not from pauses
LONGEST_STEP = 3.5  # median intervals; a longer step is a gap in a series: nothing is interpolated across
PAUSE = 5.0  # [s]; a longer step is a pause in recording, no late delivery
BURSTY = 2.0  # samples that come so many times slower over the whole than from one to the next come in bursts
MESSAGE = "message"  # key of `Log.detail`: the kind of message of the topic that a table holds
MOST_INSTANCES = 256  # of one sensor: ArduPilot numbers them in one byte


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


Series = TimeSeries
"""The name under which packages import it (docs/extending.md)."""


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

    def with_notes(self, *notes: str) -> "Log":
        """The same with notes added."""
        return replace(self, notes=(*self.notes, *notes))


def instance_rows(topic: str, number: Array) -> dict[str, Mask]:
    """Which messages of a topic are of each sensor: name (`GPS`, further ones `GPS[1]`) -> (N,). number: (N,) of the sensor."""
    numbers = np.unique(number[np.isfinite(number)])
    if not 0 < numbers.size <= MOST_INSTANCES:
        return {topic: np.ones(number.size, bool)}
    return {topic if n == numbers[0] else f"{topic}[{n:g}]": number == n for n in numbers}


def without_damaged_times(series: Mapping[str, TimeSeries]) -> tuple[dict[str, TimeSeries], int]:
    """The series without samples whose time is far from all others (damaged stamps), and how many were left out."""
    clocks = {id(s.time): s.time for s in series.values()}  # fields of one message share their time
    times = np.concatenate(list(clocks.values())) if clocks else np.zeros(0)
    times = times[np.isfinite(times)]
    if not times.size:
        return dict(series), 0
    low, high = np.percentile(times, [2, 98])
    reach = 60.0 + (high - low)
    kept_series, outliers = {}, 0
    for name, item in series.items():
        plausible = np.isfinite(item.time) & (item.time > low - reach) & (item.time < high + reach)
        outliers = max(outliers, int(np.sum(~plausible)))
        kept_series[name] = replace(item, time=item.time[plausible], values=item.values[plausible])
    return kept_series, outliers


def even_time_base(series: Mapping[str, TimeSeries], rate_hz: float) -> Array:
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
    expected_samples = (stop - start) * min(rate_hz, max(native_rate(s) for s in series.values()) or rate_hz)
    if expected_samples > max(EMPTIEST * recorded, SHORT_GRID):
        raise ImportDataError(
            f"{recorded} samples spread over {stop - start:.4g} s: most of that time is empty, so the time is damaged or of "
            "another unit"
        )
    return start + np.arange(int(np.floor((stop - start) * rate_hz + 1e-9)) + 1) / rate_hz


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
    t, y = _finite_samples(series)
    rate = native_rate(TimeSeries(t, y))
    if not rate:  # fewer than two samples, or all at one instant
        return np.full_like(time, np.nan)
    interval = 1.0 / rate
    step = float(np.median(np.diff(time))) if time.size > 1 else interval
    if hold and (series.lag or interval > 0.5 * step):
        return held_at(series, time)
    index = np.clip(np.searchsorted(t, time, side="right") - 1, 0, t.size - 2)
    edge = 1e-6 * interval  # rounding of a grid that ends with the series
    valid = (time >= t[0] - edge) & (time <= t[-1] + edge) & (t[index + 1] - t[index] <= LONGEST_STEP * interval)
    values = _mean_over(t, y, time, step) if interval <= 0.5 * step else np.interp(time, t, y)
    return np.where(valid, values, np.nan)


def _finite_samples(series: TimeSeries) -> tuple[Array, Array]:
    """Times, each once and in order, and values of the samples that have both."""
    finite = np.isfinite(series.values) & np.isfinite(series.time)
    t, first = np.unique(series.time[finite], return_index=True)
    return t, series.values[finite][first]


SETTLED = 4.0  # lags after which 2 % are left of where a servo stood


def held_at(series: TimeSeries, time: Array) -> Array:
    """Commands at `time` (n,), as the servo behind them shows them: each holds from half an interval before its record until half
    an interval before the next. NaN outside the series, inside its gaps, and while a servo comes from wherever it stood
    before the series began."""
    t, target = _finite_samples(series)
    if t.size < 2:
        return np.full_like(time, np.nan)
    interval = 1.0 / native_rate(TimeSeries(t, target))
    begins = t - DATED_BACK * interval
    latest = np.searchsorted(begins, time + 1e-6 * interval, side="right") - 1
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
    """What a first-order servo makes of commands that hold until the next; exact between samples."""
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
    """Mean of the piecewise straight line through (t, y) over time +- step/2."""
    area = integral(t, y)

    def area_until(instant: Array) -> Array:
        i = np.clip(np.searchsorted(t, instant, side="right") - 1, 0, t.size - 2)
        dt = instant - t[i]
        return np.asarray(area[i] + dt * (y[i] + 0.5 * dt * (y[i + 1] - y[i]) / (t[i + 1] - t[i])))

    low, high = np.maximum(time - step / 2, t[0]), np.minimum(time + step / 2, t[-1])
    width = np.where(high > low, high - low, np.nan)
    return np.asarray(np.where(np.isfinite(width), (area_until(high) - area_until(low)) / width, np.interp(time, t, y)))
