"""Read raw recordings: one file, or a directory with all segments of a session.

`read_recording` raises an error for a damaged recording, with the place; with `salvage=True` it returns the intact content and
the damages. Sessions are never mixed.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

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
from daq.contract.recordings.recording import RecordedMessage, RecordingError, RecordingInfo
from daq.contract.recordings.salvage import Damage
from daq.contract.recordings.segments import RecordingWalk, read_segments
from daq.contract.scan import SCAN_TOPIC, Scan, decode_scan
from daq.utilities.plain_words import visible


@dataclass(frozen=True)
class Recording:
    """A session: entries of all its segments in order of time, each message once."""

    path: Path
    info: RecordingInfo
    segments: tuple[RecordingWalk, ...]
    entries: tuple[RecordedMessage, ...] = field(repr=False)

    def scans(self) -> Iterator[Scan]:
        """The scans in order of their number, decoded one by one."""
        return (decode_scan(e.data) for e in self.entries if e.topic == SCAN_TOPIC)

    @cached_property
    def numbers(self) -> list[int]:
        """Numbers of the scans, ascending."""
        return sorted(e.sequence for e in self.entries if e.topic == SCAN_TOPIC)

    @property
    def events(self) -> tuple[EventMessage, ...]:
        return tuple(self._decoded(EVENT_TOPIC))

    @property
    def log(self) -> tuple[LogLine, ...]:
        return tuple(self._decoded(LOG_TOPIC))

    @property
    def statistics(self) -> tuple[Statistics, ...]:
        return tuple(self._decoded(STATISTICS_TOPIC))

    @cached_property
    def last_statistics(self) -> Statistics | None:
        """The last accounting report; None without any."""
        return _last_statistics(self.entries)

    @property
    def health(self) -> tuple[Health, ...]:
        return tuple(self._decoded(HEALTH_TOPIC))

    @property
    def sequencer(self) -> tuple[SequencerFrame, ...]:
        return tuple(self._decoded(SEQUENCER_TOPIC))

    @property
    def given_up(self) -> tuple[RecordingWalk, ...]:
        """Segments that the logger left after a write error, by its own statistics.

        It wrote unconfirmed messages again in the next file, so that their incomplete ends are no damage of the recording.
        """
        statistics = self.last_statistics
        if statistics is None:
            return ()
        numbers = {k.removeprefix("abandoned_") for k in statistics.extra if k.startswith("abandoned_")}
        return tuple(s for s in self.segments if str(s.number) in numbers and not s.closed)

    @property
    def damages(self) -> tuple[tuple[Path, Damage], ...]:
        """File and damage, for all segments but those in `given_up`."""
        given_up = {id(s) for s in self.given_up}
        return tuple((s.path, d) for s in self.segments if id(s) not in given_up for d in s.damages)

    @property
    def files(self) -> tuple[Path, ...]:
        """The files it was read from, each once."""
        return tuple(dict.fromkeys(s.path for s in self.segments))

    def _decoded(self, topic: str) -> Iterator[Any]:
        return (decode(topic, e.data) for e in self.entries if e.topic == topic)


def _last_statistics(entries: Iterable[RecordedMessage]) -> Statistics | None:
    reports = [e for e in entries if e.topic == STATISTICS_TOPIC]
    last = max(reversed(reports), key=lambda e: e.log_time_ns, default=None)  # of equal times the last written
    return decode(STATISTICS_TOPIC, last.data) if last else None


def by_session(segments: Iterable[RecordingWalk]) -> dict[str, list[RecordingWalk]]:
    """Session -> its segments, in order of appearance.

    A segment without an identity belongs to the session that its statistics name, or else to the only session that its scan
    numbers and times continue consistently; otherwise it is a session of its own.
    """
    sessions: dict[str, list[RecordingWalk]] = {}
    unidentified: list[RecordingWalk] = []
    for segment in segments:
        session = _session_of(segment)
        if session is None:
            unidentified.append(segment)
        else:
            sessions.setdefault(session, []).append(segment)
    for segment in unidentified:
        candidates = [k for k, group in sessions.items() if _continues(group, segment)]
        new_name = f"{visible(segment.path.stem)}@{segment.at_byte}" if segment.at_byte else visible(segment.path.stem)
        sessions.setdefault(candidates[0] if len(candidates) == 1 else new_name, []).append(segment)
    return sessions


def _session_of(segment: RecordingWalk) -> str | None:
    if segment.info is not None:
        return segment.info.session
    statistics = _last_statistics(segment.entries)
    return statistics.session or None if statistics else None


def _continues(group: list[RecordingWalk], segment: RecordingWalk) -> bool:
    """Whether the scans of all these segments can belong to one session: each number to one scan, and time rising with it."""
    scans: dict[int, RecordedMessage] = {}
    for entry in (e for s in (*group, segment) for e in s.entries if e.topic == SCAN_TOPIC):
        if scans.setdefault(entry.sequence, entry).data != entry.data:
            return False
    times = [scans[n].log_time_ns for n in sorted(scans)]
    return all(a < b for a, b in zip(times, times[1:], strict=False))


def read_recordings(path: str | Path) -> list[Recording]:
    """Read the recording of each session in a file, intact or not, in order of appearance; of a directory, the only one.

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
    """Join segments into one recording; a message in two segments (written again after an error) appears once.

    Raises RecordingError when the segments belong to different sessions or hold no raw recording.
    """
    infos = [s.info for s in segments if s.info is not None]
    sessions = sorted({i.session for i in infos})
    if len(sessions) > 1:
        raise RecordingError(
            f"{path}: recordings of {len(sessions)} sessions ({', '.join(sessions)}); name one of the files"
        )
    entries = unique(e for s in segments for e in s.entries)
    if not infos and not entries:
        raise RecordingError(f"{path}: {_why_not_raw(segments)}")
    info = (
        infos[0]
        if infos
        else RecordingInfo(session=visible(path.stem), source="unknown", role="recovered", software="unknown")
    )
    details = {k: v for i in infos for k, v in i.details.items()}
    attachments = {k: v for i in reversed(infos) for k, v in i.attachments.items()}
    info = replace(info, details=details, attachments=attachments)
    return Recording(path, info, tuple(segments), entries)


