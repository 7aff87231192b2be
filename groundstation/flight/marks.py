"""Marks of a log: flight modes, events and messages of the autopilot. They are stored with a flight, drawn in figures, and select
stretches of it.

In a flight file they stand in the provenance: `modes` [{"mode", "from", "to"}], `events` and
`messages` [{"time", "origin", "text"}].
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from operator import itemgetter
from typing import Any

from daq.utilities.plain_words import one_line
from groundstation.flight.flight import LATEST, Flight

MODES, EVENTS, MESSAGES, PARAMETERS = "modes", "events", "messages", "parameters"  # keys of a provenance's detail
MOST = 20_000  # marks of each kind that are stored: a mode every second for five hours
LONGEST_TEXT = 200  # characters of a mark; MAVLink's messages have 50, PX4's 127


@dataclass(frozen=True, slots=True)
class FlightMode:
    """A flight mode by its name, from `start` until `stop` [s]."""

    name: str
    start: float
    stop: float


@dataclass(frozen=True, slots=True)
class Mark:
    """An event or a message at `time` [s]. origin: its source."""

    time: float
    text: str
    origin: str = "autopilot"


@dataclass(frozen=True, slots=True)
class Marks:
    """The marks of a flight, each kind in order of time."""

    modes: tuple[FlightMode, ...] = ()
    events: tuple[Mark, ...] = ()
    messages: tuple[Mark, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.modes or self.events or self.messages)

    def moved(self, delay: float) -> "Marks":
        """The same marks, `delay` seconds later."""
        modes = tuple(replace(m, start=m.start + delay, stop=m.stop + delay) for m in self.modes)
        events, messages = (
            tuple(replace(m, time=m.time + delay) for m in marks) for marks in (self.events, self.messages)
        )
        return Marks(modes, events, messages)

    def to_json(self) -> dict[str, list[dict[str, Any]]]:
        """As in a flight file and in `info --json`."""
        return {
            MODES: [{"mode": m.name, "from": m.start, "to": m.stop} for m in self.modes[:MOST]],
            EVENTS: [{"time": m.time, "origin": m.origin, "text": m.text} for m in self.events[:MOST]],
            MESSAGES: [{"time": m.time, "origin": m.origin, "text": m.text} for m in self.messages[:MOST]],
        }


def joined_marks(parts: Iterable[Marks]) -> Marks:
    """The marks of several records in a row."""
    records = tuple(parts)
    return Marks(
        tuple(m for record in records for m in record.modes),
        tuple(m for record in records for m in record.events),
        tuple(m for record in records for m in record.messages),
    )


def marks_of(flight: Flight) -> Marks:
    """The marks stored with a flight. Malformed entries, which a flight from elsewhere may have, are left out."""
    detail = flight.provenance.detail

    def text(row: Mapping[str, Any], key: str) -> str:
        return one_line(str(row.get(key, "")), LONGEST_TEXT)

    rows = rows_of(detail, MODES, ("from", "to"), "mode")
    modes = [FlightMode(text(row, "mode"), float(row["from"]), float(row["to"])) for row in rows]
    events, messages = (
        tuple(
            Mark(float(r["time"]), text(r, "text"), text(r, "origin")) for r in rows_of(detail, key, ("time",), "text")
        )
        for key in (EVENTS, MESSAGES)
    )
    return Marks(tuple(m for m in modes if m.start <= m.stop), events, messages)


def mode_changes(time: Iterable[float], names: Iterable[str], end: float) -> tuple[FlightMode, ...]:
    """Modes from samples of their name in order of time; the last lasts until `end` [s]."""
    pairs = list(zip(time, names, strict=True))
    starts = [next(samples) for _, samples in groupby(pairs, key=itemgetter(1))]
    stops = [*(t for t, _ in starts[1:]), max(end, starts[-1][0] if starts else end)]
    return tuple(FlightMode(name, start, stop) for (start, name), stop in zip(starts, stops, strict=False))


def rows_of(detail: Mapping[str, Any], key: str, numbers: tuple[str, ...], text: str) -> list[Mapping[str, Any]]:
    """The entries of a provenance under `key` whose fields `numbers` are finite numbers and whose field `text` is text."""
    rows = detail.get(key)
    return [
        row
        for row in (rows[:MOST] if isinstance(rows, list) else [])
        if isinstance(row, Mapping)
        and all(isinstance(row.get(n), int | float) and abs(row[n]) < LATEST for n in numbers)
        and isinstance(row.get(text), str)
    ]
