"""Received scans as a raw recording, in the very format the logger writes, so that one calibration path serves both.

While scans come in they go to a `SessionLog`; `write` makes the MCAP file from it at the end, after backfill, or whenever
asked. Complete scans (backfilled) are written in the aircraft's own bytes. The link's quality is a topic of its own.
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
"""Origin of events that the ground station itself adds to a recording."""
MAX_NOTES = 100

_LINK_FIELDS = (
    "time_monotonic_s",
    *(f.name for f in fields(ev.LinkStatistics) if f.name not in ("session", "received_ns")),
)
_LINK_ALWAYS = ("time_monotonic_s", "loss", "scan_rate_hz")


class ReceivedWriter(RecordingWriter):
    """A recording with the link's quality added as JSON messages."""

    def __init__(self, stream: IO[bytes], info: RecordingInfo, log_time: LogTime) -> None:
        super().__init__(stream, info, log_time=log_time)
        properties = {n: {"type": ["number", "null"]} for n in _LINK_FIELDS}
        schema = json.dumps({"type": "object", "properties": properties}).encode()
        schema_id = self._writer.register_schema(LINK_SCHEMA, "jsonschema", schema)
        self._channels[LINK_TOPIC] = self._writer.register_channel(LINK_TOPIC, "json", schema_id)

    def write_link(self, data: bytes, time_ns: int, sequence: int) -> None:
        self.write(RecordedMessage(LINK_TOPIC, time_ns, time_ns + self.log_time.offset_ns, sequence, data))


def link_json(report: ev.LinkStatistics, aircraft_ns: int) -> bytes:
    """A link report as the topic carries it, on the aircraft's time scale."""
    values = {k: v for k, v in asdict(report).items() if k in _LINK_FIELDS}
    return json.dumps({"time_monotonic_s": aircraft_ns * 1e-9, **values}).encode()


def read_link(path: Path) -> list[dict[str, Any]]:
    """Link reports of a received recording, as `link_json` made them; those that are intact. Empty for other files."""
    from daq.contract.recordings.recording import RecordingError
    from daq.contract.recordings.segments import read_parts

    try:
        reports = [data for part in read_parts(path) for data in part.auxiliary.get(LINK_TOPIC, ())]
    except RecordingError:
        return []
    return [report for report in map(_link_report, reports) if report is not None]


def _link_report(data: bytes) -> dict[str, Any] | None:
    """A link report with all its fields; None for JSON that is none."""
    try:
        report = json.loads(data)
        values = {name: None if report[name] is None else float(report[name]) for name in _LINK_FIELDS}
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None
    return None if any(values[name] is None for name in _LINK_ALWAYS) else values


