"""What came of a session's scans, on disk the moment it is known: the memory of recording and backfill.

An append-only file of checked records. A ground station that is killed and started again in the same folder goes on
where it was: nothing received is asked for twice, and a torn last record costs that record only.
"""

import os
import struct
import zlib
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import IO

from daq.contract.scan import Scan, ScanDecodeError, decode_scan, encode_scan

_HEAD = struct.Struct("<BIII")  # kind, number, length, CRC-32 over the three and the data
_CRC_OF = struct.Struct("<BII")
_MAGIC = b"SSJ1"
_LIMIT = 1 << 20


class Kind(IntEnum):
    """What a record holds."""

    RECEIVED = 0  # a scan as far as the downlink carries it
    COMPLETE = 1  # a scan as the aircraft encoded it
    EVENT = 2  # an encoded event
    LINK = 3  # link statistics as JSON
    PAPERS = 4  # identity of the recording, part 0 of the papers
    ARCHIVE = 5  # attachments of the recording


class Journal:
    """Scans by number, the complete form preferred, and the other records in order."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self._received: dict[int, int] = {}  # number -> position of the data
        self._complete: dict[int, int] = {}
        self._others: list[tuple[Kind, int]] = []
        self._file: IO[bytes] = path.open("a+b")
        end = self._load()
        self._file.truncate(end)
        self._file.seek(0, os.SEEK_END)
        if end == 0:
            self._file.write(_MAGIC)

    def _load(self) -> int:
        """Index what is there; returns where the sound part ends."""
        self._file.seek(0)
        if self._file.read(4) != _MAGIC:
            return 0
        at = 4
        while True:
            record = self._record_at(at)
            if record is None:
                return at
            kind, number, data = record
            self._index(kind, number, at)
            at += _HEAD.size + len(data)

    def _record_at(self, at: int) -> tuple[Kind, int, bytes] | None:
        self._file.seek(at)
        head = self._file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return None
        kind, number, size, crc = _HEAD.unpack(head)
        data = self._file.read(size) if size <= _LIMIT else b""
        if len(data) < size or zlib.crc32(_CRC_OF.pack(kind, number, size) + data) != crc or kind not in set(Kind):
            return None
        return Kind(kind), number, data

    def _index(self, kind: Kind, number: int, at: int) -> None:
        if kind is Kind.RECEIVED:
            self._received[number] = at
        elif kind is Kind.COMPLETE:
            self._complete[number] = at
        else:
            self._others.append((kind, at))

    def _append(self, kind: Kind, number: int, data: bytes) -> None:
        self._file.seek(0, os.SEEK_END)
        at = self._file.tell()
        crc = zlib.crc32(_CRC_OF.pack(kind, number, len(data)) + data)
        self._file.write(_HEAD.pack(kind, number, len(data), crc) + data)
        self._index(kind, number, at)

    def add_received(self, scan: Scan) -> None:
        """Keep a scan as received; one completed by a later part replaces it."""
        self._append(Kind.RECEIVED, scan.number, encode_scan(scan))

    def add_complete(self, data: bytes) -> int | None:
        """Keep a scan in the aircraft's own bytes; returns its number, None when the bytes are no scan."""
        try:
            scan = decode_scan(data)
        except ScanDecodeError:
            return None
        if scan.number not in self._complete:
            self._append(Kind.COMPLETE, scan.number, data)
        return scan.number

    def add(self, kind: Kind, data: bytes) -> None:
        """Keep another record."""
        self._append(kind, 0, data)

    @property
    def complete(self) -> set[int]:
        """Numbers of the scans held in full."""
        return set(self._complete)

    @property
    def received(self) -> set[int]:
        """Numbers of the scans received on the downlink."""
        return set(self._received)

    def has_complete(self, number: int) -> bool:
        """Whether a scan is held in full."""
        return number in self._complete

    def complete_count(self) -> int:
        """Scans held in full."""
        return len(self._complete)

    def scans(self, *, complete_only: bool = False) -> Iterator[bytes]:
        """Encoded scans in order of number, the complete form where there is one."""
        numbers = set(self._complete) if complete_only else set(self._complete) | set(self._received)
        for number in sorted(numbers):
            record = self._record_at(self._complete.get(number, self._received.get(number, 0)))
            if record is not None:
                yield record[2]

    def others(self, kind: Kind) -> Iterator[bytes]:
        """The other records of a kind, in order."""
        for found, at in self._others:
            if found is kind:
                record = self._record_at(at)
                if record is not None:
                    yield record[2]

    def last(self, kind: Kind) -> bytes | None:
        """The last record of a kind."""
        for found, at in reversed(self._others):
            record = self._record_at(at) if found is kind else None
            if record is not None:
                return record[2]
        return None

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
