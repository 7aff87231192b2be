"""HDC2080 humidity sensor. TI datasheet SNAS678C (2021). Transfer function: RH = count / 65536."""

from collections.abc import Callable, Generator

from daq.contract.scan import SensorState
from daq.sensors.base import MS, Driver, Reading, Wait, WrongChipError
from daq.sensors.bus import I2cBus
from daq.sensors.config import ExtraConfig


class Hdc2080(Driver):
    """Relative humidity [counts], five new samples a second."""

    max_rate_hz = 4.5

    def __init__(self, group: str, section: ExtraConfig, bus: I2cBus, now_ns: Callable[[], int]) -> None:
        self.group, self._bus, self._address = group, bus, section.address or 0x40

    def initialise(self) -> Generator[Wait, None, None]:
        low, high = self._bus.read_i2c_block_data(self._address, 0xFC, 2)
        if (low, high) != (0x49, 0x54):
            raise WrongChipError("HDC2080", self._address, 0x5449, high << 8 | low)
        self._bus.write_byte_data(self._address, 0x0E, 0b111 << 4)  # measure five times a second
        self._bus.write_byte_data(self._address, 0x0F, 0x01)
        yield 250 * MS

    def read(self) -> Reading:
        if not self._bus.read_byte_data(self._address, 0x04) & 0x80:
            return Reading(state=SensorState.STALE, detail="humidity sensor has no new sample")
        low, high = self._bus.read_i2c_block_data(self._address, 0x02, 2)
        return Reading({"humidity": high << 8 | low})