class SessionRecorder:
    """Keeps one session in a folder: `<name>.journal` while it goes on, `<name>.mcap` when written."""

    def __init__(self, folder: Path, session: ev.Session) -> None:
        self.session = session
        self.path = folder / f"{session.name}.mcap"
        self.journal = SessionLog(folder / f"{session.name}.journal")
        self._last_ns = self._last_number = 0
        self._events: set[bytes] = set(self.journal.others(RecordKind.EVENT))
        self._notes: list[bytes] = list(self.journal.others(RecordKind.NOTE))[-MAX_NOTES:]
        self.papers: Papers | None = None
        archive = self.journal.last(RecordKind.ARCHIVE)
        self._attachments = None if archive is None else parse_archive(archive)
        papers = self.journal.last(RecordKind.PAPERS)
        if papers is not None:
            self.take_papers(papers)

    def scan(self, event: ev.ScanReceived) -> None:
        """Keep a scan."""
        self.journal.add_received(event.scan)
        self._last_ns, self._last_number = event.scan.time_monotonic_ns, event.scan.number

    def event(self, marked: ev.EventMarked) -> bool:
        """Keep an event, once; False when there have been too many."""
        data = encode(EventMessage(marked.time_monotonic_ns, 0, marked.number, marked.origin, marked.text))
        if data in self._events:
            return True
        if len(self._events) >= MAX_EVENTS:
            return False
        self._events.add(data)
        self.journal.add(RecordKind.EVENT, data)
        return True

    def note(self, text: str) -> None:
        """Keep an event of the reception itself, at the time of the last scan; of very many the first ones."""
        if len(self._notes) < MAX_NOTES:
            data = encode(EventMessage(self._last_ns, 0, self._last_number, RECEIVER, text))
            self._notes.append(data)
            self.journal.add(RecordKind.NOTE, data)

    def link(self, report: ev.LinkStatistics) -> None:
        if self._last_ns:
            self.journal.add(RecordKind.LINK, link_json(report, self._last_ns))

    def complete(self, data: bytes) -> int | None:
        """Keep a scan in the aircraft's own bytes; its number, or None when the bytes are no scan."""
        return self.journal.add_complete(data)

    def take_papers(self, data: bytes) -> bool:
        """Use the recording's identity; False when the bytes are none."""
        papers = parse_papers(data)
        if papers is None:
            return False
        if papers != self.papers:
            self.papers = papers
            self.journal.add(RecordKind.PAPERS, data)
        # The papers have every event in full; what came down as it happened may be shortened.
        if papers.events:
            self._events = {encode(e) for e in papers.marks()}
        return True

    def take_archive(self, data: bytes) -> bool:
        """Keep the attachments of the recording; False when the bytes are none."""
        attachments = parse_archive(data)
        if attachments is None:
            return False
        self._attachments = attachments
        self.journal.add(RecordKind.ARCHIVE, data)
        return True

    @property
    def archive_bytes(self) -> int:
        """Size of the attachments as the papers give it; 0 when there are none, or they are here already."""
        if self.papers is None or self._attachments is not None:
            return 0
        return self.papers.archive_bytes

    def state(self, received: ScanMap) -> tuple[int, int]:
        """Scans in the journal on the disk, and of those received so many that are not in it."""
        on_disk = self.journal.on_disk
        return on_disk, len(
            received.minus(self.journal.received).minus(self.journal.complete)
        ) + self.journal.scans_waiting

    def info(self) -> RecordingInfo:
        """Identity of the recording, as far as the aircraft has told."""
        attachments = self._attachments or {}
        if self.papers is None:
            return RecordingInfo(self.session.name, UNKNOWN_SOURCE, role="received", attachments=attachments)
        return self.papers.info(attachments)

    @property
    def has_scans(self) -> bool:
        return bool(len(self.journal.complete) or len(self.journal.received))

    def write(self, path: Path | None = None) -> Path | None:
        """Write the recording to `path` (default: beside the journal); None when no scan has come."""
        path = path or self.path
        if not self.has_scans:
            return None
        with replacing(path) as new:
            self._write(new)
        return path

    def _write(self, path: Path) -> None:
        stamps = [e._replace(data=b"") for e in self._scan_entries()]
        odd = out_of_line((e.sequence, e.log_time_ns) for e in stamps)
        notes = self._notes
        if odd:
            text = f"{len(odd)} scans left out: their time contradicts their number"
            notes = [*notes, encode(EventMessage(self._last_ns, 0, self._last_number, RECEIVER, text))]
        with path.open("wb") as stream:
            writer = ReceivedWriter(stream, self.info(), utc_of(e for e in stamps if e.sequence not in odd))
            for entry in self._scan_entries(odd):
                writer.write(entry)
            for event in sorted(_decoded([*self._events, *notes]), key=lambda e: e.time_monotonic_ns):
                writer.write(message_entry(event))
            for i, link in enumerate(self.journal.others(RecordKind.LINK)):
                writer.write_link(link, round(json.loads(link)["time_monotonic_s"] * 1e9), i)
            writer.finish()

    def _scan_entries(self, odd: Container[int] = ()) -> Iterator[RecordedMessage]:
        entries = (entry_of(SCAN_TOPIC, data) for data in self.journal.scans())
        return (e for e in entries if e.sequence not in odd)

    def close(self) -> None:
        self.journal.close()


def out_of_line(scans: Iterable[tuple[int, int]]) -> set[int]:
    """Numbers of the fewest scans without which time rises with the number: a sender's, for a logger's clock never goes back.

    scans: number and time [ns] of each. Whoever reads a recording takes others for a second session in it.
    """
    ordered = sorted(scans)
    if all(a[1] < b[1] for a, b in pairwise(ordered)):
        return set()
    ends: list[int] = []  # by length: the earliest time at which a rising run of that length ends, and its scan
    last: list[int] = []
    before: list[int] = []
    for index, (_, time_ns) in enumerate(ordered):
        place = bisect_left(ends, time_ns)
        before.append(last[place - 1] if place else -1)
        ends[place : place + 1], last[place : place + 1] = [time_ns], [index]
    in_line, index = set[int](), last[-1]
    while index >= 0:
        in_line.add(index)
        index = before[index]
    return {number for index, (number, _) in enumerate(ordered) if index not in in_line}


def _decoded(events: Iterable[bytes]) -> list[EventMessage]:
    messages = []
    for data in events:
        try:
            messages.append(decode(EVENT_TOPIC, data))
        except MessageError:
            continue
    return messages
