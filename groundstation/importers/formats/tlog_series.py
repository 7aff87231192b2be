"""Time series of one aircraft's messages in a telemetry log, with time on the autopilot's clock, separately for each boot.

Series of the autopilot are called 'MESSAGE.field'; of a further output port or sensor 'MESSAGE[1].field', of another component (a
gimbal, a companion) '154:MESSAGE.field'. Time is the message's time_usec or time_boot_ms. A message without one gets a time
between those of its neighbours in the log: a radio may deliver late, but in order. Where the autopilot's clock goes back, or
stands still while the receiver's runs, the autopilot was booted again.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.flight.contradictions import Contradiction
from groundstation.flight.marks import FlightMode, Mark, Marks, mode_changes
from groundstation.importers.evidence import FIX_3D
from groundstation.importers.modes import ARMED, armings, heartbeat_mode, mark_text
from groundstation.importers.series import CLOCK_BACK_S, LONGEST_ARRAY, Array, TimeSeries

_NOT_KNOWN = {
    **{("SYS_STATUS", "voltage_battery"): 65535, ("SYS_STATUS", "current_battery"): -1},
    **{("GPS_RAW_INT", name): 65535 for name in ("vel", "cog", "eph", "epv")},
    ("GLOBAL_POSITION_INT", "hdg"): 65535,
}
"""Values that mean "not known" in the message definitions, by message and field."""
_INSTANCE = {"SERVO_OUTPUT_RAW": "port", "HIGHRES_IMU": "id", "BATTERY_STATUS": "id", "DISTANCE_SENSOR": "id"}
"""Message that a component sends for several ports or sensors -> field with their number."""
EPOCH_US = 1e15  # a larger time_usec counts from 1970, not from boot: 1e15 us are the year 2001
DELAY_PERCENTILES = (95, 5)
AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
OFF_TIME = 10.0
"""[s] by which an interval by the receiver's clock exceeds that by the sender's, where the sender was off in between."""
DENSE_STEP = 0.3  # [s] between two messages with a time, at most, for the time of one between them to be interpolated
CLOCK_RATE = 0.02  # relative difference of the clocks' rates, larger than of any quartz
SHORTEST_DRIFT_SPAN = 20.0  # [s] over which late deliveries do not look like a difference of rate
FEWEST_DRIFT_MESSAGES = 20  # with a time, for the rate of a clock
LEAST_SPAN = 1e-9  # [s] guards the division by the span of equal times
STOPPING_CLOCK_RATE = 0.05  # difference of rate from which no estimate is recommended


@dataclass(frozen=True)
class ReceivedMessages:
    """Messages of one kind from one component, in the order of the file. table: (n,) records; stamps: (n,) time received [s];
    places: (n,) position in the file; rank: (n,) position in the order of sending, comparable between kinds."""

    name: str
    component: int
    table: NDArray[np.void]
    stamps: Array
    places: NDArray[np.int64]
    rank: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def sender_time(self) -> Array:
        """(n,) time of each message on its sender's clock since boot [s]; NaN without one, or for a time since 1970."""
        names = self.table.dtype.names or ()
        if "time_boot_ms" in names:
            return np.asarray(self.table["time_boot_ms"] * 1e-3)
        if "time_usec" in names:
            return np.where(self.table["time_usec"] < EPOCH_US, self.table["time_usec"] * 1e-6, np.nan)
        return np.full(len(self.table), np.nan)

    def part(self, use: NDArray[np.bool_]) -> "ReceivedMessages":
        """The messages at the rows `use` (n,)."""
        arrays = {n: getattr(self, n)[use] for n in ("table", "stamps", "places", "rank")}
        return replace(self, **arrays)


@dataclass(frozen=True)
class Boot:
    """One run of the autopilot. series: by name, on its clock, for later boots shifted by the receiver's clock; component: id of
    the autopilot; notes, contradictions: on the messages; marks: modes, events and texts."""

    series: dict[str, TimeSeries]
    component: int
    notes: tuple[str, ...] = ()
    contradictions: tuple[Contradiction, ...] = ()
    marks: Marks = field(default_factory=Marks)


@dataclass(frozen=True)
class _Clock:
    """(n,) rank, time received [s] and sender's time [s] of messages that carry a time, in the order of sending."""

    rank: Array
    stamp: Array
    sender_time: Array

    @property
    def offset(self) -> float:
        """Receiver's less sender's clock [s], by the message with the shortest delay; 0 without messages."""
        return float(np.min(self.stamp - self.sender_time)) if self.sender_time.size else 0.0

    def part(self, rows: slice | NDArray[np.bool_] | NDArray[np.int64]) -> "_Clock":
        """The messages at some rows."""
        return _Clock(self.rank[rows], self.stamp[rows], self.sender_time[rows])


