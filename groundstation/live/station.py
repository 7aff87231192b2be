"""The ground station: receiver, one monitor per aircraft, views, and the hand-over at the end of a flight."""

import math
from collections.abc import Callable
from pathlib import Path

from daq.contract.recordings.recording import RecordingInfo
from daq.identification.regression import AircraftSource
from daq.utilities.rotating_log import RotatingLog
from groundstation.calibration.calibration_set import CalibrationSet, load_calibration
from groundstation.calibration.facts import reported
from groundstation.calibration.schema import CalibrationError
from groundstation.live.aircraft_monitor import AircraftMonitor, MonitorView
from groundstation.live.config import GroundConfig
from groundstation.live.identifying import LiveIdentifications
from groundstation.live.watches import FreeSpace, free_bytes
from groundstation.receiver import events as ev
from groundstation.receiver.findings import NOBODY, legible
from groundstation.receiver.receive import Receiver
from groundstation.receiver.timeline import NS, GroundClock

PAPERS_PERIOD_NS = 2 * NS  # between two looks at recordings' papers and the disk


class Station:
    """The ground station. Call `step` often; it never waits.

    make_view: makes the view of an aircraft, or None when it cannot. aircraft: reads aircraft files for live identification,
    which is off without it.
    """

    def __init__(
        self,
        config: GroundConfig,
        receiver: Receiver,
        clock: GroundClock,
        folder: Path,
        *,
        make_view: Callable[[int], MonitorView | None] | None = None,
        echo: Callable[[str], None] = lambda _: None,
        aircraft: AircraftSource | None = None,
    ) -> None:
        self.config, self.receiver, self.folder = config, receiver, folder
        self._clock = clock
        self._make_view = make_view
        self._echo = echo
        self.calibration = load_calibration(config.calibration.directory)
        self.monitors: dict[int, AircraftMonitor] = {}
        self.landed: list[int] = []
        self.replayed: Path | None = None  # a recording that was played instead of received
        self.replayed_as: ev.Session | None = None
        self.identifications = LiveIdentifications(config.identification, config.handover.landing, aircraft, self._note)
        self.space = FreeSpace()
        self._space_reported = False
        self._papers: set[str] = set()
        self._next_papers_ns = 0
        self._log = RotatingLog(folder / "events.log")

    def monitor(self, system: int) -> AircraftMonitor:
        """The monitor of an aircraft; made when the aircraft is first heard."""
        if system not in self.monitors:

            def say(time: float, level: str, text: str) -> None:
                self._note(f"{time:10.2f} s  aircraft {system}  {level:<8} {text}")

            view = None if self._make_view is None else self._make_view(system)
            self.monitors[system] = AircraftMonitor(
                self.config, self.calibration, view, say, system, self._clock.utc_ns
            )
            self._echo(f"aircraft {system} heard")
        return self.monitors[system]

    def _note_untimed(self, source: str, level: str, text: str) -> None:
        """Note a line without a time of flight. source: an aircraft or the ground station."""
        self._note(f"{'':10}    {source}  {level} {text}")

    def _note(self, line: str) -> None:
        """Print a line, and write it to the event log."""
        line = legible(line)
        self._echo(line)
        self._log.write((line + "\n").encode("utf-8", "backslashreplace"))
        with self.receiver.faults.watch("event log"):
            if self._log.trouble:
                raise OSError(self._log.trouble)

    def step(self) -> list[ev.Event]:
        """Act on everything received since the last call; gives the events."""
        events = self.receiver.poll()
        findings = self.receiver.findings
        for event in events:
            try:
                self._dispatch(event)
            except Exception as error:  # noqa: BLE001  data of a sender must not end the station: see ReceptionFindings
                findings.quarantine_error(_system(event), f"a {type(event).__name__}", error)
        with findings.guard(NOBODY, "live identification"):
            self.identifications.step()
        now_ns = self._clock.monotonic_ns()
        for system, monitor in self.monitors.items():
            with findings.guard(system, "its silence"):
                monitor.silence(now_ns)
        if now_ns >= self._next_papers_ns:
            self._next_papers_ns = now_ns + PAPERS_PERIOD_NS
            for session, recorder in self.receiver.session_recorders().items():
                with findings.guard(session.system, "what its recording says of itself"):
                    self._adopt_papers(session, recorder.info())
            self._check_disk(now_ns)
        return events

    def _dispatch(self, event: ev.Event) -> None:
        match event:
            case ev.ScanReceived(session=session):
                monitor = self.monitor(session.system)
                if monitor.scan(event.scan, late=event.late, received_ns=event.received_ns):
                    self.landed.append(session.system)
                self.identifications.take_scan(session, event.scan, monitor)
            case ev.ScanFetched(session=session, data=data):
                self.identifications.take_fetched(session, data, self.monitor(session.system))
            case ev.ReceptionFinding(system=system) if system not in self.monitors:
                if event.kind is not ev.ReceptionFindingKind.REFUSED:
                    self._note_untimed(f"aircraft {system}" if system else "ground station", "WARN", event.text)
            case ev.StatusText() | ev.CommandResult() | ev.ManoeuvreSent() | ev.ReceptionFinding():
                if event.system in self.monitors:
                    self.monitors[event.system].take_event(event)
            case ev.Heartbeat():
                pass
            case ev.Trouble(what=what, words=words):
                level = "INFO" if words is None else "WARN"
                self._note_untimed("ground station", level, f"{what}: {words or 'works again'}")
                for monitor in self.monitors.values():
                    monitor.take_event(event)
            case _:
                self.monitor(event.session.system).take_event(event)

    def _check_disk(self, now_ns: int) -> None:
        """Measure the free space of this computer's disk for each monitor's alarms, and report it once at the start."""
        with self.receiver.faults.watch("disk"):
            self.space.update(now_ns * 1e-9, free_bytes(self.folder))
        for system, monitor in self.monitors.items():
            with self.receiver.findings.guard(system, "the disk"):
                monitor.disk(self.space)
        if not (self._space_reported or math.isnan(self.space.megabytes)):
            self._space_reported = True
            self._note_untimed("ground station", "INFO", f"disk: {self.space.words}")

    def _adopt_papers(self, session: ev.Session, info: RecordingInfo) -> None:
        """Use the aircraft and the calibration that a recording's papers name, as soon as they have arrived."""
        if info.aircraft and (aircraft_key := f"{session.name}:{info.aircraft}") not in self._papers:
            self._papers.add(aircraft_key)
            self.identifications.begin(session, info, self.monitor(session.system))
        # checked to be text when they arrived
        texts = {n: d.decode("utf-8") for n, d in info.calibration.items() if n.endswith(".toml")}
        key = f"{session.name}:{len(texts)}:{len(info.details)}"
        if not (texts or info.details) or key in self._papers:
            return
        self._papers.add(key)
        facts, refused_facts = reported(info.details)
        for name, reason in refused_facts.items():
            self.receiver.findings.quarantine(session.system, f"fact {name}", reason)
        try:
            calibration = CalibrationSet.from_texts("embedded", texts) if texts else self.calibration
            self.monitor(session.system).use_calibration(calibration, facts)
        except CalibrationError as error:
            self.receiver.findings.quarantine(session.system, "its calibration", str(error))
            self.monitor(session.system).use_calibration(self.calibration, facts)
        self.identifications.begin(session, info, self.monitor(session.system))

    def close(self) -> None:
        """Write recordings, close every file and port, and report failures."""
        with self.receiver.findings.guard(NOBODY, "live identification"):
            self.identifications.finish()
        if scans := sum(r.journal.total for r in self.receiver.session_recorders().values()):
            self._echo(f"the session ends: {scans} scans are written as recordings")
        self.receiver.close()
        for event in self.receiver.faults.changes(self._clock.monotonic_ns()):
            self._dispatch(event)
        self.identifications.close()
        self._log.close()


def _system(event: ev.Event) -> int:
    """System id of the aircraft of an event; NOBODY for an event of the ground station itself."""
    session = getattr(event, "session", None)
    return session.system if isinstance(session, ev.Session) else int(getattr(event, "system", NOBODY))
