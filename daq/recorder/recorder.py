"""The recorder: takes scans without blocking the scan loop, and writes them to the card.

For the scan loop `Recorder` is a bounded memory with counters. One thread writes segments and another waits for the card
(fdatasync), so that a stalled card delays neither the scans nor the writing. Messages stay in memory until the card has confirmed
them; when a file fails they go into the next one, if necessary in the next directory. Scans that are lost are counted, with their
numbers, in the recording itself.
"""

import logging
import math
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import cast

from daq.clock import NS, Clock
from daq.contract.recordings.messages import LogLevel, LogLine, Message, Statistics
from daq.contract.recordings.recording import RecordedMessage, RecordingInfo, message_entry, scan_entry
from daq.contract.scan import SCAN_TOPIC, Scan
from daq.recorder.config import RecorderConfig
from daq.recorder.counts import Histogram, LoopTiming, SlotCounts
from daq.recorder.segment import OpenRecording, Syncer
from daq.recorder.segment_files import SegmentFiles, SessionTime
from daq.recorder.storage import RealStorage, Storage

_LOG = logging.getLogger("sideslip.recorder")

_MESSAGE_ROOM = 256  # events and log lines held in memory, beyond the scans
_IDLE_S = 0.2  # after a chunk should have been full, the writer wakes up without being notified
_LONGEST_PAUSE_S = 8.0  # between files that fail at once: well within queue_s, and short for a card that comes back
_STOP_TIMEOUT_S = 2.0  # for the writer to end after it has been told to give up