def by_boot(received: Sequence[ReceivedMessages]) -> list[Boot]:
    """Series and marks of each boot that has series, in the order of the file."""
    component = _autopilot(received)
    received = _ranked(received)
    clock = _clock([r for r in received if r.component == component])
    edges = _boot_edges(clock)
    first_offset = clock.part(slice(0, edges[1])).offset
    boots = []
    for begin, end in pairwise(edges):
        part = clock.part(slice(begin, end))
        low = -np.inf if begin == 0 else float(clock.rank[begin])
        high = np.inf if end == clock.sender_time.size else float(clock.rank[end])
        messages = [r.part((r.rank >= low) & (r.rank < high)) for r in received]
        messages = [r for r in messages if len(r.table)]
        delay = part.offset - first_offset if part.sender_time.size else 0.0
        series, notes = _series(messages, component, part, delay)
        marks = _marks([r for r in messages if r.component == component], part).moved(delay)
        boots.append(Boot(series, component, notes, tuple(_clock_rates(part)), marks))
    return [b for b in boots if b.series]


def _autopilot(received: Sequence[ReceivedMessages]) -> int:
    """Component id of the autopilot: AUTOPILOT, else that with most ATTITUDE messages, else with most messages."""
    components = {r.component for r in received}
    if AUTOPILOT in components:
        return AUTOPILOT
    weight = dict.fromkeys(components, (0, 0))
    for r in received:
        attitudes, messages = weight[r.component]
        weight[r.component] = (attitudes + (len(r.table) if r.name == "ATTITUDE" else 0), messages + len(r.table))
    return max(weight, key=lambda c: weight[c])


def _ranked(received: Sequence[ReceivedMessages]) -> list[ReceivedMessages]:
    """The messages with their ranks: the position in the file; the time received where a merged file is not in its order."""
    places = np.concatenate([r.places for r in received])
    stamps = np.concatenate([r.stamps for r in received])[np.argsort(places, kind="stable")]
    by_stamp = bool(np.any(np.diff(stamps) < -CLOCK_BACK_S))
    return [replace(r, rank=r.stamps if by_stamp else r.places.astype(float)) for r in received]


def _clock(received: Sequence[ReceivedMessages]) -> _Clock:
    """The times of the messages that carry one, without damaged ones."""
    time = np.concatenate([r.sender_time for r in received])
    clock = _Clock(np.concatenate([r.rank for r in received]), np.concatenate([r.stamps for r in received]), time)
    order = np.lexsort((clock.sender_time, clock.rank))
    clock = clock.part(order[np.isfinite(clock.sender_time[order])])
    damaged = np.abs(clock.sender_time - _median_of_five(clock.sender_time)) > OFF_TIME
    return clock.part(~damaged)


def _median_of_five(values: Array) -> Array:
    """(n,) running median of five values; the values themselves where there are fewer."""
    if values.size < 5:
        return values
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, 2, mode="edge"), 5)
    return np.asarray(np.median(windows, axis=1))


def _boot_edges(clock: _Clock) -> list[int]:
    """Indices of the first message of each boot, and the number of messages."""
    step, receiver_step = np.diff(clock.sender_time), np.diff(clock.stamp)
    booted = (step < -CLOCK_BACK_S) | ((step > CLOCK_BACK_S) & (receiver_step - step > OFF_TIME))
    return [0, *(np.flatnonzero(booted) + 1).tolist(), clock.sender_time.size]


def _series(
    received: Sequence[ReceivedMessages], component: int, clock: _Clock, delay: float
) -> tuple[dict[str, TimeSeries], tuple[str, ...]]:
    """Series by name, `delay` [s] later than the autopilot's clock, and notes on other components."""
    series: dict[str, TimeSeries] = {}
    for r in received:
        time = _time(r, component, clock) + delay
        prefix = "" if r.component == component else f"{r.component}:"
        for label, use in _instances(r):
            for name, values in _fields(r.table):
                series[f"{prefix}{r.name}{label}.{name}"] = _valid_samples(r, name, time, values, use)
    components = sorted({r.component for r in received} - {component})
    if not components:
        return series, ()
    names = ", ".join(map(str, components))
    return series, (f"messages of component {names} stand under names like {components[0]}:ATTITUDE.roll",)


