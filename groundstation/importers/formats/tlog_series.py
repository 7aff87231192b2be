"""Series of the messages that one aircraft sent: their names, and their time on the autopilot's clock, boot by boot.

The autopilot's own messages are called 'MESSAGE.field'; those of another output port or sensor 'MESSAGE[1].field', of another
component (a gimbal, a companion) '154:MESSAGE.field'. Time is the autopilot's own (time_usec or time_boot_ms) where the message
has one. One without is of the time of those that were sent just before and after it: a radio may deliver late, but in order.
Where the autopilot's clock falls back, or stands still while the receiver's goes on, it has booted anew.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from groundstation.flight.contradictions import Contradiction
from groundstation.flight.marks import FlightMode, Mark, Marks, mode_changes
from groundstation.importers.modes import ARMED, armings, heartbeat_mode, mark_text
from groundstation.importers.series import Array, TimeSeries

LONGEST_ARRAY = 32
"""Elements of an array field that become series (the 32 outputs of ACTUATOR_OUTPUT_STATUS); longer ones are blocks of bytes."""
_NOT_KNOWN = {
    **{("SYS_STATUS", "voltage_battery"): 65535, ("SYS_STATUS", "current_battery"): -1},
    **{("GPS_RAW_INT", name): 65535 for name in ("vel", "cog", "eph", "epv")},
    ("GLOBAL_POSITION_INT", "hdg"): 65535,
}
"""Values that mean "not known" in the message definitions, by message and field."""
_INSTANCE = {"SERVO_OUTPUT_RAW": "port", "HIGHRES_IMU": "id", "BATTERY_STATUS": "id", "DISTANCE_SENSOR": "id"}
"""Message -> field that tells its several senders of one component apart."""
_FIX_3D = 3
AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
FALLS_BACK = 1.0
"""[s] by which the own clock of a later message is earlier only after a boot: messages are some tenths of a second old."""
STOOD_STILL = 10.0
"""[s] more between two messages by the receiver's clock than by the sender's, which had a pause, too: it was off between."""
DENSE = 0.3  # [s] between two messages with a time, between which one without can be placed by its order
CLOCK_RATE = 0.02  # difference of rate of the sender's and the receiver's clock that no quartz has
LONG_ENOUGH = 20.0  # [s] over which late deliveries do not look like another rate


@dataclass(frozen=True)
class ReceivedMessages:
    """Messages of one kind from one component, in the order of the file: table (n,) records; stamps (n,) time received [s];
    places (n,) of each in the file; rank (n,) by which messages of all kinds are in the order in which they were sent."""

    name: str
    component: int
    table: NDArray[np.void]
    stamps: Array
    places: NDArray[np.int64]
    rank: Array = field(default_factory=lambda: np.zeros(0))

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
        arrays = {n: getattr(self, n)[use] for n in ("table", "stamps", "places", "rank")}
        return replace(self, **arrays)


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

    def part(self, rows: slice | NDArray[np.bool_] | NDArray[np.int64]) -> "_Clock":
        """Some of the messages."""
        return _Clock(self.place[rows], self.stamp[rows], self.own[rows])


def by_boot(received: Sequence[ReceivedMessages]) -> list[Boot]:
    """The series of each boot, in the order of the file."""
    component = _autopilot(received)
    received = _ranked(received)
    clock = _clock([r for r in received if r.component == component])
    edges = _boot_edges(clock)
    first_offset = clock.part(slice(0, edges[1])).offset
    boots = []
    for begin, end in pairwise(edges):
        part = clock.part(slice(begin, end))
        low = -np.inf if begin == 0 else float(clock.place[begin])
        high = np.inf if end == clock.own.size else float(clock.place[end])
        messages = [r.part((r.rank >= low) & (r.rank < high)) for r in received]
        messages = [r for r in messages if len(r.table)]
        delay = part.offset - first_offset if part.own.size else 0.0
        series, notes = _series(messages, component, part, delay)
        marks = _marks([r for r in messages if r.component == component], part).moved(delay)
        boots.append(Boot(series, component, notes, tuple(_clock_rates(part)), marks))
    return [b for b in boots if b.series]


def _autopilot(received: Sequence[ReceivedMessages]) -> int:
    """The component that flies: the autopilot's number, else the one with most attitudes, else with most messages."""
    components = {r.component for r in received}
    if AUTOPILOT in components:
        return AUTOPILOT
    weight = dict.fromkeys(components, (0, 0))
    for r in received:
        attitudes, messages = weight[r.component]
        weight[r.component] = (attitudes + (len(r.table) if r.name == "ATTITUDE" else 0), messages + len(r.table))
    return max(weight, key=lambda c: weight[c])


def _ranked(received: Sequence[ReceivedMessages]) -> list[ReceivedMessages]:
    """With the rank of each message: its place in the file, or by the receiver's clock where the file is not in order of it."""
    places = np.concatenate([r.places for r in received])
    stamps = np.concatenate([r.stamps for r in received])[np.argsort(places, kind="stable")]
    by_stamp = bool(np.any(np.diff(stamps) < -FALLS_BACK))
    return [replace(r, rank=r.stamps if by_stamp else r.places.astype(float)) for r in received]


