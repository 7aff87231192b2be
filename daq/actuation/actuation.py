"""The sequencer at work: once a scan it looks, decides, writes the servo driver, and only then beats.

A frame that could not be written ends the heartbeat there and then. Everything that was done is recorded, and words about it go
to the ground. The logger calls `frame` after each scan; commands from the ground come through `ask`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from daq.actuation.config import SequencerConfig
from daq.actuation.heartbeat import Heartbeat
from daq.actuation.motion import MotionReader
from daq.actuation.part import Part
from daq.actuation.pca9685 import Pca9685
from daq.actuation.pilot_inputs import US_PER_COUNT, PilotInputs, PilotSignals
from daq.actuation.sequencer import Frame, Seen, Sequencer
from daq.actuation.servos import Plan, plan_of, servos_of
from daq.clock import NS, Clock
from daq.contract.manoeuvre import Manoeuvre
from daq.contract.recordings.messages import Event, LogLevel, SequencerFrame
from daq.contract.scan import Scan, SensorState
from daq.contract.sequencing import Reason, State
from daq.sensors.base import SensorError
from daq.sensors.bus import I2cBus
from daq.sensors.config import SensorsConfig

LOOPBACK_US = 1500.0
_ORDINARY = (Reason.NONE, Reason.COMPLETE)


class Reporter(Protocol):
    """Where the sequencer's doings go; everything returns at once."""

    @property
    def recording(self) -> bool:
        """Whether a recording is under way."""
        ...

    def say(self, level: LogLevel, name: str, text: str) -> None:
        """A line for the log and, from warnings up, the ground."""
        ...

    def mark_event(self, text: str, origin: str) -> Event:
        """An event in the recording, told to the ground."""
        ...

    def record_sequencer(self, frame: SequencerFrame, *, send: bool) -> bool:
        """A frame for the recording, False when it is not taken, and when it is time for the ground."""
        ...


@dataclass(frozen=True, slots=True)
class Devices:
    """What the sequencer drives and goes by."""

    bus: I2cBus
    heartbeat: Heartbeat
    clock: Clock


class ServoDriver:
    """The chip with the outputs of a configuration and the loopback, as one block of channels."""

    def __init__(self, config: SequencerConfig, bus: I2cBus) -> None:
        self._places = [o.channel for o in config.output.values()]
        self._loopback = config.chip.loopback_channel
        channels = [*self._places, self._loopback]
        self._first, self._count = min(channels), max(channels) - min(channels) + 1
        self.chip = Pca9685(config.chip, bus, self._first, self._count)
        self.part = Part(self.chip.initialise)
        step = self.chip.step_us
        self.loopback_us = round(LOOPBACK_US / step) * step
        """What the loopback pulse is, given the oscillator is as configured [us]."""

    def fault(self, now_ns: int, *, running: bool) -> str:
        """Why the chip cannot be used; while `running` it is asked whether it still runs as set."""
        if self.part.attend(now_ns) and running:
            try:
                if not self.chip.awake():
                    self.part.fail(SensorError("servo driver has lost its settings"), now_ns)
            except OSError as error:
                self.part.fail(error, now_ns)
        return self.part.fault

    def write(self, pulses: Sequence[float] | None, scale: float, now_ns: int) -> bool:
        """Put pulses out [us], or none on the servos' channels; False when the chip does not take them.

        scale: true width over the width asked for, as measured.
        """
        widths: list[float | None] = [None] * self._count
        widths[self._loopback - self._first] = LOOPBACK_US
        for place, pulse in zip(self._places, pulses or (), strict=False):
            widths[place - self._first] = pulse / scale
        try:
            self.chip.write(widths)
        except OSError as error:
            self.part.fail(error, now_ns)
            return False
        return True


