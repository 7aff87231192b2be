"""The sequencer with its output, a servo driver or an autopilot: each scan it observes, decides, and commands.

Every frame is recorded, and transitions are reported to the ground. The logger calls `frame` after each scan; requests from the
ground come through `request`.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from daq.actuation.autopilot.link import AutopilotError, AutopilotPort
from daq.actuation.autopilot.output import ArduPilotOutput
from daq.actuation.autopilot.trial import AutopilotTrial
from daq.actuation.config import SequencerConfig
from daq.actuation.motion import MotionReader
from daq.actuation.output import FrameObservation, Output, SequencerCommand
from daq.actuation.pwm.heartbeat import HeartbeatError, HeartbeatLine
from daq.actuation.pwm.output import PwmOutput
from daq.actuation.pwm.trial import ServoDriverTrial
from daq.actuation.sequencer import Sequencer
from daq.actuation.servos import ServoManoeuvre, TrialFinding, plan_of, servos_of
from daq.clock import NS, Clock
from daq.contract.manoeuvre import Manoeuvre
from daq.contract.recordings.messages import EventMessage, LogLevel, SequencerFrame
from daq.contract.scan import Scan
from daq.contract.sequencing import Reason, State
from daq.sensors.bus import I2cBus
from daq.sensors.config import SensorsConfig


@dataclass(frozen=True, slots=True)
class Devices:
    """The opened devices of an output, None where not opened. bus, heartbeat: for a servo driver behind a multiplexer;
    autopilot: the port to one that passes the pilot's signals on."""

    bus: I2cBus | None
    heartbeat: HeartbeatLine | None
    clock: Clock
    autopilot: AutopilotPort | None = None


def findings(config: SequencerConfig, devices: Devices, take_scan: Callable[[], Scan]) -> Iterator[TrialFinding]:
    """Results of the trial of the configured output. take_scan: samples the aircraft's sensors once, now."""
    if config.through == "ardupilot":
        if devices.autopilot is None:
            return iter([TrialFinding("sequencer", False, "no port to the autopilot is open; set sequencer.autopilot")])
        return AutopilotTrial(config, devices.autopilot, devices.clock, take_scan).findings()
    if devices.bus is None or devices.heartbeat is None:
        words = "no bus or heartbeat line is open; set sequencer.heartbeat"
        return iter([TrialFinding("sequencer", False, words)])
    return ServoDriverTrial(config, devices.bus, devices.heartbeat, devices.clock, take_scan).findings()


_ORDINARY = (Reason.NONE, Reason.COMPLETE, Reason.REACHED)


class Reporter(Protocol):
    """Takes the sequencer's reports for log, recording and ground; no call blocks."""

    @property
    def recording(self) -> bool:
        """Whether a recording is under way."""
        ...

    def say(self, level: LogLevel, name: str, text: str) -> None:
        """Write a line to the log and, from warnings up, send it to the ground."""
        ...

    def mark_event(self, text: str, origin: str) -> EventMessage:
        """Record an event and send it to the ground."""
        ...

    def record_sequencer(self, frame: SequencerFrame, *, send: bool) -> bool:
        """Record a frame, and send it to the ground where `send`. Returns whether it was recorded."""
        ...


def output_of(config: SequencerConfig, devices: Devices) -> Output:
    """The output that the configuration names. Raises HeartbeatError or AutopilotError where a device for it is not open."""
    if config.through == "ardupilot":
        if devices.autopilot is None:
            raise AutopilotError(
                "[sequencer] goes through an autopilot, and no port to it is open; set sequencer.autopilot"
            )
        return ArduPilotOutput(config, devices.autopilot)
    if devices.bus is None or devices.heartbeat is None:
        raise HeartbeatError(
            "[sequencer] needs an I2C bus and a heartbeat line, and none was opened; set sequencer.heartbeat"
        )
    return PwmOutput(config, devices.bus, devices.heartbeat, devices.clock)


