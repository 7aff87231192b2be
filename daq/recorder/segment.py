"""A file of a recording that is being written, and the thread that waits for the card to confirm it."""

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, cast

from daq.clock import Clock
from daq.contract.recordings.recording import RecordedMessage, RecordingInfo, RecordingWriter
from daq.recorder.counts import Histogram
from daq.recorder.storage import StorageFile

_LOG = logging.getLogger("sideslip.recorder")


class OpenRecording:
    """A file that is being written, with copies of the messages that the card has not confirmed yet.

    capacity: most messages that are copied.
    """

    def __init__(self, path: Path, file: StorageFile, info: RecordingInfo, *, compress: bool, capacity: int) -> None:
        self.path = path
        self.number = info.segment
        self.file = file
        self.writer = RecordingWriter(cast(IO[bytes], file), info, compress=compress)
        self.started_ns: int | None = None  # message time of the first message
        self.chunk_started_ns: int | None = None
        self.synced_ns = 0  # message time up to which a sync has been requested
        self.flushes = 0
        self.flushed = 0  # messages that the operating system has, which a sync that begins now will cover
        self.confirmed = False  # whether the card has confirmed anything of it
        self.failure: OSError | None = None  # set by the sync thread
        self._capacity = capacity
        self._lock = threading.Lock()
        self._unconfirmed: deque[RecordedMessage] = deque()
        self._total = 0  # messages ever added; the last of them are the unconfirmed ones

    def add(self, entry: RecordedMessage) -> None:
        """Add a message to the current chunk, and copy it until it is confirmed. Raises OSError when the file fails."""
        self.writer.write(entry)
        with self._lock:
            self._total += 1
            self._unconfirmed.append(entry)
            if len(self._unconfirmed) > self._capacity:
                self._unconfirmed.popleft()  # memory is bounded, and the system has had this message for minutes
        if self.started_ns is None:
            self.started_ns = self.synced_ns = entry.log_time_ns
        if self.chunk_started_ns is None:
            self.chunk_started_ns = entry.log_time_ns

    def mark_flushed(self) -> None:
        """Note that all messages added so far have been written to the file."""
        self.flushed = self._total

    def confirm(self, total: int) -> None:
        """Note that the card has the first `total` messages, and drop their copies."""
        self.confirmed = True
        with self._lock:
            while self._unconfirmed and self._total - len(self._unconfirmed) < total:
                self._unconfirmed.popleft()

    def take_unconfirmed(self) -> list[RecordedMessage]:
        """Remove the unconfirmed messages, and return them in order."""
        with self._lock:
            entries = list(self._unconfirmed)
            self._unconfirmed.clear()
            return entries


@dataclass(frozen=True, slots=True)
class _WriteJob:
    file: StorageFile
    segment: OpenRecording | None = None  # to be synced
    closed: threading.Event | None = None  # close the file after the sync, then set this


class Syncer:
    """Syncs segments (fdatasync) and closes files in a thread of its own.

    failed: called in this thread with a segment, its error, and whether the segment was finished. sync: False to skip fdatasync.
    """

    def __init__(self, failed: Callable[[OpenRecording, OSError, bool], None], clock: Clock, sync: bool) -> None:
        self.latency = Histogram()
        self._failed = failed
        self._clock = clock
        self._sync = sync
        self._jobs: deque[_WriteJob] = deque()
        self._at_work = False
        self._changed = threading.Condition()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="recorder-sync", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def request(self, segment: OpenRecording) -> None:
        """Queue a sync of a segment, unless one is queued already.

        On a card slower than the requests one sync runs and one is queued, which will cover all that is written until it begins.
        """
        with self._changed:
            is_queued = any(j.segment is segment for j in self._jobs)
        if not is_queued:
            self._add(_WriteJob(segment.file, segment))

    @property
    def busy(self) -> bool:
        """Whether a job is running or queued."""
        with self._changed:
            return self._at_work or bool(self._jobs)

    def retire(self, segment: OpenRecording) -> threading.Event:
        """Queue the last sync of a finished segment and the closing of its file; returns an event that is set after both."""
        closed = threading.Event()
        with self._changed:  # this sync covers earlier requests
            self._jobs = deque(j for j in self._jobs if j.segment is not segment)
        self._add(_WriteJob(segment.file, segment, closed))
        return closed

    def close_later(self, file: StorageFile) -> None:
        """Queue the closing of a file that is no longer needed; closing may block on a bad card."""
        self._add(_WriteJob(file))

    def stop(self) -> None:
        """Make the thread end after the queued jobs; returns at once."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()

    @property
    def thread(self) -> threading.Thread:
        """The thread, which ends after `stop`."""
        return self._thread

    def _add(self, job: _WriteJob) -> None:
        with self._changed:
            self._jobs.append(job)
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._at_work = False
                self._changed.wait_for(lambda: self._jobs or self._stopping)
                if not self._jobs:
                    return
                job = self._jobs.popleft()
                self._at_work = True
            if job.segment is not None:
                self._confirm(job.segment, finished=job.closed is not None)
            if job.segment is None or job.closed is not None:
                _close(job.file)
            if job.closed is not None:
                job.closed.set()

    def _confirm(self, segment: OpenRecording, *, finished: bool) -> None:
        if segment.failure is not None:
            # the system drops pages whose writing failed: the next sync of the same file would succeed without them
            self._failed(segment, segment.failure, finished)
            return
        started = self._clock.monotonic_ns()
        total = segment.flushed  # before the sync, which may not cover what is written while it runs
        if self._sync:
            try:
                segment.file.sync()
            except OSError as error:
                self._failed(segment, error, finished)
                return
        segment.confirm(total)
        self.latency.add((self._clock.monotonic_ns() - started) // 1000)


def _close(file: StorageFile) -> None:
    try:
        file.close()
    except OSError as error:  # its messages were synced before, or are being written again
        _LOG.warning("closing a file: %s", error.strerror or error)
