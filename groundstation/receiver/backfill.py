"""The ground's end of backfill: requests for missing scans until they have arrived, and the proof that all have.

Answers are the aircraft's encoded scans, compressed and cut into fragments; lost fragments are requested again. All that
arrives goes to the session's journal, so an interrupted backfill continues where it was. It is complete when the aircraft's
count and SHA-256 of all scans equal those of the scans here.
"""

import hashlib
import struct
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from daq.contract.link.scan_map import ScanMap
from daq.contract.scan import GroupStatus, ScanDecodeError, decode_scan
from groundstation.receiver import events as ev
from groundstation.receiver.link_accounting import LAST_NUMBER, SessionAccounting
from groundstation.receiver.storage.recording import SessionRecorder
from groundstation.receiver.timeline import NS

Mode = Literal["off", "lost", "all"]
Request = tuple[str, dict[str, Any]]

WINDOW = 4  # open requests: enough that the aircraft always has one to serve
MAX_WANTED, SPAN = 24, 64
"""Scans in one request, at most, as the aircraft refuses more; and the width of its mask of scan numbers."""
RETRY_NS, MAX_RETRY_NS = 2 * NS, 16 * NS
"""Time without an answer, after which a request is sent again; it doubles each time, to leave the radio free."""
SUMMARY_NS = 2 * NS  # between requests for the summary
PROGRESS_NS = NS  # between reports of progress
SEARCH_NS = NS // 2  # until missing scans are searched again, after none was found
PAPERS_AGAIN_NS = 10 * NS
"""Time between requests for papers because a sensor has joined: they are some 2 % of what the radio carries in that time."""
PAPERS_PART_BYTES = 8192  # of the archive in one answer, as the aircraft cuts it
_ALL_FRAGMENTS = 2**64 - 1
_MAX_ANSWER = 1 << 20  # bytes of an answer decompressed: ten times MAX_WANTED scans of _MAX_SCAN_BYTES
_ARCHIVE_TRIES = 3  # then scans are fetched without it: an archive whose hash never fits must not delay them
_MAX_SCAN_BYTES = 4096  # of one encoded scan; the largest possible has 466
_LENGTH = struct.Struct("<I")


@dataclass
class _OpenRequest:
    """A request without a complete answer. retry_ns: from sent_ns until it is sent again; checksum, total: of the answer's
    fragments, None before the first; fragments: received, by number; flowing: whether some came since it was sent."""

    sent_ns: int
    retry_ns: int = RETRY_NS
    checksum: int | None = None
    total: int | None = None
    fragments: dict[int, bytes] = field(default_factory=dict)
    flowing: bool = False

    def missing(self) -> int:
        """Bit mask of the fragments that have not come."""
        if self.total is None:
            return _ALL_FRAGMENTS
        return sum(1 << i for i in range(self.total) if i not in self.fragments)


def group_numbers(numbers: Iterable[int], limit: int) -> list[tuple[int, int]]:
    """At most `limit` requests (first number, mask) for ascending scan numbers, each of up to MAX_WANTED scans within SPAN."""
    requests: list[tuple[int, int]] = []
    first, mask = -1, 0
    for number in numbers:
        if mask and (number - first >= SPAN or mask.bit_count() >= MAX_WANTED):
            requests.append((first, mask))
            mask = 0
            if len(requests) >= limit:
                return requests
        if not mask:
            first = number
        mask |= 1 << (number - first)
    if mask:
        requests.append((first, mask))
    return requests