def _why_not_raw(segments: list[RecordingWalk]) -> str:
    if any(s.foreign or s.metadata for s in segments):
        return "not a raw recording but a calibrated flight or a file of another program"
    if any(s.damages for s in segments):
        return "nothing in it is intact; there is nothing to recover"
    return "not a raw recording of Sideslip"


def unique(entries: Iterable[RecordedMessage]) -> tuple[RecordedMessage, ...]:
    """Entries in order of time, without scans of a repeated number and repeated messages."""
    keys: set[tuple[str, int] | tuple[str, bytes]] = set()
    unique_entries = []
    for entry in sorted(entries, key=lambda e: e.log_time_ns):
        key = (entry.topic, entry.sequence) if entry.topic == SCAN_TOPIC else (entry.topic, entry.data)
        if key not in keys:
            keys.add(key)
            unique_entries.append(entry)
    return tuple(unique_entries)


def read_recording(path: str | Path, *, salvage: bool = False) -> Recording:
    """Read a raw recording, a file or a directory of segments.

    Raises RecordingError for anything that is no raw recording, for a file with several sessions in it and, unless `salvage`,
    for a damaged one, with the place. A file in `given_up` does not count as damaged.
    """
    path = Path(path)
    recordings = read_recordings(path)
    if len(recordings) > 1:
        raise RecordingError(_several(path, [s for r in recordings for s in r.segments]))
    return recordings[0] if salvage else sound(recordings[0])


def sound(recording: Recording) -> Recording:
    """Return the recording unless it is damaged. Raises RecordingError with the first damage and the remedy."""
    for damaged, first in recording.damages:
        raise RecordingError(
            f"{damaged}: damaged at byte {first.at_byte} ({first.what}); "
            f"'sideslip recover {recording.path} -o OUT.mcap' saves what is intact"
        )
    return recording
