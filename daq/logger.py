"""The logger: takes scans on absolute deadlines and passes them to recorder and downlink.

Clock, sampler, recorder and link are passed in, real or simulated. Deadlines are multiples of the period from one start, so that
lateness does not accumulate. A slot that has passed is skipped, its number is never used, and the recorder counts it as missed,
also before the first scan of a recording and after its last.

Every scan is read on its deadline. The later work (attitude, recorder, radio) can be done for several scans together, because
half of the cost of a scan is refilling caches that were emptied between scans.
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
_GONE = (SensorState.ABSENT, SensorState.STUCK, SensorState.FAULT)  # sent to the ground for any sensor, required or not
_DEAF_NS = NS  # longest time for which the uplink may be skipped because a scan is due


@dataclass(frozen=True, slots=True)
class Opening:
    """A line for the log at the start of a recording, such as an overridden preflight check."""

    level: LogLevel
    name: str
    text: str


class Logger:
    """Runs the scan loop.

    rate_hz: scans a second. together: how many scans are finished and passed on at a time. recorder: of the first recording;
    new_recorder: makes those of recordings begun by command. downlink, uplink: the link, or `connect` adds one that itself needs
    the logger. timing: the histograms that the recorder reports; the recorder has the same object. housekeeping: called about
    once a second after a scan (watchdog, garbage collection). opening: lines for the log at the start.
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
        self._last_begun = -1  # number of the last slot in which a scan began
        self._first = 0  # number of the slot at `_start_ns`
        self._start_ns: int | None = None  # None before the first slot
        self._uplink_ns = clock.monotonic_ns()
        self._states: dict[str, SensorState] = {}
        self._health_due = True
        self._health_words = ""
        self._next_health_ns = 0
        self._next_housekeeping_ns = 0
        self._last_scan_ns: int | None = None
        self._together = together
        self._unfinished: list[UnfinishedScan] = []  # scans that are not finished and passed on yet
        self._newest: UnfinishedScan | None = None
        self._link_fault = ""
        self._actuator: Actuation | None = None
        self._companion: Companion | None = None
        self._truth: AirTruth | None = None
        self._closers: list[threading.Thread] = []
        self._last_statistics: Statistics | None = None
        self._recordings_ended = 0  # recordings whose closing has begun
        self._statistics_of = 0  # which of them `_last_statistics` belongs to
        sampler.on_event = self._switch

    def connect(self, downlink: RadioLink, uplink: Uplink | None) -> None:
        """Set the link, before `run`."""
        self._downlink, self._uplink = downlink, uplink

    def attach_actuation(self, actuator: Actuation) -> None:
        """Set the sequencer's actuation, before `run`. Raises ValueError unless scans are passed on one by one."""
        if self._together != 1:
            raise ValueError("controls cannot wait for several scans to be finished together")
        self._actuator = actuator

    def attach_companion(self, companion: Companion) -> None:
        """Set the companion process that gets all scans, before `run`."""
        self._companion = companion

    def check_air_truth(self, truth: AirTruth) -> None:
        """Set the check of sensors against each other, before `run`."""
        self._truth = truth

    # ------------------------------------------------------------------------------------------ the loop

    def run(self, stop: Callable[[], bool]) -> Statistics:
        """Scan until `stop()` is true, then end the recording in order, also after an exception. Returns its statistics."""
        try:
            self._begin()
            self._scan_until(stop)
        finally:
            if self._actuator is not None:
                self._actuator.close()
            if self._companion is not None:
                self._companion.close()
            statistics = self._end()
        return statistics

    def _scan_until(self, stop: Callable[[], bool]) -> None:
        self._start_ns = self._clock.monotonic_ns() + self._period_ns
        self._first = self._number
        try:
            while not stop():
                deadline = self._deadline(self._number)
                self._clock.sleep_until(deadline)
                try:
                    self._take_scan(deadline)
                finally:
                    self._number = self._next_number()
        finally:
            self._hand_over()

    def _deadline(self, number: int) -> int:
        return (self._start_ns or 0) + (number - self._first) * self._period_ns

    def _next_number(self) -> int:
        """Number of the next slot: the current one, or the one after the last in which a scan began."""
        if self._start_ns is None:
            return self._number
        under_way = self._first + (self._clock.monotonic_ns() - self._start_ns) // self._period_ns
        return max(self._last_begun + 1, under_way)

    def _begin(self) -> None:
        summary = self._sampler.start()
        if self._companion is not None:
            self._companion.start(self._sampler.metadata())
        if self._recorder is not None:
            self._start(self._recorder)
        for line in self._opening:
            self.say(line.level, line.name, line.text)
        self.say(LogLevel.INFO, "logger", f"recording begins: {summary.words}")

    def _start(self, recorder: Recorder) -> None:
        recorder.detail(self._sampler.metadata())
        recorder.reach(self._next_number())
        recorder.start()

    def _take_scan(self, deadline: int) -> None:
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
        """Finish the scans that were read and pass them to sequencer, recorder, radio and companion."""
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
        if self._companion is not None:
            self._companion.scans(scans)

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
        """Serve the radio; answers leave at once. A port that fails does not stop the recording and is reported once."""
        try:
            if self._downlink is not None:
                for scan in scans:
                    self._downlink.offer(scan)
            if self._uplink is not None and self._uplink_due():
                self._uplink.service(self._uplink_ns, self)
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

    def _uplink_due(self) -> bool:
        """Whether to serve the uplink now: not while a scan is due, but at least every _DEAF_NS."""
        now_ns = self._clock.monotonic_ns()
        if now_ns >= self._deadline(self._last_begun + 1) and now_ns - self._uplink_ns < _DEAF_NS:
            return False
        self._uplink_ns = now_ns
        return True

    # ------------------------------------------------------------------------------------------ health

    def _watch_states(self, scan: Scan) -> None:
        for group, status in scan.groups.items():
            if self._states.get(group) is not status.state:
                self._states[group] = status.state
                self._health_due = True

    def _judge(self, truth: AirTruth, scan: Scan) -> None:
        """Report sensors that contradict each other, and zero the pitot before the first motion."""
        for contradiction in truth.check(scan):
            self.say(LogLevel.WARNING, "sensors", contradiction.text)
        rest = truth.zero()
        if rest is not None:
            self.mark_event(pitot_zero_text(rest.count, rest.scans), "logger")
            self.say(LogLevel.WARNING, "pitot", f"pitot rested at {rest.words}: zeroed before motion")

    def _report(self, now: int) -> None:
        """Record the health of the sensors after a change of state, and log it where its sentence is new."""
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
        """Begin a new recording; False when one is under way or cannot be begun."""
        if self._recorder is not None or self._new_recorder is None:
            return False
        self._hand_over()
        self._recorder = self._new_recorder()
        self._start(self._recorder)
        self._health_due = True
        self.say(LogLevel.INFO, "logger", "recording begins by command")
        return True

    def stop_recording(self) -> bool:
        """End the recording; scans are still taken and sent. False when none is under way."""
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
        """Statistics of the current recording or, between recordings, of the last one; None before the first."""
        return self._recorder.statistics() if self._recorder is not None else self._last_statistics

    def mark_event(self, text: str, origin: str) -> EventMessage:
        """Record an event at the present scan and send it to the ground."""
        zero = parse_pitot_zero(text)
        if zero is not None and self._truth is not None:
            self._truth.zeroed(zero)
        return self._mark(self._clock.monotonic_ns(), self._number, text, origin)

    def request_sequencer(self, digest: int | None) -> str:
        """Start the manoeuvre whose digest begins with these 24 bits; None: stop. Returns why it is refused, or ""."""
        return "there is no sequencer on board" if self._actuator is None else self._actuator.request(digest)

    @property
    def check_manoeuvre(self) -> ManoeuvreCheck | None:
        """Checks a manoeuvre received by radio; None without a sequencer."""
        return None if self._actuator is None else self._actuator.check_manoeuvre

    def record_sequencer(self, frame: SequencerFrame, *, send: bool) -> bool:
        """Record a frame of the sequencer and, with `send`, send it to the ground. Returns whether it was recorded."""
        if send and self._downlink is not None:
            self._downlink.sequencer(frame)
        return self._recorder is not None and self._recorder.message(frame)

    def say(self, level: LogLevel, name: str, text: str) -> None:
        """Write a line to the recording and the journal and, from warnings up, send it to the ground."""
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
        if self._last_statistics is None:
            raise RuntimeError("the logger had no recorder")
        return self._last_statistics

    def _close(self, recorder: Recorder, which: int) -> None:
        statistics = recorder.close()
        if statistics.lost or statistics.dropped:
            _LOG.error("%d scans could not be written, %d were dropped", statistics.lost, statistics.dropped)
        if which > self._statistics_of:  # an earlier recording may close later
            self._last_statistics, self._statistics_of = statistics, which


_PYTHON_LEVEL: Mapping[LogLevel, int] = {
    LogLevel.UNKNOWN: logging.INFO,
    LogLevel.DEBUG: logging.DEBUG,
    LogLevel.INFO: logging.INFO,
    LogLevel.WARNING: logging.WARNING,
    LogLevel.ERROR: logging.ERROR,
    LogLevel.FATAL: logging.CRITICAL,
}
_SYSLOG: Mapping[LogLevel, int] = {LogLevel.WARNING: 4, LogLevel.ERROR: 3, LogLevel.FATAL: 2}
