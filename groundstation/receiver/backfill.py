"""The asking side of backfill: which scans are wanted, requests until they are here, and the proof that all are.

Answers are the aircraft's own encoded scans, compressed and cut into fragments; lost fragments are asked for again.
Everything that arrives goes to the session's journal, so an interrupted backfill goes on where it was. It is over
when count and SHA-256 of all scans, as the aircraft gives them, equal those of the scans held here.
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
from groundstation.receiver.link_accounting import SessionAccounting
from groundstation.receiver.storage.recording import SessionRecorder
from groundstation.receiver.timeline import NS

Mode = Literal["off", "lost", "all"]
Request = tuple[str, dict[str, Any]]

WINDOW = 4
MAX_WANTED = 24
SPAN = 64
RETRY_NS = 2 * NS
MAX_RETRY_NS = 16 * NS
SUMMARY_NS = 2 * NS
PROGRESS_NS = NS
LOOK_NS = NS // 2
PAPERS_AGAIN_NS = 10 * NS
"""Between requests for papers because a sensor has joined: they are some 2 % of what the radio carries in that time."""
PAPERS_PART_BYTES = 8192
_ALL_FRAGMENTS = 2**64 - 1
_MAX_ANSWER = 1 << 20
_ARCHIVE_TRIES = 3  # then scans are fetched without: an archive that never fits must not stand before them
_MAX_SCAN_BYTES = 4096
"""Of one encoded scan; the largest there can be has 466."""
_LENGTH = struct.Struct("<I")
_LAST = 2**32 - 1


@dataclass
class _Open:
    """A request under way."""

    asked_ns: int
    retry_ns: int = RETRY_NS
    checksum: int | None = None
    total: int | None = None
    have: dict[int, bytes] = field(default_factory=dict)
    flowing: bool = False  # fragments have come since it was asked

    def missing(self) -> int:
        if self.total is None:
            return _ALL_FRAGMENTS
        return sum(1 << i for i in range(self.total) if i not in self.have)


def group_numbers(numbers: Iterable[int], limit: int) -> list[tuple[int, int]]:
    """Scan numbers as at most `limit` (first, mask) requests of up to 24 scans within 64."""
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
    def __init__(self, recorder: SessionRecorder, accounting: SessionAccounting, mode: Mode = "off") -> None:
        self.mode = mode
        self.agreed = False
        self.unavailable = ScanMap()
        self._fetched: list[bytes] = []
        self.refused = 0  # papers and archives that were none
        self._recorder = recorder
        self._accounting = accounting
        self._boot = accounting.session.boot
        self._open: dict[tuple[int, int], _Open] = {}
        self._archive: dict[int, bytes] = {}  # parts by number, as many as the papers say there are
        self._summary: tuple[int, int, int, bytes] | None = None  # first, last, count, hash
        self._summary_ns: int | None = None
        self._summary_asked = False  # and not answered yet
        self._archive_tries = 0
        self._papers_ns = 0  # when to ask for papers again, after such that were none
        self._usable: set[str] = set()  # groups that were in order in some scan
        self._papers_again = False  # one has joined since the papers came
        self._papers_again_ns = 0
        self._progress_ns = 0
        self._look_ns = 0  # nothing was wanted: when to look again
        self._cursor: int | None = None  # every scan before it is held, or cannot be had
        self._final_papers = False
        for number in recorder.journal.received:  # by this ground station before it was started again
            accounting.see(number)
            accounting.received.add(number)
        for number in recorder.journal.complete:
            accounting.see(number)
            accounting.backfilled.add(number)

    # ------------------------------------------------------------------------------------------ asking

    def due(self, now_ns: int) -> list[Request]:
        """Messages to send now (name, fields without targets)."""
        messages = []
        for key, request in self._open.items():
            if now_ns - request.asked_ns >= request.retry_ns:
                request.asked_ns, request.flowing = now_ns, False
                request.retry_ns = min(MAX_RETRY_NS, max(RETRY_NS, request.retry_ns * 2))
                messages.append(self._request(key, request.missing()))
        room = WINDOW - len(self._open)
        if room > 0 and not messages and now_ns >= self._look_ns:
            for key in self._next_wanted(room, now_ns):
                if key not in self._open:
                    self._open[key] = _Open(now_ns)
                    messages.append(self._request(key, _ALL_FRAGMENTS))
            if not messages:
                self._look_ns = now_ns + LOOK_NS
        summary_due = self._summary_ns is None or now_ns - self._summary_ns >= SUMMARY_NS
        if self.mode == "all" and not self.agreed and not self._open and summary_due:
            self._summary_ns, self._summary_asked = now_ns, True
            messages.append(("BACKFILL_SUMMARY_REQUEST", {"through_number": _LAST, "boot": self._boot}))
        return messages

    def _request(self, key: tuple[int, int], fragments: int) -> Request:
        first, mask = key
        fields = {"first_number": first, "wanted": mask, "fragments": fragments, "boot": self._boot}
        return "BACKFILL_REQUEST", fields

    def _next_wanted(self, room: int, now_ns: int) -> list[tuple[int, int]]:
        if self._recorder.papers is None and now_ns >= self._papers_ns:
            return [(0, 0)]
        if self._papers_again and now_ns >= self._papers_again_ns:
            self._papers_again, self._papers_again_ns = False, now_ns + PAPERS_AGAIN_NS
            return [(0, 0)]
        if self.mode == "all" and now_ns >= self._papers_ns and self._archive_tries < _ARCHIVE_TRIES:
            parts = (self._recorder.archive_bytes + PAPERS_PART_BYTES - 1) // PAPERS_PART_BYTES
            missing = [(i + 1, 0) for i in range(parts) if i + 1 not in self._archive]
            if missing:
                return missing[:room]
        if self.mode == "off":
            return []
        busy = {first + i for first, mask in self._open for i in range(SPAN) if mask >> i & 1}
        return group_numbers(self._wanted_numbers(busy), room)

    def _wanted_numbers(self, busy: set[int]) -> Iterable[int]:
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
            if n not in busy and n not in self.unavailable and n not in complete:
                yield n

    def not_on_disk(self) -> ScanMap:
        """Scans that came down and that the disk has lost or never took: the aircraft may still have them."""
        journal = self._recorder.journal
        return self._accounting.received.minus(journal.received).minus(journal.complete)

    def look_after(self) -> None:
        """Called now and then: where the disk has lost scans that were held in full, they are wanted again."""
        complete = self._recorder.journal.complete
        if len(complete) < len(self._accounting.backfilled):
            self._accounting.backfilled = self._accounting.backfilled.both(complete)
            self._cursor, self.agreed = None, False

    def _from_cursor(self, first: int, last: int) -> Iterable[int]:
        """Numbers from the first that is neither held nor given up; a long flight is not gone through again."""
        complete = self._recorder.journal.complete
        number = first if self._cursor is None else max(first, self._cursor)
        while number <= last and (number in complete or number in self.unavailable):
            number += 1
        self._cursor = number
        return range(number, last + 1)

    # ------------------------------------------------------------------------------------------ answers

    def see_sensors(self, groups: Mapping[str, GroupStatus]) -> None:
        """Look at a scan's groups: of one that joins, the aircraft has facts now that the papers did not have."""
        joined = {group for group, sample in groups.items() if sample.state.usable} - self._usable
        if joined:
            self._usable |= joined
            self._papers_again = True

    def take_data(self, f: Mapping[str, Any], now_ns: int) -> None:
        key = (f["first_number"], f["wanted"])
        o = self._open.get(key)
        if o is None:
            return
        if f["fragments"] == 0:
            self._finish(key, b"", now_ns)
            return
        if f["length"] > len(f["data"]) or f["fragment"] >= f["fragments"]:
            return
        if (o.checksum, o.total) != (f["checksum"], f["fragments"]):
            o.checksum, o.total = f["checksum"], f["fragments"]
            o.have.clear()
        o.have[f["fragment"]] = bytes(f["data"][: f["length"]])
        self._note_flow(o, now_ns)
        if len(o.have) == o.total:
            data = b"".join(o.have[i] for i in range(o.total))
            if zlib.crc32(data) == o.checksum:
                self._finish(key, data, now_ns)
            else:
                o.have.clear()

    def take_fetched(self) -> list[bytes]:
        """Scans that have come since the last call, in the aircraft's own bytes."""
        fetched, self._fetched = self._fetched, []
        return fetched

    def _note_flow(self, now_served: _Open, now_ns: int) -> None:
        """The aircraft serves requests one after another: what flows now tells of the others.

        A request whose fragments had been coming is over, and what it lacks was lost; one that has not begun waits.
        """
        for o in self._open.values():
            if o is now_served:
                o.asked_ns, o.retry_ns, o.flowing = now_ns, RETRY_NS, True
            elif o.flowing:
                o.retry_ns = 0
            else:
                o.asked_ns = now_ns

    def _finish(self, key: tuple[int, int], data: bytes, now_ns: int) -> None:
        del self._open[key]
        first, mask = key
        if mask:
            self._take_scans({first + i for i in range(SPAN) if mask >> i & 1}, data)
        elif first:
            self._take_archive(first, data, now_ns)
        elif not self._recorder.take_papers(data):
            self._refuse(now_ns, bool(data))  # an empty answer: the logger has no recording yet

    def _refuse(self, now_ns: int, unsound: bool) -> None:
        """Ask again, but not at the pace at which nonsense can be answered."""
        self.refused += unsound
        self._papers_ns = now_ns + RETRY_NS

    def _take_scans(self, requested: set[int], data: bytes) -> None:
        for encoded in unpack_scans(data):
            try:
                scan = decode_scan(encoded)
            except ScanDecodeError:
                continue
            # only one that was asked for, and that can have been made when it says
            if scan.number in requested and self._accounting.fits(scan.number, scan.time_monotonic_ns):
                self._recorder.complete(encoded)
                self._fetched.append(encoded)
                requested.discard(scan.number)
                self._accounting.see(scan.number)
                self._accounting.backfilled.add(scan.number)
        # What the aircraft left out of a sound answer it does not have (any more).
        for number in requested:
            self.unavailable.add(number)

    def _take_archive(self, part: int, data: bytes, now_ns: int) -> None:
        papers = self._recorder.papers
        if papers is None:
            return
        self._archive[part] = data
        if len(self._archive) * PAPERS_PART_BYTES < papers.archive_bytes:
            return
        archive = b"".join(self._archive[i] for i in sorted(self._archive))
        if hashlib.sha256(archive).hexdigest() != papers.archive_sha256 or not self._recorder.take_archive(archive):
            self._archive.clear()  # some part was not the aircraft's, or the papers were not
            self._archive_tries += 1
            self._refuse(now_ns, True)

    def take_summary(self, f: Mapping[str, Any]) -> None:
        """Use a BACKFILL_SUMMARY that was asked for; decides whether air and ground agree."""
        if not self._summary_asked:
            return
        self._summary_asked = False
        summary = (f["first_number"], f["last_number"], f["count"], bytes(f["sha256"]))
        if summary != self._summary:
            self._summary = summary
            self._look_ns = 0
        if not f["count"] or self._open:
            return
        journal = self._recorder.journal
        complete = journal.complete.count_within(summary[0], summary[1])
        if complete != f["count"]:
            return
        if not self._final_papers:
            self._final_papers = True  # events may have been added since the papers came first
            self._open[(0, 0)] = _Open(0, 0)
            return
        digest = hashlib.sha256()
        for data in journal.scans(complete_only=True):
            digest.update(_LENGTH.pack(len(data)) + data)
        self.agreed = digest.digest() == summary[3]

    def progress(self, now_ns: int) -> ev.BackfillProgress | None:
        """A report of progress about once a second while there is anything to do; None otherwise."""
        if self.mode == "off" or now_ns - self._progress_ns < PROGRESS_NS:
            return None
        self._progress_ns = now_ns
        complete = len(self._recorder.journal.complete)
        total = self._summary[2] if self._summary else complete + len(self._open)
        return ev.BackfillProgress(self._accounting.session, complete, total, self.agreed, now_ns)


def unpack_scans(data: bytes) -> list[bytes]:
    """The encoded scans of a backfill answer; empty for bytes that are none."""
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