class Actuation:
    """Sequencer and output of one aircraft. period_s: of the scans; clock: the one that dates them.

    Two functions that the caller sets: link_s: time [ns] -> time since the last message from the ground [s], None for none.
    known: -> derivative -> estimate and standard deviation by identification on board, None while out of date.
    """

    def __init__(
        self,
        config: SequencerConfig,
        plan: ServoManoeuvre,
        sensors: SensorsConfig,
        output: Output,
        clock: Clock,
        period_s: float,
    ) -> None:
        self._config, self._clock, self._output = config, clock, output
        self._motion = MotionReader(config, sensors)
        self.sequencer = Sequencer(config, plan, servos_of(config), period_s, self._output.proof)
        self.link_s: Callable[[int], float | None] = lambda now_ns: None
        self.known: Callable[[], Mapping[str, tuple[float, float]] | None] = lambda: None
        self._wanted = config.wanted
        self._send_ns = round(NS / config.status_rate_hz) if config.status_rate_hz else 0
        self._next_send_ns = 0
        self._idle = True  # the last frame was idle: nothing to record
        self._recorded = True  # the last frame was recorded, or did not have to be

    def request(self, digest: int | None) -> str:
        """Take a request from the ground: start the manoeuvre whose digest begins with these 24 bits; None: stop. Returns why it
        is refused, or ""."""
        return self.sequencer.request_stop() if digest is None else self.sequencer.request_start(digest)

    def check_manoeuvre(self, manoeuvre: Manoeuvre) -> Callable[[], str]:
        """Check a manoeuvre against this aircraft's limits, in any thread. Returns a function that loads it between two frames
        and returns why it is refused, or "". Raises ManoeuvreError."""
        return partial(self.sequencer.load_plan, plan_of(manoeuvre, self._config))

    def frame(self, scan: Scan, reporter: Reporter) -> None:
        """Observe, decide, command and report one frame, after its scan."""
        now_ns = self._clock.monotonic_ns()
        output = self._output.observe(scan, now_ns)
        observation = FrameObservation(
            now_ns=now_ns,
            late_ns=1000 * scan.lateness_us,
            motion=self._motion.read(scan, now_ns),
            output=output,
            recording=reporter.recording and self._recorded,
            link_s=self.link_s(now_ns),
            reached=self._reached(),
        )
        frame = self.sequencer.decide_frame(observation)
        self._report(frame, self._output.apply(frame, now_ns), observation, scan, reporter)

    def _reached(self) -> bool | None:
        known = self.known() if self._wanted is not None else None
        return None if self._wanted is None or known is None else self._wanted.reached(known)

    def close(self) -> None:
        """Release the servos to the pilot at the end of the recording."""
        self._output.close(self._clock.monotonic_ns())

    def _report(
        self,
        frame: SequencerCommand,
        sent: tuple[float, ...] | None,
        seen: FrameObservation,
        scan: Scan,
        reporter: Reporter,
    ) -> None:
        if frame.words:
            ordinary = frame.reason in _ORDINARY or frame.state is State.IDLE
            reporter.say(LogLevel.INFO if ordinary else LogLevel.WARNING, "sequencer", frame.words)
            reporter.mark_event(frame.words, "sequencer")
        was_idle, self._idle = self._idle, frame.state is State.IDLE
        if was_idle and self._idle:
            self._recorded = True
            return
        due = bool(frame.words) or (self._send_ns > 0 and seen.now_ns >= self._next_send_ns)
        if due:
            self._next_send_ns = seen.now_ns + self._send_ns
        utc = scan.time_utc_ns + seen.now_ns - scan.time_monotonic_ns if scan.time_utc_ns else 0
        self._recorded = reporter.record_sequencer(
            SequencerFrame(
                seen.now_ns,
                utc,
                scan.number,
                int(frame.state),
                int(frame.reason),
                int(seen.output.switch),
                elapsed_us=min(math.floor(frame.elapsed_s * 1e6), 2**32 - 1),
                beating=sent is not None,
                limited=frame.limited,
                increments=frame.increments,
                pilot_us=seen.output.pilot or (),
                output_us=sent or (),
            ),
            send=due,
        )
