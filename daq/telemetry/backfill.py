"""The serving side of backfill: every scan of this session kept, compressed, until the ground has it.

The ground asks for sets of scans by number and gets exactly the bytes the recorder wrote, compressed and cut into
fragments; it asks for lost fragments again. Count and hash of all scans let both ends know that nothing is missing.

A request is 34 bytes and its answer milliseconds of work: answers are made in a thread of their own, remembered for when
they are asked for again, and few may be under way.
"""

import hashlib
import json
import logging
import struct
import zlib
from bisect import bisect_right
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import NamedTuple

from daq.contract.link.papers_dictionary import PAPERS_DICTIONARY
from daq.contract.recordings.messages import EventMessage
from daq.contract.recordings.recording import RecordingInfo
from daq.contract.scan import Scan, encode_scan
from daq.telemetry.send_queue import Item, item
from daq.telemetry.worker import Worker
from daq.utilities.errors import UserError

_LOG = logging.getLogger("sideslip.uplink")

MAX_WANTED = 24
FRAGMENT_BYTES = 190
MAX_FRAGMENTS = 64
PAPERS_PART_BYTES = 8192
_CHUNK = 32  # scans compressed together in memory
_SNAPSHOT = 64  # a hash is remembered at every multiple of this
_MAX_REQUESTS = 16  # being prepared, and answers remembered: four times what a ground station asks for at a time
_MAX_EVENTS = 200
_PATIENCE_S = 2.0  # for the answer under way when the link is closed
_LENGTH = struct.Struct("<I")


def pack_scans(encoded: list[bytes]) -> bytes:
    """Encoded scans, each preceded by its length, compressed."""
    return zlib.compress(b"".join(_LENGTH.pack(len(e)) + e for e in encoded), 9)


class Kept(NamedTuple):
    """What the store holds of some scans: compressed chunks by number, and the scans of the chunk in progress."""

    chunks: dict[int, bytes]
    scans: dict[int, Scan]

    def encoded(self, numbers: Sequence[int]) -> dict[int, bytes]:
        """The encoded scans of these numbers, as far as they are here; milliseconds of work for a few dozen."""
        rows = {n: data for chunk in self.chunks.values() for n, data in _rows(zlib.decompress(chunk)).items()}
        rows |= {n: encode_scan(scan) for n, scan in self.scans.items()}
        return {n: rows[n] for n in numbers if n in rows}


