"""The pilot's own signals, measured between his receiver and the multiplexer by a capture co-processor of their own."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from daq.actuation.config import PilotConfig
from daq.actuation.pwm.part import ChipState
from daq.contract.scan import RawValue, SensorState
from daq.contract.sequencing import Switch, switch_position
from daq.sensors.base import NO_VALUES, SensorError
from daq.sensors.bus import I2cBus
from daq.sensors.capture import Capture, CaptureConfig

US_PER_COUNT = 0.1


@dataclass(frozen=True, slots=True)
class PilotSignals:
    """sticks: pulse width of each output's input [us], None unless all are there. loopback_us: of the chip's spare output."""

    sticks: tuple[float, ...] | None = None
    switch: Switch = Switch.UNKNOWN
    loopback_us: float | None = None


class PilotInputs:
    """inputs: which of the six belongs to each output. stale_ns: how old a reading may be when the bus fails."""

    def __init__(
        self, config: PilotConfig, inputs: Sequence[int], bus: I2cBus, now_ns: Callable[[], int], stale_ns: int
    ) -> None:
        # None of the inputs has to be alive for a reading: a receiver that is off, or a chip that is, shows by its channel.
        capture = CaptureConfig(address=config.address, timeout_ms=config.timeout_ms, pwm_inputs=0)
        self._driver = Capture(capture, bus, now_ns)
        self.part = ChipState(self._driver.initialise)
        self._config = config
        self._inputs = tuple(inputs)
        self._stale_ns = stale_ns
        self._values = NO_VALUES
        self._values_ns = -stale_ns

    def poll(self, now_ns: int) -> PilotSignals:
        """The signals now; nothing is seen when the last good reading is too old."""
        if self.part.attend(now_ns):
            self._read(now_ns)
        if now_ns - self._values_ns > self._stale_ns:
            self._values = NO_VALUES
        sticks = [self._width(i) for i in self._inputs]
        known = tuple(w for w in sticks if w is not None)
        return PilotSignals(
            known if len(known) == len(sticks) else None,
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
