"""ArduPilot dataflash (.bin). Series are named 'MESSAGE.field', further instances of a sensor 'MESSAGE[1].field'.

Format: ArduPilot developer guide, "Log messages": each file describes its own messages (FMT: length, field letters and names;
FMTU: units, among them '#' for the field that tells instances apart). Every message begins with A3 95 and its type; bytes
that are no message are stepped over. Time is TimeUS since boot.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from groundstation.importers.errors import ImportDataError
from groundstation.importers.series import Log, Series

_HEAD = b"\xa3\x95"
_FMT, _FMT_SIZE = 128, 89

# Field letter -> struct code and factor; letters without a factor here are text or arrays and are left out.
_LETTERS: dict[str, tuple[str, float | None]] = {
    "b": ("b", 1), "B": ("B", 1), "h": ("h", 1), "H": ("H", 1), "i": ("i", 1), "I": ("I", 1), "q": ("q", 1), "Q": ("Q", 1),
    "f": ("f", 1), "d": ("d", 1), "g": ("e", 1), "M": ("B", 1), "c": ("h", 0.01), "C": ("H", 0.01), "e": ("i", 0.01),
    "E": ("I", 0.01), "L": ("i", 1e-7), "n": ("4s", None), "N": ("16s", None), "Z": ("64s", None), "a": ("64s", None),
}  # fmt: skip


@dataclass
class _Message:
    """One message type: its layout, and the rows read so far."""

    name: str
    size: int
    layout: struct.Struct
    fields: tuple[str, ...]
    factors: tuple[float | None, ...]
    rows: list[tuple[float, ...]]
    instance: int | None = None


def read_dataflash(path: Path) -> Log:
    """All numeric fields of all timed messages. Raises ImportDataError when the file is not a dataflash log."""
    data = path.read_bytes()
    if not data.startswith(_HEAD):
        raise ImportDataError(f"{path}: not an ArduPilot dataflash log (it does not begin with a message head)")
    messages: dict[int, _Message] = {}
    skipped = 0
    at = 0
    while at + 3 <= len(data):
        size = _size(data, at, messages)
        if size == 0:
            following = data.find(_HEAD, at + 1)
            skipped += (following if following > 0 else len(data)) - at
            at = following if following > 0 else len(data)
            continue
        _take(data, at, size, messages)
        at += size
    series = dict(_series(messages))
    if not series:
        raise ImportDataError(f"{path}: no timed messages in this dataflash log")
    for name in [n for n in series if n.endswith(".Spd") and n.startswith("GPS")]:
        _velocity(name.rsplit(".", 1)[0], series)
    notes = (f"{skipped} bytes of the log are damaged and left out",) if skipped else ()
    return Log("dataflash", series, notes=notes)


def _size(data: bytes, at: int, messages: dict[int, _Message]) -> int:
    """Length of the message at `at`, 0 when none that is known begins there, or it is cut off."""
    if data[at : at + 2] != _HEAD:
        return 0
    kind = data[at + 2]
    size = _FMT_SIZE if kind == _FMT else messages[kind].size if kind in messages else 0
    return size if at + size <= len(data) else 0


def _take(data: bytes, at: int, size: int, messages: dict[int, _Message]) -> None:
    kind, body = data[at + 2], data[at + 3 : at + size]
    if kind == _FMT:
        described, length, name, letters, labels = struct.unpack("<BB4s16s64s", body)
        if described != _FMT and described not in messages:
            made = _described(_text(name), length, _text(letters), _text(labels))
            if made is not None:
                messages[described] = made
        return
    message = messages[kind]
    values = message.layout.unpack(body)
    if message.name == "FMTU":
        _units(dict(zip(message.fields, values, strict=True)), messages)
    elif message.fields and message.fields[0] == "TimeUS":
        message.rows.append(values)


def _described(name: str, length: int, letters: str, labels: str) -> _Message | None:
    """A message type from its FMT; None when the description does not fit together (damage)."""
    fields = tuple(labels.split(",")) if labels else ()
    if len(fields) != len(letters) or any(c not in _LETTERS for c in letters):
        return None
    layout = struct.Struct("<" + "".join(_LETTERS[c][0] for c in letters))
    if layout.size + 3 != length:
        return None
    return _Message(name, length, layout, fields, tuple(_LETTERS[c][1] for c in letters), [])


def _units(values: dict[str, object], messages: dict[int, _Message]) -> None:
    described, units = values.get("FmtType"), values.get("UnitIds")
    if isinstance(described, int) and isinstance(units, bytes) and described in messages and b"#" in units:
        messages[described].instance = units.index(b"#")


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("ascii", "replace")


def _series(messages: dict[int, _Message]) -> Iterator[tuple[str, Series]]:
    for message in messages.values():
        if not message.rows:
            continue
        numeric = [i for i, f in enumerate(message.factors) if f is not None]
        table = np.array([[row[i] for i in numeric] for row in message.rows], float)
        table *= [message.factors[i] for i in numeric]
        column = {i: k for k, i in enumerate(numeric)}
        # logs older than FMTU tell instances by a field named I
        instance = message.instance if message.instance is not None else _index(message.fields, "I")
        which = table[:, column[instance]] if instance in column else np.zeros(len(table))
        for number in np.unique(which):
            rows = table[which == number]
            prefix = message.name if number == which.min() else f"{message.name}[{number:g}]"
            for i in numeric[1:]:
                yield f"{prefix}.{message.fields[i]}", Series(rows[:, 0] * 1e-6, rows[:, column[i]])


def _index(fields: tuple[str, ...], name: str) -> int | None:
    return fields.index(name) if name in fields else None


def _velocity(prefix: str, series: dict[str, Series]) -> None:
    """North and east velocity from ground speed and course [deg]."""
    speed, course = series.get(f"{prefix}.Spd"), series.get(f"{prefix}.GCrs")
    if speed is not None and course is not None:
        angle = np.deg2rad(course.values)
        series[f"{prefix}.VN"] = Series(speed.time, speed.values * np.cos(angle))
        series[f"{prefix}.VE"] = Series(speed.time, speed.values * np.sin(angle))
