"""Series of the messages that one aircraft sent: their names, and their time on the autopilot's clock, boot by boot.

The autopilot's own messages are called 'MESSAGE.field'; those of another output port or sensor 'MESSAGE[1].field', of another
component (a gimbal, a companion) '154:MESSAGE.field'. Time is the autopilot's own (time_usec or time_boot_ms) where the message
has one. One without is of the time of those that were sent just before and after it: a radio may deliver late, but in order.
Where the autopilot's clock falls back, or stands still while the receiver's goes on, it has booted anew.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from groundstation.flight.contradictions import Contradiction
from groundstation.flight.marks import FlightMode, Mark, Marks, changes
from groundstation.importers.modes import ARMED, armings, heartbeat_mode, words
from groundstation.importers.series import Array, TimeSeries

LONGEST_ARRAY = 32
"""Elements of an array field that become series (the 32 outputs of ACTUATOR_OUTPUT_STATUS); longer ones are blocks of bytes."""
# Values that mean "not known" in the message definitions, by message and field.
_NOT_KNOWN = {
    ("SYS_STATUS", "voltage_battery"): 65535,
    ("SYS_STATUS", "current_battery"): -1,
    ("GPS_RAW_INT", "vel"): 65535,
    ("GPS_RAW_INT", "cog"): 65535,
    ("GPS_RAW_INT", "eph"): 65535,
    ("GPS_RAW_INT", "epv"): 65535,
    ("GLOBAL_POSITION_INT", "hdg"): 65535,
}
_INSTANCE = {"SERVO_OUTPUT_RAW": "port", "HIGHRES_IMU": "id", "BATTERY_STATUS": "id", "DISTANCE_SENSOR": "id"}
"""Message -> field that tells its several senders of one component apart."""
_FIX_3D = 3
AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
FALLS_BACK = 1.0
"""[s] by which the own clock of a later message is earlier only after a boot: messages are some tenths of a second old."""
STOOD_STILL = 10.0
"""[s] more between two messages by the receiver's clock than by the sender's, which had a pause, too: it was off between."""
DENSE = 0.3
"""[s] between two messages with a time, between which one without can be placed by its order."""
CLOCK_RATE = 0.02
"""Difference of rate of the sender's and the receiver's clock that no quartz has."""
LONG_ENOUGH = 20.0
"""[s] over which late deliveries do not look like another rate."""


@dataclass(frozen=True)
class ReceivedMessages:
    """Messages of one kind from one component, in the order of the file: table (n,) records; stamps (n,) time received [s];
    places (n,) of each in the file."""

    name: str
    component: int
    table: NDArray[np.void]
    stamps: Array
    places: NDArray[np.int64]

    @property
    def own(self) -> Array:
        """Time of each message on its sender's clock since boot [s], NaN where it has none; a time since 1970 is none."""
        names = self.table.dtype.names or ()
        if "time_boot_ms" in names:
            return np.asarray(self.table["time_boot_ms"] * 1e-3)
        if "time_usec" in names:
            return np.where(self.table["time_usec"] < 1e15, self.table["time_usec"] * 1e-6, np.nan)
        return np.full(len(self.table), np.nan)

    def part(self, use: NDArray[np.bool_]) -> "ReceivedMessages":
        """Some of the messages."""
        return ReceivedMessages(self.name, self.component, self.table[use], self.stamps[use], self.places[use])


@dataclass(frozen=True)
class Boot:
    """series: of one run of the autopilot, on its clock (of a later one, as much later as the receiver saw it)."""

    series: dict[str, TimeSeries]
    component: int
    notes: tuple[str, ...] = ()
    contradictions: tuple[Contradiction, ...] = field(default_factory=tuple)
    marks: Marks = field(default_factory=Marks)


@dataclass(frozen=True)
class _Clock:
    """Messages with a time of their own in the order in which they were sent: rank of each, stamp, own time [s]."""

    place: Array
    stamp: Array
    own: Array

    @property
    def offset(self) -> float:
        """Receiver's less sender's clock [s] of the message that came least late."""
        return float(np.min(self.stamp - self.own)) if self.own.size else 0.0


