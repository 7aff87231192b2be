"""ArduPilot dataflash (.bin, .log as text). Series are named 'MESSAGE.field', further instances of a sensor 'MESSAGE[1].field'.

Format: ArduPilot developer guide, "Log messages": each file describes its own messages (FMT: length, field letters and names;
FMTU: units, among them '#' for the field with the number of the instance). In a binary log every message begins with A3 95 and
its type; bytes outside messages are skipped. In a text log each line is a message: its name and its scaled fields, separated by
commas; a line with another number of fields than its FMT is damaged. Time is TimeUS since boot.
"""

import math
import re
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from daq.utilities.input_files import read_bytes
from groundstation.flight.arrays import Array
from groundstation.importers.errors import ImportDataError
from groundstation.importers.modes import dataflash_marks
from groundstation.importers.series import Log, TimeSeries, instance_rows

Rows = list[tuple[float, dict[str, object]]]

HEAD = b"\xa3\x95"
MOST_BETWEEN_HEADS = 1000
"""Bytes for each head of a message, at most, in a log whose beginning is lost: random bytes hold one in 64 kB."""
FEWEST_HEADS = 10  # in such a log
_FMT, _FMT_SIZE = 128, 89
_DESCRIPTION = struct.Struct("<BB4s16s64s")
_FIRST_LINE = re.compile(rb"\s*FMT\s*,\s*\d+\s*,")

# Field letter -> struct code and factor; None for text and arrays, which become no series.
_LETTERS: dict[str, tuple[str, float | None]] = {
    **{code: (code, 1) for code in "bBhHiIqQfd"}, "g": ("e", 1), "M": ("B", 1),
    "c": ("h", 0.01), "C": ("H", 0.01), "e": ("i", 0.01), "E": ("I", 0.01), "L": ("i", 1e-7),
    "n": ("4s", None), "N": ("16s", None), "Z": ("64s", None), "a": ("64s", None),
}  # fmt: skip
TIME_UNITS = {"TimeUS": 1e-6, "TimeMS": 1e-3}
"""First field of a message, its time since boot -> unit [s]; TimeMS in logs before ArduPilot 3.3."""
EVENTS = ("MODE", "MSG", "EV", "ERR", "ARM")  # messages of text or events


def is_text(data: bytes) -> bool:
    """Whether a log has the text form: its first line describes a message."""
    return _FIRST_LINE.match(data) is not None


def read_dataflash(path: Path) -> Log:
    """A dataflash log: all numeric fields of all timed messages. Raises ImportDataError for another file."""
    data = read_bytes(path, error=ImportDataError)
    return with_velocities(_read_text(path, data) if is_text(data) else _read_binary(path, data))


def with_velocities(log: Log) -> Log:
    """The log with VN and VE [m/s] from each GPS's speed and course [deg]."""
    series = dict(log.series)
    for gps in [n.rsplit(".", 1)[0] for n in series if n.endswith(".Spd") and n.startswith("GPS")]:
        speed, course = series[f"{gps}.Spd"], series.get(f"{gps}.GCrs")
        if course is not None:
            angle = np.deg2rad(course.values)
            series[f"{gps}.VN"] = TimeSeries(speed.time, speed.values * np.cos(angle))
            series[f"{gps}.VE"] = TimeSeries(speed.time, speed.values * np.sin(angle))
    return replace(log, series=series)


def _dataflash_log(
    path: Path,
    series: dict[str, TimeSeries],
    notes: tuple[str, ...],
    events: Mapping[str, Rows],
    parameters: Iterable[tuple[str, float]],
) -> Log:
    """The log of its series, events and parameters (the last value of each). Raises ImportDataError without series."""
    if not series:
        raise ImportDataError(f"{path}: no timed messages in this dataflash log")
    marks = dataflash_marks(events, max(float(s.time[-1]) for s in series.values()))
    finite = {name: value for name, value in parameters if math.isfinite(value)}
    return Log("dataflash", series, notes=notes, parameters=finite, marks=marks)


# -------------------------------------------------------------------------------------------------------------- binary


