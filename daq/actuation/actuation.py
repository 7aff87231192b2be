"""The sequencer at work: once a scan it looks, decides, and puts out through a servo driver or an autopilot.

Everything that was done is recorded, and words about it go to the ground. The logger calls `frame` after each scan; commands
from the ground come through `ask`.
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
    """bus and heartbeat for a servo driver behind a multiplexer, autopilot for one in between; None where not opened."""

    bus: I2cBus | None
    heartbeat: HeartbeatLine | None
    clock: Clock
    autopilot: AutopilotPort | None = None


def findings(config: SequencerConfig, devices: Devices, take_scan: Callable[[], Scan]) -> Iterator[TrialFinding]:
    """Try the configured output; take_scan: one scan of the aircraft's sensors, now."""
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
    """Where the sequencer's doings go; everything returns at once."""

    @property
    def recording(self) -> bool:
        """Whether a recording is under way."""
        ...

    def say(self, level: LogLevel, name: str, text: str) -> None:
        """A line for the log and, from warnings up, the ground."""
        ...

    def mark_event(self, text: str, origin: str) -> EventMessage:
        """An event in the recording, told to the ground."""
        ...

    def record_sequencer(self, frame: SequencerFrame, *, send: bool) -> bool:
        """A frame for the recording, False when it is not taken, and when it is time for the ground."""
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
    """Sequencer and output of one aircraft. period_s: of the scans, clock: theirs.

    link_s: seconds since the ground was last heard at a time [ns], None for never; set where there is a link. known:
    derivative -> estimate and bound, by identification on board, None where it has not told lately; set where there is one.
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
        self._quiet = True  # the last frame was idle: nothing to record
        self._recorded = True  # the last frame was recorded, where it was to be

    def ask(self, digest: int | None) -> str:
        """A wish from the ground: start the manoeuvre with this digest (its first 24 bits), or None: stop. Why not, or empty."""
        return self.sequencer.ask_stop() if digest is None else self.sequencer.ask_start(digest)

    def weigh(self, manoeuvre: Manoeuvre) -> Callable[[], str]:
        """Weigh a manoeuvre against this aircraft's limits, in any thread. What is returned puts it in place, between two
        frames, and says why not, empty when it is taken. Raises ManoeuvreError."""
        return partial(self.sequencer.load_plan, plan_of(manoeuvre, self._config))

    def frame(self, scan: Scan, reporter: Reporter) -> None:
        """One frame, after the scan it goes by."""
        now_ns = self._clock.monotonic_ns()
        output = self._output.look(scan, now_ns)
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
        self._report(frame, self._output.put(frame, now_ns), observation, scan, reporter)

    def _reached(self) -> bool | None:
        known = self.known() if self._wanted is not None else None
        return None if self._wanted is None or known is None else self._wanted.reached(known)

    def close(self) -> None:
        """Let go at the end of the recording."""
        self._output.close(self._clock.monotonic_ns())

    def _report(
        self,
        frame: SequencerCommand,
        put: tuple[float, ...] | None,
        seen: FrameObservation,
        scan: Scan,
        reporter: Reporter,
    ) -> None:
        if frame.words:
            ordinary = frame.reason in _ORDINARY or frame.state is State.IDLE
            reporter.say(LogLevel.INFO if ordinary else LogLevel.WARNING, "sequencer", frame.words)
            reporter.mark_event(frame.words, "sequencer")
        quiet, self._quiet = self._quiet, frame.state is State.IDLE
        if quiet and self._quiet:
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
                beating=put is not None,
                limited=frame.limited,
                increments=frame.increments,
                pilot_us=seen.output.pilot or (),
                output_us=put or (),
            ),
            send=due,
        )
