"""ArduPilot dataflash logs as text (.log), as Mission Planner and sim_vehicle write them from a .bin.

Each line is a message: its name and its fields, parted by commas; FMT lines name the fields. Values are in the units of the
message, scaled already. A line that has not as many fields as its FMT says is damage: counted and left out.
"""

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from groundstation.importers.errors import ImportDataError
from groundstation.importers.modes import dataflash_marks
from groundstation.importers.series import Array, Log, TimeSeries

_FIRST = re.compile(rb"\s*FMT\s*,\s*\d+\s*,")
_TIME = {"TimeUS": 1e-6, "TimeMS": 1e-3}
_TEXT_LETTERS = "nNZa"
SAID = ("MODE", "MSG", "EV", "ERR", "ARM")
"""Messages that are words, or events, and no samples."""
MOST_INSTANCES = 256
"""Of one sensor: ArduPilot numbers them in one byte."""


@dataclass
class _Kind:
    """A message: its fields, which of them are numbers, and the rows read so far."""

    fields: tuple[str, ...]
    numeric: tuple[bool, ...]
    rows: list[list[str]] = field(default_factory=list)

    @property
    def timed(self) -> bool:
        """Whether its first field is its time."""
        return bool(self.fields) and self.fields[0] in _TIME and self.numeric[0]


def is_text(data: bytes) -> bool:
    """Whether a log is the text form: it begins with the description of a message in words."""
    return _FIRST.match(data) is not None


def read_text_log(path: Path, data: bytes) -> Log:
    """All numeric fields of all timed messages. Raises ImportDataError when there is none."""
    kinds: dict[str, _Kind] = {}
    damaged = 0
    for line in data.decode("latin-1").splitlines():
        name, _, rest = line.partition(",")
        name = name.strip()
        if name == "FMT":
            damaged += not _describe(rest, kinds)
            continue
        if not name:
            continue
        kind = kinds.get(name)
        cells = [c.strip() for c in rest.split(",", max(len(kind.fields) - 1, 0))] if kind else []
        if kind is None or len(cells) != len(kind.fields):
            damaged += 1
        elif kind.timed:
            kind.rows.append(cells)
    series: dict[str, TimeSeries] = {}
    unread = 0
    for name, kind in kinds.items():
        made, wrong = _series(name, kind)
        series |= made
        unread += wrong
    if not series:
        raise ImportDataError(f"{path}: no timed messages in this dataflash log")
    notes = (f"{damaged + unread} lines of the log are damaged and left out",) if damaged + unread else ()
    end = max(float(s.time[-1]) for s in series.values())
    marks = dataflash_marks({n: _said(kinds[n]) for n in SAID if n in kinds}, end)
    return Log("dataflash", series, notes=notes, parameters=_parameters(kinds.get("PARM")), marks=marks)


def _said(kind: _Kind) -> list[tuple[float, dict[str, object]]]:
    """Time [s] and fields of messages that are words or events."""
    unit = _TIME.get(kind.fields[0], 0.0) if kind.fields else 0.0
    rows = [(_number(row[0]) * unit, dict(zip(kind.fields, row, strict=True))) for row in kind.rows]
    return [(time, dict[str, object](row)) for time, row in rows if math.isfinite(time)]


def _describe(rest: str, kinds: dict[str, _Kind]) -> bool:
    """Take a FMT line: type, length, name, letters, fields."""
    cells = [c.strip() for c in rest.split(",")]
    if len(cells) < 5:
        return False
    name, letters, fields = cells[2], cells[3], tuple(cells[4:])
    if len(letters) != len(fields) or name in kinds:
        return name in kinds or name == "FMT"
    kinds[name] = _Kind(fields, tuple(c not in _TEXT_LETTERS for c in letters))
    return True


def _series(name: str, kind: _Kind) -> tuple[dict[str, TimeSeries], int]:
    """The series of a message, further instances as 'NAME[1].field', and how many lines hold what are no numbers."""
    if not kind.rows:
        return {}, 0
    numbers = [i for i, numeric in enumerate(kind.numeric) if numeric]
    table = np.array([[_number(row[i]) for i in numbers] for row in kind.rows])
    sound = np.isfinite(table[:, 0])
    table = table[sound]
    time = table[:, 0] * _TIME[kind.fields[0]]
    labels = [kind.fields[i] for i in numbers]
    which = table[:, labels.index("I")] if "I" in labels[1:] else np.zeros(len(table))
    instances = np.unique(which[np.isfinite(which)])
    if not 0 < instances.size <= MOST_INSTANCES:
        which, instances = np.zeros(len(table)), np.zeros(1)
    out: dict[str, TimeSeries] = {}
    for number in instances:
        rows = which == number
        prefix = name if number == instances[0] else f"{name}[{number:g}]"
        out |= {
            f"{prefix}.{label}": TimeSeries(time[rows], _column(table, rows, k)) for k, label in enumerate(labels) if k
        }
    return out, int((~sound).sum())


def _column(table: Array, rows: Array, index: int) -> Array:
    return np.ascontiguousarray(table[rows.astype(bool), index])


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _parameters(kind: _Kind | None) -> dict[str, float]:
    if kind is None or not {"Name", "Value"} <= set(kind.fields):
        return {}
    name, value = kind.fields.index("Name"), kind.fields.index("Value")
    return {row[name]: number for row in kind.rows if math.isfinite(number := _number(row[value]))}