@dataclass
class _BinaryMessage:
    """One message type: its layout, and the bodies read so far, one after the other."""

    name: str
    size: int
    layout: struct.Struct
    fields: tuple[str, ...]
    letters: str
    bodies: bytearray = field(default_factory=bytearray)
    instance: int | None = None

    @property
    def timed(self) -> bool:
        """Whether the message carries the time at which it was logged."""
        return self.fields[0] in TIME_UNITS and self.numeric(0)

    @property
    def time(self) -> Array:
        """(N,) since boot [s]."""
        return self.column(0) * TIME_UNITS[self.fields[0]]

    def column(self, index: int) -> Array:
        """(N,) values of a numeric field, in its unit."""
        code, factor = _LETTERS[self.letters[index]]
        offset = struct.calcsize("<" + "".join(_LETTERS[c][0] for c in self.letters[:index]))
        kind = np.dtype({"names": ["x"], "formats": [f"<{code}"], "offsets": [offset], "itemsize": self.layout.size})
        with np.errstate(invalid="ignore"):  # a signalling NaN of a damaged message
            return np.frombuffer(self.bodies, kind)["x"].astype(float) * (factor or 1.0)

    def numeric(self, index: int) -> bool:
        """Whether a field is a number."""
        return _LETTERS[self.letters[index]][1] is not None

    def rows(self) -> Iterator[dict[str, object]]:
        """Field by name of each message."""
        return (dict(zip(self.fields, row, strict=True)) for row in self.layout.iter_unpack(bytes(self.bodies)))

    def instances(self) -> Array:
        """(N,) number of the sensor of each message, by the field that FMTU marks, or I in logs older than FMTU."""
        index = self.instance
        if index is None:
            index = self.fields.index("I") if "I" in self.fields else 0
        usable = 0 < index < len(self.fields) and self.numeric(index) and np.isfinite(self.column(index)).all()
        return self.column(index) if usable else np.zeros(self.time.size)


def _read_binary(path: Path, data: bytes) -> Log:
    headless = not data.startswith(HEAD)
    if headless and data.count(HEAD) * MOST_BETWEEN_HEADS < max(len(data), FEWEST_HEADS * MOST_BETWEEN_HEADS):
        raise ImportDataError(f"{path}: not an ArduPilot dataflash log (it does not begin with a message head)")
    messages, skipped = _binary_messages(data)
    if headless and not messages:
        raise ImportDataError(
            f"{path}: the beginning of this ArduPilot log is lost, and with it the descriptions of its messages (FMT): nothing "
            "of the rest can be read; copy the log from the card again"
        )
    headless_note = "; its first bytes are lost, and messages described only there" if headless else ""
    notes = (f"{skipped} bytes of the log are damaged and left out{headless_note}",) if skipped or headless_note else ()
    events: dict[str, Rows] = {}
    for message in messages.values():
        if message.name in EVENTS and message.timed:
            events.setdefault(message.name, []).extend(zip(message.time.tolist(), message.rows(), strict=True))
    return _dataflash_log(path, _binary_series(messages), notes, events, _binary_parameters(messages))


def _binary_messages(data: bytes) -> tuple[dict[int, _BinaryMessage], int]:
    """The messages by type, and the number of bytes outside messages.

    After damage a regular expression finds the next head of a known type, in time proportional to the bytes.
    """
    messages: dict[int, _BinaryMessage] = {}
    heads = _heads(messages)
    skipped = position = 0
    while position + 3 <= len(data):
        size = _message_size(data, position, messages)
        if size:
            if _add_message(data, position, size, messages):
                heads = _heads(messages)
            position += size
            continue
        match = heads.search(data, position + 1)
        following = match.start() if match else len(data)
        skipped += following - position
        position = following
    return messages, skipped + len(data) - min(position, len(data))


def _heads(messages: dict[int, _BinaryMessage]) -> "re.Pattern[bytes]":
    """A pattern for the beginning of a message of a known type."""
    kinds = b"".join(re.escape(bytes([kind])) for kind in (_FMT, *messages))
    return re.compile(re.escape(HEAD) + b"[" + kinds + b"]")


def _message_size(data: bytes, position: int, messages: dict[int, _BinaryMessage]) -> int:
    """Length of the message at a position; 0 where no known one begins, or it is cut off."""
    if data[position : position + 2] != HEAD:
        return 0
    kind = data[position + 2]
    size = _FMT_SIZE if kind == _FMT else messages[kind].size if kind in messages else 0
    return size if position + size <= len(data) else 0


def _add_message(data: bytes, position: int, size: int, messages: dict[int, _BinaryMessage]) -> bool:
    """Add the message at a position; returns whether it described a new type."""
    kind = data[position + 2]
    if kind == _FMT:
        number, length, name, letters, labels = _DESCRIPTION.unpack_from(data, position + 3)
        if number == _FMT or number in messages:
            return False
        message = _message_type(_text(name), length, _text(letters), _text(labels))
        if message is not None:
            messages[number] = message
        return message is not None
    message = messages[kind]
    if message.name == "FMTU":
        units = dict(zip(message.fields, message.layout.unpack_from(data, position + 3), strict=True))
        number, letters = units.get("FmtType"), units.get("UnitIds")
        if isinstance(number, int) and isinstance(letters, bytes) and number in messages and b"#" in letters:
            messages[number].instance = letters.index(b"#")
    elif message.timed:
        message.bodies += data[position + 3 : position + size]
    return False


def _message_type(name: str, length: int, letters: str, labels: str) -> _BinaryMessage | None:
    """A message type from its FMT; None for a description that contradicts itself (damage)."""
    fields = tuple(labels.split(",")) if labels else ()
    if not fields or len(fields) != len(letters) or any(c not in _LETTERS for c in letters):
        return None
    layout = struct.Struct("<" + "".join(_LETTERS[c][0] for c in letters))
    return _BinaryMessage(name, length, layout, fields, letters) if layout.size + 3 == length else None


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("ascii", "replace")


