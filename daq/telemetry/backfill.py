"""The serving side of backfill: every scan of this session kept, compressed, until the ground has it.

The ground asks for sets of scans by number and gets exactly the bytes the recorder wrote, compressed and cut into
fragments; it asks for lost fragments again. Count and hash of all scans let both ends know that nothing is missing.
"""

import hashlib
import json
import struct
import zlib
from collections import OrderedDict, deque
from collections.abc import Callable, Sequence

from daq.contract.recordings.messages import Event
from daq.contract.recordings.recording import RecordingInfo
from daq.contract.scan import Scan, encode_scan
from daq.telemetry.send_queue import Item, item

MAX_WANTED = 24
FRAGMENT_BYTES = 190
MAX_FRAGMENTS = 64
PAPERS_PART_BYTES = 8192
_CHUNK = 32  # scans compressed together in memory
_SNAPSHOT = 64  # a hash is remembered at every multiple of this
_MAX_REQUESTS = 16
_MAX_EVENTS = 200
_LENGTH = struct.Struct("<I")


def pack_scans(encoded: list[bytes]) -> bytes:
    """Encoded scans, each preceded by its length, compressed."""
    return zlib.compress(b"".join(_LENGTH.pack(len(e)) + e for e in encoded), 9)


class ScanStore:
    """All scans offered so far, compressed, the oldest given up beyond `room_bytes`; and their running hash.

    A scan is only kept when it comes: its bytes are made once the recorder has most likely made them already.
    """

    def __init__(self, room_bytes: int) -> None:
        self._room = room_bytes
        self._chunks: OrderedDict[int, bytes] = OrderedDict()  # chunk number -> compressed (number, data) rows
        self._open: dict[int, Scan] = {}  # of the chunk in progress, not in the hash yet
        self._open_chunk = 0
        self._held = 0
        self._hash = hashlib.sha256()
        self._snapshots: dict[int, tuple[int, bytes]] = {}  # last number -> count, digest
        self._cache: tuple[int, dict[int, bytes]] = (-1, {})
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
                self._snapshots[self.last] = (self.count, self._hash.digest())
            self._open_chunk = number // _CHUNK
        self._open[number] = scan
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
        self._held += len(packed)
        self._open = {}
        while self._held > self._room and len(self._chunks) > 1:
            self._held -= len(self._chunks.popitem(last=False)[1])

    def get(self, number: int) -> bytes | None:
        """The encoded scan of a number; None when there was none or it has been given up."""
        if number in self._open:
            return encode_scan(self._open[number])
        chunk = number // _CHUNK
        if self._cache[0] != chunk:
            packed = self._chunks.get(chunk)
            if packed is None:
                return None
            self._cache = (chunk, _rows(zlib.decompress(packed)))
        return self._cache[1].get(number)

    def summary(self, through: int) -> tuple[int, int, bytes]:
        """Last number, count and hash of the scans up to the last remembered instant not after `through`."""
        if through >= self.last:
            digest = self._hash.copy()
            for data in map(encode_scan, self._open.values()):
                digest.update(_LENGTH.pack(len(data)) + data)
            return self.last, self.count, digest.digest()
        known = [n for n in self._snapshots if n <= through]
        if not known:
            return self.first or 0, 0, hashlib.sha256().digest()
        at = max(known)
        return at, *self._snapshots[at]


def _rows(data: bytes) -> dict[int, bytes]:
    out: dict[int, bytes] = {}
    at = 0
    while at < len(data):
        number, size = struct.unpack_from("<II", data, at)
        out[number] = data[at + 8 : at + 8 + size]
        at += 8 + size
    return out


def papers_of(info: RecordingInfo, events: Sequence[Event] = ()) -> tuple[bytes, bytes]:
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
    return zlib.compress(json.dumps(identity).encode(), 9), archive


class BackfillServer:
    """Answers BACKFILL_REQUEST and BACKFILL_SUMMARY_REQUEST in what bandwidth is left."""

    def __init__(self, store: ScanStore, boot: int, papers: Callable[[], RecordingInfo | None]) -> None:
        self._store = store
        self._boot = boot
        self._papers = papers
        # What is queued is not queued again, however often it is asked for.
        self._queue: OrderedDict[tuple[int, int, int], Item] = OrderedDict()
        self._answers: OrderedDict[tuple[int, int], bytes] = OrderedDict()
        self._events: deque[Event] = deque(maxlen=_MAX_EVENTS)

    def event(self, event: Event) -> None:
        """Keep an event for the papers."""
        self._events.append(event)

    def request(self, first: int, wanted: int, fragments: int) -> None:
        """Queue the wanted fragments of an answer; a request that is too large or too many at once is ignored."""
        if wanted.bit_count() > MAX_WANTED or len(self._queue) > _MAX_REQUESTS * MAX_FRAGMENTS:
            return
        data = self._answer(first, wanted)
        total = (len(data) + FRAGMENT_BYTES - 1) // FRAGMENT_BYTES
        if total > MAX_FRAGMENTS:
            return
        if not total:
            self._queue[first, wanted, 0] = item("BACKFILL_DATA", wanted=wanted, first_number=first, boot=self._boot)
        for i in range(total):
            if fragments >> i & 1:
                self._queue.setdefault((first, wanted, i), self._fragment(first, wanted, data, i, total))

    def _fragment(self, first: int, wanted: int, data: bytes, index: int, total: int) -> Item:
        part = data[index * FRAGMENT_BYTES : (index + 1) * FRAGMENT_BYTES]
        return item(
            "BACKFILL_DATA",
            wanted=wanted,
            first_number=first,
            checksum=zlib.crc32(data),
            boot=self._boot,
            fragment=index,
            fragments=total,
            length=len(part),
            data=part,
        )

    def _answer(self, first: int, wanted: int) -> bytes:
        if not wanted:
            return self._papers_part(first)
        key = (first, wanted)
        if key not in self._answers:
            found = [self._store.get(first + i) for i in range(64) if wanted >> i & 1]
            here = [data for data in found if data is not None]
            if len(here) < len(found):  # not offered yet, or given up: an answer that may change is not kept
                return pack_scans(here) if here else b""
            self._answers[key] = pack_scans(here)
            while len(self._answers) > _MAX_REQUESTS:
                self._answers.popitem(last=False)
        return self._answers[key]

    def _papers_part(self, part: int) -> bytes:
        info = self._papers()
        if info is None:
            return b""
        identity, archive = papers_of(info, tuple(self._events))
        return identity if part == 0 else archive[(part - 1) * PAPERS_PART_BYTES : part * PAPERS_PART_BYTES]

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
        """Whether anything waits to be sent."""
        return bool(self._queue)

    def next_item(self) -> Item | None:
        """The next fragment to send."""
        return self._queue.popitem(last=False)[1] if self._queue else None
