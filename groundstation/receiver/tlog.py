"""Telemetry logs: every byte received, in the `.tlog` form that MAVLink tools read.

A record is a timestamp (microseconds UTC, 8 bytes big-endian) and a frame. Bytes outside valid frames are wrapped into TUNNEL
messages of system 0, which other tools skip; `read_tlog` unwraps them, so that a replay sees the byte stream as it was received.
"""

import os
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from daq.contract.channels import CHANNELS
from daq.contract.link.wire import layouts
from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder, Junk, MavlinkFrame, frame_at
from daq.utilities.errors import UserError
from daq.utilities.input_files import read_bytes
from groundstation.receiver.decode import AircraftDecoder
from groundstation.receiver.events import ScanReceived
from groundstation.receiver.storage.lasting_log import LastingLog

JUNK_PAYLOAD_TYPE = 44100
"""TUNNEL payload type of wrapped bytes, from the range for private use."""
JUNK_CHUNK = 128  # bytes in one TUNNEL message
_STAMP = struct.Struct(">Q")
_STAMP_FROM, _STAMP_TO = 1_000_000, 4_102_444_800_000_000  # [us] of valid stamps: up to the year 2100
_RECORD = re.compile(rb"\x00[\x00-\x0e].{6}(?=[\xfd\xfe])", re.DOTALL)  # a time before 2100, a frame's first byte
_FLUSH_BYTES = 4096  # in memory, from which they are written
LARGEST = 1 << 30
"""Bytes of a log, after which the next file begins: three days of a 57600 baud radio, and half the limit for reading a file."""


class TlogError(UserError):
    """A telemetry log that cannot be read or written."""


class TlogWriter:
    """Appends records; a killed process loses a few kilobytes at most.

    A log of `largest` bytes is continued in the next file: telemetry.tlog, telemetry_1.tlog, telemetry_2.tlog.
    """

    def __init__(self, path: Path, largest: int = LARGEST) -> None:
        self._first, self._largest, self._number = path, largest, 0
        try:
            while self.path.is_file() and self.path.stat().st_size >= largest:
                self._number += 1
            self.file = LastingLog(self.path)
        except OSError as error:
            raise TlogError(f"{path}: telemetry log cannot be written ({error.strerror})") from error
        self._wrapper = FrameEncoder(0, 0)
        self._disk_works = True

    @property
    def path(self) -> Path:
        """The log that is written at present."""
        return self._path_of(self._number)

    def _path_of(self, number: int) -> Path:
        return self._first.with_stem(f"{self._first.stem}_{number}") if number else self._first

    def write(self, item: MavlinkFrame | Junk, utc_ns: int) -> None:
        """Add a frame, or bytes outside frames. Raises OSError."""
        stamp = _STAMP.pack(max(0, utc_ns) // 1000)
        if isinstance(item, MavlinkFrame):
            self._append(stamp + item.raw)
            return
        for offset in range(0, len(item.raw), JUNK_CHUNK):
            piece = item.raw[offset : offset + JUNK_CHUNK]
            wrapped = self._wrapper.message(
                "TUNNEL", payload_type=JUNK_PAYLOAD_TYPE, payload_length=len(piece), payload=piece
            )
            self._append(stamp + wrapped)

    def _append(self, record: bytes) -> None:
        self.file.append(record)
        if self.file.bytes_waiting >= _FLUSH_BYTES and self._disk_works:
            self.flush()

    def flush(self) -> None:
        """Write all records to the operating system. Raises OSError."""
        self._disk_works = False  # after an error `write` does not try again at each frame, only `look_after` does
        self.file.flush()
        self._disk_works = True

    def look_after(self) -> None:
        """`LastingLog.look_after` and `flush`, and the next file where this one is full. Call it now and then. Raises OSError."""
        self._disk_works = False
        self.file.look_after()
        self.flush()
        if os.fstat(self.file.descriptor()).st_size >= self._largest:
            full, self.file = self.file, LastingLog(self._path_of(self._number + 1))
            self._number += 1
            full.close()

    def close(self) -> None:
        self.file.close()


def read_tlog(path: str | Path) -> Iterator[tuple[int, bytes]]:
    """UTC time [ns] and received bytes of each record; damaged bytes are skipped one by one.

    Raises TlogError for a file that cannot be read or holds no record.
    """
    path = Path(path)
    data = read_bytes(path, "telemetry log", TlogError)
    offset, count = 0, 0
    while (record := _RECORD.search(data, offset)) is not None:
        offset = record.start()
        (stamp,) = _STAMP.unpack_from(data, offset)
        frame = frame_at(data, offset + 8) if _STAMP_FROM <= stamp <= _STAMP_TO else None
        if frame is None:
            offset += 1
            continue
        count += 1
        offset += 8 + len(frame.raw)
        yield stamp * 1000, _unwrapped(frame)
    if not data:
        raise TlogError(f"{path}: the telemetry log is empty")
    if not count:
        raise TlogError(f"{path}: not a MAVLink telemetry log; no frame behind a timestamp in it")


def _unwrapped(frame: MavlinkFrame) -> bytes:
    """The received bytes of a record: of its frame, or those that a TUNNEL message wraps."""
    if frame.name == "TUNNEL" and frame.system == 0:
        fields = frame.fields()
        if fields["payload_type"] == JUNK_PAYLOAD_TYPE:
            payload, size = fields["payload"], fields["payload_length"]
            if isinstance(payload, tuple) and isinstance(size, int):
                return bytes(int(b) for b in payload[:size])
    return frame.raw


def info_tlog(path: str | Path) -> dict[str, Any]:
    """The answer of `info --json` for a telemetry log. Raises TlogError for another file."""
    decoder = FrameDecoder()
    aircraft: dict[int, AircraftDecoder] = {}
    samples: dict[str, int] = {}
    first_utc = last_utc = 0
    first: int | None = None
    last: int | None = None
    for utc, data in read_tlog(path):
        first_utc, last_utc = first_utc or utc, utc
        for item in decoder.feed(data):
            if isinstance(item, MavlinkFrame) and item.msg_id in layouts():
                aircraft_decoder = aircraft.setdefault(item.system, AircraftDecoder(item.system))
                for event in aircraft_decoder.decode_frame(item, utc, utc):
                    if isinstance(event, ScanReceived):
                        number = event.scan.number
                        first = number if first is None else min(first, number)
                        last = number if last is None else max(last, number)
                        for name in event.scan.values:
                            samples[name] = samples.get(name, 0) + 1
    sessions = [session for a in aircraft.values() for session in a.sessions]
    scans = sum(len(session.received) for session in sessions)
    duration = (last_utc - first_utc) * 1e-9
    return {
        "file": str(path),
        "kind": "tlog",
        "source": "unknown",
        "aircraft": ", ".join(f"system {s}" for s in sorted(aircraft)),
        "duration_s": duration,
        "rate_hz": scans / duration if duration > 0 else 0.0,
        "scans": scans,
        "first_scan": first,
        "last_scan": last,
        "channels": [
            {"name": c.name, "unit": c.unit, "samples": samples[c.name]} for c in CHANNELS if c.name in samples
        ],
        "software": "",
        "frames": decoder.counts.frames,
        "frames_damaged": decoder.counts.damaged,
        "sessions": len(sessions),
    }
