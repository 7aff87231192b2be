"""ArduPilot dataflash (.bin). Series are named 'MESSAGE.field', further instances of a sensor 'MESSAGE[1].field'.

Format: ArduPilot developer guide, "Log messages": each file describes its own messages (FMT: length, field letters and names;
FMTU: units, among them '#' for the field that tells instances apart). Every message begins with A3 95 and its type; bytes
that are no message are stepped over. Time is TimeUS since boot.
"""

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from daq.contract.input_files import read_bytes
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.dataflash_text import SAID, is_text, read_text_log
from groundstation.importers.modes import dataflash_marks
from groundstation.importers.series import Array, Log, TimeSeries

_HEAD = b"\xa3\x95"
MOST_BETWEEN_HEADS = 1000
"""Bytes to a head of a message on average in a log whose beginning is lost: chance makes one in 64 kB."""
_FMT, _FMT_SIZE = 128, 89
_DESCRIPTION = struct.Struct("<BB4s16s64s")

# Field letter -> struct code and factor; letters without a factor here are text or arrays and are left out.
_LETTERS: dict[str, tuple[str, float | None]] = {
    "b": ("b", 1), "B": ("B", 1), "h": ("h", 1), "H": ("H", 1), "i": ("i", 1), "I": ("I", 1), "q": ("q", 1), "Q": ("Q", 1),
    "f": ("f", 1), "d": ("d", 1), "g": ("e", 1), "M": ("B", 1), "c": ("h", 0.01), "C": ("H", 0.01), "e": ("i", 0.01),
    "E": ("I", 0.01), "L": ("i", 1e-7), "n": ("4s", None), "N": ("16s", None), "Z": ("64s", None), "a": ("64s", None),
}  # fmt: skip
_NUMPY = {
    "b": "i1",
    "B": "u1",
    "h": "i2",
    "H": "u2",
    "i": "i4",
    "I": "u4",
    "q": "i8",
    "Q": "u8",
    "f": "f4",
    "d": "f8",
    "e": "f2",
}
"""Struct code -> what numpy calls it."""


TIME_UNITS = {"TimeUS": 1e-6, "TimeMS": 1e-3}
"""First field of a message that is its time since boot -> seconds; TimeMS in logs before ArduPilot 3.3."""
MOST_INSTANCES = 256
"""Of one sensor: ArduPilot numbers them in one byte."""


@dataclass
class _Message:
    """One message type: its layout, and the bodies read so far, one after the other."""

    name: str
    size: int
    layout: struct.Struct
    fields: tuple[str, ...]
    letters: str
    bodies: bytearray
    instance: int | None = None

    @property
    def timed(self) -> bool:
        """Whether the message carries the time at which it was logged."""
        return bool(self.fields) and self.fields[0] in TIME_UNITS and _LETTERS[self.letters[0]][1] is not None

    def column(self, index: int) -> Array:
        """All values of one field (N,), in its unit. A field of text is none."""
        code, factor = _LETTERS[self.letters[index]]
        offset = struct.calcsize("<" + "".join(_LETTERS[c][0] for c in self.letters[:index]))
        kind = np.dtype(
            {"names": ["x"], "formats": [f"<{_NUMPY[code]}"], "offsets": [offset], "itemsize": self.layout.size}
        )
        with np.errstate(invalid="ignore"):  # a signalling NaN of a damaged message
            return np.frombuffer(self.bodies, kind)["x"].astype(float) * (factor or 1.0)

    def numeric(self, index: int) -> bool:
        """Whether a field is a number."""
        return _LETTERS[self.letters[index]][1] is not None


def read_dataflash(path: Path) -> Log:
    """All numeric fields of all timed messages. Raises ImportDataError when the file is not a dataflash log."""
    data = read_bytes(path, error=ImportDataError)
    if is_text(data):
        return with_velocities(read_text_log(path, data))
    headless = not data.startswith(_HEAD)
    if headless and data.count(_HEAD) * MOST_BETWEEN_HEADS < max(len(data), 10 * MOST_BETWEEN_HEADS):
        raise ImportDataError(f"{path}: not an ArduPilot dataflash log (it does not begin with a message head)")
    messages, skipped = _gathered(data)
    if headless and not messages:
        raise ImportDataError(
            f"{path}: the beginning of this ArduPilot log is lost, and with it the descriptions of its messages (FMT): nothing "
            "of the rest can be read; copy the log from the card anew"
        )
    series = dict(_series(messages))
    if not series:
        raise ImportDataError(f"{path}: no timed messages in this dataflash log")
    lost = "; its first bytes are lost, and messages described only there" if headless else ""
    notes = (f"{skipped} bytes of the log are damaged and left out{lost}",) if skipped or lost else ()
    end = max(float(s.time[-1]) for s in series.values())
    marks = dataflash_marks(_said(messages), end)
    return with_velocities(Log("dataflash", series, notes=notes, parameters=_parameters(messages), marks=marks))


def with_velocities(log: Log) -> Log:
    """The log with VN and VE [m/s] beside each GPS's speed and course."""
    series = dict(log.series)
    for name in [n for n in series if n.endswith(".Spd") and n.startswith("GPS")]:
        _velocity(name.rsplit(".", 1)[0], series)
    return replace(log, series=series)


def _gathered(data: bytes) -> tuple[dict[int, _Message], int]:
    """The messages by type, and how many bytes belong to none.

    Behind damage the next head of a type that is described is searched as a pattern, so that any bytes are passed over in
    time in proportion to their number.
    """
    messages: dict[int, _Message] = {}
    heads = _heads(messages)
    skipped = at = 0
    while at + 3 <= len(data):
        size = _size(data, at, messages)
        if size:
            if _take(data, at, size, messages):
                heads = _heads(messages)
            at += size
            continue
        found = heads.search(data, at + 1)
        following = found.start() if found else len(data)
        skipped += following - at
        at = following
    return messages, skipped + len(data) - min(at, len(data))


