"""Reading the files of a recording: a segment for each recording in a file, usually one.

A file may hold several recordings one behind the other, and scans of two sessions may follow one header: bytes of another file
pasted into a recording, or left behind the place where a file was cut off. Within a session a number belongs to one scan, and
time rises with it; where that is violated there are two sessions. Scans of one session lie on a line, time = number * period +
constant, on the aircraft's clock; a session of another start of computer or logger lies on another line.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from statistics import median

from daq.contract.recordings.mcap_records import Attachment, Metadata
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
from daq.contract.scan import SCAN_TOPIC
from daq.utilities.input_files import read_bytes

FLIGHT_TOPIC, FLIGHT_METADATA = "/flight", "sideslip.flight"
LINK_TOPIC = "/link"
_AUXILIARY_TOPICS = (FLIGHT_TOPIC, LINK_TOPIC)
"""Our topics besides those of a raw recording: calibrated flights, and link quality in received recordings."""
NEAR_NS = 2_000_000_000
"""Largest distance of a scan from its session's line: slots are missed one by one, and no logger restarts within two seconds."""
MOST_SESSIONS = 64
"""Most sessions that are separated within one part of a file: a card has some hundred files, and not all of them in one."""


@dataclass(frozen=True, slots=True)
class RecordingWalk:
    """One recording within a file: its intact messages and its damages."""

    path: Path
    size: int  # bytes
    info: RecordingInfo | None  # None where the identity is missing or damaged
    entries: tuple[RecordedMessage, ...]
    foreign: Mapping[str, int]  # topic of other programs, or of _AUXILIARY_TOPICS -> number of messages
    damages: tuple[Damage, ...]
    closed: bool
    metadata: tuple[Metadata, ...] = ()
    at_byte: int = 0  # offset in the file, not 0 for a second recording in it
    auxiliary: Mapping[str, tuple[bytes, ...]] = field(
        default_factory=dict
    )  # messages of flights and of link quality by topic
    schemas: Mapping[str, tuple[str, bytes]] = field(
        default_factory=dict
    )  # name and definition by topic, for `auxiliary`

    @property
    def empty(self) -> bool:
        """Whether it holds nothing but damage."""
        return not (self.entries or self.metadata or self.foreign or self.info)

    @property
    def number(self) -> int | None:
        """The file's number in the session, from the identity or else from the file name."""
        if self.info is not None:
            return self.info.segment
        ending = self.path.stem.rpartition("_")[2]
        return int(ending) if ending.isdecimal() else None

    @property
    def sound(self) -> bool:
        """Whether nothing is damaged and the file was closed in order."""
        return self.closed and not self.damages


