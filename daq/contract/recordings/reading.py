"""Read raw recordings: one segment, or a directory with all segments of a session.

`read_recording` wants sound data and says where it is not; with `salvage=True` it returns all that is surely right,
together with the list of damages. A file may hold several recordings, one behind the other: each part is a segment of
its own, and sessions are never mixed.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from daq.contract.input_files import read_bytes
from daq.contract.plain_words import visible
from daq.contract.recordings.apart import sessions_apart
from daq.contract.recordings.mcap_records import Attachment, Metadata
from daq.contract.recordings.messages import (
    EVENT_TOPIC,
    HEALTH_TOPIC,
    LOG_TOPIC,
    SEQUENCER_TOPIC,
    STATISTICS_TOPIC,
    EventMessage,
    Health,
    LogLine,
    SequencerFrame,
    Statistics,
    decode,
)
from daq.contract.recordings.recording import (
    CHANNELS_ATTACHMENT,
    DETAIL_NAME,
    INFO_ATTACHMENT,
    INFO_NAME,
    SCHEMA_OF_TOPIC,
    RecordedMessage,
    RecordingError,
    RecordingInfo,
    info_from_metadata,
    metadata_digest,
    on_monotonic_clock,
)
from daq.contract.recordings.salvage import Began, Closed, Damage, Item, Walk
from daq.contract.scan import SCAN_TOPIC, Scan, decode_scan

FLIGHT_TOPIC, FLIGHT_METADATA = "/flight", "sideslip.flight"
LINK_TOPIC = "/link"
_KEPT = (FLIGHT_TOPIC, LINK_TOPIC)
"""Topics that are none of a raw recording's, yet ours: calibrated flights, and the link's quality in received recordings."""


@dataclass(frozen=True, slots=True)
class RecordingWalk:
    """One file, walked through: what is right in it, and where it is damaged."""

    path: Path
    size: int
    info: RecordingInfo | None  # None: the file does not say what it is
    entries: tuple[RecordedMessage, ...]
    foreign: Mapping[str, int]  # topics that are not ours -> messages
    damages: tuple[Damage, ...]
    closed: bool
    metadata: tuple[Metadata, ...] = ()
    at_byte: int = 0  # where in the file it begins: not 0 for a second recording in one file
    kept: Mapping[str, tuple[bytes, ...]] = field(
        default_factory=dict
    )  # messages of flights and of link quality by topic
    schemas: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)  # name and definition by topic, for `kept`

    @property
    def empty(self) -> bool:
        """Whether nothing but damage is in it."""
        return not (self.entries or self.metadata or self.foreign or self.info)

    @property
    def number(self) -> int | None:
        """Its number in the session: as it says itself or, where nothing of it is left, as its name does."""
        if self.info is not None:
            return self.info.segment
        ending = self.path.stem.rpartition("_")[2]
        return int(ending) if ending.isdecimal() else None

    @property
    def sound(self) -> bool:
        """Whether nothing is damaged and the file was closed in order."""
        return self.closed and not self.damages


@dataclass(frozen=True)
class Recording:
    """A session: entries of all segments in order of time, each message once."""

    path: Path
    info: RecordingInfo
    segments: tuple[RecordingWalk, ...]
    entries: tuple[RecordedMessage, ...] = field(repr=False)

    def scans(self) -> Iterator[Scan]:
        """The scans in order of their number, decoded one by one."""
        return (decode_scan(e.data) for e in self.entries if e.topic == SCAN_TOPIC)

    @cached_property
    def numbers(self) -> list[int]:
        """Numbers of the scans present, rising."""
        return sorted(e.sequence for e in self.entries if e.topic == SCAN_TOPIC)

    @property
    def events(self) -> tuple[EventMessage, ...]:
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

    @cached_property
    def last_statistics(self) -> Statistics | None:
        """The last accounting report; None without any."""
        return _last_statistics(self.entries)

    @property
    def health(self) -> tuple[Health, ...]:
        """Sensor health reports in order of time."""
        return tuple(self._decoded(HEALTH_TOPIC))

    @property
    def sequencer(self) -> tuple[SequencerFrame, ...]:
        """Frames of the sequencer in order of time."""
        return tuple(self._decoded(SEQUENCER_TOPIC))

    @property
    def given_up(self) -> tuple[RecordingWalk, ...]:
        """Segments that the logger itself says it left after a write error, writing what was in doubt to the next file.

        Their torn ends are accounted for: no damage of the recording.
        """
        books = self.last_statistics
        if books is None:
            return ()
        numbers = {k.removeprefix("abandoned_") for k in books.extra if k.startswith("abandoned_")}
        return tuple(s for s in self.segments if str(s.number) in numbers and not s.closed)

    @property
    def damages(self) -> tuple[tuple[Path, Damage], ...]:
        """Damages of all segments but those given up, and the file of each."""
        given_up = {id(s) for s in self.given_up}
        return tuple((s.path, d) for s in self.segments if id(s) not in given_up for d in s.damages)

    @property
    def files(self) -> tuple[Path, ...]:
        """The files it was read from, each once."""
        return tuple(dict.fromkeys(s.path for s in self.segments))

    def _decoded(self, topic: str) -> Iterator[Any]:
        return (decode(topic, e.data) for e in self.entries if e.topic == topic)


def read_parts(path: Path) -> list[RecordingWalk]:
    """Walk through one file: a segment for each recording in it, one as a rule.

    Raises RecordingError when the file cannot be opened or is not an MCAP file at all.
    """
    data = read_bytes(path, "recording", RecordingError)
    if not data:
        raise RecordingError(f"{path}: the file is empty")
    parts = [_OpenPart(path, 0)]
    walk = Walk(data)
    for item in walk:
        if isinstance(item, Began):
            parts[-1].schemas = _schemas(walk)
            parts.append(_OpenPart(path, item.at_byte))
        else:
            parts[-1].take(item)
    parts[-1].schemas = _schemas(walk)
    found: list[RecordingWalk] = []
    for part, end in zip(parts, [*(p.at_byte for p in parts[1:]), len(data)], strict=True):
        segment = part.segment(end - part.at_byte)
        if segment.empty and found:  # stray bytes behind a recording: a damage of it
            stray = tuple(d for d in segment.damages if d.length)
            found[-1] = replace(found[-1], size=found[-1].size + segment.size, damages=(*found[-1].damages, *stray))
        elif found and found[-1].empty:
            found[-1] = replace(segment, at_byte=found[-1].at_byte, damages=(*found[-1].damages, *segment.damages))
        else:
            found.append(segment)
    found = [piece for segment in found for piece in _by_line(segment)]
    if all(s.empty for s in found) and not data.startswith(b"\x89MCAP"):
        raise RecordingError(f"{path}: not an MCAP file, and nothing of ours in it")
    return found


def _by_line(segment: RecordingWalk) -> list[RecordingWalk]:
    """A segment as it is, or taken apart where scans of another session stand among its own: those have lost their head."""
    own, *others = sessions_apart(segment.entries) or [()]
    if not others:
        return [segment]
    at = next((d.at_byte for d in segment.damages if d.at_byte > segment.at_byte), segment.at_byte)
    strange = [
        replace(segment, info=None, metadata=(), entries=e, at_byte=at + n, size=0, kept={}, foreign={}, closed=False, damages=(
            Damage(at, 0, f"{sum(x.topic == SCAN_TOPIC for x in e)} scans of another session stand here"),
        ))
        for n, e in enumerate(others, start=1)
    ]  # fmt: skip
    return [replace(segment, entries=own), *strange]


def _schemas(walk: Walk) -> dict[str, tuple[str, bytes]]:
    ids = ((topic, walk.channel_schema.get(topic)) for topic in _KEPT)
    return {topic: walk.schemas[i] for topic, i in ids if i is not None and i in walk.schemas}


@dataclass
class _OpenPart:
    """A recording while it is being read."""

    path: Path
    at_byte: int
    entries: list[RecordedMessage] = field(default_factory=list)
    damages: list[Damage] = field(default_factory=list)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    foreign: dict[str, int] = field(default_factory=dict)
    kept: dict[str, list[bytes]] = field(default_factory=dict)
    schemas: dict[str, tuple[str, bytes]] = field(default_factory=dict)
    closed: bool = False

    def take(self, item: Item) -> None:
        match item:
            case RecordedMessage():
                if item.topic in SCHEMA_OF_TOPIC:
                    self.entries.append(on_monotonic_clock(item))
                else:
                    self.foreign[item.topic] = self.foreign.get(item.topic, 0) + 1
                    if item.topic in _KEPT:
                        self.kept.setdefault(item.topic, []).append(item.data)
            case Attachment():
                self.attachments.setdefault(item.name, item.data)
            case Metadata():
                if (
                    item.name.startswith("sideslip.") or not self.metadata
                ):  # another program may have any number of them
                    self.metadata.append(item)
            case Damage():
                self.damages.append(item)
            case Closed():
                self.closed = True

    def segment(self, size: int) -> RecordingWalk:
        info = _identity(self.metadata, self.attachments)
        metadata = self.metadata or ([Metadata("attachment", {})] if self.attachments else [])
        return RecordingWalk(
            self.path, size, info, tuple(self.entries), self.foreign, tuple(self.damages), self.closed, tuple(metadata),
            self.at_byte, {k: tuple(v) for k, v in self.kept.items()}, self.schemas,
        )  # fmt: skip


def _identity(metadata: Iterable[Metadata], attachments: Mapping[str, bytes]) -> RecordingInfo | None:
    """Identity from the metadata, or from its copy among the attachments when the metadata is damaged."""
    fields: Mapping[str, str] | None = next((i.fields for i in metadata if i.name == INFO_NAME), None)
    if fields is None and INFO_ATTACHMENT in attachments:
        fields = _copy_of_identity(attachments[INFO_ATTACHMENT])
    if fields is None:
        return None
    try:
        info = info_from_metadata(fields)
    except (KeyError, ValueError):
        return None  # a digest that holds over fields that are none of ours: another program's, or a forger's
    details = {k: v for i in metadata if i.name == DETAIL_NAME for k, v in i.fields.items() if k != "sha256"}
    own = {k: v for k, v in attachments.items() if k not in (INFO_ATTACHMENT, CHANNELS_ATTACHMENT)}
    return replace(info, details={**info.details, **details}, attachments=own)


def _copy_of_identity(data: bytes) -> Mapping[str, str] | None:
    try:
        copy = json.loads(data)
    except (ValueError, RecursionError):
        return None
    if not isinstance(copy, dict) or not all(isinstance(v, str) for v in copy.values()):
        return None
    return copy if copy.get("sha256") == metadata_digest(copy) else None


def _last_statistics(entries: Iterable[RecordedMessage]) -> Statistics | None:
    told = [e for e in entries if e.topic == STATISTICS_TOPIC]
    last = max(reversed(told), key=lambda e: e.log_time_ns, default=None)  # of the same instant the last written
    return decode(STATISTICS_TOPIC, last.data) if last else None


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


def read_segments(path: str | Path) -> list[RecordingWalk]:
    """Walk through a file or all files of a directory, sound or not; a file gives a segment for each recording in it.

    A file of a directory that holds nothing at all is one whole damage: a power cut leaves the name of a file that was
    just begun, empty or full of zeros, and the files before it are none the worse.
    """
    path = Path(path)
    read = _parts_or_blank if path.is_dir() else read_parts
    return [s for p in segment_paths(path) for s in read(p)]


def _parts_or_blank(path: Path) -> list[RecordingWalk]:
    try:
        return read_parts(path)
    except RecordingError as error:
        if isinstance(error.__cause__, OSError):
            raise
        size = path.stat().st_size
        what = "the file is empty" if size == 0 else "nothing in it was written by the logger"
        return [RecordingWalk(path, size, None, (), {}, (Damage(0, size, what),), False)]


# ------------------------------------------------------------------------------------------------------- sessions


def by_session(segments: Iterable[RecordingWalk]) -> dict[str, list[RecordingWalk]]:
    """Segments by session, in order of appearance.

    A part that has lost its identity tells its session by its accounting, or is counted to the only session whose scan
    numbers and times it continues without contradiction; else it stands for itself.
    """
    known: dict[str, list[RecordingWalk]] = {}
    lost: list[RecordingWalk] = []
    for segment in segments:
        session = _session_told(segment)
        if session is None:
            lost.append(segment)
        else:
            known.setdefault(session, []).append(segment)
    for segment in lost:
        homes = [k for k, group in known.items() if _continues(group, segment)]
        alone = f"{visible(segment.path.stem)}@{segment.at_byte}" if segment.at_byte else visible(segment.path.stem)
        known.setdefault(homes[0] if len(homes) == 1 else alone, []).append(segment)
    return known


def _session_told(segment: RecordingWalk) -> str | None:
    if segment.info is not None:
        return segment.info.session
    books = _last_statistics(segment.entries)
    return books.session or None if books else None


def _continues(group: list[RecordingWalk], segment: RecordingWalk) -> bool:
    """Whether the scans of all these segments can be one session: a number stands for one scan, and time rises with it."""
    scans: dict[int, RecordedMessage] = {}
    for entry in (e for s in (*group, segment) for e in s.entries if e.topic == SCAN_TOPIC):
        if scans.setdefault(entry.sequence, entry).data != entry.data:
            return False
    times = [scans[n].log_time_ns for n in sorted(scans)]
    return all(a < b for a, b in zip(times, times[1:], strict=False))


def read_recordings(path: str | Path) -> list[Recording]:
    """The recording of each session in a file, sound or not, in order of appearance; of a directory, the only one.

    Raises RecordingError when there is none, or the files of a directory belong to different sessions.
    """
    path = Path(path)
    segments = read_segments(path)
    if path.is_dir():
        return [join(path, segments)]
    return [join(path, group) for group in by_session(segments).values()]


def _several(path: Path, segments: list[RecordingWalk]) -> str:
    names = ", ".join(
        f"{k} ({sum(e.topic == SCAN_TOPIC for s in g for e in s.entries)} scans)"
        for k, g in list(by_session(segments).items())[:5]
    )
    return (
        f"{path}: recordings of {len(by_session(segments))} sessions in one file: {names}; "
        f"'sideslip recover {path} -o OUT.mcap' writes each to a file of its own"
    )


# ------------------------------------------------------------------------------------------------------ recordings


def join(path: Path, segments: list[RecordingWalk]) -> Recording:
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
        known[0]
        if known
        else RecordingInfo(session=visible(path.stem), source="unknown", role="recovered", software="unknown")
    )
    details = {k: v for i in known for k, v in i.details.items()}
    attachments = {k: v for i in reversed(known) for k, v in i.attachments.items()}
    info = replace(info, details=details, attachments=attachments)
    return Recording(path, info, tuple(segments), entries)


def _why_not_raw(segments: list[RecordingWalk]) -> str:
    if any(s.foreign or s.metadata for s in segments):
        return "not a raw recording but a calibrated flight or a file of another program"
    if any(s.damages for s in segments):
        return "nothing in it is intact; there is nothing to recover"
    return "not a raw recording of Sideslip"


def unique(entries: Iterable[RecordedMessage]) -> tuple[RecordedMessage, ...]:
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

    Raises RecordingError for anything that is no raw recording, for a file with several sessions in it and, unless
    `salvage`, for a damaged one, saying where. A
    file that the logger gave up and continued in the next one does not count as damaged.
    """
    path = Path(path)
    recordings = read_recordings(path)
    if len(recordings) > 1:
        raise RecordingError(_several(path, [s for r in recordings for s in r.segments]))
    return recordings[0] if salvage else sound(recordings[0])


def sound(recording: Recording) -> Recording:
    """The recording, unless it is damaged: then RecordingError with the first damage and what to do."""
    for damaged, first in recording.damages:
        raise RecordingError(
            f"{damaged}: damaged at byte {first.at_byte} ({first.what}); "
            f"'sideslip recover {recording.path} -o OUT.mcap' saves what is intact"
        )
    return recording
