"""Through a servo driver of our own behind a multiplexer that the pilot switches: written first, beaten after.

A frame that could not be written ends the heartbeat there and then.
"""

from collections.abc import Sequence

from daq.actuation.config import SequencerConfig
from daq.actuation.proof import FrequencyProof
from daq.actuation.pwm.heartbeat import HeartbeatLine
from daq.actuation.pwm.part import ChipState
from daq.actuation.pwm.pca9685 import Pca9685
from daq.actuation.pwm.pilot_inputs import US_PER_COUNT, PilotInputs
from daq.actuation.seen import Glimpse
from daq.actuation.sequencer import SequencerCommand
from daq.clock import Clock
from daq.contract.scan import Scan, SensorState
from daq.sensors.base import SensorError
from daq.sensors.bus import I2cBus

LOOPBACK_US = 1500.0


class ServoDriver:
    """The chip with the outputs of a configuration and the loopback, as one block of channels."""

    def __init__(self, config: SequencerConfig, bus: I2cBus) -> None:
        self._places = [o.channel for o in config.output.values()]
        self._loopback = config.chip.loopback_channel
        channels = [*self._places, self._loopback]
        self._first, self._count = min(channels), max(channels) - min(channels) + 1
        self.chip = Pca9685(config.chip, bus, self._first, self._count)
        self.part = ChipState(self.chip.initialise)
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


class PwmOutput:
    """Driver, pilot's signals and heartbeat of one aircraft."""

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
        self._held = False  # the last frame beat

    def look(self, scan: Scan, now_ns: int) -> Glimpse:
        """The pilot's co-processor, the driver, and the pulses behind the multiplexer as the scan has them."""
        pilot = self._pilot.poll(now_ns)
        status = scan.groups.get("capture")
        readable = status is not None and status.state is SensorState.OK
        counts = [scan.values.get(f"pwm_{o.readback}") if readable and o.readback else None for o in self._outputs]
        return Glimpse(
            switch=pilot.switch,
            pilot=pilot.sticks,
            loopback_us=pilot.loopback_us,
            fault=self._driver.fault(now_ns, running=self._held),
            readback=tuple(None if c is None else c * US_PER_COUNT for c in counts),
        )

    def put(self, frame: SequencerCommand, now_ns: int) -> tuple[float, ...] | None:
        """Write, then beat; whatever fails on the way lets go."""
        if not frame.state.beats:
            self.close(now_ns)
            return None
        if self._driver.write(frame.pulses, self.proof.scale, now_ns):
            try:
                self._heartbeat.beat()
                self._held = True
                return frame.pulses or ()
            except OSError as error:
                self._driver.part.fail(error, now_ns)
        self.close(now_ns)
        return None

    def close(self, now_ns: int) -> None:
        """Let go, if the last frame has not."""
        if not self._held:
            return
        self._held = False
        try:
            self._heartbeat.release()
        except OSError as error:  # the monostable ends by itself; until the line works nothing is armed
            self._driver.part.fail(error, now_ns)
        if self._driver.part.up:
            self._driver.write(None, 1.0, now_ns)