class ScanStore:
    """All scans offered so far, compressed, the oldest given up beyond `room_bytes`; and their running hash.

    A scan is only kept when it comes: its bytes are made once the recorder has most likely made them already.
    """

    def __init__(self, room_bytes: int) -> None:
        self._room = room_bytes
        self._chunks: OrderedDict[int, bytes] = OrderedDict()  # chunk number -> compressed (number, data) rows
        self._open: dict[int, Scan] = {}  # of the chunk in progress, not in the hash yet
        self._open_chunk = 0
        self._stored_bytes = 0
        self._hash = hashlib.sha256()
        self._snapshot_numbers: list[int] = []  # ascending
        self._snapshots: list[tuple[int, bytes]] = []  # count and digest of all scans up to that number
        self._newest: tuple[int, int, bytes] | None = None  # the summary of all, until the next scan comes
        self.first: int | None = None
        self.last = 0
        self.count = 0

    def add(self, scan: Scan) -> None:
        """Keep a scan; numbers must rise."""
        number = scan.number
        if self.first is None:
            self.first = number
        if number // _CHUNK != self._open_chunk:
            self._close_chunk()
            if self.count and number // _SNAPSHOT != self.last // _SNAPSHOT:
                self._snapshot_numbers.append(self.last)
                self._snapshots.append((self.count, self._hash.digest()))
            self._open_chunk = number // _CHUNK
        self._open[number] = scan
        self._newest = None
        self.last = number
        self.count += 1

    def _close_chunk(self) -> None:
        if not self._open:
            return
        rows = []
        for number, scan in self._open.items():
            data = encode_scan(scan)
            rows.append(struct.pack("<II", number, len(data)) + data)
            self._hash.update(_LENGTH.pack(len(data)) + data)
        packed = zlib.compress(b"".join(rows), 1)
        self._chunks[self._open_chunk] = packed
        self._stored_bytes += len(packed)
        self._open = {}
        while self._stored_bytes > self._room and len(self._chunks) > 1:
            self._stored_bytes -= len(self._chunks.popitem(last=False)[1])

    def kept(self, numbers: Sequence[int]) -> Kept:
        """What is held of these scans, to be worked on elsewhere; costs next to nothing."""
        chunks = {n // _CHUNK for n in numbers}
        return Kept(
            {c: self._chunks[c] for c in chunks if c in self._chunks},
            {n: self._open[n] for n in numbers if n in self._open},
        )

    def get(self, number: int) -> bytes | None:
        """The encoded scan of a number; None when there was none or it has been given up."""
        return self.kept([number]).encoded([number]).get(number)

    def summary(self, through: int) -> tuple[int, int, bytes]:
        """Last number, count and hash of the scans up to the last remembered instant not after `through`."""
        if through >= self.last:
            if self._newest is None:
                self._newest = (self.last, self.count, self._digest_of_all())
            return self._newest
        index = bisect_right(self._snapshot_numbers, through) - 1
        if index < 0:
            return self.first or 0, 0, hashlib.sha256().digest()
        return self._snapshot_numbers[index], *self._snapshots[index]

    def _digest_of_all(self) -> bytes:
        digest = self._hash.copy()
        for data in map(encode_scan, self._open.values()):
            digest.update(_LENGTH.pack(len(data)) + data)
        return digest.digest()


def _rows(data: bytes) -> dict[int, bytes]:
    rows: dict[int, bytes] = {}
    offset = 0
    while offset < len(data):
        number, size = struct.unpack_from("<II", data, offset)
        rows[number] = data[offset + 8 : offset + 8 + size]
        offset += 8 + size
    return rows


def papers_of(info: RecordingInfo, events: Sequence[EventMessage] = ()) -> tuple[bytes, bytes]:
    """What the ground needs to read a recording's counts: identity, and the archive of its attachments."""
    archive = zlib.compress(
        json.dumps({name: data.hex() for name, data in sorted(info.attachments.items())}).encode(), 9
    )
    identity = {
        "session": info.session,
        "source": info.source,
        "aircraft": info.aircraft,
        "scan_rate_hz": info.scan_rate_hz,
        "started_utc_ns": info.started_utc_ns,
        "software": info.software,
        "details": dict(info.details),
        "events": [[e.time_monotonic_ns, e.time_utc_ns, e.number, e.origin, e.text] for e in events],
        "archive_bytes": len(archive),
        "archive_sha256": hashlib.sha256(archive).hexdigest(),
    }
    packer = zlib.compressobj(9, zdict=PAPERS_DICTIONARY)
    return packer.compress(json.dumps(identity).encode()) + packer.flush(), archive


@dataclass(frozen=True, slots=True)
class _Answer:
    """The bytes that answer a request; empty when there is nothing to be had."""

    data: bytes
    checksum: int
    fragments: int


def _answer(data: bytes) -> _Answer:
    return _Answer(data, zlib.crc32(data), -(-len(data) // FRAGMENT_BYTES))


class _Preparation:
    """Makes answers, and remembers them. All of it belongs to the worker's thread."""

    def __init__(self, papers: Callable[[], RecordingInfo | None]) -> None:
        self._papers = papers
        self._papers_parts: tuple[bytes, bytes] = b"", b""  # identity, archive
        self._made_from: tuple[int, Mapping[str, str]] | None = None  # how many events, facts of the sensors
        self._answers: OrderedDict[tuple[int, int], _Answer] = OrderedDict()

    def scans(self, first: int, wanted: int, kept: Kept) -> _Answer:
        key = (first, wanted)
        if key in self._answers:
            self._answers.move_to_end(key)
            return self._answers[key]
        numbers = [first + i for i in range(64) if wanted >> i & 1]
        encoded = list(kept.encoded(numbers).values())
        answer = _answer(pack_scans(encoded) if encoded else b"")
        if len(encoded) == len(numbers):  # else not offered yet, or given up: an answer that may change is not kept
            self._answers[key] = answer
            if len(self._answers) > _MAX_REQUESTS:
                self._answers.popitem(last=False)
        return answer

    def part(self, part: int, events_so_far: int, events: tuple[EventMessage, ...]) -> _Answer:
        """A part of the papers: 0 the identity, anew where a sensor that joined late has added its facts; then the archive."""
        if part == 0 or self._made_from is None:
            info = self._identity()
            if info is None:
                return _answer(b"")
            if self._made_from != (events_so_far, info.details):
                self._made_from, self._papers_parts = (events_so_far, info.details), papers_of(info, events)
        identity, archive = self._papers_parts
        return _answer(identity if part == 0 else archive[(part - 1) * PAPERS_PART_BYTES : part * PAPERS_PART_BYTES])

    def _identity(self) -> RecordingInfo | None:
        try:
            return self._papers()
        except (OSError, UserError) as error:  # the calibration files have been taken away meanwhile
            _LOG.error("the recording's identity cannot be sent: %s", error)
            return None


@dataclass(slots=True)
class _BackfillJob:
    """A request whose answer is being made."""

    future: "Future[_Answer]"
    fragments: int  # wanted, one bit each


@dataclass(slots=True)
class _Waiting:
    """Fragments of an answer that wait to be sent."""

    answer: _Answer
    indices: deque[int] = field(default_factory=deque)


class BackfillServer:
    """Answers BACKFILL_REQUEST and BACKFILL_SUMMARY_REQUEST in what bandwidth is left.

    papers: identity and attachments of the recording, None while there is none; asked in the worker's thread.
    All methods belong to one thread; `close` ends the worker.
    """

    def __init__(self, store: ScanStore, boot: int, papers: Callable[[], RecordingInfo | None]) -> None:
        self._store = store
        self._boot = boot
        self._preparation = _Preparation(papers)
        self._worker = Worker("backfill", room=_MAX_REQUESTS)
        # What is being made or queued is not made or queued again, however often it is asked for.
        self._jobs: OrderedDict[tuple[int, int], _BackfillJob] = OrderedDict()
        self._queue: OrderedDict[tuple[int, int], _Waiting] = OrderedDict()
        self._events: deque[EventMessage] = deque(maxlen=_MAX_EVENTS)
        self._events_so_far = 0

    def event(self, event: EventMessage) -> None:
        self._events.append(event)
        self._events_so_far += 1

    def request(self, first: int, wanted: int, fragments: int) -> bool:
        """Have the wanted fragments of an answer sent; False for a request that is too large, or one too many."""
        key = (first, wanted)
        job = self._jobs.get(key)
        if job is not None:
            job.fragments |= fragments
            return True
        full = key not in self._queue and len(self._queue) + len(self._jobs) >= _MAX_REQUESTS
        if full or wanted.bit_count() > MAX_WANTED:
            return False
        future = self._prepare(first, wanted)
        if future is None:
            return False
        self._jobs[key] = _BackfillJob(future, fragments)
        return True

    def _prepare(self, first: int, wanted: int) -> "Future[_Answer] | None":
        if not wanted:
            events = tuple(self._events)
            return self._worker.submit(self._preparation.part, first, self._events_so_far, events)
        stored = self._store.kept([first + i for i in range(64) if wanted >> i & 1])
        return self._worker.submit(self._preparation.scans, first, wanted, stored)

    @property
    def preparing(self) -> bool:
        """Whether an answer is being made; a simulated clock waits on this (`follow`)."""
        return self._worker.busy

    def _take_prepared(self) -> None:
        """Queue the fragments of what has been made, in the order in which it was asked for."""
        while self._jobs:
            key, job = next(iter(self._jobs.items()))
            if not job.future.done():
                return
            del self._jobs[key]
            answer = job.future.result()
            if answer.fragments > MAX_FRAGMENTS:
                continue
            pending = self._queue.setdefault(key, _Waiting(answer))
            if pending.answer.data != answer.data:
                pending = self._queue[key] = _Waiting(answer)
            indices = (i for i in range(max(1, answer.fragments)) if job.fragments >> i & 1 or not answer.fragments)
            pending.indices.extend(i for i in indices if i not in pending.indices)
            if not pending.indices:
                del self._queue[key]

    def _fragment(self, first: int, wanted: int, answer: _Answer, index: int) -> Item:
        part = answer.data[index * FRAGMENT_BYTES : (index + 1) * FRAGMENT_BYTES]
        return item(
            "BACKFILL_DATA",
            wanted=wanted,
            first_number=first,
            checksum=answer.checksum,
            boot=self._boot,
            fragment=index,
            fragments=answer.fragments,
            length=len(part),
            data=part,
        )

    def summary(self, through: int) -> Item:
        """The BACKFILL_SUMMARY of all scans up to about `through`."""
        last, count, digest = self._store.summary(through)
        return item(
            "BACKFILL_SUMMARY",
            first_number=self._store.first or 0,
            last_number=last,
            count=count,
            boot=self._boot,
            sha256=digest,
        )

    @property
    def busy(self) -> bool:
        return bool(self._queue or self._jobs)

    def next_item(self) -> Item | None:
        """The next fragment to send; None while there is none, or while it is being made."""
        self._take_prepared()
        if not self._queue:
            return None
        (first, mask), pending = next(iter(self._queue.items()))
        index = pending.indices.popleft()
        if not pending.indices:
            del self._queue[first, mask]
        return self._fragment(first, mask, pending.answer, index)

    def close(self) -> None:
        self._worker.close(_PATIENCE_S)
