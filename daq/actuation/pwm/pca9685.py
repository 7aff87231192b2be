"""PCA9685 sixteen-channel PWM driver (NXP data sheet rev. 4, 16 April 2015).

Settings: MODE1 (00h) auto-increment on, ALLCALL off; MODE2 (01h) totem pole, outputs change at STOP, outputs low while
OE is high; PRE_SCALE (FEh) = round(fosc / (4096 f)) - 1, written in SLEEP only. Register addresses 06h + 4 n: ON_L, ON_H,
OFF_L, OFF_H of channel n; bit 4 of OFF_H is full off. New values act at the end of the cycle under way. After SLEEP the
oscillator needs 500 us. Self-test: settings read back.

The chip has no watchdog: while it has power it repeats its last pulses, so nothing here is a means of stopping it.
"""

from collections.abc import Callable, Generator, Sequence

from daq.actuation.config import ChipConfig
from daq.sensors.base import SECOND, US, SelfTestError, SensorError, Wait
from daq.sensors.bus import I2cBus

RETRY_NS = SECOND


class ChipState:
    """Set-up and faults of the chip. initialise: its set-up, which yields waits [ns] as drivers do."""

    def __init__(self, initialise: Callable[[], Generator[Wait, None, None]]) -> None:
        self.fault = "not set up yet"
        self._initialise = initialise
        self._setup: Generator[Wait, None, None] | None = None
        self._next_ns = 0

    @property
    def up(self) -> bool:
        """Whether the chip is set up and has not failed since."""
        return not self.fault

    def attend(self, now_ns: int) -> bool:
        """Run a step of the set-up if one is due; returns whether the chip can be used."""
        if self.up or now_ns < self._next_ns:
            return self.up
        self._setup = self._setup or self._initialise()
        try:
            self._next_ns = now_ns + next(self._setup)
        except StopIteration:
            self._setup, self.fault = None, ""
        except (OSError, SensorError) as error:
            self.fail(error, now_ns)
        return self.up

    def fail(self, error: Exception, now_ns: int) -> None:
        """Note a failure; the set-up is repeated after RETRY_NS, and until then `fault` holds the reason."""
        self._setup, self._next_ns = None, now_ns + RETRY_NS
        text = (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
        self.fault = text or type(error).__name__


MODE1, MODE2, LED0, ALL_LED, PRE_SCALE = 0x00, 0x01, 0x06, 0xFA, 0xFE
RESTART, AUTO_INCREMENT, SLEEP = 0x80, 0x20, 0x10
TOTEM_POLE = 0x04
FULL_OFF = 0x10
STEPS = 4096
OSCILLATOR_START = 500 * US


def prescale(oscillator_hz: float, frequency_hz: float) -> int:
    """Value of PRE_SCALE, 3 to 255 (data sheet, equation 1)."""
    return min(max(round(oscillator_hz / (STEPS * frequency_hz)) - 1, 3), 255)


class Pca9685:
    """Neighbouring channels of one chip, all written in one transfer.

    first: lowest channel. channels: how many. frequency_hz: of the pulses, with PRE_SCALE and the configured oscillator.
    """

    def __init__(self, config: ChipConfig, bus: I2cBus, first: int, channels: int) -> None:
        self._bus = bus
        self._address = config.address
        self._register = LED0 + 4 * first
        self._channels = channels
        self._prescale = prescale(config.oscillator_hz, config.frequency_hz)
        self.frequency_hz = config.oscillator_hz / (STEPS * (self._prescale + 1))

    def initialise(self) -> Generator[Wait, None, None]:
        """Set the chip up with all outputs off. Raises OSError, or SelfTestError when it does not keep its settings."""
        bus, address = self._bus, self._address
        bus.write_byte_data(address, MODE1, AUTO_INCREMENT | SLEEP)
        bus.write_byte_data(address, MODE2, TOTEM_POLE)
        bus.write_byte_data(address, PRE_SCALE, self._prescale)
        bus.write_i2c_block_data(address, ALL_LED, [0, 0, 0, FULL_OFF])
        bus.write_byte_data(address, MODE1, AUTO_INCREMENT)
        yield OSCILLATOR_START
        if bus.read_byte_data(address, MODE1) & RESTART:
            bus.write_byte_data(address, MODE1, RESTART | AUTO_INCREMENT)
        self.verify()

    def verify(self) -> None:
        """Raise SelfTestError unless mode, output driver and frequency are as set."""
        settings = (
            *self._bus.read_i2c_block_data(self._address, MODE1, 2),
            self._bus.read_byte_data(self._address, PRE_SCALE),
        )
        configured = (AUTO_INCREMENT, TOTEM_POLE, self._prescale)
        if settings != configured:
            raise SelfTestError(
                f"servo driver at I2C address 0x{self._address:02x} has MODE1, MODE2, PRE_SCALE "
                f"{bytes(settings).hex(' ')} instead of {bytes(configured).hex(' ')}; check its supply"
            )

    def awake(self) -> bool:
        """Whether MODE1 is as set; after a dip of its supply the chip sleeps. One short transfer."""
        return self._bus.read_byte_data(self._address, MODE1) == AUTO_INCREMENT

    def write(self, widths_us: Sequence[float | None]) -> None:
        """Write the pulse widths of all channels [us], None for no pulse; they act together, after the current cycle."""
        if len(widths_us) != self._channels:
            raise ValueError(f"{len(widths_us)} widths for {self._channels} channels")
        data: list[int] = []
        for width in widths_us:
            data += self.registers(width)
        self._bus.write_i2c_block_data(self._address, self._register, data)

    def registers(self, width_us: float | None) -> list[int]:
        """ON_L, ON_H, OFF_L, OFF_H of a pulse that begins with the cycle."""
        if width_us is None:
            return [0, 0, 0, FULL_OFF]
        steps = min(max(round(width_us * 1e-6 * self.frequency_hz * STEPS), 1), STEPS - 1)
        return [0, 0, steps & 0xFF, steps >> 8]

    @property
    def step_us(self) -> float:
        """Width of one step [us]."""
        return 1e6 / (self.frequency_hz * STEPS)
