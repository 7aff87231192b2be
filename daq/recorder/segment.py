"""One file of a recording while it is written, and the thread that waits for the card to have it."""

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
    """A file in progress, with the messages in it that the card has not confirmed yet."""

    def __init__(self, path: Path, file: StorageFile, info: RecordingInfo, *, compress: bool, keep: int) -> None:
        self.path = path
        self.number = info.segment
        self.file = file
        self.writer = RecordingWriter(cast(IO[bytes], file), info, compress=compress)
        self.started_ns: int | None = None  # message time of the first message
        self.chunk_started_ns: int | None = None
        self.synced_ns = 0  # message time up to which a sync has been asked for
        self.flushes = 0
        self.flushed = 0  # messages that the operating system has: what a sync beginning now will cover
        self.confirmed = False  # whether the card has ever taken anything of it
        self.failure: OSError | None = None  # found by the sync thread
        self._keep = keep
        self._lock = threading.Lock()
        self._unconfirmed: deque[RecordedMessage] = deque()
        self._total = 0  # messages ever added; the last of them are the unconfirmed ones

    def add(self, entry: RecordedMessage) -> None:
        """Add a message to the chunk in progress and keep it until confirmed; OSError when the file fails."""
        self.writer.write(entry)
        with self._lock:
            self._total += 1
            self._unconfirmed.append(entry)
            if len(self._unconfirmed) > self._keep:
                self._unconfirmed.popleft()  # the system has had it for minutes, and memory is bounded
        if self.started_ns is None:
            self.started_ns = self.synced_ns = entry.log_time_ns
        if self.chunk_started_ns is None:
            self.chunk_started_ns = entry.log_time_ns

    def handed_over(self) -> None:
        """All messages added so far have been written to the file."""
        self.flushed = self._total

    def confirm(self, total: int) -> None:
        """The card has the first `total` messages: they need not be kept."""
        self.confirmed = True
        with self._lock:
            while self._unconfirmed and self._total - len(self._unconfirmed) < total:
                self._unconfirmed.popleft()

    def take_back(self) -> list[RecordedMessage]:
        """The messages not confirmed, in order; they are the caller's from now on."""
        with self._lock:
            entries = list(self._unconfirmed)
            self._unconfirmed.clear()
            return entries


@dataclass(frozen=True, slots=True)
class _WriteJob:
    file: StorageFile
    segment: OpenRecording | None = None  # to be synced
    over: threading.Event | None = None  # close the file after the sync, and say so


class Syncer:
    """Waits for the card in a thread of its own: fdatasync of segments, and the closing of files.

    failed: called from this thread with a segment and its error; the flag says whether the segment was finished.
    """

    def __init__(self, failed: Callable[[OpenRecording, OSError, bool], None], clock: Clock, sync: bool) -> None:
        self.latency = Histogram()
        self._failed = failed
        self._clock = clock
        self._sync = sync
        self._jobs: deque[_WriteJob] = deque()
        self._at_work = False
        self._news = threading.Condition()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="recorder-sync", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def request(self, segment: OpenRecording) -> None:
        """Have what a segment holds now confirmed.

        While a sync is under way one more waits behind it, whatever comes: on a card slower than the requests it begins
        the moment the card is free, and covers all that has been written until then.
        """
        with self._news:
            is_queued = any(j.segment is segment for j in self._jobs)
        if not is_queued:
            self._add(_WriteJob(segment.file, segment))

    @property
    def busy(self) -> bool:
        """Whether it waits for the card, or will."""
        with self._news:
            return self._at_work or bool(self._jobs)

    def retire(self, segment: OpenRecording) -> threading.Event:
        """Sync a finished segment and close its file; the event is set when that is over."""
        closed = threading.Event()
        with self._news:  # this sync covers what waits for one
            self._jobs = deque(j for j in self._jobs if j.segment is not segment)
        self._add(_WriteJob(segment.file, segment, closed))
        return closed

    def close_later(self, file: StorageFile) -> None:
        """Close a file that is of no more use; closing may block on a bad card."""
        self._add(_WriteJob(file))

    def stop(self) -> None:
        """End the thread after the jobs it has; returns at once."""
        with self._news:
            self._stopping = True
            self._news.notify_all()

    @property
    def thread(self) -> threading.Thread:
        """The thread, to be waited for after `stop`."""
        return self._thread

    def _add(self, job: _WriteJob) -> None:
        with self._news:
            self._jobs.append(job)
            self._news.notify_all()

    def _run(self) -> None:
        while True:
            with self._news:
                self._at_work = False
                self._news.wait_for(lambda: self._jobs or self._stopping)
                if not self._jobs:
                    return
                job = self._jobs.popleft()
                self._at_work = True
            if job.segment is not None:
                self._confirm(job.segment, finished=job.over is not None)
            if job.segment is None or job.over is not None:
                _close(job.file)
            if job.over is not None:
                job.over.set()

    def _confirm(self, segment: OpenRecording, *, finished: bool) -> None:
        if segment.failure is not None:
            # The system forgets pages whose writing failed: the next sync of the same file succeeds without them.
            self._failed(segment, segment.failure, finished)
            return
        started = self._clock.monotonic_ns()
        total = segment.flushed  # before the sync: what is written while it runs may not be covered
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
    except OSError as error:  # whatever is of worth in it was synced before, or is being written again
        _LOG.warning("closing a file: %s", error.strerror or error)