class Recorder:
    """Records a session. No public method but `close` blocks; all may be called from any thread.

    info: identity of the session; the recorder sets its segment number. folder: appended to each configured directory (a
    directory for each session). storage: the file system, or a test's. timing: the scan loop's histograms, reported in the
    recording.
    """

    def __init__(
        self,
        config: RecorderConfig,
        info: RecordingInfo,
        clock: Clock,
        *,
        folder: str = "",
        storage: Storage | None = None,
        timing: LoopTiming | None = None,
    ) -> None:
        self.session = info.session
        self._config = config
        self._info = info
        self._clock = clock
        self._timing = timing or LoopTiming()
        self._capacity = math.ceil(config.queue_s * info.scan_rate_hz)
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        self._inbox: deque[Scan | Message] = deque()
        self._counters = SlotCounts()
        self._pending: deque[RecordedMessage] = deque()  # encoded, in order, not yet in a file
        self._returned: deque[RecordedMessage] = deque()  # of a finished file whose sync failed
        self._time = SessionTime(clock)
        self._details: dict[str, str] = {}
        self._new_details: dict[str, str] = {}
        self._abandoned: list[int] = []  # numbers of segments that failed
        self._free: dict[str, int] = {}  # free_bytes of the card, empty until known
        self._segment: OpenRecording | None = None
        self._reported_ns: int | None = None
        self._pause_s = config.retry_s  # before the next file, while files fail
        self._write_latency = Histogram()
        self._reports: deque[str] = deque(maxlen=8)  # the last ones, which are not repeated while retrying
        self._writing = True  # the writer is not waiting for a change
        self._closing = False
        self._given_up = False
        self._syncer = Syncer(self._sync_failed, clock, config.sync)
        self._files = SegmentFiles(
            config,
            info,
            storage or RealStorage(),
            folder=folder,
            capacity=self._capacity + _MESSAGE_ROOM,
            close_later=self._syncer.close_later,
            report=self._report_failure,
        )
        # message time from a chunk's first to its last scan
        self._chunk_ns = max(0, round((config.flush_s - 1 / info.scan_rate_hz) * NS))
        # only the scan that completes a chunk wakes the writer, for waking costs more than writing a scan
        self._chunk_full_ns: int | None = None  # message time of that scan; None before the chunk's first
        self._chunk_is_full = False
        self._idle_limit_s = config.flush_s + _IDLE_S
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)

    # ------------------------------------------------------------------------------------------ for the scan loop

    def start(self) -> None:
        """Start the threads."""
        self._syncer.start()
        self._thread.start()

    def scan(self, scan: Scan) -> bool:
        """Take a scan; False when the memory is full, and the scan is dropped and counted."""
        with self._lock:
            counters = self._counters
            pending = counters.offer(scan.number)
            if pending > counters.high_water:
                counters.high_water = min(pending, self._capacity)
            if pending > self._capacity or self._given_up:
                counters.drop(scan.number)
                return False
            self._inbox.append(scan)
            if self._chunk_full_ns is None:
                self._chunk_full_ns = scan.time_monotonic_ns + self._chunk_ns
            if not self._chunk_is_full and scan.time_monotonic_ns >= self._chunk_full_ns:
                self._chunk_is_full = True
                self._changed.notify_all()
        return True

    def reach(self, number: int) -> None:
        """Count the slots before `number` without a scan as missed. The first call sets the first slot of the session."""
        with self._lock:
            self._counters.reach(number)

    def message(self, message: Message) -> bool:
        """Record an event, a health report or a frame of the sequencer; False when the memory is full."""
        with self._changed:
            accepted = len(self._inbox) <= self._capacity + _MESSAGE_ROOM and not self._given_up
            if accepted:
                self._inbox.append(message)
            return accepted

    def log(self, level: LogLevel, name: str, text: str) -> None:
        """Record a log line with the present time."""
        self.message(LogLine(self._clock.monotonic_ns(), max(0, self._clock.utc_ns()), level, name, text))

    def detail(self, details: Mapping[str, str]) -> None:
        """Add facts to the identity, in this segment and all later ones (a sensor's factory data)."""
        with self._changed:
            self._new_details.update(details)

    def busy(self) -> bool:
        """Whether the writer is more than a flush behind; a simulated clock waits until it is not."""
        with self._changed:
            return self._counters.pending > max(4, self._config.flush_s * self._info.scan_rate_hz)

    def at_work(self) -> bool:
        """Whether either thread has work now; a simulation that must be exact does not advance time meanwhile."""
        with self._changed:
            return self._thread.is_alive() and (self._chunk_is_full or self._writing or self._syncer.busy)

    def statistics(self, *, final: bool = False) -> Statistics:
        """The present counters and timing. final: whether the session has ended."""
        with self._changed:
            counters = replace(self._counters, absent=list(self._counters.absent))
        return Statistics(
            time_monotonic_ns=self._clock.monotonic_ns(),
            time_utc_ns=max(0, self._clock.utc_ns()),
            session=self.session,
            segment=max(0, self._files.next_number - 1),
            final=final,
            extra={f"abandoned_{n}": 1 for n in self._abandoned} | self._free,
            **counters.counts(),
            **self._timing.counts(),
            write_latency=tuple(self._write_latency.counts),
            sync_latency=tuple(self._syncer.latency.counts),
        )

    @property
    def path(self) -> Path | None:
        """The file being written, if there is one."""
        segment = self._segment
        return segment.path if segment else None

    def close(self, timeout_s: float = 60.0) -> Statistics:
        """Write what is in memory, end the recording in order and return its statistics.

        While the card fails this retries for `timeout_s` [s]; scans that are still in memory then are counted as lost.
        """
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        deadline = self._clock.monotonic_ns() + round(timeout_s * NS)
        if not self._wait_for(self._thread, deadline):
            self._given_up = True
            self._wait_for(self._thread, deadline + round(_STOP_TIMEOUT_S * NS))
        self._syncer.stop()
        self._wait_for(self._syncer.thread, deadline)
        self._count_lost()
        return self.statistics(final=True)

    def _wait_for(self, thread: threading.Thread, deadline_ns: int) -> bool:
        """Wait for a thread to end; False when it is still in a system call at the deadline."""
        while thread.is_alive():
            thread.join(0.005)
            now_ns = self._clock.monotonic_ns()
            if thread.is_alive():
                if now_ns >= deadline_ns:
                    return False
                self._clock.sleep_until(now_ns + NS // 10)
        return True

    # ------------------------------------------------------------------------------------------ the writer's thread

    def _run(self) -> None:
        self._write_pending()  # opens the first file before the first scan
        while not self._given_up:
            items, closing = self._wait_for_change()
            self._pending.extend(_entry(item) for item in items)
            all_written = self._write_pending()
            if closing and all_written and self._is_empty() and self._close_segment(final=True):
                return
            if not all_written:
                self._pause()

    def _pause(self) -> None:
        """Wait before a failing card is tried again, each time twice as long up to _LONGEST_PAUSE_S."""
        until_ns = self._clock.monotonic_ns() + round(self._pause_s * NS)
        self._pause_s = min(2 * self._pause_s, _LONGEST_PAUSE_S)
        while not self._given_up and (now_ns := self._clock.monotonic_ns()) < until_ns:
            self._clock.sleep_until(min(until_ns, now_ns + round(self._config.retry_s * NS)))

    def _wait_for_change(self) -> tuple[list[Scan | Message], bool]:
        segment = self._segment
        begun_ns = segment.chunk_started_ns if segment is not None else None
        with self._changed:
            if not self._inbox:
                self._chunk_full_ns = None if begun_ns is None else begun_ns + self._chunk_ns
            self._writing = False
            self._changed.wait_for(
                lambda: self._chunk_is_full or self._closing or self._returned or self._failed(), self._idle_limit_s
            )
            items = list(self._inbox)
            self._inbox.clear()
            self._chunk_is_full = False
            self._writing = True
            return items, self._closing

    def _is_empty(self) -> bool:
        with self._changed:
            return not (self._inbox or self._returned or self._pending)

    def _failed(self) -> bool:
        return self._segment is not None and self._segment.failure is not None

    def _write_pending(self) -> bool:
        """Write all pending messages; False when no file can be written at present."""
        with self._changed:
            self._pending.extendleft(reversed(self._returned))
            self._returned.clear()
        while self._pending or self._segment is None or self._failed():
            if self._segment is None and not self._open_segment():
                return False
            segment = cast(OpenRecording, self._segment)
            try:
                self._fill(segment)
            except OSError as error:
                self._abandon(segment, error)
                if not segment.confirmed:
                    return False  # the next file would fail too, and fill the card with empty files
                self._pause_s = self._config.retry_s
        return self._flush_if_idle()

    def _fill(self, segment: OpenRecording) -> None:
        """Write pending messages into the segment, flushing it and ending it when due. Raises OSError when it fails."""
        if segment.failure is not None:
            raise segment.failure
        self._write_details(segment)
        while self._pending:
            entry = self._pending[0]
            self._time.update(entry)
            if segment.started_ns is None:
                segment.writer.log_time = self._time.best
            elif self._time.contradicts(segment.writer.log_time):
                self._close_segment(final=False)
                return
            if segment.started_ns is not None and entry.log_time_ns - segment.started_ns >= self._config.segment_s * NS:
                self._close_segment(final=False)
                return
            segment.add(entry)
            self._pending.popleft()
            if entry.topic == SCAN_TOPIC:
                with self._changed:
                    self._counters.written += 1
            if entry.log_time_ns - (segment.chunk_started_ns or 0) >= self._chunk_ns:
                self._flush(segment)

    def _flush(self, segment: OpenRecording) -> None:
        now_ns = self._clock.monotonic_ns()
        if self._reported_ns is None or now_ns - self._reported_ns >= self._config.statistics_s * NS:
            self._reported_ns = now_ns
            self._free = {"free_bytes": self._files.free_bytes(segment)}
            segment.writer.write_message(self.statistics())
        chunk_end_ns = (segment.chunk_started_ns or 0) + self._chunk_ns
        segment.writer.flush()
        segment.mark_flushed()
        segment.flushes += 1
        segment.chunk_started_ns = None
        self._write_latency.add((self._clock.monotonic_ns() - now_ns) // 1000)
        if chunk_end_ns - segment.synced_ns >= self._config.sync_s * NS - self._chunk_ns // 2:
            segment.synced_ns = chunk_end_ns
            self._syncer.request(segment)

    def _flush_if_idle(self) -> bool:
        """Flush a chunk that stays incomplete because no scan has come for long; False when the file fails."""
        segment = self._segment
        if segment is None or segment.chunk_started_ns is None:
            return True
        idle_ns = self._clock.monotonic_ns() - segment.chunk_started_ns
        if idle_ns >= self._idle_limit_s * NS:
            try:
                self._flush(segment)
            except OSError as error:
                self._abandon(segment, error)
                return False
        return True

    def _write_details(self, segment: OpenRecording) -> None:
        with self._changed:
            fresh = {k: v for k, v in self._new_details.items() if self._details.get(k) != v}
            self._new_details = {}
        if fresh:
            self._details.update(fresh)  # first, so that the next segment has them even if this one fails now
            segment.writer.add_detail(fresh)

    # ------------------------------------------------------------------------------------------ segments

    def _open_segment(self) -> bool:
        """Open the next segment; False when no directory can be written at present."""
        with self._changed:
            self._details.update(self._new_details)
            self._new_details = {}
        self._segment = self._files.open(self._details)
        if self._segment is None:
            return False
        self._segment.writer.log_time = self._time.best
        # Sync the header, so that the session shows even after a power cut in its first moments. If the syncer still has another
        # file, that goes first: its last scans matter more than this header.
        if not self._syncer.busy:
            self._syncer.request(self._segment)
        return True

    def _close_segment(self, *, final: bool) -> bool:
        """End the segment in order; its messages stay in memory until the card has confirmed them. False when it fails."""
        segment = self._segment
        if segment is None:
            return True
        try:
            segment.writer.write_message(self.statistics(final=final))
            segment.writer.finish()
        except OSError as error:
            self._abandon(segment, error)
            return False
        segment.mark_flushed()
        self._segment = None
        closed = self._syncer.retire(segment)
        while final and not closed.is_set() and not self._given_up:
            closed.wait(_IDLE_S)
        with self._changed:
            return not self._returned

    def _abandon(self, segment: OpenRecording, error: OSError) -> None:
        """Leave a file after an error; messages that the card has not confirmed go into the next one."""
        self._segment = None
        self._report_failure(f"{segment.path} given up ({error.strerror or error}); recording goes on in a new file")
        entries = self._take_unconfirmed(segment)
        self._pending.extendleft(reversed(entries))
        if segment.flushes:
            self._syncer.close_later(segment.file)
        else:
            self._files.remove(segment.path, segment.file)

    def _sync_failed(self, segment: OpenRecording, error: OSError, finished: bool) -> None:
        """Called in the sync thread when the sync of a segment has failed."""
        if finished:
            entries = self._take_unconfirmed(segment)
            text = f"{segment.path} did not reach the card ({error.strerror or error}); its last part is written again"
            _LOG.error(text)
        with self._changed:
            if finished:
                self._returned.extend(entries)
            else:
                segment.failure = error
            self._changed.notify_all()

    def _take_unconfirmed(self, segment: OpenRecording) -> list[RecordedMessage]:
        entries = segment.take_unconfirmed()
        with self._changed:
            self._counters.write_errors += 1
            self._counters.written -= sum(1 for e in entries if e.topic == SCAN_TOPIC)
            self._abandoned.append(segment.number)
        return entries

    def _count_lost(self) -> None:
        """Count the scans that are still in memory at the end as lost."""
        with self._changed:
            numbers = [i.number for i in self._inbox if isinstance(i, Scan)]
            numbers += [e.sequence for e in (*self._pending, *self._returned) if e.topic == SCAN_TOPIC]
            self._counters.lose(numbers)
            self._inbox.clear()

    def _report_failure(self, text: str, level: LogLevel = LogLevel.ERROR) -> None:
        """Write a line to the journal and into the next file, once while the same failure repeats."""
        if text in self._reports:
            return
        self._reports.append(text)
        _LOG.log(logging.WARNING if level is LogLevel.WARNING else logging.ERROR, text)
        line = LogLine(self._clock.monotonic_ns(), max(0, self._clock.utc_ns()), level, "recorder", text)
        self._pending.append(message_entry(line))


def _entry(item: Scan | Message) -> RecordedMessage:
    return scan_entry(item) if isinstance(item, Scan) else message_entry(item)
