"""Received scans as a raw recording in the logger's format, so that the same calibration serves both.

Received scans go to a `SessionLog`; `write` makes the MCAP file from it, at the end or at any time. Complete scans (by backfill)
are written as the aircraft encoded them. The link's quality has its own topic.
"""

import json
from bisect import bisect_left
from collections.abc import Container, Iterable, Iterator
from dataclasses import asdict, fields
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

from daq.contract.link.scan_map import ScanMap
from daq.contract.recordings.messages import EVENT_TOPIC, EventMessage, MessageError, decode, encode
from daq.contract.recordings.recording import (
    LogTime,
    RecordedMessage,
    RecordingInfo,
    RecordingWriter,
    entry_of,
    message_entry,
    utc_of,
)
from daq.contract.scan import SCAN_TOPIC
from daq.utilities.durable import replacing
from groundstation.receiver import events as ev
from groundstation.receiver.storage.papers import MAX_EVENTS, Papers, parse_archive, parse_papers
from groundstation.receiver.storage.session_log import RecordKind, SessionLog

LINK_TOPIC = "/link"
LINK_SCHEMA = "sideslip.Link"
UNKNOWN_SOURCE = "unknown"
RECEIVER = "receiver"
"""Origin of events that the ground station adds to a recording."""
MAX_NOTES = 100  # such events

_LINK_FIELDS = (
    "time_monotonic_s",
    *(f.name for f in fields(ev.LinkStatistics) if f.name not in ("session", "received_ns")),
)
_LINK_REQUIRED = ("time_monotonic_s", "loss", "scan_rate_hz")  # never null


class ReceivedWriter(RecordingWriter):
    """A recording with the link's quality added as JSON messages."""

    def __init__(self, stream: IO[bytes], info: RecordingInfo, log_time: LogTime) -> None:
        super().__init__(stream, info, log_time=log_time)
        properties = {n: {"type": ["number", "null"]} for n in _LINK_FIELDS}
        schema = json.dumps({"type": "object", "properties": properties}).encode()
        schema_id = self._writer.register_schema(LINK_SCHEMA, "jsonschema", schema)
        self._channels[LINK_TOPIC] = self._writer.register_channel(LINK_TOPIC, "json", schema_id)

    def write_link(self, data: bytes, time_ns: int, sequence: int) -> None:
        """Add a link report, as of `link_json`. time_ns: on the aircraft's clock."""
        self.write(RecordedMessage(LINK_TOPIC, time_ns, time_ns + self.log_time.offset_ns, sequence, data))


def link_json(report: ev.LinkStatistics, aircraft_ns: int) -> bytes:
    """A link report as JSON for its topic. aircraft_ns: its time on the aircraft's clock."""
    values = {k: v for k, v in asdict(report).items() if k in _LINK_FIELDS}
    return json.dumps({"time_monotonic_s": aircraft_ns * 1e-9, **values}).encode()


def read_link(path: Path) -> list[dict[str, Any]]:
    """The intact link reports of a received recording, as of `link_json`; empty for other files."""
    from daq.contract.recordings.recording import RecordingError
    from daq.contract.recordings.segments import read_parts

    try:
        reports = [data for part in read_parts(path) for data in part.auxiliary.get(LINK_TOPIC, ())]
    except RecordingError:
        return []
    return [report for report in map(_link_report, reports) if report is not None]


def _link_report(data: bytes) -> dict[str, Any] | None:
    """A link report with all its fields; None for invalid JSON."""
    try:
        report = json.loads(data)
        values = {name: None if report[name] is None else float(report[name]) for name in _LINK_FIELDS}
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None
    return None if any(values[name] is None for name in _LINK_REQUIRED) else values