def by_boot(received: Sequence[ReceivedMessages]) -> list[Boot]:
    """The series of each boot, in the order of the file."""
    component = _autopilot(received)
    order = _sent_in_order(received)
    own = [r for r in received if r.component == component]
    clock = _clock(own, order)
    edges = _boots(clock)
    first = _Clock(*(a[: edges[1]] for a in (clock.place, clock.stamp, clock.own)))
    boots = []
    for begin, end in zip(edges[:-1], edges[1:], strict=True):
        part = _Clock(clock.place[begin:end], clock.stamp[begin:end], clock.own[begin:end])
        low = -np.inf if begin == 0 else float(clock.place[begin])
        high = np.inf if end == clock.own.size else float(clock.place[end])
        inside = [r.part((order(r) >= low) & (order(r) < high)) for r in received]
        late = part.offset - first.offset if part.own.size else 0.0
        series, notes = _series([r for r in inside if len(r.table)], component, order, part, late)
        marks = _marks(inside, component, order, part).moved(late)
        boots.append(Boot(series, component, notes, tuple(_clock_rates(part)), marks))
    return [b for b in boots if b.series]


def _autopilot(received: Sequence[ReceivedMessages]) -> int:
    """The component that flies: the autopilot's number, else the one with most attitudes, else with most messages."""
    components = {r.component for r in received}
    if AUTOPILOT in components:
        return AUTOPILOT
    weight = dict.fromkeys(components, (0, 0))
    for r in received:
        attitudes, every = weight[r.component]
        weight[r.component] = (attitudes + (len(r.table) if r.name == "ATTITUDE" else 0), every + len(r.table))
    return max(weight, key=lambda c: weight[c])


class _Order:
    """Rank of each message: its place in the file, or by the receiver's clock where the file is not in order of it."""

    def __init__(self, received: Sequence[ReceivedMessages]) -> None:
        places = np.concatenate([r.places for r in received])
        stamps = np.concatenate([r.stamps for r in received])[np.argsort(places, kind="stable")]
        self._by_stamp = bool(np.any(np.diff(stamps) < -FALLS_BACK))

    def __call__(self, r: ReceivedMessages) -> Array:
        return r.stamps if self._by_stamp else r.places.astype(float)


def _sent_in_order(received: Sequence[ReceivedMessages]) -> _Order:
    return _Order(received)


def _clock(own: Sequence[ReceivedMessages], order: _Order) -> _Clock:
    place = np.concatenate([order(r) for r in own])
    stamp = np.concatenate([r.stamps for r in own])
    time = np.concatenate([r.own for r in own])
    keep = np.flatnonzero(np.isfinite(time))
    keep = keep[np.lexsort((time[keep], place[keep]))]
    clock = _Clock(place[keep], stamp[keep], time[keep])
    wild = np.abs(clock.own - _median_of_five(clock.own)) > STOOD_STILL  # a damaged time among sound ones
    return _Clock(clock.place[~wild], clock.stamp[~wild], clock.own[~wild])


def _median_of_five(values: Array) -> Array:
    if values.size < 5:
        return values
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, 2, mode="edge"), 5)
    return np.asarray(np.median(windows, axis=1))


def _boots(clock: _Clock) -> list[int]:
    """Where each boot begins among the messages with a time, and the end."""
    step, passed = np.diff(clock.own), np.diff(clock.stamp)
    anew = (step < -FALLS_BACK) | ((step > FALLS_BACK) & (passed - step > STOOD_STILL))
    return [0, *(np.flatnonzero(anew) + 1).tolist(), clock.own.size]


def _series(
    received: Sequence[ReceivedMessages], component: int, order: _Order, clock: _Clock, late: float
) -> tuple[dict[str, TimeSeries], tuple[str, ...]]:
    series: dict[str, TimeSeries] = {}
    others = set()
    for r in received:
        time = _time(r, component, order, clock) + late
        head = "" if r.component == component else f"{r.component}:"
        others |= {r.component} - {component}
        for label, use in _instances(r):
            for name, values in _fields(r.table):
                series[f"{head}{r.name}{label}.{name}"] = _known(r, name, time, values, use)
    told = ", ".join(map(str, sorted(others)))
    notes = (f"messages of component {told} stand under names like {min(others)}:ATTITUDE.roll",) if others else ()
    return series, notes