class Actuation:
    """Sequencer, servo driver, pilot's signals and heartbeat of one aircraft. period_s: of the scans.

    link_s: seconds since the ground was last heard at a time [ns], None for never; set where there is a link.
    """

    def __init__(
        self, config: SequencerConfig, plan: Plan, sensors: SensorsConfig, devices: Devices, period_s: float
    ) -> None:
        limits = config.limits
        clock = devices.clock
        self._config, self._devices = config, devices
        self._outputs = tuple(config.output.values())
        self._motion = MotionReader(config, sensors)
        self._pilot = PilotInputs(
            config.pilot,
            [o.pilot_input for o in self._outputs],
            devices.bus,
            clock.monotonic_ns,
            round(limits.stale_ms * 1e6),
        )
        self._driver = ServoDriver(config, devices.bus)
        self.sequencer = Sequencer(
            config,
            plan,
            servos_of(config.output),
            period_s,
            self._driver.loopback_us,
            self._driver.chip.frequency_hz,
        )
        self.link_s: Callable[[int], float | None] = lambda now_ns: None
        self._send_ns = round(NS / config.status_rate_hz) if config.status_rate_hz else 0
        self._next_send_ns = 0
        self._held = False  # the last frame beat
        self._quiet = True  # the last frame was idle: nothing to record
        self._recorded = True  # the last frame was recorded, where it was to be

    def ask(self, digest: int | None) -> str:
        """A wish from the ground: start the manoeuvre with this digest (its first 24 bits), or None: stop. Why not, or empty."""
        return self.sequencer.ask_stop() if digest is None else self.sequencer.ask_start(digest)

    def weigh(self, manoeuvre: Manoeuvre) -> Callable[[], str]:
        """Weigh a manoeuvre against this aircraft's limits, in any thread. What is returned puts it in place, between two
        frames, and says why not, empty when it is taken. Raises ManoeuvreError."""
        return partial(self.sequencer.take, plan_of(manoeuvre, self._config))

    def frame(self, scan: Scan, reporter: Reporter) -> None:
        """One frame, after the scan it goes by."""
        now = self._devices.clock.monotonic_ns()
        pilot = self._pilot.poll(now)
        seen = self._seen(scan, pilot, now, recording=reporter.recording and self._recorded)
        frame = self.sequencer.step(seen)
        self._carry_out(frame, now)
        self._report(frame, seen, scan, reporter)

    def _seen(self, scan: Scan, pilot: PilotSignals, now: int, *, recording: bool) -> Seen:
        status = scan.groups.get("capture")
        readable = status is not None and status.state is SensorState.OK
        counts = [scan.values.get(f"pwm_{o.readback}") if readable and o.readback else None for o in self._outputs]
        return Seen(
            now_ns=now,
            late_ns=1000 * scan.lateness_us,
            switch=pilot.switch,
            pilot=pilot.sticks,
            motion=self._motion.read(scan, now),
            recording=recording,
            loopback_us=pilot.loopback_us,
            link_s=self.link_s(now),
            chip_fault=self._driver.fault(now, running=self._held),
            readback=tuple(None if c is None else c * US_PER_COUNT for c in counts),
        )

    def _carry_out(self, frame: Frame, now: int) -> None:
        """Write, then beat; whatever fails on the way lets go."""
        if not frame.state.beats:
            self._let_go(now)
            return
        if self._driver.write(frame.pulses, self.sequencer.width_scale, now):
            try:
                self._devices.heartbeat.beat()
                self._held = True
                return
            except OSError as error:
                self._driver.part.fail(error, now)
        self._let_go(now)

    def _let_go(self, now: int) -> None:
        if not self._held:
            return
        self._held = False
        try:
            self._devices.heartbeat.release()
        except OSError as error:  # the monostable ends by itself; until the line works nothing is armed
            self._driver.part.fail(error, now)
        if self._driver.part.up:
            self._driver.write(None, 1.0, now)

    def close(self) -> None:
        """Let go at the end of the recording."""
        self._let_go(self._devices.clock.monotonic_ns())

    def _report(self, frame: Frame, seen: Seen, scan: Scan, reporter: Reporter) -> None:
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
                int(seen.switch),
                elapsed_us=min(math.floor(frame.elapsed_s * 1e6), 2**32 - 1),
                beating=self._held,
                limited=frame.limited,
                increments=frame.increments,
                pilot_us=seen.pilot or (),
                output_us=(frame.pulses or ()) if self._held else (),
            ),
            send=due,
        )
