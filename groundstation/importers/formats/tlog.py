"""MAVLink telemetry log (.tlog): 8-byte big-endian microseconds before each message. Series are named 'MESSAGE.field'.

Time is the aircraft's own (time_usec or time_boot_ms of the message) where it has one, else the receiver's, moved to the
aircraft's clock by the smallest difference seen. Only one system is imported, the one with the most messages.
"""

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import fastcrc
import numpy as np
from numpy.typing import NDArray

from daq.contract.input_files import read_bytes
from daq.transport.mavlink_codec import padded
from groundstation.importers.errors import ImportDataError
from groundstation.importers.series import Array, Log, Series

_MAGIC = (0xFD, 0xFE)
_NEXT = re.compile(rb"\0[\x00-\x0e](?s:.{6})[\xfd\xfe]")
"""How a record begins: a stamp before the year 2100, whose first two bytes are small, and the first byte of a frame."""
_OUR_FRAME = 44100
_GROUND_STATION = 255
LONGEST_ARRAY = 32
"""Elements of an array field that become series (the 32 outputs of ACTUATOR_OUTPUT_STATUS); longer ones are blocks of bytes."""
# Values that mean "not known" in the message definitions, by message and field.
_NOT_KNOWN = {
    ("SYS_STATUS", "voltage_battery"): 65535,
    ("SYS_STATUS", "current_battery"): -1,
    ("GPS_RAW_INT", "vel"): 65535,
    ("GPS_RAW_INT", "cog"): 65535,
    ("GPS_RAW_INT", "eph"): 65535,
    ("GPS_RAW_INT", "epv"): 65535,
    ("GLOBAL_POSITION_INT", "hdg"): 65535,
}
_FIX_3D = 3
_PARAM_VALUE = 22
_NUMPY = {"b": "i1", "B": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "q": "i8", "Q": "u8", "f": "f4", "d": "f8"}
"""Letter of the struct -> what numpy calls it."""
_V1_EXTRA, _V2_EXTRA, _SIGNATURE = 8, 12, 13


def read_tlog(path: Path) -> Log:
    """All numeric fields of the standard messages of one aircraft. Raises ImportDataError when nothing can be read."""
    found = _gathered(read_bytes(path, error=ImportDataError))
    if not found.systems:
        raise ImportDataError(f"{path}: no MAVLink message in it; is it a telemetry log (.tlog)?")
    systems = Counter({s: n for s, n in found.systems.items() if s != _GROUND_STATION})
    if not systems:
        raise ImportDataError(f"{path}: only ground-station messages in this log")
    system = systems.most_common(1)[0][0]
    series = _series({kind: rows for (of, kind), rows in found.rows.items() if of == system})
    others = sorted(set(systems) - {system})
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
    stated = _parameters(found.rows.get((system, _PARAM_VALUE)))
    return Log("tlog", series, notes=tuple(notes), detail={"system": str(system)}, parameters=stated)


@dataclass(frozen=True)
class _Layout:
    """A message of the dialect: name, numpy type of a whole payload, numeric fields with their number of elements."""

    name: str
    dtype: np.dtype[np.void]
    fields: tuple[tuple[str, int], ...]
    crc_extra: int


@dataclass
class _Rows:
    """Messages of one kind from one system: time received [s] and payloads, one after the other."""

    stamps: list[float] = field(default_factory=list)
    payloads: bytearray = field(default_factory=bytearray)


@dataclass
class _Found:
    rows: dict[tuple[int, int], _Rows] = field(default_factory=dict)  # by system and message id
    systems: Counter[int] = field(default_factory=Counter)
    ours: int = 0
    skipped: int = 0


@cache
def _layouts() -> Mapping[int, _Layout]:
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
        out[number] = _Layout(made.msgname, np.dtype(types), tuple(fields), made.crc_extra)
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
    layout = _layouts().get(kind)
    if layout is None:
        follows = first + size
        found.ours += kind == _OUR_FRAME
        return follows == len(data) or _frame_size(data, follows + 8) > 0
    end = first + head + data[first + 1]
    checksum = fastcrc.crc16.mcrf4xx(data[first + 1 : end] + bytes([layout.crc_extra]))
    if checksum != data[end] | data[end + 1] << 8:
        return False
    system = data[first + 3] if is_v1 else data[first + 5]
    rows = found.rows.setdefault((system, kind), _Rows())
    rows.stamps.append(int.from_bytes(data[at : at + 8], "big") * 1e-6)
    rows.payloads += padded(data[first + head : end], layout.dtype.itemsize)
    found.systems[system] += 1
    return True


def _frame_size(data: bytes, at: int) -> int:
    """Length of the MAVLink frame that begins here, 0 when none does."""
    if at + 3 > len(data) or data[at] not in _MAGIC:
        return 0
    if data[at] == 0xFE:
        return data[at + 1] + _V1_EXTRA
    return data[at + 1] + _V2_EXTRA + (_SIGNATURE if data[at + 2] & 1 else 0)


def _parameters(rows: _Rows | None) -> dict[str, float]:
    """The autopilot's parameters, each as last stated, as ArduPilot sends them (PX4 packs whole numbers otherwise)."""
    if rows is None:
        return {}
    table = np.frombuffer(rows.payloads, _layouts()[_PARAM_VALUE].dtype)
    pairs = zip(table["param_id"].tolist(), table["param_value"].tolist(), strict=True)
    return {name.decode("ascii", "replace"): value for name, value in pairs if math.isfinite(value)}


def _series(found: dict[int, _Rows]) -> dict[str, Series]:
    """Each numeric field of the messages of one system, on the aircraft's clock."""
    tables = {kind: np.frombuffer(rows.payloads, _layouts()[kind].dtype) for kind, rows in found.items()}
    stamps = {kind: np.array(rows.stamps) for kind, rows in found.items()}
    own = {kind: _own_time(table) for kind, table in tables.items()}
    behind = [float(np.nanmin(stamps[k] - t)) for k, t in own.items() if np.isfinite(t).any()]
    offset = min(behind, default=min(float(s[0]) for s in stamps.values()))
    series: dict[str, Series] = {}
    for kind, table in tables.items():
        layout = _layouts()[kind]
        time = np.where(np.isfinite(own[kind]), own[kind], stamps[kind] - offset)
        for name, many in layout.fields:
            for i in range(many):
                label = f"{layout.name}.{name}" + (f"[{i}]" if many > 1 else "")
                series[label] = _known(layout.name, name, table, time, table[name][:, i] if many > 1 else table[name])
    return series


def _known(message: str, field_name: str, table: NDArray[np.void], time: Array, values: NDArray[Any]) -> Series:
    """The samples of which the definition of the message does not say that they are none."""
    with np.errstate(invalid="ignore"):  # a signalling NaN
        numbers = values.astype(float)
    good = numbers != _NOT_KNOWN.get((message, field_name), np.nan)
    if message == "GPS_RAW_INT" and field_name in ("lat", "lon", "alt"):
        good &= table["fix_type"] >= _FIX_3D
    return Series(time, numbers) if good.all() else Series(time[good], numbers[good])


def _own_time(table: NDArray[np.void]) -> Array:
    """Time of each message on the aircraft's clock since boot [s], NaN where it has none; a time since 1970 is none."""
    names = table.dtype.names or ()
    if "time_boot_ms" in names:
        return np.asarray(table["time_boot_ms"] * 1e-3)
    if "time_usec" in names:
        return np.where(table["time_usec"] < 1e15, table["time_usec"] * 1e-6, np.nan)
    return np.full(len(table), np.nan)
