"""Reader of MAVLink telemetry logs (.tlog): a time in microseconds, 8 bytes big-endian, before each frame.

Only the system with the most messages is imported; see `tlog_series` for names and times of series.
"""

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import fastcrc
import numpy as np
from numpy.typing import NDArray

from daq.transport.mavlink_codec import padded
from daq.utilities.input_files import read_bytes
from daq.utilities.packages import optional
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.tlog_series import ReceivedMessages, by_boot
from groundstation.importers.series import LONGEST_ARRAY, Log

_V1, _V2 = 0xFE, 0xFD  # first byte of a frame of MAVLink 1 and 2
_NEXT = re.compile(rb"\0[\x00-\x0e](?s:.{6})[\xfd\xfe]")
"""Beginning of a record: a stamp before the year 2100, whose first two bytes are small, and the first byte of a frame."""
_STAMP = 8  # bytes before each frame
_DOWNLINK_FRAME = 44100  # message id of Sideslip's downlink
_GROUND_STATION = 255  # system id
_V1_EXTRA, _V2_EXTRA, _SIGNATURE = 8, 12, 13  # bytes of header and checksum, and of a signature


def read_tlog(path: Path) -> list[Log]:
    """A log for each boot of one aircraft's autopilot, with the numeric fields of its standard messages. Raises ImportDataError
    for a file without messages of an aircraft."""
    scan = TlogScan(read_bytes(path, error=ImportDataError))
    systems: Counter[int] = Counter()
    for (system, _, _), rows in scan.rows.items():
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
        for (sender, component, kind), rows in scan.rows.items()
        if sender == system
    ]
    parameters = _parameters([r for r in received if r.name == "PARAM_VALUE"])
    boots = by_boot(received)
    logs = []
    for number, boot in enumerate(boots, start=1):
        notes = scan.notes(sorted(set(aircraft) - {system}), system) if number == 1 else []
        notes += [f"boot {number} of {len(boots)} in this log: imported as a separate record"] if len(boots) > 1 else []
        detail = {"system": str(system), "component": str(boot.component)}
        log = Log("tlog", boot.series, notes=(*notes, *boot.notes), detail=detail, parameters=parameters)
        logs.append(replace(log, contradictions=boot.contradictions, marks=boot.marks))
    return logs


@dataclass(frozen=True)
class DialectLayout:
    """A message of the dialect: name, numpy type of a payload, numeric fields with their number of elements, CRC_EXTRA."""

    name: str
    dtype: np.dtype[np.void]
    fields: tuple[tuple[str, int], ...]
    crc_extra: int


@dataclass
class _Rows:
    """Messages of one kind from one component: time received [s], position in the file, and the payloads joined."""

    stamps: list[float] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    payloads: bytearray = field(default_factory=bytearray)

    def table(self, kind: int) -> NDArray[np.void]:
        """(n,) the payloads as records of message `kind`."""
        return np.frombuffer(self.payloads, layouts()[kind].dtype)


@cache
def layouts() -> Mapping[int, DialectLayout]:
    """The messages of the dialect ardupilotmega, which contains PX4's, by id."""
    ardupilotmega = optional("pymavlink.dialects.v20.ardupilotmega", "a telemetry log")

    by_id = {}
    for number, message in ardupilotmega.mavlink_map.items():
        letters = re.findall(r"(\d*)([a-zA-Z])", message.unpacker.format)
        types: list[tuple[str, str, tuple[int, ...]]] = []
        fields = []
        for name, (count, letter) in zip(message.ordered_fieldnames, letters, strict=True):
            if letter in "sc":
                types.append((name, f"S{count or 1}", ()))
                continue
            elements = int(count or 1)
            types.append((name, f"<{letter}", (elements,) if elements > 1 else ()))
            if elements <= LONGEST_ARRAY:
                fields.append((name, elements))
        by_id[number] = DialectLayout(message.msgname, np.dtype(types), tuple(fields), message.crc_extra)
    return by_id


class TlogScan:
    """Every message of a log with a valid checksum. Messages that are not in the dialect are skipped where another frame follows.
    After damage the scan continues at the next bytes that can begin a record.

    rows: by system, component and message id; downlink_frames: number of those of Sideslip's downlink; skipped: damaged bytes.
    """

    def __init__(self, data: bytes) -> None:
        self.rows: dict[tuple[int, int, int], _Rows] = {}
        self.downlink_frames = self.skipped = 0
        start = 0
        while start + _STAMP + _V1_EXTRA <= len(data):
            size = _frame_size(data, start + _STAMP)
            following = start + _STAMP + size
            if not size or following > len(data) or not self._add_record(data, start, following):
                match = _NEXT.search(data, start + 1)
                following = match.start() if match else len(data)
                self.skipped += following - start
            start = following
        self.skipped += len(data) - min(start, len(data))

    def _add_record(self, data: bytes, start: int, following: int) -> bool:
        """Add the record in data[start:following]; returns False where its frame is damaged."""
        first = start + _STAMP
        is_v1 = data[first] == _V1
        head = 6 if is_v1 else 10
        kind = data[first + 5] if is_v1 else int.from_bytes(data[first + 7 : first + 10], "little")
        layout = layouts().get(kind)
        if layout is None:
            self.downlink_frames += kind == _DOWNLINK_FRAME
            return following == len(data) or _frame_size(data, following + _STAMP) > 0
        end = first + head + data[first + 1]
        checksum = fastcrc.crc16.mcrf4xx(data[first + 1 : end] + bytes([layout.crc_extra]))
        if checksum != data[end] | data[end + 1] << 8:
            return False
        system, component = (data[first + 3], data[first + 4]) if is_v1 else (data[first + 5], data[first + 6])
        rows = self.rows.setdefault((system, component, kind), _Rows())
        rows.places.append(start)
        rows.stamps.append(int.from_bytes(data[start:first], "big") * 1e-6)
        rows.payloads += padded(data[first + head : end], layout.dtype.itemsize)
        return True

    def notes(self, excluded: list[int], system: int) -> list[str]:
        """Notes on what was left out. excluded: systems that are not imported; system: the imported one."""
        notes = []
        if self.downlink_frames:
            notes.append(
                f"{self.downlink_frames} frames of Sideslip's own downlink are not used here: 'sideslip ground --replay' makes "
                "the flight of them"
            )
        if excluded:
            notes.append(f"messages of systems {', '.join(map(str, excluded))} left out; system {system} is imported")
        if self.skipped:
            notes.append(f"{self.skipped} bytes of the log are damaged and left out")
        return notes


def _frame_size(data: bytes, offset: int) -> int:
    """Length in bytes of the MAVLink frame that begins at `offset`; 0 where none does."""
    if offset + 3 > len(data) or data[offset] not in (_V1, _V2):
        return 0
    if data[offset] == _V1:
        return data[offset + 1] + _V1_EXTRA
    return data[offset + 1] + _V2_EXTRA + (_SIGNATURE if data[offset + 2] & 1 else 0)


def _parameters(received: list[ReceivedMessages]) -> dict[str, float]:
    """The autopilot's parameters, last values, in ArduPilot's encoding (PX4 encodes integers in another way)."""
    parameters: dict[str, float] = {}
    for messages in received:
        pairs = zip(messages.table["param_id"].tolist(), messages.table["param_value"].tolist(), strict=True)
        parameters |= {name.decode("ascii", "replace"): value for name, value in pairs if math.isfinite(value)}
    return parameters
