"""MAVLink telemetry log (.tlog): 8-byte big-endian microseconds before each message. Series are named 'MESSAGE.field'.

Time is the aircraft's own (time_usec or time_boot_ms of the message) where it has one, else the receiver's, moved to the
aircraft's clock by the smallest difference seen. Only one system is imported, the one with the most messages.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.importers.errors import ImportDataError
from groundstation.importers.series import Log, Series

_MAGIC = (0xFD, 0xFE)
_OUR_FRAME = "UNKNOWN_44100"
# Values that mean "not known" in the message definitions, by message and field.
_NOT_KNOWN = {
    ("SYS_STATUS", "voltage_battery"): 65535, ("SYS_STATUS", "current_battery"): -1, ("GPS_RAW_INT", "vel"): 65535,
    ("GPS_RAW_INT", "cog"): 65535, ("GPS_RAW_INT", "eph"): 65535, ("GPS_RAW_INT", "epv"): 65535,
    ("GLOBAL_POSITION_INT", "hdg"): 65535,
}  # fmt: skip
_FIX_3D = 3
_V1_EXTRA, _V2_EXTRA, _SIGNATURE = 8, 12, 13


def read_tlog(path: Path) -> Log:
    """All numeric fields of the standard messages of one aircraft. Raises ImportDataError when nothing can be read."""
    everything = list(_messages(path))
    ours = sum(m.get_type() == _OUR_FRAME for _, m in everything)
    messages = [(stamp, m) for stamp, m in everything if not m.get_type().startswith(("BAD_DATA", "UNKNOWN"))]
    if not messages:
        raise ImportDataError(f"{path}: no MAVLink message in it; is it a telemetry log (.tlog)?")
    systems = Counter(m.get_srcSystem() for _, m in messages if m.get_srcSystem() != 255)
    if not systems:
        raise ImportDataError(f"{path}: only ground-station messages in this log")
    system = systems.most_common(1)[0][0]
    own = [(stamp, m) for stamp, m in messages if m.get_srcSystem() == system]
    offset = min((stamp - t for stamp, m in own if (t := _own_time(m)) is not None), default=own[0][0])
    collected: dict[str, tuple[list[float], list[float]]] = {}
    for stamp, message in own:
        time = _own_time(message)
        for field in message.get_fieldnames():
            value = getattr(message, field)
            values = value if isinstance(value, (list, tuple)) else [value]
            for i, item in enumerate(values):
                if isinstance(item, (int, float)) and not _unknown(message, field, item):
                    name = f"{message.get_type()}.{field}" + (f"[{i}]" if isinstance(value, (list, tuple)) else "")
                    times, items = collected.setdefault(name, ([], []))
                    times.append(stamp - offset if time is None else time)
                    items.append(float(item))
    series = {name: Series(np.array(t), np.array(v)) for name, (t, v) in collected.items()}
    others = sorted(set(systems) - {system})
    notes = []
    if ours:
        notes.append(
            f"{ours} frames of Sideslip's own downlink are not used here: 'sideslip ground --replay' makes the flight of them"
        )
    if others:
        notes.append(f"messages of systems {', '.join(map(str, others))} left out; system {system} is imported")
    return Log("tlog", series, notes=tuple(notes), detail={"system": str(system)})


def _unknown(message: Any, field: str, value: float) -> bool:
    """Whether the definition of the message says that this value is none."""
    kind = message.get_type()
    if kind == "GPS_RAW_INT" and field in ("lat", "lon", "alt") and message.fix_type < _FIX_3D:
        return True
    return _NOT_KNOWN.get((kind, field)) == value


def _own_time(message: Any) -> float | None:
    """Time of the message on the aircraft's clock since boot [s]; a time since 1970 is not one."""
    if "time_boot_ms" in message.get_fieldnames():
        return float(message.time_boot_ms) * 1e-3
    if "time_usec" in message.get_fieldnames() and message.time_usec < 1e15:
        return float(message.time_usec) * 1e-6
    return None


def _messages(path: Path) -> Iterator[tuple[float, Any]]:
    """Received time [s] and message. Bytes that are no message are stepped over one by one."""
    from pymavlink.dialects.v20 import ardupilotmega

    decoder = ardupilotmega.MAVLink(None)
    decoder.robust_parsing = True
    data = path.read_bytes()
    at = 0
    while at + 8 + _V1_EXTRA <= len(data):
        size = _frame_size(data, at + 8)
        frame = data[at + 8 : at + 8 + size]
        if size == 0 or len(frame) < size:
            at += 1
            continue
        try:
            message = decoder.decode(bytearray(frame))
        except ardupilotmega.MAVError:
            # a message of another dialect has a right length but an unknown id; damage has neither
            follows = at + 8 + size
            at = follows if follows == len(data) or _frame_size(data, follows + 8) else at + 1
            continue
        yield struct.unpack(">Q", data[at : at + 8])[0] * 1e-6, message
        at += 8 + size


def _frame_size(data: bytes, at: int) -> int:
    """Length of the MAVLink frame that begins here, 0 when none does."""
    if at + 3 > len(data) or data[at] not in _MAGIC:
        return 0
    if data[at] == 0xFE:
        return data[at + 1] + _V1_EXTRA
    return data[at + 1] + _V2_EXTRA + (_SIGNATURE if data[at + 2] & 1 else 0)
