"""Read raw recordings: one segment, or a directory with all segments of a session.

`read_recording` wants sound data and says where it is not; with `salvage=True` it returns all that is surely right,
together with the list of damages.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from daq.contract.recordings.mcap_records import Attachment, Metadata
from daq.contract.recordings.messages import (
    EVENT_TOPIC,
    HEALTH_TOPIC,
    LOG_TOPIC,
    STATISTICS_TOPIC,
    Event,
    Health,
    LogLine,
    Statistics,
)
from daq.contract.recordings.recording import (
    DECODERS,
    DETAIL_NAME,
    INFO_ATTACHMENT,
    INFO_NAME,
    SCHEMA_OF_TOPIC,
    Entry,
    RecordingError,
    RecordingInfo,
    info_from_metadata,
    metadata_digest,
)
from daq.contract.recordings.salvage import Closed, Damage, Walk
from daq.contract.scan import SCAN_TOPIC, Scan, decode_scan


@dataclass(frozen=True, slots=True)
class Segment:
    """One file, walked through: what is right in it, and where it is damaged."""

    path: Path
    size: int
    info: RecordingInfo | None  # None: the file does not say what it is
    entries: tuple[Entry, ...]
    foreign: Mapping[str, int]  # topics that are not ours -> messages
    damages: tuple[Damage, ...]
    closed: bool
    metadata: tuple[Metadata, ...] = ()

    @property
    def sound(self) -> bool:
        """Whether nothing is damaged and the file was closed in order."""
        return self.closed and not self.damages


@dataclass(frozen=True)
class Recording:
    """A session: entries of all segments in order of time, each message once."""

    path: Path
    info: RecordingInfo
    segments: tuple[Segment, ...]
    entries: tuple[Entry, ...] = field(repr=False)

    def scans(self) -> Iterator[Scan]:
        """The scans in order of their number, decoded one by one."""
        return (decode_scan(e.data) for e in self.entries if e.topic == SCAN_TOPIC)

    @property
    def numbers(self) -> list[int]:
        """Numbers of the scans present, rising."""
        return [e.sequence for e in self.entries if e.topic == SCAN_TOPIC]

    @property
    def events(self) -> tuple[Event, ...]:
        """Event markers in order of time."""
        return tuple(self._decoded(EVENT_TOPIC))

    @property
    def log(self) -> tuple[LogLine, ...]:
        """Log lines in order of time."""
        return tuple(self._decoded(LOG_TOPIC))

    @property
    def statistics(self) -> tuple[Statistics, ...]:
        """Accounting and timing reports in order of time."""
        return tuple(self._decoded(STATISTICS_TOPIC))

    @property
    def health(self) -> tuple[Health, ...]:
        """Sensor health reports in order of time."""
        return tuple(self._decoded(HEALTH_TOPIC))

    @property
    def given_up(self) -> tuple[Segment, ...]:
        """Segments that the logger itself says it left after a write error, writing what was in doubt to the next file.

        Their torn ends are accounted for: no damage of the recording.
        """
        books = self.statistics
        if not books:
            return ()
        numbers = {int(k.removeprefix("abandoned_")) for k in books[-1].extra if k.startswith("abandoned_")}
        return tuple(s for s in self.segments if s.info is not None and s.info.segment in numbers and not s.closed)

    @property
    def damages(self) -> tuple[tuple[Path, Damage], ...]:
        """Damages of all segments but those given up, and the file of each."""
        given_up = self.given_up
        return tuple((s.path, d) for s in self.segments if s not in given_up for d in s.damages)

    def _decoded(self, topic: str) -> Iterator[Any]:
        return (DECODERS[topic](e.data) for e in self.entries if e.topic == topic)


def read_segment(path: Path) -> Segment:
    """Walk through one file. Raises RecordingError when it cannot be opened or is not an MCAP file at all."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror or error})") from error
    if not data:
        raise RecordingError(f"{path}: the file is empty")
    entries: list[Entry] = []
    damages: list[Damage] = []
    attachments: dict[str, bytes] = {}
    metadata: list[Metadata] = []
    foreign: dict[str, int] = {}
    closed = False
    for item in Walk(data):
        match item:
            case Entry():
                if item.topic in SCHEMA_OF_TOPIC:
                    entries.append(item)
                else:
                    foreign[item.topic] = foreign.get(item.topic, 0) + 1
            case Attachment():
                attachments.setdefault(item.name, item.data)
            case Metadata():
                metadata.append(item)
            case Damage():
                damages.append(item)
            case Closed():
                closed = True
    if not (entries or attachments or metadata or foreign) and not data.startswith(b"\x89MCAP"):
        raise RecordingError(f"{path}: not an MCAP file, and nothing of ours in it")
    info = _identity(metadata, attachments)
    return Segment(path, len(data), info, tuple(entries), foreign, tuple(damages), closed, tuple(metadata))


