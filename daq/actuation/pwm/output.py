"""Output through a servo driver (PCA9685) behind a multiplexer that the pilot switches.

Each frame writes the pulses first and beats the heartbeat after; a frame that cannot be written releases the heartbeat.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean

from daq.actuation.config import PilotConfig, SequencerConfig
from daq.actuation.output import FrameObservation, OutputObservation, OutputTrial, OutputTrialResult, SequencerCommand
from daq.actuation.pwm.heartbeat import HeartbeatLine
from daq.actuation.pwm.pca9685 import ChipState, Pca9685
from daq.clock import Clock
from daq.contract.scan import RawValue, Scan, SensorState
from daq.contract.sequencing import Reason, Switch, switch_position
from daq.sensors.base import NO_VALUES, SensorError
from daq.sensors.bus import I2cBus
from daq.sensors.capture import Capture, CaptureConfig

US_PER_COUNT = 0.1  # of the co-processor that measures pulses


@dataclass(frozen=True, slots=True)
class PilotSignals:
    """sticks: pulse width of the pilot's signal for each output [us], None unless all are measured. loopback_us: pulse width
    measured on the servo driver's spare output, None where not measured."""

    sticks: tuple[float, ...] | None = None
    switch: Switch = Switch.UNKNOWN
    loopback_us: float | None = None


class PilotInputs:
    """The pilot's pulses, as a second co-processor measures them.

    inputs: number of the input, 1 to 6, for each output. stale_ns: greatest age of a reading while the bus fails.
    """

    def __init__(
        self, config: PilotConfig, inputs: Sequence[int], bus: I2cBus, now_ns: Callable[[], int], stale_ns: int
    ) -> None:
        # pwm_inputs 0: a reading is valid without any live input; a receiver or servo driver that is off lacks its channel
        capture = CaptureConfig(address=config.address, timeout_ms=config.timeout_ms, pwm_inputs=0)
        self._driver = Capture(capture, bus, now_ns)
        self.part = ChipState(self._driver.initialise)
        self._config = config
        self._inputs = tuple(inputs)
        self._stale_ns = stale_ns
        self._values = NO_VALUES
        self._values_ns = -stale_ns

    def poll(self, now_ns: int) -> PilotSignals:
        """The signals now; all of them None when the last good reading is too old."""
        if self.part.attend(now_ns):
            self._read(now_ns)
        if now_ns - self._values_ns > self._stale_ns:
            self._values = NO_VALUES
        sticks = [self._width(i) for i in self._inputs]
        measured_sticks = tuple(w for w in sticks if w is not None)
        return PilotSignals(
            measured_sticks if len(measured_sticks) == len(sticks) else None,
            switch_position(self._width(self._config.switch_input)),
            self._width(self._config.loopback_input),
        )

    def _read(self, now_ns: int) -> None:
        try:
            reading = self._driver.read()
        except (OSError, SensorError) as error:
            if now_ns - self._values_ns > self._stale_ns:
                self.part.fail(error, now_ns)
            return
        if reading.state is SensorState.FAULT:
            self.part.fail(SensorError(reading.detail), now_ns)
        elif reading.state is not SensorState.STALE:
            self._values, self._values_ns = reading.values, now_ns

    def _width(self, number: int) -> float | None:
        count: RawValue | None = self._values.get(f"pwm_{number}")
        return None if count is None else count * US_PER_COUNT


LOOPBACK_NOMINAL_US = 1500.0
SETTLE_S = 0.1
"""Loopback pulses are ignored for so long after the start: the chip needs a cycle, the co-processor reports for 50 ms."""
LOOPBACK_PULSES = 25
"""Loopback pulses averaged: half a second; jitter of 10 us then leaves 0.2 % of a 1500 us pulse."""
LOOPBACK_TIMEOUT_S = 1.5
"""Longest time for LOOPBACK_PULSES to arrive."""


class FrequencyProof(OutputTrial):
    """Trial of a servo driver: its oscillator is measured on a spare output while the others repeat the pilot's signals.

    loopback_us, frequency_hz: pulse width and output frequency expected there with the configured oscillator. error: greatest
    relative error of the frequency.
    """

    fault = Reason.CHIP
    not_followed_hint = "multiplexer or wiring"  # printed after "servo pulses are not those put out"

    def __init__(self, loopback_us: float, frequency_hz: float, error: float) -> None:
        self._loopback_us, self._frequency_hz, self._error = loopback_us, frequency_hz, error
        self._measured: list[float] = []

    def begin(self) -> None:
        """Restart the measurement."""
        self._measured, self.scale = [], 1.0

    def check(self, frame: FrameObservation, elapsed_s: float) -> OutputTrialResult | None:
        """Collect loopback pulses, and judge the frequency by their mean."""
        if elapsed_s < SETTLE_S:
            return None
        if frame.output.loopback_us is not None:
            self._measured.append(frame.output.loopback_us)
        if len(self._measured) >= LOOPBACK_PULSES:
            return self._frequency()
        return OutputTrialResult(Reason.FREQUENCY, "no pulses come back") if elapsed_s > LOOPBACK_TIMEOUT_S else None

    def _frequency(self) -> OutputTrialResult:
        scale = fmean(self._measured) / self._loopback_us
        detail = f"{self._frequency_hz / scale:.2f} Hz measured, {self._frequency_hz:.2f} expected"
        if abs(1.0 / scale - 1.0) > self._error:
            return OutputTrialResult(Reason.FREQUENCY, detail)
        self.scale = scale
        return OutputTrialResult(detail=detail)

    def pulses(self, frame: FrameObservation) -> tuple[float, ...] | None:
        """The pilot's signals."""
        return frame.output.pilot


