"""Digital read-outs of the viewer with units, and the banner of alarms. A number older than FRESH_S shows as a dash."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from daq.utilities.constants import GRAVITY

FRESH_S = 2.5
"""Largest age [s] of a number that is shown: slow channels are sent about once a second, and one sample may be lost."""


@dataclass(frozen=True, slots=True)
class Readout:
    """One number, factor * column, in `unit` with `places` decimals; signed: whether a plus is shown."""

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
    """All read-outs in one line of Markdown. values: fresh columns in SI. link: text at the end."""
    texts = [r.text(values.get(r.column, math.nan)) for r in READOUTS]
    return "## " + " · ".join([*texts, *([link] if link else [])])


class FreshValues:
    """The last value of each column of the read-outs."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[float, float]] = {}

    def update(self, time: float, values: Mapping[str, float]) -> None:
        """Add one sample. time: [s] of the flight; values: columns in SI."""
        for readout in READOUTS:
            value = values.get(readout.column, math.nan)
            if math.isfinite(value):
                self._last[readout.column] = (time, value)

    def at(self, time: float) -> dict[str, float]:
        """The columns whose last value is no older than FRESH_S at `time` [s]."""
        return {c: value for c, (updated, value) in self._last.items() if time - updated <= FRESH_S}


LEVELS = ("WARN", "ERROR", "CRITICAL")  # of alarms, in rising order
LARGE_BANNER = 45
"""Characters of a heading that fit the pane of the banner on a page of 820 pixels; a longer text is set in bold."""


def banner(in_force: Sequence[tuple[str, str, str]]) -> tuple[str, str]:
    """Level and line of Markdown for the alarms in force, each (name, state, level); level "" without an alarm.

    The level is the highest of the active alarms, or of the latched ones where none is active.
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
