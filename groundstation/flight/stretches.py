"""Stretches of a flight by times, by the name of a flight mode, or by a condition over its columns, as `--segments` writes them.

`2:12,15:25` [s], `mode:MANUAL`, `V > 12 and abs(phi) < 0.5`, `mode:FBWA and V > 12`. Stretches by name or condition leave out
what is no flight (`airborne`), and runs too short for a manoeuvre.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.contract.plain_words import listed
from groundstation.flight.airborne import airborne, stretches_of
from groundstation.flight.errors import FlightError
from groundstation.flight.expression import MODE, Expression, parse_condition
from groundstation.flight.flight import Flight
from groundstation.flight.marks import FlightMode, marks_of

Array = NDArray[np.float64]

SHORTEST = 1.0
"""[s] of a stretch by name or condition: less holds no manoeuvre."""
_TIMES = re.compile(r"(?:[\s\d.eE+\-,]|inf|nan)*:(?:[\s\d.eE+\-:,]|inf|nan)*|[\s\d.eE+\-,]+")
_SHOWN = 12


class StretchError(FlightError):
    """A text that names no stretch of a flight."""


@dataclass(frozen=True)
class LabelledStretches:
    """label: (N,) number of the stretch of each sample, -1 outside; notes: what was left out, and why."""

    label: NDArray[np.int64]
    notes: tuple[str, ...] = ()


def is_times(text: str) -> bool:
    """Whether a text means stretches by their times."""
    return not text.strip() or _TIMES.fullmatch(text.strip()) is not None


def where(flight: Flight, text: str) -> LabelledStretches:
    """The stretches of a flight in which a condition holds. Raises FlightError where the text is none, or names a column or a
    mode that the flight has not, and where nothing is left."""
    condition = parse_condition(text)
    columns = _columns(flight, condition)
    holds = (condition.of(columns) > 0.0) & np.all([np.isfinite(c) for c in columns.values()], axis=0)
    notes: list[str] = []
    flown = airborne(flight)
    if flown.text and (holds & ~flown.flying).any():
        notes.append(flown.text)
    long_enough, short = [], 0
    for a, b in stretches_of(holds & flown.flying, flight):
        if flight.time[b - 1] - flight.time[a] >= SHORTEST:
            long_enough.append((a, b))
        else:
            short += 1
    if short:
        notes.append(f"{short} stretches of '{text}' shorter than {SHORTEST:g} s left out")
    label = np.full(len(flight), -1, np.int64)
    for number, (a, b) in enumerate(long_enough):
        label[a:b] = number
    if not long_enough:
        left = "; ".join(notes) or f"it holds at {int(holds.sum())} of {len(flight)} samples"
        raise StretchError(f"--segments {text!r}: nothing of {flight.name} is left: {left}")
    return LabelledStretches(label, tuple(notes))


def _columns(flight: Flight, condition: Expression) -> dict[str, Array]:
    """What a condition reads."""
    modes = marks_of(flight).modes
    columns: dict[str, Array] = {}
    for name in condition.columns:
        if name.startswith(MODE):
            columns[name] = _in_mode(flight, name.removeprefix(MODE), modes)
        elif name == "time":
            columns[name] = flight.time
        elif flight.measured(name):
            columns[name] = flight[name]
        else:
            known = listed(["time", *(c for c in flight.columns if flight.measured(c))], 40)
            raise StretchError(f"--segments {condition.text!r}: {flight.name} has no column {name}; it has {known}")
    return columns


def _in_mode(flight: Flight, name: str, modes: Iterable[FlightMode]) -> Array:
    """(N,) 1 where the autopilot was in a mode, 0 elsewhere."""
    spans = [m for m in modes if m.name.upper() == name.upper()]
    if not spans:
        known = listed(dict.fromkeys(m.name for m in modes), _SHOWN)
        raise StretchError(
            f"--segments mode:{name}: {flight.name} was never in it; "
            + (f"its modes are {known}" if known else "its file names no flight modes; write times like 2:12")
        )
    inside = np.zeros(len(flight))
    for span in spans:
        inside[(flight.time >= span.start) & (flight.time < span.stop)] = 1.0
    return inside