def _heads(messages: dict[int, _Message]) -> "re.Pattern[bytes]":
    """What any message of a known type begins with."""
    kinds = b"".join(re.escape(bytes([kind])) for kind in (_FMT, *messages))
    return re.compile(re.escape(_HEAD) + b"[" + kinds + b"]")


def _size(data: bytes, at: int, messages: dict[int, _Message]) -> int:
    """Length of the message at `at`, 0 when none that is known begins there, or it is cut off."""
    if data[at : at + 2] != _HEAD:
        return 0
    kind = data[at + 2]
    size = _FMT_SIZE if kind == _FMT else messages[kind].size if kind in messages else 0
    return size if at + size <= len(data) else 0


def _take(data: bytes, at: int, size: int, messages: dict[int, _Message]) -> bool:
    """Keep the message at `at`; whether it described a new type."""
    kind = data[at + 2]
    if kind == _FMT:
        described, length, name, letters, labels = _DESCRIPTION.unpack_from(data, at + 3)
        if described == _FMT or described in messages:
            return False
        made = _described(_text(name), length, _text(letters), _text(labels))
        if made is not None:
            messages[described] = made
        return made is not None
    message = messages[kind]
    if message.name == "FMTU":
        _units(dict(zip(message.fields, message.layout.unpack_from(data, at + 3), strict=True)), messages)
    elif message.timed:
        message.bodies += data[at + 3 : at + size]
    return False


def _described(name: str, length: int, letters: str, labels: str) -> _Message | None:
    """A message type from its FMT; None when the description does not fit together (damage)."""
    fields = tuple(labels.split(",")) if labels else ()
    if len(fields) != len(letters) or any(c not in _LETTERS for c in letters):
        return None
    layout = struct.Struct("<" + "".join(_LETTERS[c][0] for c in letters))
    if layout.size + 3 != length or not fields:
        return None
    return _Message(name, length, layout, fields, letters, bytearray())


def _units(values: dict[str, object], messages: dict[int, _Message]) -> None:
    described, units = values.get("FmtType"), values.get("UnitIds")
    if isinstance(described, int) and isinstance(units, bytes) and described in messages and b"#" in units:
        messages[described].instance = units.index(b"#")


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("ascii", "replace")


def _parameters(messages: dict[int, _Message]) -> dict[str, float]:
    """The autopilot's parameters (PARM: Name, Value), each as last stated."""
    found: dict[str, float] = {}
    for message in messages.values():
        names, values = _index(message.fields, "Name"), _index(message.fields, "Value")
        if message.name != "PARM" or names is None or values is None or not message.numeric(values):
            continue
        stated = message.column(values).tolist()
        for row, value in zip(message.layout.iter_unpack(bytes(message.bodies)), stated, strict=True):
            label = row[names]
            if isinstance(label, bytes) and math.isfinite(value):
                found[_text(label)] = value
    return found


def _said(messages: dict[int, _Message]) -> dict[str, list[tuple[float, dict[str, object]]]]:
    """What the autopilot says beside its samples: message -> (time [s], fields)."""
    found: dict[str, list[tuple[float, dict[str, object]]]] = {}
    for message in messages.values():
        if message.name in SAID and message.timed:
            time = (message.column(0) * TIME_UNITS[message.fields[0]]).tolist()
            rows = [
                dict(zip(message.fields, r, strict=True)) for r in message.layout.iter_unpack(bytes(message.bodies))
            ]
            found.setdefault(message.name, []).extend(zip(time, rows, strict=True))
    return found


def _series(messages: dict[int, _Message]) -> Iterator[tuple[str, TimeSeries]]:
    named: set[str] = set()
    for kind, message in messages.items():
        if not message.bodies:
            continue
        label = f"{message.name}({kind})" if message.name in named else message.name  # two types of one name are damage
        named.add(message.name)
        time = message.column(0) * TIME_UNITS[message.fields[0]]
        instance = _instance_field(message)
        which = np.zeros(time.size) if instance is None else message.column(instance)
        numbers = np.unique(which)
        rows = {number: np.flatnonzero(which == number) for number in numbers}
        times = {number: time[rows[number]] for number in numbers}
        for i in range(1, len(message.fields)):
            if not message.numeric(i):
                continue
            values = message.column(i)
            for number in numbers:
                prefix = label if number == numbers[0] else f"{label}[{number:g}]"
                yield f"{prefix}.{message.fields[i]}", TimeSeries(times[number], values[rows[number]])


def _instance_field(message: _Message) -> int | None:
    """The field that tells instances apart; None where there is none, or it holds more numbers than there are sensors."""
    # logs older than FMTU tell instances by a field named I
    index = message.instance if message.instance is not None else _index(message.fields, "I")
    if index is None or not 0 < index < len(message.fields) or not message.numeric(index):
        return None
    numbers = np.unique(message.column(index))
    return index if numbers.size <= MOST_INSTANCES and np.isfinite(numbers).all() else None


def _index(fields: tuple[str, ...], name: str) -> int | None:
    return fields.index(name) if name in fields else None


def _velocity(prefix: str, series: dict[str, TimeSeries]) -> None:
    """North and east velocity from ground speed and course [deg]."""
    speed, course = series.get(f"{prefix}.Spd"), series.get(f"{prefix}.GCrs")
    if speed is not None and course is not None:
        angle = np.deg2rad(course.values)
        series[f"{prefix}.VN"] = TimeSeries(speed.time, speed.values * np.cos(angle))
        series[f"{prefix}.VE"] = TimeSeries(speed.time, speed.values * np.sin(angle))