def _clock(received: Sequence[ReceivedMessages]) -> _Clock:
    time = np.concatenate([r.own for r in received])
    clock = _Clock(np.concatenate([r.rank for r in received]), np.concatenate([r.stamps for r in received]), time)
    order = np.lexsort((clock.own, clock.place))
    clock = clock.part(order[np.isfinite(clock.own[order])])
    wild = np.abs(clock.own - _median_of_five(clock.own)) > STOOD_STILL  # a damaged time among sound ones
    return clock.part(~wild)


def _median_of_five(values: Array) -> Array:
    if values.size < 5:
        return values
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, 2, mode="edge"), 5)
    return np.asarray(np.median(windows, axis=1))


def _boot_edges(clock: _Clock) -> list[int]:
    """Where each boot begins among the messages with a time, and the end."""
    step, receiver_step = np.diff(clock.own), np.diff(clock.stamp)
    anew = (step < -FALLS_BACK) | ((step > FALLS_BACK) & (receiver_step - step > STOOD_STILL))
    return [0, *(np.flatnonzero(anew) + 1).tolist(), clock.own.size]


def _series(
    received: Sequence[ReceivedMessages], component: int, clock: _Clock, late: float
) -> tuple[dict[str, TimeSeries], tuple[str, ...]]:
    series: dict[str, TimeSeries] = {}
    for r in received:
        time = _time(r, component, clock) + late
        head = "" if r.component == component else f"{r.component}:"
        for label, use in _instances(r):
            for name, values in _fields(r.table):
                series[f"{head}{r.name}{label}.{name}"] = _known(r, name, time, values, use)
    components = sorted({r.component for r in received} - {component})
    if not components:
        return series, ()
    names = ", ".join(map(str, components))
    return series, (f"messages of component {names} stand under names like {components[0]}:ATTITUDE.roll",)


def _marks(received: Sequence[ReceivedMessages], clock: _Clock) -> Marks:
    """Modes by the heartbeats of the autopilot, its messages, and when its motors were armed."""
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
    """Each sender of a message within the component, as it is called, and which messages are its own."""
    field = _INSTANCE.get(r.name)
    if field is None or field not in (r.table.dtype.names or ()):
        yield "", np.ones(len(r.table), bool)
        return
    for number in np.unique(r.table[field]).tolist():
        yield (f"[{number}]" if number else ""), r.table[field] == number


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


def _time(r: ReceivedMessages, component: int, clock: _Clock) -> Array:
    """Time of messages on the autopilot's clock [s]."""
    by_receiver = r.stamps - clock.offset
    sender_time = r.own if r.component == component else np.full(len(r.table), np.nan)
    if clock.own.size < 2:
        return np.where(np.isfinite(sender_time), sender_time, by_receiver)
    following = np.clip(np.searchsorted(clock.place, r.rank), 1, clock.own.size - 1)
    delay = clock.stamp - clock.own
    spread = float(np.subtract(*np.percentile(delay, [95, 5])))  # a burst is late by up to its length
    dense = np.abs(clock.own[following] - clock.own[following - 1]) < max(DENSE, spread)
    by_order = np.interp(r.rank, clock.place, clock.own)
    placeable = dense & (r.rank >= clock.place[0]) & (r.rank <= clock.place[-1])
    return np.where(np.isfinite(sender_time), sender_time, np.where(placeable, by_order, by_receiver))


def _known(r: ReceivedMessages, name: str, time: Array, values: Array, use: NDArray[np.bool_]) -> TimeSeries:
    """The samples of which the definition of the message does not say that they are none."""
    usable = use & (values != _NOT_KNOWN.get((r.name, name), np.nan))
    if r.name == "GPS_RAW_INT" and name in ("lat", "lon", "alt"):
        usable &= r.table["fix_type"] >= _FIX_3D
    return TimeSeries(time, values) if usable.all() else TimeSeries(time[usable], values[usable])


def _clock_rates(clock: _Clock) -> Iterator[Contradiction]:
    """The sender's clock against the receiver's, whose late deliveries make a line only over long."""
    if clock.own.size < 20 or clock.own[-1] - clock.own[0] < LONG_ENOUGH:
        return
    half = clock.own.size // 2
    delay = clock.stamp - clock.own
    rise, span = (float(np.median(v[half:])) - float(np.median(v[:half])) for v in (delay, clock.own))
    drift = rise / max(span, 1e-9)
    if abs(drift) <= CLOCK_RATE:
        return
    text = (
        f"the receiver's clock runs {1.0 + drift:.3g} times as fast as the aircraft's own; the aircraft's is used: if it is "
        "wrong, all rates are"
    )
    moves = f"derivatives by p, q and r by {abs(drift):.0%}"
    sides = ("receiver's clock", "aircraft's clock")
    yield Contradiction(sides, text, 1.0 + drift, moves=moves, stops=abs(drift) > 0.05)
