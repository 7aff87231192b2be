"""Digital read-outs: the numbers that somebody on the ground reads aloud, with units, and what is in alarm.

A number is shown while it is fresh; after that a dash says that it is not known now.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from daq.utilities.constants import GRAVITY

FRESH_S = 2.5
"""Longest age [s] of a number that is shown: slow channels come about once a second, and one of them may be lost."""


@dataclass(frozen=True, slots=True)
class Readout:
    """One number. shown = factor * column, in `unit` with `places` decimals; signed: with its sign always."""

    column: str
    title: str
    unit: str
    factor: float = 1.0
    places: int = 1
    signed: bool = False

    def text(self, value: float) -> str:
        """Title, number and unit; a dash for NaN."""
        if not math.isfinite(value):
            return f"{self.title} – {self.unit}"
        sign = "+" if self.signed else ""
        return f"{self.title} {self.factor * value:{sign}.{self.places}f} {self.unit}"


READOUTS = (
    Readout("V", "V", "m/s"),
    Readout("altitude", "h", "m", places=0),
    Readout("alpha", "α", "°", math.degrees(1), signed=True),
    Readout("beta", "β", "°", math.degrees(1), signed=True),
    Readout("az", "n", "g", -1 / GRAVITY, 2, signed=True),  # load factor: specific force upwards
    Readout("supply_voltage", "battery", "V"),
)


def readout_line(values: Mapping[str, float], link: str = "") -> str:
    """All read-outs in one line of Markdown. values: columns in SI; one that is not there is not known."""
    texts = [r.text(values.get(r.column, math.nan)) for r in READOUTS]
    return "## " + " · ".join([*texts, *([link] if link else [])])


class FreshValues:
    """The last value of each column of the read-outs, as long as it is fresh."""

    def __init__(self) -> None:
        self._seen: dict[str, tuple[float, float]] = {}

    def update(self, time: float, values: Mapping[str, float]) -> None:
        """Take in one sample; time [s] of the flight."""
        for readout in READOUTS:
            value = values.get(readout.column, math.nan)
            if math.isfinite(value):
                self._seen[readout.column] = (time, value)

    def at(self, time: float) -> dict[str, float]:
        """Columns that are fresh at this time."""
        return {c: value for c, (updated, value) in self._seen.items() if time - updated <= FRESH_S}


LEVELS = ("WARN", "ERROR", "CRITICAL")
LARGE_BANNER = 45
"""Letters that the pane of the banner holds as a heading on a page of 820 pixels; more are set as text, or cut off."""


def banner(in_force: Sequence[tuple[str, str, str]]) -> tuple[str, str]:
    """(level, line of Markdown) of the alarms in force, given as (name, state, level); level "" without any.

    The level is the highest of those that are active, or of the latched ones where none is active any more.
    """
    if not in_force:
        return "", "no alarm"
    active = [row for row in in_force if row[1] == "active"]
    over = [row for row in in_force if row[1] != "active"]
    level = max((row[2] for row in active or over), key=LEVELS.index)
    names = [", ".join(row[0] for row in active)] if active else []
    names += ["over: " + ", ".join(row[0] for row in over)] if over else []
    text = f"{level}: {'; '.join(names)}"
    return level, f"## {text}" if len(text) <= LARGE_BANNER else f"**{text}**"