def _binary_parameters(messages: dict[int, _BinaryMessage]) -> Iterator[tuple[str, float]]:
    """The autopilot's parameters (PARM: Name, Value), in the order of the log."""
    for message in messages.values():
        if message.name != "PARM" or not {"Name", "Value"} <= set(message.fields):
            continue
        index = message.fields.index("Value")
        if message.numeric(index):
            for row, value in zip(message.rows(), message.column(index).tolist(), strict=True):
                if isinstance(row["Name"], bytes):
                    yield _text(row["Name"]), value


def _binary_series(messages: dict[int, _BinaryMessage]) -> dict[str, TimeSeries]:
    """Series by MESSAGE.field, of each instance."""
    series: dict[str, TimeSeries] = {}
    names: set[str] = set()
    for kind, message in messages.items():
        if not message.bodies:
            continue
        label = f"{message.name}({kind})" if message.name in names else message.name  # two types of one name are damage
        names.add(message.name)
        rows = instance_rows(label, message.instances())
        times = {instance: message.time[use] for instance, use in rows.items()}
        for i, name in enumerate(message.fields):
            if i and message.numeric(i):
                values = message.column(i)
                series |= {f"{x}.{name}": TimeSeries(times[x], values[use]) for x, use in rows.items()}
    return series


# ---------------------------------------------------------------------------------------------------------------- text


@dataclass
class _TextMessage:
    """A message: its fields, which of them are numbers, and the rows read so far."""

    fields: tuple[str, ...]
    numeric: tuple[bool, ...]
    rows: list[list[str]] = field(default_factory=list)

    @property
    def timed(self) -> bool:
        """Whether its first field is its time."""
        return bool(self.fields) and self.fields[0] in TIME_UNITS and self.numeric[0]


def _read_text(path: Path, data: bytes) -> Log:
    messages: dict[str, _TextMessage] = {}
    damaged = 0
    for line in data.decode("latin-1").splitlines():
        name, _, rest = line.partition(",")
        name = name.strip()
        if name == "FMT":
            damaged += not _describe_text(rest, messages)
            continue
        if not name:
            continue
        message = messages.get(name)
        cells = [c.strip() for c in rest.split(",", max(len(message.fields) - 1, 0))] if message else []
        if message is None or len(cells) != len(message.fields):
            damaged += 1
        elif message.timed:
            message.rows.append(cells)
    series: dict[str, TimeSeries] = {}
    for name, message in messages.items():
        columns, damaged_lines = _text_series(name, message)
        series |= columns
        damaged += damaged_lines
    notes = (f"{damaged} lines of the log are damaged and left out",) if damaged else ()
    events = {n: _text_events(messages[n]) for n in EVENTS if n in messages}
    return _dataflash_log(path, series, notes, events, _text_parameters(messages.get("PARM")))


def _describe_text(rest: str, messages: dict[str, _TextMessage]) -> bool:
    """Add the message of an FMT line (type, length, name, letters, fields); returns whether the line is sound."""
    cells = [c.strip() for c in rest.split(",")]
    if len(cells) < 5:
        return False
    name, letters, fields = cells[2], cells[3], tuple(cells[4:])
    if len(letters) != len(fields) or name in messages:
        return name in messages or name == "FMT"
    messages[name] = _TextMessage(fields, tuple(_LETTERS.get(c, ("", 1))[1] is not None for c in letters))
    return True


def _text_series(name: str, message: _TextMessage) -> tuple[dict[str, TimeSeries], int]:
    """The series of a message, and the number of lines whose time is no number."""
    if not message.rows:
        return {}, 0
    numeric = [i for i, is_number in enumerate(message.numeric) if is_number]
    table = np.array([[_number(row[i]) for i in numeric] for row in message.rows])
    finite = np.isfinite(table[:, 0])
    columns = {message.fields[i]: np.ascontiguousarray(v) for i, v in zip(numeric, table[finite].T, strict=True)}
    time = columns.pop(message.fields[0]) * TIME_UNITS[message.fields[0]]
    series: dict[str, TimeSeries] = {}
    for instance, use in instance_rows(name, columns.get("I", np.zeros(time.size))).items():
        seconds = time[use]
        series |= {f"{instance}.{n}": TimeSeries(seconds, values[use]) for n, values in columns.items()}
    return series, int((~finite).sum())


def _text_events(message: _TextMessage) -> Rows:
    """Time [s] and fields of a message of text or events."""
    unit = TIME_UNITS.get(message.fields[0], 0.0)
    rows = [(_number(row[0]) * unit, dict[str, object](zip(message.fields, row, strict=True))) for row in message.rows]
    return [(time, row) for time, row in rows if math.isfinite(time)]


def _text_parameters(message: _TextMessage | None) -> list[tuple[str, float]]:
    if message is None or not {"Name", "Value"} <= set(message.fields):
        return []
    name, value = message.fields.index("Name"), message.fields.index("Value")
    return [(row[name], _number(row[value])) for row in message.rows]


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
