"""Live identification of every aircraft that a station receives: runs the estimator once the aircraft is named, reports and
forwards its estimates, and gives the result for the finished flight.

Reception is never delayed or ended: work is done in small pieces, and each fault is reported once.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from daq.contract.recordings.recording import AIRCRAFT_ATTACHMENT, RecordingInfo
from daq.contract.scan import Scan
from daq.identification.movement import ManoeuvreDetector
from daq.identification.regression import AircraftSource, LiveAircraft
from daq.transport.mavlink_codec import FrameEncoder, message_by_name
from daq.transport.ports import BytePort
from daq.utilities.errors import UserError
from groundstation.identification.alignment import ScanAlignment
from groundstation.identification.history import BELIEVED, final_json
from groundstation.identification.session import LiveIdentification, LiveState
from groundstation.identification.watching import LiveWatch
from groundstation.identification.words import estimate_text, short_line
from groundstation.live.aircraft_monitor import AircraftMonitor
from groundstation.live.config import LiveIdentificationConfig
from groundstation.live.watches import LandingLimits
from groundstation.receiver.events import Session
from groundstation.receiver.ports import open_port

UNNAMED_S = 15.0  # of reception without an aircraft's name, after which this is reported
UNNAMED = (
    "live identification waits: the recording has not named its aircraft yet; name one with --aircraft NAME or FILE, or "
    '[identification] aircraft = "..."'
)


@dataclass
class _SessionRun:
    """Live identification of one session of an aircraft. announced: derivatives already reported as identified. first: time of
    the first scan [s]. next_line_s: time of the next line of estimates [s]. given_up: whether the aircraft file or the estimator
    failed."""

    monitor: AircraftMonitor
    alignment: ScanAlignment = field(default_factory=ScanAlignment)
    live: LiveIdentification | None = None
    announced: set[str] = field(default_factory=set)
    first: float = math.nan
    next_line_s: float = -math.inf
    unnamed_reported: bool = False
    given_up: bool = False
    watch_reported: bool = False


class LiveIdentifications:
    """Live identification of all sessions. Call `take_scan` and `take_fetched` with every scan, and `step` often.

    landing: limits of speed and time from which the aircraft flies. source: reads aircraft files; None switches live
    identification off. say: prints a line that concerns no aircraft.
    """

    def __init__(
        self,
        config: LiveIdentificationConfig,
        landing: LandingLimits,
        source: AircraftSource | None,
        say: Callable[[str], None],
    ) -> None:
        self._config = config
        self._landing = (landing.flying_speed, landing.flying_s)
        self._source = source if config.enabled else None
        self._runs: dict[Session, _SessionRun] = {}
        self._forward = NamedValues(config.forward if self._source is not None else (), say)
        if self._source is not None and config.aircraft:
            self._source(config.aircraft, None, config.model)  # raises for a mistake at the start, not in flight

    def take_scan(self, session: Session, scan: Scan, monitor: AircraftMonitor) -> None:
        if self._source is None:
            return
        run = self._run(session, monitor)
        if math.isnan(run.first):
            run.first = scan.time
        run.alignment.add(scan)
        if run.live is None and not (run.unnamed_reported or run.given_up) and scan.time - run.first > UNNAMED_S:
            run.unnamed_reported = True
            monitor.note("INFO", UNNAMED)

    def take_fetched(self, session: Session, data: bytes, monitor: AircraftMonitor) -> None:
        """Take a scan from backfill, in the bytes of the recording."""
        if self._source is not None:
            self._run(session, monitor).alignment.add(data)

    def _run(self, session: Session, monitor: AircraftMonitor) -> _SessionRun:
        """The run of a session; a new one begins at once if the configuration names the aircraft."""
        run = self._runs.get(session)
        if run is None:
            run = self._runs[session] = _SessionRun(monitor)
            if self._config.aircraft:
                self._begin(run, self._config.aircraft, None)
        return run

    def begin(self, session: Session, info: RecordingInfo, monitor: AircraftMonitor) -> None:
        """Take the identity of the recording: its aircraft, and its calibration, which the monitor uses already."""
        if self._source is None:
            return
        run = self._run(session, monitor)
        if run.live is not None:
            run.live.use(monitor.calibrator)
        elif info.aircraft:
            aircraft_file = info.attachments.get(AIRCRAFT_ATTACHMENT)
            if aircraft_file is None and run.given_up:
                return
            self._begin(run, info.aircraft, None if aircraft_file is None else aircraft_file.decode("utf-8", "replace"))

    def _begin(self, run: _SessionRun, name: str, text: str | None) -> None:
        assert self._source is not None
        try:
            aircraft: LiveAircraft = self._source(name, text, self._config.model)
        except UserError as error:
            run.given_up = True
            run.monitor.note("WARN", f"no live identification: {error}")
            return
        run.given_up = False
        run.live = LiveIdentification(
            aircraft,
            run.monitor.calibrator,
            self._config.wanted,
            run.alignment,
            ManoeuvreDetector(*self._landing, aircraft.regressions),
            watched=self._config.watch,
        )
        watched_model = (
            f"; the gap monitor holds flight against {self._config.model}" if aircraft.modelled is not None else ""
        )
        run.monitor.note("INFO", f"live identification of {aircraft.name} begins{watched_model}")

    def step(self) -> None:
        """Process received scans, and report new estimates, alarms and troubles."""
        for run in self._runs.values():
            if run.live is None:
                continue
            state = run.live.step()
            self._report_alarms(run, finish=False)
            if state is not None:
                self._report_state(run, state)
            elif run.live.trouble and not run.given_up:
                run.given_up = True
                run.monitor.note("WARN", run.live.trouble)

    def _report_alarms(self, run: _SessionRun, *, finish: bool) -> None:
        watch = None if run.live is None else run.live.watch
        if watch is None:
            return
        for alarm in watch.step(finish=finish):
            run.monitor.note("WARN", f"gap monitor: {alarm.text}")
        if watch.trouble and not run.watch_reported:
            run.watch_reported = True
            run.monitor.note("WARN", watch.trouble)

    def _report_state(self, run: _SessionRun, state: LiveState) -> None:
        run.monitor.show_identification(state)
        self._forward.send(run.monitor.system, state)
        derivatives = state.estimates.derivatives
        for name in (n for n in state.aircraft.shown if n not in run.announced and derivatives[n].told):
            run.announced.add(name)
            run.monitor.note("INFO", f"live: {name} identified: {estimate_text(derivatives[name])}")
        if run.announced and state.time >= run.next_line_s:
            run.next_line_s = state.time + self._config.lines_every_s
            run.monitor.note("INFO", short_line(state))

    def state(self, system: int) -> LiveState | None:
        """The latest state of an aircraft; None before there is one."""
        runs = [r for s, r in self._runs.items() if s.system == system and r.live is not None]
        return runs[-1].live.state if runs and runs[-1].live is not None else None

    def finish(self) -> None:
        """Process all remaining scans, and report the gap monitor's alarms on them."""
        for run in self._runs.values():
            if run.live is not None:
                run.live.finish()
                self._report_alarms(run, finish=True)

    def result(self, session: Session) -> Mapping[str, Any] | None:
        """The result for the provenance of the finished flight, after `finish`; None where nothing was identified."""
        run = self._runs.get(session)
        if run is None or run.live is None:
            return None
        state, watch = run.live.state, run.live.watch
        if state is None or not run.live.history:
            return None
        e = state.estimates
        return {
            "aircraft": state.aircraft.name,
            "span_s": e.span,
            "rows": e.rows,
            "not_moved": list(e.still),
            BELIEVED: {
                n: {"value": b.value, "std": b.std, "source": state.aircraft.sources.get(n, "")}
                for n, b in state.aircraft.airframe.beliefs.items()
            },
            "final": final_json(e),
            **({} if watch is None else self._watch_result(watch, run.live.aircraft)),
            "history": run.live.history.to_json(),
        }

    def _watch_result(self, watch: LiveWatch, aircraft: LiveAircraft) -> dict[str, Any]:
        watched_model = {} if aircraft.modelled is None else {"watched_model": self._config.model}
        return {"watched_s": watch.watched, **watched_model, "alarms": [asdict(a) for a in watch.alarms]}

    def close(self) -> None:
        self._forward.close()


