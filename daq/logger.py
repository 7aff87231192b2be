"""The logger: scans on absolute deadlines, handed to the recorder and the downlink.

The loop owns no hardware. It is given a clock, a sampler, a recorder and perhaps a link, their edges real or simulated, and
cannot tell which. Its deadlines are multiples of the period from one start, so that lateness never adds up; a slot that has
passed is skipped and its number never used, and the recorder counts it as missed, also before the first scan of a
recording and after its last.

Every scan is read on its deadline. What comes after, the attitude, recorder and radio, can be done for several scans
together: between two scans the caches run empty, and to fill them is half of what a scan costs.
"""

import logging
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from daq.acquisition.air_truth import AirTruth
from daq.acquisition.health import as_message, repetitions
from daq.acquisition.sampler import EventMark, Sampler, UnfinishedScan
from daq.actuation.actuation import Actuation
from daq.clock import NS, Clock
from daq.companion.process import Companion
from daq.contract.link.commands import parse_pitot_zero, pitot_zero_text
from daq.contract.manoeuvre import ManoeuvreCheck
from daq.contract.recordings.messages import EventMessage, LogLevel, SequencerFrame, Statistics
from daq.contract.scan import Scan, SensorState
from daq.recorder.counts import LoopTiming
from daq.recorder.recorder import Recorder
from daq.telemetry.link import RadioLink
from daq.telemetry.uplink import Uplink

_LOG = logging.getLogger("sideslip.logger")

_HOUSEKEEPING_NS = NS
_HEALTH_PAUSE_NS = NS // 5  # between two health reports of a flapping sensor
_GONE = (SensorState.ABSENT, SensorState.STUCK, SensorState.FAULT)  # said on the ground display, required or not
_DEAF_NS = NS  # so long the uplink may be passed over because a scan is due, before it has its turn all the same


@dataclass(frozen=True, slots=True)
class Opening:
    """A line for the log at the start of a recording, such as an overridden preflight check."""

    level: LogLevel
    name: str
    text: str