def _marks(received: Sequence[ReceivedMessages], clock: _Clock) -> Marks:
    """Modes and arming by the autopilot's heartbeats, and its texts."""
    modes: tuple[FlightMode, ...] = ()
    events: tuple[Mark, ...] = ()
    messages: list[Mark] = []
    for r in received:
        if r.name not in ("HEARTBEAT", "STATUSTEXT"):
            continue
        time = _time(r, r.component, clock).tolist()
        if r.name == "STATUSTEXT":
            messages += [
                Mark(t, mark_text(text)) for t, text in zip(time, r.table["text"].tolist(), strict=True) if text
            ]
            continue
        fields = (r.table[n].tolist() for n in ("type", "autopilot", "custom_mode"))
        names = [heartbeat_mode(*row) for row in zip(*fields, strict=True)]
        modes = mode_changes(time, names, max(time, default=0.0))
        events = armings(time, (r.table["base_mode"] & ARMED > 0).tolist())
    return Marks(modes, events, tuple(messages))


def _instances(r: ReceivedMessages) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Each port or sensor of a message: its label in names of series, and its messages (n,)."""
    field = _INSTANCE.get(r.name)
    if field is None or field not in (r.table.dtype.names or ()):
        yield "", np.ones(len(r.table), bool)
        return
    for number in np.unique(r.table[field]).tolist():
        yield (f"[{number}]" if number else ""), r.table[field] == number


def _fields(table: NDArray[np.void]) -> Iterator[tuple[str, Array]]:
    """Name and values (n,) of each numeric field, and of each element of an array field."""
    for name in table.dtype.names or ():
        column = table[name]
        if column.dtype.kind == "S" or (column.ndim > 1 and column.shape[1] > LONGEST_ARRAY):
            continue
        with np.errstate(invalid="ignore"):  # a signalling NaN
            numbers = column.astype(float)
        if numbers.ndim == 1:
            yield name, numbers
        else:
            yield from ((f"{name}[{i}]", numbers[:, i]) for i in range(numbers.shape[1]))


def _time(r: ReceivedMessages, component: int, clock: _Clock) -> Array:
    """(n,) time of messages on the autopilot's clock [s]: that in the message, else interpolated by rank, else by the time
    received."""
    by_receiver = r.stamps - clock.offset
    sender_time = r.sender_time if r.component == component else np.full(len(r.table), np.nan)
    if clock.sender_time.size < 2:
        return np.where(np.isfinite(sender_time), sender_time, by_receiver)
    following = np.clip(np.searchsorted(clock.rank, r.rank), 1, clock.sender_time.size - 1)
    delay = clock.stamp - clock.sender_time
    spread = float(np.subtract(*np.percentile(delay, DELAY_PERCENTILES)))  # a burst is late by up to its length
    dense = np.abs(clock.sender_time[following] - clock.sender_time[following - 1]) < max(DENSE_STEP, spread)
    by_order = np.interp(r.rank, clock.rank, clock.sender_time)
    placeable = dense & (r.rank >= clock.rank[0]) & (r.rank <= clock.rank[-1])
    return np.where(np.isfinite(sender_time), sender_time, np.where(placeable, by_order, by_receiver))


def _valid_samples(r: ReceivedMessages, name: str, time: Array, values: Array, use: NDArray[np.bool_]) -> TimeSeries:
    """The samples of a field at the messages `use` (n,), without values that mean "not known" by the message's definition."""
    usable = use & (values != _NOT_KNOWN.get((r.name, name), np.nan))
    if r.name == "GPS_RAW_INT" and name in ("lat", "lon", "alt"):
        usable &= r.table["fix_type"] >= FIX_3D
    return TimeSeries(time, values) if usable.all() else TimeSeries(time[usable], values[usable])


def _clock_rates(clock: _Clock) -> Iterator[Contradiction]:
    """A contradiction where the rates of the sender's and the receiver's clock differ by more than CLOCK_RATE."""
    if clock.sender_time.size < FEWEST_DRIFT_MESSAGES:
        return
    if clock.sender_time[-1] - clock.sender_time[0] < SHORTEST_DRIFT_SPAN:
        return
    half = clock.sender_time.size // 2
    delay = clock.stamp - clock.sender_time
    rise, span = (float(np.median(v[half:])) - float(np.median(v[:half])) for v in (delay, clock.sender_time))
    drift = rise / max(span, LEAST_SPAN)
    if abs(drift) <= CLOCK_RATE:
        return
    text = (
        f"the receiver's clock runs {1.0 + drift:.3g} times as fast as the aircraft's own; the aircraft's is used: if it is "
        "wrong, all rates are"
    )
    moves = f"derivatives by p, q and r by {abs(drift):.0%}"
    sides = ("receiver's clock", "aircraft's clock")
    yield Contradiction(sides, text, 1.0 + drift, moves=moves, stops=abs(drift) > STOPPING_CLOCK_RATE)