class ServoDriver:
    """The servo driver of a configuration: outputs and loopback in one block of neighbouring channels."""

    def __init__(self, config: SequencerConfig, bus: I2cBus) -> None:
        self._servo_channels = [o.channel for o in config.output.values()]
        self._loopback = config.chip.loopback_channel
        channels = [*self._servo_channels, self._loopback]
        self._first, self._count = min(channels), max(channels) - min(channels) + 1
        self.chip = Pca9685(config.chip, bus, self._first, self._count)
        self.part = ChipState(self.chip.initialise)
        step = self.chip.step_us
        self.loopback_us = round(LOOPBACK_NOMINAL_US / step) * step
        """Width of the loopback pulse with the configured oscillator, in whole steps of the chip [us]."""

    def fault(self, now_ns: int, *, running: bool) -> str:
        """Why the chip cannot be used, empty when it can; while `running`, its mode is read back."""
        if self.part.attend(now_ns) and running:
            try:
                if not self.chip.awake():
                    self.part.fail(SensorError("servo driver has lost its settings"), now_ns)
            except OSError as error:
                self.part.fail(error, now_ns)
        return self.part.fault

    def write(self, pulses: Sequence[float] | None, scale: float, now_ns: int) -> bool:
        """Write the pulses [us] of the servos, None for no pulses, and the loopback's; False when the bus fails.

        scale: true pulse width over the commanded one, as measured.
        """
        widths: list[float | None] = [None] * self._count
        widths[self._loopback - self._first] = LOOPBACK_NOMINAL_US
        for channel, pulse in zip(self._servo_channels, pulses or (), strict=False):
            widths[channel - self._first] = pulse / scale
        try:
            self.chip.write(widths)
        except OSError as error:
            self.part.fail(error, now_ns)
            return False
        return True


class PwmOutput:
    """Servo driver, measurement of the pilot's signals and heartbeat of one aircraft."""

    def __init__(self, config: SequencerConfig, bus: I2cBus, heartbeat: HeartbeatLine, clock: Clock) -> None:
        self._outputs = tuple(config.output.values())
        self._heartbeat = heartbeat
        self._pilot = PilotInputs(
            config.pilot,
            [o.pilot_input for o in self._outputs],
            bus,
            clock.monotonic_ns,
            round(config.limits.stale_ms * 1e6),
        )
        self._driver = ServoDriver(config, bus)
        self.proof = FrequencyProof(
            self._driver.loopback_us, self._driver.chip.frequency_hz, config.limits.frequency_error
        )
        self._beating = False  # the last frame beat the heartbeat

    def observe(self, scan: Scan, now_ns: int) -> OutputObservation:
        """The pilot's signals, the driver's state, and from the scan the pulses behind the multiplexer."""
        pilot = self._pilot.poll(now_ns)
        status = scan.groups.get("capture")
        readable = status is not None and status.state is SensorState.OK
        counts = [scan.values.get(f"pwm_{o.readback}") if readable and o.readback else None for o in self._outputs]
        return OutputObservation(
            switch=pilot.switch,
            pilot=pilot.sticks,
            loopback_us=pilot.loopback_us,
            fault=self._driver.fault(now_ns, running=self._beating),
            readback=tuple(None if c is None else c * US_PER_COUNT for c in counts),
        )

    def apply(self, command: SequencerCommand, now_ns: int) -> tuple[float, ...] | None:
        """Write the pulses, then beat the heartbeat; a failure of either releases the servos to the pilot."""
        if not command.state.beats:
            self.close(now_ns)
            return None
        if self._driver.write(command.pulses, self.proof.scale, now_ns):
            try:
                self._heartbeat.beat()
                self._beating = True
                return command.pulses or ()
            except OSError as error:
                self._driver.part.fail(error, now_ns)
        self.close(now_ns)
        return None

    def close(self, now_ns: int) -> None:
        """Release the heartbeat, if the last frame beat it, and stop the pulses."""
        if not self._beating:
            return
        self._beating = False
        try:
            self._heartbeat.release()
        except OSError as error:  # the monostable ends by itself; until the line works nothing is armed
            self._driver.part.fail(error, now_ns)
        if self._driver.part.up:
            self._driver.write(None, 1.0, now_ns)