class Logger:
    """Runs the scan loop.

    rate_hz: scans a second. together: how many of them are finished and handed over at a time.
    recorder: takes the first recording; `new_recorder` makes the ones begun by command.
    `connect` adds a link that itself needs the logger.
    timing: the histograms that the recorder reports; give the recorder the same object.
    housekeeping: called about once a second in the slack after a scan (watchdog, garbage collection).
    """

    def __init__(
        self,
        rate_hz: float,
        clock: Clock,
        sampler: Sampler,
        recorder: Recorder,
        downlink: RadioLink | None = None,
        uplink: Uplink | None = None,
        *,
        together: int = 1,
        timing: LoopTiming | None = None,
        new_recorder: Callable[[], Recorder] | None = None,
        housekeeping: Callable[[], None] = lambda: None,
        opening: Iterable[Opening] = (),
    ) -> None:
        self.timing = timing or LoopTiming()
        self._period_ns = round(NS / rate_hz)
        self._clock = clock
        self._sampler = sampler
        self._recorder: Recorder | None = recorder
        self._new_recorder = new_recorder
        self._downlink = downlink
        self._uplink = uplink
        self._housekeeping = housekeeping
        self._opening = tuple(opening)
        self._number = 0
        self._last_begun = -1  # number of the last slot in which a scan was begun
        self._first = 0  # number of the slot at `_start_ns`
        self._start_ns: int | None = None  # None before the first slot
        self._heard_ns = clock.monotonic_ns()
        self._states: dict[str, SensorState] = {}
        self._health_due = True
        self._health_words = ""
        self._next_health_ns = 0
        self._next_housekeeping_ns = 0
        self._last_scan_ns: int | None = None
        self._together = together
        self._unfinished: list[UnfinishedScan] = []  # not handed over yet
        self._newest: UnfinishedScan | None = None
        self._link_fault = ""
        self._actuator: Actuation | None = None
        self._listener: Companion | None = None
        self._truth: AirTruth | None = None
        self._closers: list[threading.Thread] = []
        self._last_books: Statistics | None = None
        self._recordings_ended = 0  # recordings given up for closing
        self._books_of = 0  # the one of them whose books `_last_books` are
        sampler.on_event = self._switch

    def connect(self, downlink: RadioLink, uplink: Uplink | None) -> None:
        """Give the logger its link, before it runs."""
        self._downlink, self._uplink = downlink, uplink

    def actuate(self, actuator: Actuation) -> None:
        """Give the logger what moves controls, before it runs; scans are then to be handed over one by one."""
        if self._together != 1:
            raise ValueError("controls cannot wait for several scans to be finished together")
        self._actuator = actuator

    def listen(self, listener: Companion) -> None:
        """Give the logger somebody who looks at scans, before it runs."""
        self._listener = listener

    def judge(self, truth: AirTruth) -> None:
        """Give the logger what holds the sensors against each other, before it runs."""
        self._truth = truth

    # ------------------------------------------------------------------------------------------ the loop

    def run(self, stop: Callable[[], bool]) -> Statistics:
        """Scan until `stop()` is true, then end the recording in order; returns its books.

        The recording is also ended in order when anything raises.
        """
        try:
            self._begin()
            self._scan_until(stop)
        finally:
            if self._actuator is not None:
                self._actuator.close()
            if self._listener is not None:
                self._listener.close()
            books = self._end()
        return books

    def _scan_until(self, stop: Callable[[], bool]) -> None:
        self._start_ns = self._clock.monotonic_ns() + self._period_ns
        self._first = self._number
        try:
            while not stop():
                deadline = self._deadline(self._number)
                self._clock.sleep_until(deadline)
                try:
                    self._one_scan(deadline)
                finally:
                    self._number = self._next_number()
        finally:
            self._hand_over()

    def _deadline(self, number: int) -> int:
        return (self._start_ns or 0) + (number - self._first) * self._period_ns

    def _next_number(self) -> int:
        """The slot that would be served next: the one under way, or the one after the last that was tried."""
        if self._start_ns is None:
            return self._number
        under_way = self._first + (self._clock.monotonic_ns() - self._start_ns) // self._period_ns
        return max(self._last_begun + 1, under_way)

    def _begin(self) -> None:
        summary = self._sampler.start()
        if self._listener is not None:
            self._listener.start(self._sampler.metadata())
        if self._recorder is not None:
            self._start(self._recorder)
        for line in self._opening:
            self.say(line.level, line.name, line.text)
        self.say(LogLevel.INFO, "logger", f"recording begins: {summary.words}")

    def _start(self, recorder: Recorder) -> None:
        recorder.detail(self._sampler.metadata())
        recorder.reach(self._next_number())
        recorder.start()

    def _one_scan(self, deadline: int) -> None:
        self._last_begun = self._number
        started = self._clock.monotonic_ns()
        self._newest = self._sampler.take(self._number, deadline)
        ended_ns = self._clock.monotonic_ns()
        self._note_timing(deadline, started, ended_ns)
        self._unfinished.append(self._newest)
        if len(self._unfinished) >= self._together:
            self._hand_over()
            if ended_ns >= self._next_housekeeping_ns:
                self._next_housekeeping_ns = ended_ns + _HOUSEKEEPING_NS
                self._housekeeping()

    def _hand_over(self) -> None:
        """Finish what was taken and give it to recorder and radio."""
        unfinished, self._unfinished = self._unfinished, []
        if not unfinished:
            return
        scans = [self._sampler.finish(t) for t in unfinished]
        for scan in scans:
            if self._actuator is not None:
                self._actuator.frame(scan, self)
            if self._recorder is not None:
                self._recorder.scan(scan)
            self._watch_states(scan)
            if self._truth is not None:
                self._judge(self._truth, scan)
        if self._health_due:
            self._report(self._clock.monotonic_ns())
        self._serve_link(scans)
        if self._listener is not None:
            self._listener.scans(scans)

    def _note_timing(self, deadline: int, started: int, ended: int) -> None:
        timing = self.timing
        timing.lateness.add((started - deadline) // 1000)
        timing.scan_duration.add((ended - started) // 1000)
        if started - deadline > self._period_ns // 10:
            timing.late += 1
        if self._last_scan_ns is not None:
            timing.interval_error.add((started - self._last_scan_ns - self._period_ns) // 1000)
        self._last_scan_ns = started

    def _serve_link(self, scans: Iterable[Scan]) -> None:
        """Let the radio have its turn; answers leave at once. A port that fails must not stop the recording; it is said once."""
        try:
            if self._downlink is not None:
                for scan in scans:
                    self._downlink.offer(scan)
            if self._uplink is not None and self._may_listen():
                self._uplink.service(self._heard_ns, self)
            if self._downlink is not None:
                self._downlink.service(self._clock.monotonic_ns())
        except OSError as error:
            fault = error.strerror or str(error)
            if fault != self._link_fault:
                self._link_fault = fault
                self.say(LogLevel.ERROR, "link", f"radio port fails ({fault}); recording goes on")
        else:
            if self._link_fault:
                self._link_fault = ""
                self.say(LogLevel.INFO, "link", "radio port works again")

    def _may_listen(self) -> bool:
        """Whether the uplink has its turn now: not while a scan is due already, but now and then in any case."""
        now_ns = self._clock.monotonic_ns()
        if now_ns >= self._deadline(self._last_begun + 1) and now_ns - self._heard_ns < _DEAF_NS:
            return False
        self._heard_ns = now_ns
        return True

    # ------------------------------------------------------------------------------------------ health and books

    def _watch_states(self, scan: Scan) -> None:
        for group, status in scan.groups.items():
            if self._states.get(group) is not status.state:
                self._states[group] = status.state
                self._health_due = True

    def _judge(self, truth: AirTruth, scan: Scan) -> None:
        """Say which sensors contradict each other, and zero the pitot before the first motion."""
        for contradiction in truth.check(scan):
            self.say(LogLevel.WARNING, "sensors", contradiction.text)
        rest = truth.zero()
        if rest is not None:
            self.mark_event(pitot_zero_text(rest.count, rest.scans), "logger")
            self.say(LogLevel.WARNING, "pitot", f"pitot rested at {rest.words}: zeroed before motion")

    def _report(self, now: int) -> None:
        """A health report at every change of a sensor's state, and a sentence with it."""
        if now < self._next_health_ns:
            return
        self._health_due = False
        self._next_health_ns = now + _HEALTH_PAUSE_NS
        summary = self._sampler.health()
        if self._recorder is not None:
            self._recorder.message(as_message(summary, self._clock.utc_ns(), self._number))
            self._recorder.detail(self._sampler.metadata())
        if summary.words != self._health_words:
            self._health_words = summary.words
            any_gone = any(g.state in _GONE for g in summary.failing)
            self.say(LogLevel.WARNING if any_gone or not summary.ready else LogLevel.INFO, "sensors", summary.words)

    # ------------------------------------------------------------------------------------------ control

    @property
    def recording(self) -> bool:
        """Whether a recording is under way."""
        return self._recorder is not None

    def start_recording(self) -> bool:
        """Begin a new recording session; False when one is under way or none can be made."""
        if self._recorder is not None or self._new_recorder is None:
            return False
        self._hand_over()
        self._recorder = self._new_recorder()
        self._start(self._recorder)
        self._health_due = True
        self.say(LogLevel.INFO, "logger", "recording begins by command")
        return True

    def stop_recording(self) -> bool:
        """End the recording session; scans go on being made and sent. False when none is under way."""
        self._hand_over()
        recorder = self._recorder
        if recorder is None:
            return False
        self.say(LogLevel.INFO, "logger", "recording ends by command")
        self._recorder = None
        recorder.reach(self._next_number())
        self._recordings_ended += 1
        closer = threading.Thread(
            target=self._close, args=(recorder, self._recordings_ended), name="recorder-close", daemon=True
        )
        closer.start()  # a bad card may take its time; the scan loop does not wait for it
        self._closers = [c for c in self._closers if c.is_alive()] + [closer]
        return True

    def statistics(self) -> Statistics | None:
        """The books of the recording under way, or of the last one; None before there was one."""
        return self._recorder.statistics() if self._recorder is not None else self._last_books

    def mark_event(self, text: str, origin: str) -> EventMessage:
        """Record an event marker at the present scan and tell the ground."""
        zero = parse_pitot_zero(text)
        if zero is not None and self._truth is not None:
            self._truth.zeroed(zero)
        return self._mark(self._clock.monotonic_ns(), self._number, text, origin)

    def request_sequencer(self, digest: int | None) -> str:
        """Pass the ground's wish on, to start the manoeuvre of this digest or (None) to stop; why not, empty when taken."""
        return "there is no sequencer on board" if self._actuator is None else self._actuator.request(digest)

    @property
    def check_manoeuvre(self) -> ManoeuvreCheck | None:
        """What weighs a manoeuvre that comes up the link; None without a sequencer."""
        return None if self._actuator is None else self._actuator.check_manoeuvre

    def record_sequencer(self, frame: SequencerFrame, *, send: bool) -> bool:
        """Record a frame of the sequencer, False when it cannot be, and with `send` tell the ground."""
        if send and self._downlink is not None:
            self._downlink.sequencer(frame)
        return self._recorder is not None and self._recorder.message(frame)

    def say(self, level: LogLevel, name: str, text: str) -> None:
        """Put a line into the recording, the journal, and, from warnings up, on the downlink."""
        _LOG.log(_PYTHON_LEVEL[level], "%s: %s", name, text)
        if self._recorder is not None:
            self._recorder.log(level, name, text)
        if self._downlink is not None and level >= LogLevel.WARNING:
            self._downlink.text(_SYSLOG[level], text)

    def _switch(self, mark: EventMark) -> None:
        self._mark(mark.time_monotonic_ns, mark.scan_number, "event switch", mark.source)

    def _mark(self, time_ns: int, number: int, text: str, origin: str) -> EventMessage:
        event = EventMessage(time_ns, self._utc(time_ns), number, origin, text)
        if self._recorder is not None:
            self._recorder.message(event)
        if self._downlink is not None:
            self._downlink.event(event)
        return event

    def _utc(self, time_ns: int) -> int:
        """UTC of a monotonic time by the newest scan; 0 while unknown."""
        scan = self._newest
        return scan.time_utc_ns + time_ns - scan.time_monotonic_ns if scan is not None and scan.time_utc_ns else 0

    # ------------------------------------------------------------------------------------------ the end

    def _end(self) -> Statistics:
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            summary = self._sampler.health()
            recorder.message(as_message(summary, self._clock.utc_ns(), self._number))
            recorder.log(LogLevel.INFO, "logger", f"recording ends{repetitions(summary)}")
            recorder.reach(self._number)
            self._recordings_ended += 1
            self._close(recorder, self._recordings_ended)
        for closer in self._closers:
            while closer.is_alive():
                closer.join(0.005)
                self._clock.sleep_until(self._clock.monotonic_ns() + NS // 10)
        if self._last_books is None:
            raise RuntimeError("the logger had no recorder")
        return self._last_books

    def _close(self, recorder: Recorder, which: int) -> None:
        books = recorder.close()
        if books.lost or books.dropped:
            _LOG.error("%d scans could not be written, %d were dropped", books.lost, books.dropped)
        if which > self._books_of:  # one that was ended earlier may take longer
            self._last_books, self._books_of = books, which


_PYTHON_LEVEL: Mapping[LogLevel, int] = {
    LogLevel.UNKNOWN: logging.INFO,
    LogLevel.DEBUG: logging.DEBUG,
    LogLevel.INFO: logging.INFO,
    LogLevel.WARNING: logging.WARNING,
    LogLevel.ERROR: logging.ERROR,
    LogLevel.FATAL: logging.CRITICAL,
}
_SYSLOG: Mapping[LogLevel, int] = {LogLevel.WARNING: 4, LogLevel.ERROR: 3, LogLevel.FATAL: 2}