class SessionRecorder:
    """Stores one session in a folder: `<name>.journal` while it lasts, and `<name>.mcap` when written. papers: None before they
    came."""

    def __init__(self, folder: Path, session: ev.Session) -> None:
        self.session = session
        self.path = folder / f"{session.name}.mcap"
        self.journal = SessionLog(folder / f"{session.name}.journal")
        self._last_ns = self._last_number = 0
        self._events: set[bytes] = set(self.journal.records_of(RecordKind.EVENT))
        self._notes: list[bytes] = list(self.journal.records_of(RecordKind.NOTE))[-MAX_NOTES:]
        self.papers: Papers | None = None
        archive = self.journal.last(RecordKind.ARCHIVE)
        self._attachments = None if archive is None else parse_archive(archive)
        papers = self.journal.last(RecordKind.PAPERS)
        if papers is not None:
            self.take_papers(papers)

    def scan(self, event: ev.ScanReceived) -> None:
        """Record a received scan. Raises OSError, as the other methods that record do."""
        self.journal.add_received(event.scan)
        self._last_ns, self._last_number = event.scan.time_monotonic_ns, event.scan.number

    def event(self, marked: ev.EventMarked) -> bool:
        """Record an event, once; False where it is refused, since there are too many."""
        data = encode(EventMessage(marked.time_monotonic_ns, 0, marked.number, marked.origin, marked.text))
        if data in self._events:
            return True
        if len(self._events) >= MAX_EVENTS:
            return False
        self._events.add(data)
        self.journal.add(RecordKind.EVENT, data)
        return True

    def note(self, text: str) -> None:
        """Record a text on the reception as an event, at the time of the last scan; the first MAX_NOTES only."""
        if len(self._notes) < MAX_NOTES:
            data = encode(EventMessage(self._last_ns, 0, self._last_number, RECEIVER, text))
            self._notes.append(data)
            self.journal.add(RecordKind.NOTE, data)

    def link(self, report: ev.LinkStatistics) -> None:
        """Record a link report at the time of the last scan; without a scan none."""
        if self._last_ns:
            self.journal.add(RecordKind.LINK, link_json(report, self._last_ns))

    def complete(self, data: bytes) -> int | None:
        """Record a scan as the aircraft encoded it; returns its number, None for invalid bytes."""
        return self.journal.add_complete(data)

    def take_papers(self, data: bytes) -> bool:
        """Use and record the papers; False for invalid bytes."""
        papers = parse_papers(data)
        if papers is None:
            return False
        if papers != self.papers:
            self.papers = papers
            self.journal.add(RecordKind.PAPERS, data)
        # the papers have every event in full; in events from the downlink the text may be cut
        if papers.events:
            self._events = {encode(e) for e in papers.marks()}
        return True

    def take_archive(self, data: bytes) -> bool:
        """Use and record the archive of attachments; False for invalid bytes."""
        attachments = parse_archive(data)
        if attachments is None:
            return False
        self._attachments = attachments
        self.journal.add(RecordKind.ARCHIVE, data)
        return True

    @property
    def archive_bytes(self) -> int:
        """Size of the archive by the papers; 0 without attachments, or where they are here already."""
        if self.papers is None or self._attachments is not None:
            return 0
        return self.papers.archive_bytes

    def state(self, received: ScanMap) -> tuple[int, int]:
        """Number of scans that the journal has on the disk, and of received scans that it has not."""
        missing = received.minus(self.journal.received).minus(self.journal.complete)
        return self.journal.on_disk, len(missing) + self.journal.scans_waiting

    def info(self) -> RecordingInfo:
        """Identity of the recording by the papers; without them the name of the session."""
        attachments = self._attachments or {}
        if self.papers is None:
            return RecordingInfo(self.session.name, UNKNOWN_SOURCE, role="received", attachments=attachments)
        return self.papers.info(attachments)

    @property
    def has_scans(self) -> bool:
        return bool(len(self.journal.complete) or len(self.journal.received))

    def write(self, path: Path | None = None) -> Path | None:
        """Write the recording to `path` (default: beside the journal); returns the path, None before the first scan."""
        path = path or self.path
        if not self.has_scans:
            return None
        with replacing(path) as new:
            self._write(new)
        return path

    def _write(self, path: Path) -> None:
        stamps = [e._replace(data=b"") for e in self._scan_entries()]
        excluded = out_of_line((e.sequence, e.log_time_ns) for e in stamps)
        notes = self._notes
        if excluded:
            text = f"{len(excluded)} scans left out: their time contradicts their number"
            notes = [*notes, encode(EventMessage(self._last_ns, 0, self._last_number, RECEIVER, text))]
        with path.open("wb") as stream:
            writer = ReceivedWriter(stream, self.info(), utc_of(e for e in stamps if e.sequence not in excluded))
            for entry in self._scan_entries(excluded):
                writer.write(entry)
            for event in sorted(_decoded([*self._events, *notes]), key=lambda e: e.time_monotonic_ns):
                writer.write(message_entry(event))
            for i, link in enumerate(self.journal.records_of(RecordKind.LINK)):
                writer.write_link(link, round(json.loads(link)["time_monotonic_s"] * 1e9), i)
            writer.finish()

    def _scan_entries(self, excluded: Container[int] = ()) -> Iterator[RecordedMessage]:
        """The journal's scans in order of number, without those of some numbers."""
        entries = (entry_of(SCAN_TOPIC, data) for data in self.journal.scans())
        return (e for e in entries if e.sequence not in excluded)

    def close(self) -> None:
        self.journal.close()


def out_of_line(scans: Iterable[tuple[int, int]]) -> set[int]:
    """The smallest set of scan numbers without which time rises with the number. A logger's clock never goes back, so these scans
    are another sender's; readers of a recording would take them for a second session.

    scans: number and time [ns] of each. Method: the longest increasing subsequence by patience sorting.
    """
    ordered = sorted(scans)
    if all(a[1] < b[1] for a, b in pairwise(ordered)):
        return set()
    ends: list[int] = []  # by length: earliest time at which an increasing sequence of that length ends
    last: list[int] = []  # and the index of its last scan
    previous: list[int] = []  # by scan: index of its predecessor in such a sequence, -1 for none
    for index, (_, time_ns) in enumerate(ordered):
        length = bisect_left(ends, time_ns)
        previous.append(last[length - 1] if length else -1)
        ends[length : length + 1], last[length : length + 1] = [time_ns], [index]
    in_line, index = set[int](), last[-1]
    while index >= 0:
        in_line.add(index)
        index = previous[index]
    return {number for index, (number, _) in enumerate(ordered) if index not in in_line}


def _decoded(events: Iterable[bytes]) -> list[EventMessage]:
    """The valid ones of encoded events."""
    messages = []
    for data in events:
        try:
            messages.append(decode(EVENT_TOPIC, data))
        except MessageError:
            continue
    return messages
