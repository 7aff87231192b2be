"""The files of a session, numbered one after another in the first directory that can be written, and their log times.

A file that cannot be opened or begun is reported and tried again; it raises nothing. Each segment has one offset from the
aircraft's monotonic clock to UTC, chosen with its first message, as soon as UTC is known. Intervals in a file are therefore
those of the monotonic clock, and log times never jump, whatever GPS or the system's clock do meanwhile.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from daq.clock import NS, Clock
from daq.contract.recordings.messages import LogLevel
from daq.contract.recordings.recording import COMPUTER, GPS, LogTime, RecordedMessage, RecordingInfo, utc_of_scan
from daq.recorder.config import RecorderConfig
from daq.recorder.segment import OpenRecording
from daq.recorder.storage import Storage, StorageFile

CLOCK_SET_NS = 1_735_689_600 * NS
"""The system's clock counts as set from 2025 on: clocks without a battery begin in 1970, or when their system was built."""
TOLERANCE_NS = NS // 10
"""Largest difference of a set clock from GPS, two scans: a clock set from the network agrees with GPS to some 20 ms, the accuracy
of a fix over a serial line. Beyond it a new segment begins, once in a session."""


class SegmentFiles:
    """Opens the segments of a session.

    folder: appended to each configured directory. capacity: messages that a segment copies until the card has confirmed them.
    close_later: closes a file that is no longer needed. report: takes a failure in words, and its level.
    """

    def __init__(
        self,
        config: RecorderConfig,
        info: RecordingInfo,
        storage: Storage,
        *,
        folder: str,
        capacity: int,
        close_later: Callable[[StorageFile], None],
        report: Callable[[str, LogLevel], None],
    ) -> None:
        self.next_number = 0
        self._config = config
        self._info = info
        self._storage = storage
        self._folder = folder
        self._capacity = capacity
        self._close_later = close_later
        self._report = report

    def open(self, details: Mapping[str, str]) -> OpenRecording | None:
        """Open the next segment, and write its header with the session's identity and `details`; None when no directory can be
        written."""
        for root in self._config.directories:
            self._make_room(root)
            segment = self._open_in(root, details)
            if segment is not None:
                return segment
        return None

    def free_bytes(self, segment: OpenRecording) -> int:
        return self._storage.free_bytes(segment.path.parent)

    def remove(self, path: Path, file: StorageFile) -> None:
        """Remove a file without messages."""
        self._close_later(file)
        try:
            self._storage.remove(path)
        except OSError as error:
            self._fails(f"{path} cannot be removed", error)
            self.next_number += 1

    def _open_in(self, root: Path, details: Mapping[str, str]) -> OpenRecording | None:
        try:
            path, file = self._create(root / self._folder)
        except OSError as error:
            self._fails(f"{root}: no new file can be opened", error)
            return None
        info = replace(self._info, segment=self.next_number, details={**self._info.details, **details})
        try:
            segment = OpenRecording(path, file, info, compress=self._config.compress, capacity=self._capacity)
            segment.writer.flush()
        except OSError as error:
            self._fails(f"{root}: a new file cannot be written", error)
            self.remove(path, file)
            return None
        self.next_number += 1
        return segment

    def _create(self, directory: Path) -> tuple[Path, StorageFile]:
        while True:
            path = directory / f"{self._info.session}_{self.next_number:03d}.mcap"
            try:
                return path, self._storage.create(path)
            except FileExistsError:
                self.next_number += 1

    def _make_room(self, root: Path) -> None:
        """Remove the oldest recordings of other sessions, if that is allowed and space is short."""
        if not self._config.remove_oldest:
            return
        least_bytes = self._config.keep_free_mb * 1e6
        try:
            for path in self._storage.recordings(root):
                if self._storage.free_bytes(root) >= least_bytes:
                    return
                if not path.name.startswith(f"{self._info.session}_"):
                    self._storage.remove(path)
                    self._report(f"{path} removed to make room", LogLevel.WARNING)
        except OSError as error:
            self._fails(f"{root}: no room could be made", error)

    def _fails(self, what: str, error: OSError) -> None:
        self._report(f"{what} ({error.strerror or error})", LogLevel.ERROR)


class SessionTime:
    """The best relation to UTC in a session: at first by the system's clock, if it is set, later by GPS."""

    def __init__(self, clock: Clock) -> None:
        utc_ns = clock.utc_ns()
        is_set = utc_ns >= CLOCK_SET_NS
        self.best = LogTime(utc_ns - clock.monotonic_ns(), COMPUTER) if is_set else LogTime()

    def update(self, entry: RecordedMessage) -> None:
        """Take UTC from a scan that has it."""
        log_time = utc_of_scan(entry)
        if log_time is not None:
            self.best = log_time

    def contradicts(self, used: LogTime) -> bool:
        """Whether GPS shows that the log times of a segment, begun before the first fix, are wrong."""
        if used.source == GPS or self.best.source != GPS:
            return False
        return abs(self.best.offset_ns - used.offset_ns) > TOLERANCE_NS