def _marks(received: Sequence[ReceivedMessages], component: int, order: _Order, clock: _Clock) -> Marks:
    """Modes by the heartbeats of the autopilot, its messages, and when its motors were armed."""
    modes: tuple[FlightMode, ...] = ()
    events: tuple[Mark, ...] = ()
    messages: list[Mark] = []
    for r in received:
        if r.component != component or not len(r.table) or r.name not in ("HEARTBEAT", "STATUSTEXT"):
            continue
        time = _time(r, component, order, clock).tolist()
        if r.name == "STATUSTEXT":
            messages += [Mark(t, words(text)) for t, text in zip(time, r.table["text"].tolist(), strict=True) if text]
            continue
        fields = (r.table[n].tolist() for n in ("type", "autopilot", "custom_mode"))
        names = [heartbeat_mode(*row) for row in zip(*fields, strict=True)]
        modes = changes(time, names, max(time, default=0.0))
        events = armings(time, (r.table["base_mode"] & ARMED > 0).tolist())
    return Marks(modes, events, tuple(messages))


def _instances(r: ReceivedMessages) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Each sender of a message within the component, as it is called, and which messages are its own."""
    by = _INSTANCE.get(r.name)
    if by is None or by not in (r.table.dtype.names or ()):
        yield "", np.ones(len(r.table), bool)
        return
    for number in np.unique(r.table[by]).tolist():
        yield (f"[{number}]" if number else ""), r.table[by] == number


def _fields(table: NDArray[np.void]) -> Iterator[tuple[str, Array]]:
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


def _time(r: ReceivedMessages, component: int, order: _Order, clock: _Clock) -> Array:
    """Time of messages on the autopilot's clock [s]."""
    by_receiver = r.stamps - clock.offset
    own = r.own if r.component == component else np.full(len(r.table), np.nan)
    if clock.own.size < 2:
        return np.where(np.isfinite(own), own, by_receiver)
    place = order(r)
    after = np.clip(np.searchsorted(clock.place, place), 1, clock.own.size - 1)
    delay = clock.stamp - clock.own
    spread = float(np.subtract(*np.percentile(delay, [95, 5])))  # a burst is late by up to its length
    dense = np.abs(clock.own[after] - clock.own[after - 1]) < max(DENSE, spread)
    by_order = np.interp(place, clock.place, clock.own)
    between = dense & (place >= clock.place[0]) & (place <= clock.place[-1])
    return np.where(np.isfinite(own), own, np.where(between, by_order, by_receiver))


def _known(r: ReceivedMessages, name: str, time: Array, values: Array, use: NDArray[np.bool_]) -> TimeSeries:
    """The samples of which the definition of the message does not say that they are none."""
    good = use & (values != _NOT_KNOWN.get((r.name, name), np.nan))
    if r.name == "GPS_RAW_INT" and name in ("lat", "lon", "alt"):
        good &= r.table["fix_type"] >= _FIX_3D
    return TimeSeries(time, values) if good.all() else TimeSeries(time[good], values[good])


def _clock_rates(clock: _Clock) -> Iterator[Contradiction]:
    """The sender's clock against the receiver's, whose late deliveries make a line only over long."""
    if clock.own.size < 20 or clock.own[-1] - clock.own[0] < LONG_ENOUGH:
        return
    half = clock.own.size // 2
    delay = clock.stamp - clock.own
    early, later = delay[:half], delay[half:]
    middle = (float(np.median(clock.own[:half])), float(np.median(clock.own[half:])))
    drift = (float(np.median(later)) - float(np.median(early))) / max(middle[1] - middle[0], 1e-9)
    if abs(drift) <= CLOCK_RATE:
        return
    text = (
        f"the receiver's clock runs {1.0 + drift:.3g} times as fast as the aircraft's own; the aircraft's is used: if it is "
        "wrong, all rates are"
    )
    yield Contradiction(
        ("receiver's clock", "aircraft's clock"), text, 1.0 + drift, moves=f"derivatives by p, q and r by {abs(drift):.0%}",
        stops=abs(drift) > 0.05,
    )  # fmt: skip
