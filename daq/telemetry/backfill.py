"""The aircraft's side of backfill: stores the scans of this session, compressed, and sends those that the ground requests.

The ground requests scans by number and gets exactly the bytes that the recorder wrote, compressed and cut into fragments; it
requests lost fragments again. Count and hash of all scans show both ends that nothing is missing.

A request has 34 bytes, and its answer takes milliseconds: answers are prepared in a thread of their own and remembered, and their
number is limited.
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

MAX_WANTED = 24  # scans in a request
FRAGMENT_BYTES = 190  # of data in a BACKFILL_DATA
MAX_FRAGMENTS = 64  # of an answer: the bits of `fragments` in a request
PAPERS_PART_BYTES = 8192
_CHUNK = 32  # scans compressed together in memory
_SNAPSHOT = 64  # scan numbers between two stored hashes
_MAX_REQUESTS = 16  # in preparation, and answers remembered: four times what a ground station requests at a time
_MAX_EVENTS = 200  # sent with the identity; older ones are dropped
_CLOSE_TIMEOUT_S = 2.0  # for an answer in preparation when the link is closed
_LENGTH = struct.Struct("<I")


def pack_scans(encoded: list[bytes]) -> bytes:
    """Encoded scans, each preceded by its length (u32), compressed with zlib."""
    return zlib.compress(b"".join(_LENGTH.pack(len(e)) + e for e in encoded), 9)


class StoredScans(NamedTuple):
    """Scans of the store as it holds them: compressed chunks by chunk number, and scans that are not compressed yet by number."""

    chunks: dict[int, bytes]
    scans: dict[int, Scan]

    def encoded(self, numbers: Sequence[int]) -> dict[int, bytes]:
        """The encoded scans with these numbers, without missing ones; takes milliseconds for a few dozen."""
        rows = {n: data for chunk in self.chunks.values() for n, data in _rows(zlib.decompress(chunk)).items()}
        rows |= {n: encode_scan(scan) for n, scan in self.scans.items()}
        return {n: rows[n] for n in numbers if n in rows}


class ScanStore:
    """All scans so far, compressed, and their running hash; beyond `capacity_bytes` the oldest are dropped.

    A scan is encoded when its chunk is complete: by then the recorder has most likely encoded it, and the scan holds the bytes.
    """

    def __init__(self, capacity_bytes: int) -> None:
        self._capacity_bytes = capacity_bytes
        self._chunks: OrderedDict[int, bytes] = OrderedDict()  # chunk number -> compressed (number, data) rows
        self._open: dict[int, Scan] = {}  # scans of the current chunk, not in the hash yet
        self._open_chunk = 0
        self._stored_bytes = 0
        self._hash = hashlib.sha256()
        self._snapshot_numbers: list[int] = []  # ascending
        self._snapshots: list[tuple[int, bytes]] = []  # count and digest of all scans up to that number
        self._newest: tuple[int, int, bytes] | None = None  # summary of all scans, until the next one comes
        self.first: int | None = None
        self.last = 0
        self.count = 0

    def add(self, scan: Scan) -> None:
        """Store a scan; its number must be higher than the last."""
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
        while self._stored_bytes > self._capacity_bytes and len(self._chunks) > 1:
            self._stored_bytes -= len(self._chunks.popitem(last=False)[1])

    def stored(self, numbers: Sequence[int]) -> StoredScans:
        """The scans with these numbers as stored, to be decompressed in another thread; takes microseconds."""
        chunks = {n // _CHUNK for n in numbers}
        return StoredScans(
            {c: self._chunks[c] for c in chunks if c in self._chunks},
            {n: self._open[n] for n in numbers if n in self._open},
        )

    def get(self, number: int) -> bytes | None:
        """The encoded scan with a number; None when there was none or it has been dropped."""
        return self.stored([number]).encoded([number]).get(number)

    def summary(self, through: int) -> tuple[int, int, bytes]:
        """Last number, count and SHA-256 of the scans up to the last stored hash not after number `through`."""
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
    """Identity of a recording and archive of its attachments, both compressed: all that is needed to interpret its counts."""
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
class _PreparedAnswer:
    """The bytes that answer a request, empty without any; their CRC-32 and the number of fragments."""

    data: bytes
    checksum: int
    fragments: int


def _answer(data: bytes) -> _PreparedAnswer:
    return _PreparedAnswer(data, zlib.crc32(data), -(-len(data) // FRAGMENT_BYTES))


class _Preparation:
    """Prepares answers and remembers them; used in the worker's thread only."""

    def __init__(self, papers: Callable[[], RecordingInfo | None]) -> None:
        self._papers = papers
        self._papers_parts: tuple[bytes, bytes] = b"", b""  # identity, archive
        self._papers_version: tuple[int, Mapping[str, str]] | None = None  # number of events, facts of the sensors
        self._answers: OrderedDict[tuple[int, int], _PreparedAnswer] = OrderedDict()

    def scans(self, first: int, wanted: int, stored: StoredScans) -> _PreparedAnswer:
        key = (first, wanted)
        if key in self._answers:
            self._answers.move_to_end(key)
            return self._answers[key]
        numbers = [first + i for i in range(64) if wanted >> i & 1]
        encoded = list(stored.encoded(numbers).values())
        answer = _answer(pack_scans(encoded) if encoded else b"")
        if len(encoded) == len(numbers):  # an answer without scans that may still come is not remembered
            self._answers[key] = answer
            if len(self._answers) > _MAX_REQUESTS:
                self._answers.popitem(last=False)
        return answer

    def part(self, part: int, events_so_far: int, events: tuple[EventMessage, ...]) -> _PreparedAnswer:
        """Part 0: the identity, made again after a new event or a sensor that started late; parts 1 on: the archive."""
        if part == 0 or self._papers_version is None:
            info = self._identity()
            if info is None:
                return _answer(b"")
            if self._papers_version != (events_so_far, info.details):
                self._papers_version, self._papers_parts = (events_so_far, info.details), papers_of(info, events)
        identity, archive = self._papers_parts
        return _answer(identity if part == 0 else archive[(part - 1) * PAPERS_PART_BYTES : part * PAPERS_PART_BYTES])

    def _identity(self) -> RecordingInfo | None:
        try:
            return self._papers()
        except (OSError, UserError) as error:  # the calibration files are gone
            _LOG.error("the recording's identity cannot be sent: %s", error)
            return None