class BackfillClient:
    """Fetches what a session lacks. mode: `lost` scans, `all` scans, or `off` (papers only).

    agreed: whether all scans here are proven to be all that the aircraft has; unavailable: scans that it does not have; refused:
    number of invalid papers and archives.
    """

    def __init__(self, recorder: SessionRecorder, accounting: SessionAccounting, mode: Mode = "off") -> None:
        self.mode = mode
        self.agreed = False
        self.unavailable = ScanMap()
        self.refused = 0
        self._fetched: list[bytes] = []
        self._recorder = recorder
        self._accounting = accounting
        self._boot = accounting.session.boot
        self._open: dict[tuple[int, int], _OpenRequest] = {}  # by first number and mask of the scans
        self._archive: dict[int, bytes] = {}  # parts by number from 1
        self._summary: tuple[int, int, int, bytes] | None = None  # first, last, count, hash
        self._summary_ns: int | None = None  # time of the latest request for it
        self._summary_pending = False
        self._archive_tries = 0
        self._papers_ns = 0  # earliest time of the next request for papers, after invalid ones
        self._usable_groups: set[str] = set()  # sensor groups with usable samples in some scan
        self._papers_outdated = False  # a group has joined since the papers came
        self._papers_again_ns = 0  # earliest time of the next request for outdated papers
        self._progress_ns = 0
        self._next_search_ns = 0
        self._cursor: int | None = None  # every scan before it is complete or unavailable
        self._final_papers = False  # requested after all scans had come
        for number in recorder.journal.received:  # before a restart of this ground station
            accounting.see(number)
            accounting.received.add(number)
        for number in recorder.journal.complete:
            accounting.see(number)
            accounting.backfilled.add(number)

    # ------------------------------------------------------------------------------------------ requests

    def due(self, now_ns: int) -> list[Request]:
        """Messages to send now: name, and fields without the target."""
        messages = []
        for key, request in self._open.items():
            if now_ns - request.sent_ns >= request.retry_ns:
                request.sent_ns, request.flowing = now_ns, False
                request.retry_ns = min(MAX_RETRY_NS, max(RETRY_NS, request.retry_ns * 2))
                messages.append(self._request(key, request.missing()))
        room = WINDOW - len(self._open)
        if room > 0 and not messages and now_ns >= self._next_search_ns:
            for key in self._next_wanted(room, now_ns):
                if key not in self._open:
                    self._open[key] = _OpenRequest(now_ns)
                    messages.append(self._request(key, _ALL_FRAGMENTS))
            if not messages:
                self._next_search_ns = now_ns + SEARCH_NS
        summary_due = self._summary_ns is None or now_ns - self._summary_ns >= SUMMARY_NS
        if self.mode == "all" and not self.agreed and not self._open and summary_due:
            self._summary_ns, self._summary_pending = now_ns, True
            messages.append(("BACKFILL_SUMMARY_REQUEST", {"through_number": LAST_NUMBER, "boot": self._boot}))
        return messages

    def _request(self, key: tuple[int, int], fragments: int) -> Request:
        first, mask = key
        fields = {"first_number": first, "wanted": mask, "fragments": fragments, "boot": self._boot}
        return "BACKFILL_REQUEST", fields

    def _next_wanted(self, room: int, now_ns: int) -> list[tuple[int, int]]:
        """First number and mask of at most `room` further requests: papers (0, 0), parts of the archive (n, 0), or scans."""
        if self._recorder.papers is None and now_ns >= self._papers_ns:
            return [(0, 0)]
        if self._papers_outdated and now_ns >= self._papers_again_ns:
            self._papers_outdated, self._papers_again_ns = False, now_ns + PAPERS_AGAIN_NS
            return [(0, 0)]
        if self.mode == "all" and now_ns >= self._papers_ns and self._archive_tries < _ARCHIVE_TRIES:
            parts = (self._recorder.archive_bytes + PAPERS_PART_BYTES - 1) // PAPERS_PART_BYTES
            missing = [(part, 0) for part in range(1, parts + 1) if part not in self._archive]
            if missing:
                return [key for key in missing if key not in self._open][:room]
        if self.mode == "off":
            return []
        pending = {first + i for first, mask in self._open for i in range(SPAN) if mask >> i & 1}
        return group_numbers(self._wanted_numbers(pending), room)

    def _wanted_numbers(self, pending: set[int]) -> Iterable[int]:
        """Numbers of scans to request, ascending. pending: those of open requests."""
        if self.mode == "lost":
            not_on_disk = self.not_on_disk().ranges()
            ranges = sorted([*self._accounting.totals().missing, *not_on_disk])
            candidates: Iterable[int] = (n for a, b in ranges for n in range(a, b + 1))
        elif self._summary is None:
            return
        else:
            candidates = self._from_cursor(*self._summary[:2])
        complete = self._recorder.journal.complete
        for n in candidates:
            if n not in pending and n not in self.unavailable and n not in complete:
                yield n

    def not_on_disk(self) -> ScanMap:
        """Received scans that the disk has lost or never took: the aircraft may still have them."""
        journal = self._recorder.journal
        return self._accounting.received.minus(journal.received).minus(journal.complete)

    def look_after(self) -> None:
        """Request complete scans again that the disk has lost. Call it now and then."""
        complete = self._recorder.journal.complete
        if len(complete) < len(self._accounting.backfilled):
            self._accounting.backfilled = self._accounting.backfilled.both(complete)
            self._cursor, self.agreed = None, False

    def _from_cursor(self, first: int, last: int) -> Iterable[int]:
        """Numbers from the first scan that is neither complete nor unavailable; the cursor saves a search from `first`."""
        complete = self._recorder.journal.complete
        number = first if self._cursor is None else max(first, self._cursor)
        while number <= last and (number in complete or number in self.unavailable):
            number += 1
        self._cursor = number
        return range(number, last + 1)

    # ------------------------------------------------------------------------------------------ answers

    def note_sensors(self, groups: Mapping[str, GroupStatus]) -> None:
        """Note the usable sensor groups of a scan: of a new one, the aircraft now knows facts that the papers lack."""
        joined = {group for group, sample in groups.items() if sample.state.usable} - self._usable_groups
        if joined:
            self._usable_groups |= joined
            self._papers_outdated = True

    def take_data(self, f: Mapping[str, Any], now_ns: int) -> None:
        """Use the fields of a BACKFILL_DATA."""
        key = (f["first_number"], f["wanted"])
        request = self._open.get(key)
        if request is None:
            return
        if f["fragments"] == 0:
            self._finish(key, b"", now_ns)
            return
        if f["length"] > len(f["data"]) or f["fragment"] >= f["fragments"]:
            return
        if (request.checksum, request.total) != (f["checksum"], f["fragments"]):
            request.checksum, request.total = f["checksum"], f["fragments"]
            request.fragments.clear()
        request.fragments[f["fragment"]] = bytes(f["data"][: f["length"]])
        self._note_flow(request, now_ns)
        if len(request.fragments) == request.total:
            data = b"".join(request.fragments[i] for i in range(request.total))
            if zlib.crc32(data) == request.checksum:
                self._finish(key, data, now_ns)
            else:
                request.fragments.clear()

    def take_fetched(self) -> list[bytes]:
        """Scans that have come since the last call, in the aircraft's encoding."""
        fetched, self._fetched = self._fetched, []
        return fetched

    def _note_flow(self, served: _OpenRequest, now_ns: int) -> None:
        """Set the times of all open requests by a fragment of one: the aircraft serves them one after another.

        Another request that had fragments before is over, and its missing fragments are lost; one without any still waits.
        """
        for request in self._open.values():
            if request is served:
                request.sent_ns, request.retry_ns, request.flowing = now_ns, RETRY_NS, True
            elif request.flowing:
                request.retry_ns = 0
            else:
                request.sent_ns = now_ns

    def _finish(self, key: tuple[int, int], data: bytes, now_ns: int) -> None:
        """Close a request and use its complete answer."""
        del self._open[key]
        first, mask = key
        if mask:
            self._take_scans({first + i for i in range(SPAN) if mask >> i & 1}, data)
        elif first:
            self._take_archive(first, data, now_ns)
        elif not self._recorder.take_papers(data):
            self._refuse(now_ns, invalid=bool(data))  # an empty answer: the logger has no recording yet

    def _refuse(self, now_ns: int, *, invalid: bool) -> None:
        """Delay the next request, since invalid answers may come at any rate."""
        self.refused += invalid
        self._papers_ns = now_ns + RETRY_NS

    def _take_scans(self, requested: set[int], data: bytes) -> None:
        """Record the requested scans of an answer that fit number and time of the session; the others are unavailable."""
        for encoded in unpack_scans(data):
            try:
                scan = decode_scan(encoded)
            except ScanDecodeError:
                continue
            if scan.number in requested and self._accounting.fits(scan.number, scan.time_monotonic_ns):
                self._recorder.complete(encoded)
                self._fetched.append(encoded)
                requested.discard(scan.number)
                self._accounting.see(scan.number)
                self._accounting.backfilled.add(scan.number)
        for number in requested:
            self.unavailable.add(number)

    def _take_archive(self, part: int, data: bytes, now_ns: int) -> None:
        """Store a part of the archive; with the last one, check and record it."""
        papers = self._recorder.papers
        if papers is None:
            return
        self._archive[part] = data
        if len(self._archive) * PAPERS_PART_BYTES < papers.archive_bytes:
            return
        archive = b"".join(self._archive[i] for i in sorted(self._archive))
        if hashlib.sha256(archive).hexdigest() != papers.archive_sha256 or not self._recorder.take_archive(archive):
            self._archive.clear()  # a part or the papers came from another sender
            self._archive_tries += 1
            self._refuse(now_ns, invalid=True)

    def take_summary(self, f: Mapping[str, Any]) -> None:
        """Use the fields of a requested BACKFILL_SUMMARY; decides whether air and ground agree."""
        if not self._summary_pending:
            return
        self._summary_pending = False
        summary = (f["first_number"], f["last_number"], f["count"], bytes(f["sha256"]))
        if summary != self._summary:
            self._summary = summary
            self._next_search_ns = 0
        if not f["count"] or self._open:
            return
        journal = self._recorder.journal
        complete = journal.complete.count_within(summary[0], summary[1])
        if complete != f["count"]:
            return
        if not self._final_papers:
            self._final_papers = True  # events may have been added since the first papers
            self._open[(0, 0)] = _OpenRequest(0, 0)
            return
        digest = hashlib.sha256()
        for data in journal.scans(complete_only=True):
            digest.update(_LENGTH.pack(len(data)) + data)
        self.agreed = digest.digest() == summary[3]

    def progress(self, now_ns: int) -> ev.BackfillProgress | None:
        """Progress every PROGRESS_NS in modes `lost` and `all`; else None."""
        if self.mode == "off" or now_ns - self._progress_ns < PROGRESS_NS:
            return None
        self._progress_ns = now_ns
        complete = len(self._recorder.journal.complete)
        total = self._summary[2] if self._summary else complete + len(self._open)
        return ev.BackfillProgress(self._accounting.session, complete, total, self.agreed, now_ns)


def unpack_scans(data: bytes) -> list[bytes]:
    """The encoded scans of a backfill answer; empty for invalid bytes."""
    decompressor = zlib.decompressobj()
    try:
        rows = decompressor.decompress(data, _MAX_ANSWER)
    except zlib.error:
        return []
    scans: list[bytes] = []
    offset = 0
    while offset + _LENGTH.size <= len(rows):
        (size,) = _LENGTH.unpack_from(rows, offset)
        offset += _LENGTH.size
        if offset + size > len(rows) or size > _MAX_SCAN_BYTES:
            return scans
        scans.append(rows[offset : offset + size])
        offset += size
    return scans