def read_parts(path: Path) -> list[RecordingWalk]:
    """Read one file: a segment for each recording in it, usually one.

    Raises RecordingError when the file cannot be opened, or is no MCAP file and holds nothing of ours.
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
    segments: list[RecordingWalk] = []
    for part, end in zip(parts, [*(p.at_byte for p in parts[1:]), len(data)], strict=True):
        segment = part.segment(end - part.at_byte)
        if segment.empty and segments:  # stray bytes behind a recording count as its damage
            stray = tuple(d for d in segment.damages if d.length)
            segments[-1] = replace(
                segments[-1], size=segments[-1].size + segment.size, damages=(*segments[-1].damages, *stray)
            )
        elif segments and segments[-1].empty:
            segments[-1] = replace(
                segment, at_byte=segments[-1].at_byte, damages=(*segments[-1].damages, *segment.damages)
            )
        else:
            segments.append(segment)
    segments = [piece for segment in segments for piece in _by_line(segment)]
    if all(s.empty for s in segments) and not data.startswith(b"\x89MCAP"):
        raise RecordingError(f"{path}: not an MCAP file, and nothing of ours in it")
    return segments


def _by_line(segment: RecordingWalk) -> list[RecordingWalk]:
    """The segment, split where it holds scans of other sessions; the segments of these have no header and no identity."""
    main_entries, *foreign_entries = split_sessions(segment.entries) or [()]
    if not foreign_entries:
        return [segment]
    damage_byte = next((d.at_byte for d in segment.damages if d.at_byte > segment.at_byte), segment.at_byte)
    headless = replace(segment, info=None, metadata=(), size=0, auxiliary={}, foreign={}, closed=False)
    parts = [replace(segment, entries=main_entries)]
    for n, entries in enumerate(foreign_entries, start=1):
        scans = sum(e.topic == SCAN_TOPIC for e in entries)
        damage = Damage(damage_byte, 0, f"{scans} scans of another session stand here")
        parts.append(replace(headless, at_byte=damage_byte + n, entries=entries, damages=(damage,)))
    return parts


def _schemas(walk: Walk) -> dict[str, tuple[str, bytes]]:
    ids = ((topic, walk.channel_schema.get(topic)) for topic in _AUXILIARY_TOPICS)
    return {topic: walk.schemas[i] for topic, i in ids if i is not None and i in walk.schemas}


@dataclass
class _OpenPart:
    """A recording that is being read."""

    path: Path
    at_byte: int
    entries: list[RecordedMessage] = field(default_factory=list)
    damages: list[Damage] = field(default_factory=list)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    foreign: dict[str, int] = field(default_factory=dict)
    auxiliary: dict[str, list[bytes]] = field(default_factory=dict)
    schemas: dict[str, tuple[str, bytes]] = field(default_factory=dict)
    closed: bool = False

    def take(self, item: Item) -> None:
        match item:
            case RecordedMessage():
                topic = item.topic
                if topic in SCHEMA_OF_TOPIC:
                    self.entries.append(on_monotonic_clock(item))
                    return
                self.foreign[topic] = self.foreign.get(topic, 0) + 1
                if topic in _AUXILIARY_TOPICS:
                    self.auxiliary.setdefault(topic, []).append(item.data)
            case Attachment():
                self.attachments.setdefault(item.name, item.data)
            case Metadata():
                # other programs may write any number of them: only the first counts, as a sign of a recording
                if item.name.startswith("sideslip.") or not self.metadata:
                    self.metadata.append(item)
            case Damage():
                self.damages.append(item)
            case Closed():
                self.closed = True

    def segment(self, size: int) -> RecordingWalk:
        info = _identity(self.metadata, self.attachments)
        metadata = self.metadata or ([Metadata("attachment", {})] if self.attachments else [])
        return RecordingWalk(
            self.path,
            size,
            info,
            tuple(self.entries),
            self.foreign,
            tuple(self.damages),
            self.closed,
            metadata=tuple(metadata),
            at_byte=self.at_byte,
            auxiliary={k: tuple(v) for k, v in self.auxiliary.items()},
            schemas=self.schemas,
        )


def _identity(metadata: Iterable[Metadata], attachments: Mapping[str, bytes]) -> RecordingInfo | None:
    """The identity from the metadata or, when that is damaged, from its copy among the attachments."""
    fields: Mapping[str, str] | None = next((i.fields for i in metadata if i.name == INFO_NAME), None)
    if fields is None and INFO_ATTACHMENT in attachments:
        fields = _copy_of_identity(attachments[INFO_ATTACHMENT])
    if fields is None:
        return None
    try:
        info = info_from_metadata(fields)
    except (KeyError, ValueError):
        return None  # valid digest over fields of another program, or forged ones
    details = {k: v for i in metadata if i.name == DETAIL_NAME for k, v in i.fields.items() if k != "sha256"}
    own_attachments = {k: v for k, v in attachments.items() if k not in (INFO_ATTACHMENT, CHANNELS_ATTACHMENT)}
    return replace(info, details={**info.details, **details}, attachments=own_attachments)


def _copy_of_identity(data: bytes) -> Mapping[str, str] | None:
    try:
        copy = json.loads(data)
    except (ValueError, RecursionError):
        return None
    if not isinstance(copy, dict) or not all(isinstance(v, str) for v in copy.values()):
        return None
    return copy if copy.get("sha256") == metadata_digest(copy) else None


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
    """Read a file or all files of a directory, intact or not; a file gives a segment for each recording in it.

    In a directory a file that holds nothing of ours becomes one damage, because a power cut may leave the last file empty or full
    of zeros.
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
        damage_text = "the file is empty" if size == 0 else "nothing in it was written by the logger"
        return [RecordingWalk(path, size, None, (), {}, (Damage(0, size, damage_text),), False)]


# ----------------------------------------------------------------------------------------- mixed sessions


def split_sessions(entries: Sequence[RecordedMessage]) -> list[tuple[RecordedMessage, ...]]:
    """Split entries, in order of the file, by session, in the order of their first scans; one group where all scans are
    consistent with one session. Other entries go with the scan before them."""
    scans = [e for e in entries if e.topic == SCAN_TOPIC]
    if not _contradict(scans):
        return [tuple(entries)]
    period = _period(scans)
    lines: list[float] = []  # latest intercept of each session's line: time - number * period [ns]
    groups: list[list[RecordedMessage]] = []
    current = 0
    for entry in entries:
        if entry.topic == SCAN_TOPIC:
            intercept = entry.log_time_ns - entry.sequence * period
            nearby = [i for i, line in enumerate(lines) if abs(intercept - line) <= NEAR_NS]
            current = (
                min(nearby, key=lambda i: abs(intercept - lines[i])) if nearby else min(len(lines), MOST_SESSIONS - 1)
            )
            if current == len(lines):
                lines.append(intercept)
                groups.append([])
            lines[current] = intercept
        if groups:
            groups[current].append(entry)
    preamble = entries[: next(i for i, e in enumerate(entries) if e.topic == SCAN_TOPIC)]
    groups[0][:0] = preamble
    return [tuple(group) for group in groups]


def _contradict(scans: Sequence[RecordedMessage]) -> bool:
    """Whether a number belongs to two different scans, or time does not rise with the number."""
    by_number: dict[int, RecordedMessage] = {}
    if any(by_number.setdefault(e.sequence, e).data != e.data for e in scans):
        return True
    return any(by_number[a].log_time_ns >= by_number[b].log_time_ns for a, b in pairwise(sorted(by_number)))


def _period(scans: Sequence[RecordedMessage]) -> float:
    """Time from one number to the next [ns]: the median over neighbours in the file."""
    steps = [b.log_time_ns - a.log_time_ns for a, b in pairwise(scans) if b.sequence == a.sequence + 1]
    return float(median(steps)) if steps else 0.0