@dataclass(slots=True)
class _BackfillJob:
    """A request whose answer is being prepared."""

    future: "Future[_PreparedAnswer]"
    fragments: int  # wanted, one bit each


@dataclass(slots=True)
class _PendingAnswer:
    """Fragments of an answer that wait to be sent, by index."""

    answer: _PreparedAnswer
    indices: deque[int] = field(default_factory=deque)


class BackfillServer:
    """Answers BACKFILL_REQUEST and BACKFILL_SUMMARY_REQUEST.

    boot: number of this start. papers: returns identity and attachments of the recording, None while there is none; called in the
    worker's thread. Call all methods from one thread; `close` ends the worker.
    """

    def __init__(self, store: ScanStore, boot: int, papers: Callable[[], RecordingInfo | None]) -> None:
        self._store = store
        self._boot = boot
        self._preparation = _Preparation(papers)
        self._worker = Worker("backfill", capacity=_MAX_REQUESTS)
        # an answer in preparation or in the queue is not prepared again, however often it is requested
        self._jobs: OrderedDict[tuple[int, int], _BackfillJob] = OrderedDict()
        self._queue: OrderedDict[tuple[int, int], _PendingAnswer] = OrderedDict()
        self._events: deque[EventMessage] = deque(maxlen=_MAX_EVENTS)
        self._events_so_far = 0

    def event(self, event: EventMessage) -> None:
        self._events.append(event)
        self._events_so_far += 1

    def request(self, first: int, wanted: int, fragments: int) -> bool:
        """Queue fragments of an answer; False for a request that is too large, or beyond _MAX_REQUESTS.

        first, wanted: number of the first scan, and a bit for each scan from there on; without a bit, `first` is a part of the
        papers. fragments: a bit for each fragment.
        """
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

    def _prepare(self, first: int, wanted: int) -> "Future[_PreparedAnswer] | None":
        if not wanted:
            events = tuple(self._events)
            return self._worker.submit(self._preparation.part, first, self._events_so_far, events)
        stored = self._store.stored([first + i for i in range(64) if wanted >> i & 1])
        return self._worker.submit(self._preparation.scans, first, wanted, stored)

    @property
    def preparing(self) -> bool:
        """Whether an answer is being prepared; a simulated clock waits until it is not."""
        return self._worker.busy

    def _queue_prepared(self) -> None:
        """Queue the fragments of prepared answers, in the order of the requests."""
        while self._jobs:
            key, job = next(iter(self._jobs.items()))
            if not job.future.done():
                return
            del self._jobs[key]
            answer = job.future.result()
            if answer.fragments > MAX_FRAGMENTS:
                continue
            pending = self._queue.setdefault(key, _PendingAnswer(answer))
            if pending.answer.data != answer.data:
                pending = self._queue[key] = _PendingAnswer(answer)
            indices = (i for i in range(max(1, answer.fragments)) if job.fragments >> i & 1 or not answer.fragments)
            pending.indices.extend(i for i in indices if i not in pending.indices)
            if not pending.indices:
                del self._queue[key]

    def _fragment(self, first: int, wanted: int, answer: _PreparedAnswer, index: int) -> Item:
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
        """The next fragment to send; None without one, or while the next answer is being prepared."""
        self._queue_prepared()
        if not self._queue:
            return None
        (first, mask), pending = next(iter(self._queue.items()))
        index = pending.indices.popleft()
        if not pending.indices:
            del self._queue[first, mask]
        return self._fragment(first, mask, pending.answer, index)

    def close(self) -> None:
        self._worker.close(_CLOSE_TIMEOUT_S)
