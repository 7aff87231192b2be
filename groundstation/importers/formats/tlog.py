"""MAVLink telemetry log (.tlog): 8-byte big-endian microseconds before each message. Series are named 'MESSAGE.field'.

Only one system is imported, the one with the most messages; see `tlog_series` for names and time.
"""

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import fastcrc
import numpy as np
from numpy.typing import NDArray

from daq.contract.input_files import read_bytes
from daq.transport.mavlink_codec import padded
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.tlog_series import LONGEST_ARRAY, ReceivedMessages, by_boot
from groundstation.importers.series import Log

_MAGIC = (0xFD, 0xFE)
_NEXT = re.compile(rb"\0[\x00-\x0e](?s:.{6})[\xfd\xfe]")
"""How a record begins: a stamp before the year 2100, whose first two bytes are small, and the first byte of a frame."""
_OUR_FRAME = 44100
_GROUND_STATION = 255
_NUMPY = {"b": "i1", "B": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "q": "i8", "Q": "u8", "f": "f4", "d": "f8"}
"""Letter of the struct -> what numpy calls it."""
_V1_EXTRA, _V2_EXTRA, _SIGNATURE = 8, 12, 13


def read_tlog(path: Path) -> list[Log]:
    """All numeric fields of the standard messages of one aircraft, a log for each boot of its autopilot. Raises ImportDataError
    when nothing can be read."""
    found = _gathered(read_bytes(path, error=ImportDataError))
    systems: Counter[int] = Counter()
    for (system, _, _), rows in found.rows.items():
        systems[system] += len(rows.stamps)
    if not systems:
        raise ImportDataError(f"{path}: no MAVLink message in it; is it a telemetry log (.tlog)?")
    aircraft = Counter({s: n for s, n in systems.items() if s != _GROUND_STATION})
    if not aircraft:
        raise ImportDataError(f"{path}: only ground-station messages in this log")
    system = aircraft.most_common(1)[0][0]
    received = [
        ReceivedMessages(
            layouts()[kind].name, component, rows.table(kind), np.array(rows.stamps), np.array(rows.places)
        )
        for (of, component, kind), rows in found.rows.items()
        if of == system
    ]
    notes = _notes(found, sorted(set(aircraft) - {system}), system)
    stated = _parameters([r for r in received if r.name == "PARAM_VALUE"])
    boots = by_boot(received)
    logs = []
    for number, boot in enumerate(boots, start=1):
        told = [f"boot {number} of {len(boots)} in this log: a record of its own"] if len(boots) > 1 else []
        detail = {"system": str(system), "component": str(boot.component)}
        said = (*(notes if number == 1 else ()), *told, *boot.notes)
        seen = boot.contradictions
        logs.append(
            Log(
                "tlog", boot.series, notes=said, detail=detail, parameters=stated, contradictions=seen, marks=boot.marks
            )
        )
    return logs


def _notes(found: "_Found", others: list[int], system: int) -> list[str]:
    notes = []
    if found.ours:
        notes.append(
            f"{found.ours} frames of Sideslip's own downlink are not used here: 'sideslip ground --replay' makes the flight "
            "of them"
        )
    if others:
        notes.append(f"messages of systems {', '.join(map(str, others))} left out; system {system} is imported")
    if found.skipped:
        notes.append(f"{found.skipped} bytes of the log are damaged and left out")
    return notes


@dataclass(frozen=True)
class DialectLayout:
    """A message of the dialect: name, numpy type of a whole payload, numeric fields with their number of elements."""

    name: str
    dtype: np.dtype[np.void]
    fields: tuple[tuple[str, int], ...]
    crc_extra: int


@dataclass
class _Rows:
    """Messages of one kind from one component: time received [s], place in the file and payloads, one after the other."""

    stamps: list[float] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    payloads: bytearray = field(default_factory=bytearray)

    def table(self, kind: int) -> NDArray[np.void]:
        """The payloads as records of their fields."""
        return np.frombuffer(self.payloads, layouts()[kind].dtype)


