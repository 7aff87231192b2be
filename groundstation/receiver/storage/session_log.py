"""The journal of a session: each received scan goes to the disk at once, for the recording and for backfill.

An append-only file of records with checksums. A ground station that is killed and started again in the same folder continues
where it was: it requests nothing twice, and loses no other record by a damaged one. In memory there is one bit for each scan; the
file is read through to find the records when a recording is written.
"""

import os
import struct
import zlib
from array import array
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from enum import IntEnum
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from daq.contract.link.scan_map import ScanMap
from daq.contract.scan import Scan, ScanDecodeError, decode_scan, encode_scan
from groundstation.receiver.storage.lasting_log import LastingLog

_HEAD = struct.Struct("<BIII")  # kind, number, length, CRC-32 over the three and the data
_CHECKED = struct.Struct("<BII")  # the three fields under the checksum
_MAGIC = b"SSJ1"
_LIMIT = 1 << 20  # bytes of a record's data


class RecordKind(IntEnum):
    """Kinds of records; their numbers are in the files."""

    RECEIVED = 0  # a scan as far as the downlink carries it
    COMPLETE = 1  # a scan as the aircraft encoded it
    EVENT = 2  # an encoded event
    LINK = 3  # link statistics as JSON
    PAPERS = 4  # identity of the recording, part 0 of the papers
    ARCHIVE = 5  # attachments of the recording
    NOTE = 6  # an encoded event of the reception itself


_KINDS = frozenset(RecordKind)


class _Record(NamedTuple):
    """A record at an offset of the file."""

    offset: int
    kind: RecordKind
    number: int
    data: bytes

    @property
    def end(self) -> int:
        return self.offset + _HEAD.size + len(self.data)


class SessionLog:
    """Scans by number, of which the complete form is preferred, and the other records in order. received, complete: numbers of
    the scans in the journal."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.received = ScanMap()
        self.complete = ScanMap()
        self.file = LastingLog(path)
        self._take_stock()

    # ------------------------------------------------------------------------------------------ writing

    def _take_stock(self) -> None:
        """Read which scans the file has, and cut it after the last valid record, so that others can follow."""
        self.received, self.complete = ScanMap(), ScanMap()
        end = 0
        for record in self._records():
            self._note_scan(record.kind, record.number)
            end = record.end
        self.file.truncate(end)  # removes an incomplete last record, or all of a file that is no journal
        if end == 0:
            self.file.append(_MAGIC)

    def look_after(self) -> None:
        """Write the waiting records; where the file is gone, continue in a new one, with the old content if that can be read;
        `received` and `complete` then tell what it holds. Call it now and then. Raises OSError while there is no disk."""
        if not self.file.look_after():
            unwritten = self.file.take_waiting()
            self._take_stock()
            for record in unwritten:
                if record != _MAGIC:
                    self.file.append(record)
                    kind, number, *_ = _HEAD.unpack_from(record)
                    self._note_scan(RecordKind(kind), number)
        self.file.flush()

    @property
    def scans_waiting(self) -> int:
        """Number of scans that are in memory only, because the disk has not taken them yet."""
        kinds = (record[0] for record in self.file.records_waiting if record != _MAGIC)
        return sum(kind in (RecordKind.RECEIVED, RecordKind.COMPLETE) for kind in kinds)

    @property
    def total(self) -> int:
        """Number of scans in the file or waiting for it."""
        return len(self.complete) + len(self.received.minus(self.complete))

    @property
    def on_disk(self) -> int:
        """Number of scans in the file."""
        return self.total - self.scans_waiting

    def _note_scan(self, kind: RecordKind, number: int) -> None:
        """Add a record to `received` or `complete`."""
        if kind is RecordKind.RECEIVED:
            self.received.add(number)
        elif kind is RecordKind.COMPLETE:
            self.complete.add(number)

    def add(self, kind: RecordKind, data: bytes, number: int = 0) -> None:
        """Append a record. number: of a scan. Raises OSError where the record has to wait."""
        crc = zlib.crc32(_CHECKED.pack(kind, number, len(data)) + data)
        if self.file.append(_HEAD.pack(kind, number, len(data), crc) + data):
            self._note_scan(kind, number)
        self.file.flush()  # on a full disk the record waits in memory for a later flush

    def add_received(self, scan: Scan) -> None:
        """Append a received scan; a later one of the same number, with more parts, replaces it."""
        self.add(RecordKind.RECEIVED, encode_scan(scan), scan.number)

    def add_complete(self, data: bytes) -> int | None:
        """Append a scan as the aircraft encoded it; returns its number, None for invalid bytes."""
        try:
            scan = decode_scan(data)
        except ScanDecodeError:
            return None
        if scan.number not in self.complete:
            self.add(RecordKind.COMPLETE, data, scan.number)
        return scan.number

    def close(self) -> None:
        self.file.close()

    # ------------------------------------------------------------------------------------------ reading

    def _records(self) -> Iterator[_Record]:
        """All valid records of the file in order; damaged bytes are skipped. Waiting records are flushed first, if possible."""
        with suppress(OSError):
            self.file.flush()
        with self.path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if file.read(len(_MAGIC)) != _MAGIC:
                return
            offset = len(_MAGIC)
            while offset + _HEAD.size <= size:
                record = _record_at(file, offset, size)
                if record is None:
                    offset += 1
                    continue
                yield record
                offset = record.end

    def scans(self, *, complete_only: bool = False) -> Iterator[bytes]:
        """Encoded scans in order of number, in the complete form where there is one."""
        numbers, offsets = array("Q"), array("Q")
        for record in self._records():
            is_scan = record.kind is RecordKind.COMPLETE or (
                record.kind is RecordKind.RECEIVED and not complete_only and record.number not in self.complete
            )
            if is_scan:
                numbers.append(record.number)
                offsets.append(record.offset)
        order = np.argsort(np.frombuffer(numbers, np.uint64), kind="stable")
        with self.path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            for i, index in enumerate(order):
                replaced = i + 1 < len(order) and numbers[order[i + 1]] == numbers[index]
                scan_record = None if replaced else _record_at(file, offsets[index], size)
                if scan_record is not None:
                    yield scan_record.data

    def records_of(self, kind: RecordKind) -> Iterator[bytes]:
        """Data of the records of a kind that is no scan, in order."""
        return (record.data for record in self._records() if record.kind is kind)

    def last(self, kind: RecordKind) -> bytes | None:
        """The last record of a kind; None without one."""
        return next(iter(deque(self.records_of(kind), maxlen=1)), None)


def _record_at(file: IO[bytes], offset: int, size: int) -> _Record | None:
    """The record at an offset of a file of `size` bytes; None where none is valid."""
    file.seek(offset)
    head = file.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    kind, number, length, crc = _HEAD.unpack(head)
    if kind not in _KINDS or length > _LIMIT or offset + _HEAD.size + length > size:
        return None
    data = file.read(length)
    if zlib.crc32(_CHECKED.pack(kind, number, length) + data) != crc:
        return None
    return _Record(offset, RecordKind(kind), number, data)
