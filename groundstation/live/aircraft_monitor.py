"""One aircraft on the ground station: calibrates its scans, shows them, watches limits, and detects the landing.

A monitor takes scans and events in order. It never waits: the view drops pictures rather than delay it.
"""

import math
import time as clock
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Protocol

from daq.contract.scan import Scan
from daq.contract.sequencing import Reason, State
from groundstation.calibration.apply import Calibrator
from groundstation.calibration.calibration_set import CalibrationSet
from groundstation.calibration.schema import CalibrationError
from groundstation.identification.session import LiveState
from groundstation.live.config import GroundConfig
from groundstation.live.readouts import FRESH_S, FreshValues, banner, readout_line
from groundstation.live.watches import AlarmChange, Alarms, AlarmState, FreeSpace, LandingWatch, Phase
from groundstation.receiver import events as ev
from groundstation.receiver.findings import legible

IN_FLIGHT_ONLY = ("V", "alpha")  # columns whose alarms count in flight only
_SEVERITY = {0: "CRITICAL", 1: "CRITICAL", 2: "CRITICAL", 3: "ERROR", 4: "WARN"}  # MAV_SEVERITY -> level
STATUS_PERIOD_S = 1.0
MOST_RECENT = 1000  # scans in memory, also from a sender whose time does not advance
RECENT_SPARE_S = 1.0  # of scans beyond those that prove a flight
READOUT_PERIOD_S = 0.25  # nobody reads digits faster


class MonitorView(Protocol):
    """The methods of a view that a monitor calls."""

    def sample(self, time_s: float, values: Mapping[str, float]) -> None: ...
    def states(self, time_s: float, states: Mapping[str, str]) -> None: ...
    def event(self, time_s: float, text: str, level: str = "INFO") -> None: ...
    def quality(self, time_s: float, report: ev.LinkStatistics) -> None: ...
    def status(self, time_s: float, markdown: str) -> None: ...
    def readouts(self, time_s: float, numbers: str, alarms: str, level: str) -> None: ...
    def identification(self, state: LiveState) -> None: ...