@dataclass
class _Found:
    rows: dict[tuple[int, int, int], _Rows] = field(default_factory=dict)  # by system, component and message id
    ours: int = 0
    skipped: int = 0


@cache
def layouts() -> Mapping[int, DialectLayout]:
    """The messages of the dialect that ArduPilot and PX4 share, by id."""
    from pymavlink.dialects.v20 import ardupilotmega

    out = {}
    for number, made in ardupilotmega.mavlink_map.items():
        letters = re.findall(r"(\d*)([a-zA-Z])", made.unpacker.format)
        types: list[tuple[str, str, tuple[int, ...]]] = []
        fields = []
        for name, (count, letter) in zip(made.ordered_fieldnames, letters, strict=True):
            if letter in "sc":
                types.append((name, f"S{count or 1}", ()))
                continue
            many = int(count or 1)
            types.append((name, f"<{_NUMPY[letter]}", (many,) if many > 1 else ()))
            if many <= LONGEST_ARRAY:
                fields.append((name, many))
        out[number] = DialectLayout(made.msgname, np.dtype(types), tuple(fields), made.crc_extra)
    return out


def _gathered(data: bytes) -> _Found:
    """Every sound message of a log. A frame counts when its checksum holds; one of a message that the dialect does not have
    counts for nothing and is passed over where another follows it. After damage the search goes on with the next bytes that a
    record can begin with."""
    found = _Found()
    at = 0
    while at + 8 + _V1_EXTRA <= len(data):
        size = _frame_size(data, at + 8)
        if not size or at + 8 + size > len(data) or not _take(data, at, size, found):
            match = _NEXT.search(data, at + 1)
            following = match.start() if match else len(data)
            found.skipped += following - at
            at = following
            continue
        at += 8 + size
    found.skipped += len(data) - min(at, len(data))
    return found


def _take(data: bytes, at: int, size: int, found: _Found) -> bool:
    """Keep the record at `at`; False when its frame is damaged."""
    first = at + 8
    is_v1 = data[first] == 0xFE
    head = 6 if is_v1 else 10
    kind = data[first + 5] if is_v1 else int.from_bytes(data[first + 7 : first + 10], "little")
    layout = layouts().get(kind)
    if layout is None:
        follows = first + size
        found.ours += kind == _OUR_FRAME
        return follows == len(data) or _frame_size(data, follows + 8) > 0
    end = first + head + data[first + 1]
    checksum = fastcrc.crc16.mcrf4xx(data[first + 1 : end] + bytes([layout.crc_extra]))
    if checksum != data[end] | data[end + 1] << 8:
        return False
    system, component = (data[first + 3], data[first + 4]) if is_v1 else (data[first + 5], data[first + 6])
    rows = found.rows.setdefault((system, component, kind), _Rows())
    rows.places.append(at)
    rows.stamps.append(int.from_bytes(data[at : at + 8], "big") * 1e-6)
    rows.payloads += padded(data[first + head : end], layout.dtype.itemsize)
    return True


def _frame_size(data: bytes, at: int) -> int:
    """Length of the MAVLink frame that begins here, 0 when none does."""
    if at + 3 > len(data) or data[at] not in _MAGIC:
        return 0
    if data[at] == 0xFE:
        return data[at + 1] + _V1_EXTRA
    return data[at + 1] + _V2_EXTRA + (_SIGNATURE if data[at + 2] & 1 else 0)


def _parameters(received: list[ReceivedMessages]) -> dict[str, float]:
    """The autopilot's parameters, each as last stated, as ArduPilot sends them (PX4 packs whole numbers otherwise)."""
    found: dict[str, float] = {}
    for one in received:
        pairs = zip(one.table["param_id"].tolist(), one.table["param_value"].tolist(), strict=True)
        found |= {name.decode("ascii", "replace"): value for name, value in pairs if math.isfinite(value)}
    return found