COMPONENT = 192  # MAV_COMP_ID_ONBOARD_COMPUTER2: a computer of that aircraft other than the autopilot and the logger
STD = ".s"  # the end of the name of a bound; a name has ten bytes
_MILLISECONDS = 2**32  # range of time_boot_ms


class NamedValues:
    """Sends estimates as NAMED_VALUE_FLOAT to each port. say: prints a line, once for each failure of a port."""

    def __init__(self, ports: Sequence[str], say: Callable[[str], None]) -> None:
        self._ports: dict[str, BytePort] = {text: open_port(text) for text in ports}
        self._encoders: dict[int, FrameEncoder] = {}
        self._failing: set[str] = set()
        self._say = say

    def send(self, system: int, state: LiveState) -> None:
        """Send each identified derivative, and its bound as `<name>.s`."""
        if not self._ports:
            return
        encoder = self._encoders.setdefault(system, FrameEncoder(system, COMPONENT))
        message = message_by_name()["NAMED_VALUE_FLOAT"]
        boot_ms = int(state.time * 1e3) % _MILLISECONDS
        for name in state.aircraft.shown:
            d = state.estimates.derivatives[name]
            if d.told:
                for key, value in ((name, d.estimate), (name + STD, d.std)):
                    payload = message.pack({"time_boot_ms": boot_ms, "name": key, "value": value})
                    self._write(encoder.frame(message.msg_id, payload))

    def _write(self, frame: bytes) -> None:
        for text, port in self._ports.items():
            try:
                port.read()  # discard what arrives, so that the system's buffer does not fill
                port.write(frame)
                self._failing.discard(text)
            except OSError as error:
                if text not in self._failing:
                    self._failing.add(text)
                    self._say(f"values cannot be forwarded to {text} ({error.strerror or error})")

    def close(self) -> None:
        for port in self._ports.values():
            port.close()