class AircraftMonitor:
    """State of one aircraft. system: its MAVLink system id. say: gets every line for the log: time [s], level, text. utc_ns:
    gives the time of day [ns since 1970]."""

    def __init__(
        self,
        config: GroundConfig,
        calibration: CalibrationSet,
        view: MonitorView | None,
        say: Callable[[float, str, str], None],
        system: int = 1,
        utc_ns: Callable[[], int] = clock.time_ns,
    ) -> None:
        self.system = system
        self._utc_ns = utc_ns
        self._station_calibration = self._calibration = calibration
        self.calibrator = Calibrator(calibration)
        self._view = view
        self._say = say
        self._alarms = Alarms(config.alarms)
        self._landing_config = config.handover.landing
        self._landing = LandingWatch(self._landing_config)
        self._air_facts: dict[str, str] = {}
        self._recent: deque[Scan] = deque(maxlen=MOST_RECENT)
        self._logger: ev.LoggerStatus | None = None
        self._sequencer: ev.SequencerStatus | None = None
        self._link: ev.LinkStatistics | None = None
        self._backfill: ev.BackfillProgress | None = None
        self._last_heard_ns: int | None = None
        self._next_status = self._next_readout = -math.inf
        self._fresh = FreshValues()
        self._disk = ""
        self.time = 0.0

    @property
    def phase(self) -> Phase:
        return self._landing.phase

    def show_identification(self, state: LiveState) -> None:
        if self._view is not None:
            self._view.identification(state)

    def acknowledge(self) -> None:
        """Clear latched alarms."""
        self._announce(self._alarms.acknowledge(self.time))

    def use_calibration(self, calibration: CalibrationSet, facts: Mapping[str, str]) -> None:
        """Calibrate with the aircraft's own set and facts from now on.

        An airspeed computed with other scales does not prove a flight. The last seconds are calibrated again, so that a flight
        under way is recognised at once, and with it a radio that falls silent at that moment.
        """
        self.calibrator = Calibrator(calibration, facts)
        self._calibration = calibration
        air = {key: text for key, text in facts.items() if key.startswith(("pitot.", "static."))}
        if air != self._air_facts:
            self._air_facts, self._landing = air, LandingWatch(self._landing_config)
            with suppress(CalibrationError):  # the next scan reports it
                for scan in self._recent:
                    self._landing.update(scan.time, self.calibrator.sample(scan))

    def _remember(self, scan: Scan) -> None:
        """Keep the scans that prove a flight."""
        if self._recent and scan.time < self._recent[-1].time:  # the logger has restarted
            self._recent.clear()
        self._recent.append(scan)
        while scan.time - self._recent[0].time > self._landing_config.flying_s + RECENT_SPARE_S:
            self._recent.popleft()

    def scan(self, scan: Scan, *, late: bool = False, received_ns: int | None = None) -> bool:
        """Take one scan; True when it shows that the flight has ended. late: fetched later, so shown nowhere."""
        self._last_heard_ns = received_ns
        values = self._calibrated(scan)
        if late:
            return False
        self.time = scan.time
        states = {group: status.state.words for group, status in scan.groups.items()}
        unusable = [
            f"{group} ({status.state.words})"
            for group, status in scan.groups.items()
            if not (status.state.usable or status.state.words in ("off", "stale"))
        ]
        self._remember(scan)
        landed = self._landing.update(scan.time, values)
        watched = {k: v for k, v in values.items() if k not in IN_FLIGHT_ONLY or self.phase is Phase.FLYING}
        if scan.groups:
            watched["sensors.unusable"] = float(len(unusable))
        self._announce(self._alarms.update(scan.time, watched, {"sensors.unusable": ", ".join(unusable)}))
        if self._view is not None:
            self._view.sample(scan.time, values)
            self._view.states(scan.time, states)
            self._fresh.update(scan.time, values)
            if scan.time >= self._next_readout:
                self._show_readouts(self._view, scan.time)
            if scan.time >= self._next_status:
                self._next_status = scan.time + STATUS_PERIOD_S
                self._view.status(scan.time, self.status_page())
        if landed:
            self.note("INFO", "landed: the flight has ended")
        return landed

    def _show_readouts(self, view: MonitorView, time: float, quiet: float = 0.0) -> None:
        """Show the present numbers and alarms, with the time of day, by which a person sees that a browser lags. quiet: time
        since the last scan [s]."""
        self._next_readout = time + READOUT_PERIOD_S
        level, alarms = banner(self._alarms.in_force())
        link = "" if self._link is None else f"link {self._link.scan_rate_hz:.0f} Hz, "
        link = f"no data for {quiet:.0f} s, " if quiet > FRESH_S else link
        link += clock.strftime("%H:%M:%S", clock.localtime(self._utc_ns() / 1e9))
        view.readouts(time, readout_line(self._fresh.at(time), link), alarms, level)

    def _calibrated(self, scan: Scan) -> dict[str, float]:
        """Columns of a scan; by the station's own set once the aircraft's has proved unusable."""
        try:
            return self.calibrator.sample(scan)
        except CalibrationError as error:
            if self._calibration is self._station_calibration:
                raise
            self.note("WARN", f"the aircraft's calibration is not usable: {error}; the station's own is used")
            self.use_calibration(self._station_calibration, {})
            return self.calibrator.sample(scan)

    def silence(self, now_ns: int) -> None:
        """Watch for telemetry that has stopped. Call it often."""
        if self._last_heard_ns is None:
            return
        quiet = (now_ns - self._last_heard_ns) * 1e-9
        if self.phase is Phase.FLYING:
            self._announce(self._alarms.update(self.time + quiet, {"link.silence_s": quiet}))
        if self._view is not None and quiet > FRESH_S and self.time + quiet >= self._next_readout:
            self._show_readouts(self._view, self.time + quiet, quiet)  # without scans nothing else does

    def disk(self, space: FreeSpace) -> None:
        """Take the free space of this computer's disk: for the status page and its alarms."""
        self._disk = space.words
        self._announce(self._alarms.update(self.time, space.values))

    def take_event(self, event: ev.Event) -> None:
        """Take an event other than a scan."""
        match event:
            case ev.StatusText(severity=severity, text=text):
                self.note(_SEVERITY.get(severity, "INFO"), text)
            case ev.EventMarked(time_monotonic_ns=at, origin=origin, text=text):
                self.note("INFO", f"event ({origin}): {text}", at * 1e-9)
            case ev.CommandResult(words=words, accepted=accepted, command=command):
                self.note("INFO" if accepted else "WARN", f"command {command}: {words}")
            case ev.ManoeuvreSent(digest=digest, words=words, taken=taken):
                self.note("INFO" if taken else "WARN", f"manoeuvre {digest[:6]}: {words}")
            case ev.ReceptionFinding():
                self.note("WARN", event.text)
            case ev.Restarted(previous=previous) if previous is not None:
                self.note("WARN", "the aircraft's logger has started anew: scan numbers begin again")
                self.calibrator = Calibrator(self._calibration)
            case ev.LinkStatistics():
                self._link = event
                self._announce(self._alarms.update(self.time, {"link.loss_percent": 100 * event.loss}))
                if self._view is not None:
                    self._view.quality(self.time, event)
            case ev.Trouble(what=what, words=words) if self._view is not None:
                self._view.event(self.time, f"{what}: {words or 'works again'}", "INFO" if words is None else "WARN")
            case ev.BackfillProgress(held=held, agreed=agreed):
                if agreed and not (self._backfill is not None and self._backfill.agreed):
                    self.note("INFO", f"air and ground agree: {held} scans")
                self._backfill = event
            case ev.SequencerStatus():
                self._sequencer = event
            case ev.LoggerStatus():
                self._logger = event
                self._announce(self._alarms.update(self.time, {"recorder.recording": float(event.recording)}))

    def _announce(self, changes: list[AlarmChange]) -> None:
        for change in changes:
            level = change.level if change.state is AlarmState.ACTIVE else "INFO"
            self.note(level, change.text, change.time)

    def note(self, level: str, text: str, time: float | None = None) -> None:
        """Report a line in the log and in the view. time: of the flight [s], now by default."""
        time, text = self.time if time is None else time, legible(text)
        self._say(time, level, text)
        if self._view is not None:
            self._view.event(time, text, level)

    def status_page(self) -> str:
        """The status page as Markdown."""
        lines = [f"**{self.phase.value}**  t = {self.time:.1f} s", ""]
        if self._logger is not None:
            s = self._logger
            free = "unknown" if s.free_bytes is None else f"{s.free_bytes / 1e6:.0f} MB"
            state = "recording" if s.recording else "**NOT RECORDING**"
            lines += [
                f"- recorder: {state}, {s.written} scans written, {s.dropped} dropped, {s.lost} lost, queue {s.queue}",
                f"- timing: 99 % within {s.lateness_p99_us / 1000:.1f} ms, {s.missed} slots missed",
                f"- card: {free} free, {s.write_errors} write errors",
            ]
        if self._sequencer is not None:
            lines.append(f"- sequencer: {_sequencer_words(self._sequencer)}")
        if self._link is not None:
            latency = "unknown" if self._link.latency_s is None else f"{1e3 * self._link.latency_s:.0f} ms"
            lines.append(
                f"- link: {self._link.scan_rate_hz:.1f} Hz, {100 * self._link.loss:.1f} % lost, latency {latency}"
            )
        if self._backfill is not None:
            b = self._backfill
            lines.append(
                f"- backfill: {b.held} of {b.wanted} scans here in full{', air and ground agree' if b.agreed else ''}"
            )
        lines += [f"- disk here: {self._disk}"] if self._disk else []
        in_force = self._alarms.in_force()
        lines.append("")
        lines += [f"- **{level}** {name} ({state.value})" for name, state, level in in_force] or ["no alarms"]
        return "\n".join(lines)


def _sequencer_words(status: ev.SequencerStatus) -> str:
    """State, its duration, increments and reason of the sequencer; unknown numbers, of a later release, stay numbers."""
    state = _enum_words(State, status.state)
    reason = _enum_words(Reason, status.reason)
    increments = ", ".join(f"{math.degrees(value):+.1f}" for value in status.increments)
    return f"{state} for {status.elapsed_s:.1f} s, e a r {increments} deg" + (f" ({reason})" if reason else "")


def _enum_words(kind: type[State] | type[Reason], number: int) -> str:
    member: State | Reason | None = kind._value2member_map_.get(number)  # type: ignore[assignment]
    return f"{kind.__name__.lower()} {number}" if member is None else member.words