def _identity(metadata: Iterable[Metadata], attachments: Mapping[str, bytes]) -> RecordingInfo | None:
    """Identity from the metadata, or from its copy among the attachments when the metadata is damaged."""
    fields: Mapping[str, str] | None = next((i.fields for i in metadata if i.name == INFO_NAME), None)
    if fields is None and INFO_ATTACHMENT in attachments:
        copy = json.loads(attachments[INFO_ATTACHMENT])
        fields = copy if copy.get("sha256") == metadata_digest(copy) else None
    if fields is None:
        return None
    details = {k: v for i in metadata if i.name == DETAIL_NAME for k, v in i.fields.items() if k != "sha256"}
    info = info_from_metadata(fields)
    own = {k: v for k, v in attachments.items() if k not in (INFO_ATTACHMENT, "channels.json")}
    return replace(info, details={**info.details, **details}, attachments=own)


def segment_paths(path: Path) -> list[Path]:
    """The files of a recording: the file itself, or all .mcap files of a directory in order of name."""
    if not path.exists():
        raise RecordingError(f"{path}: no such file or directory")
    if path.is_file():
        return [path]
    paths = sorted(path.glob("*.mcap"))
    if not paths:
        raise RecordingError(f"{path}: no .mcap files in this directory")
    return paths


def read_segments(path: str | Path) -> list[Segment]:
    """Walk through a file or all files of a directory, sound or not."""
    return [read_segment(p) for p in segment_paths(Path(path))]


def join(path: Path, segments: list[Segment]) -> Recording:
    """One recording of all segments; a message that two segments hold (rewritten after an error) appears once.

    Raises RecordingError when the segments belong to different sessions or hold no raw recording.
    """
    known = [s.info for s in segments if s.info is not None]
    sessions = sorted({i.session for i in known})
    if len(sessions) > 1:
        raise RecordingError(
            f"{path}: recordings of {len(sessions)} sessions ({', '.join(sessions)}); name one of the files"
        )
    entries = unique(e for s in segments for e in s.entries)
    if not known and not entries:
        raise RecordingError(f"{path}: {_why_not_raw(segments)}")
    info = (
        known[0] if known else RecordingInfo(session=path.stem, source="unknown", role="recovered", software="unknown")
    )
    details = {k: v for i in known for k, v in i.details.items()}
    attachments = {k: v for i in reversed(known) for k, v in i.attachments.items()}
    info = replace(info, details=details, attachments=attachments)
    return Recording(path, info, tuple(segments), entries)


def _why_not_raw(segments: list[Segment]) -> str:
    if any(s.foreign or s.metadata for s in segments):
        return "not a raw recording but a calibrated flight or a file of another program"
    if any(s.damages for s in segments):
        return "nothing in it is intact; there is nothing to recover"
    return "not a raw recording of Sideslip"


def unique(entries: Iterable[Entry]) -> tuple[Entry, ...]:
    """Entries in order of time, scans with a number seen before and repeated messages left out."""
    seen: set[tuple[str, int] | tuple[str, bytes]] = set()
    out = []
    for entry in sorted(entries, key=lambda e: e.log_time_ns):
        key = (entry.topic, entry.sequence) if entry.topic == SCAN_TOPIC else (entry.topic, entry.data)
        if key not in seen:
            seen.add(key)
            out.append(entry)
    return tuple(out)


def read_recording(path: str | Path, *, salvage: bool = False) -> Recording:
    """Read a raw recording, a file or a directory of segments.

    Raises RecordingError for anything that is no raw recording and, unless `salvage`, for a damaged one, saying where. A
    file that the logger gave up and continued in the next one does not count as damaged.
    """
    path = Path(path)
    recording = join(path, read_segments(path))
    if salvage:
        return recording
    for damaged, first in recording.damages:
        raise RecordingError(
            f"{damaged}: damaged at byte {first.at_byte} ({first.what}); "
            f"'sideslip recover {damaged} -o OUT.mcap' saves what is intact"
        )
    return recording
