"""AS5600 and AS5600L: the angle of a vane by a magnet on the end of its shaft.

ams datasheets AS5600 v1-06 and AS5600L v1-00. 4096 counts a turn; RAW ANGLE is recorded as the distance from `centre_count`: the
wrap lies opposite to where the vane points. An AS5600 is at 0x36 always: of two vanes one is an AS5600L, whose address can be
programmed (0x40 as delivered), or the two sit behind a multiplexer that the kernel shows as two buses.
The chip's slow filter is set to 2x, settling in 0.286 ms, without fast filter, hysteresis or watchdog (table "CONF").

Self-test: CONF read back, magnet there. Plausibility: STATUS bit 5 (MD) clear is no magnet, bit 4 (ML) one too weak or far,
bit 3 (MH) one too strong or near; such angles are out of range. CONF is read again each second.
"""

from collections.abc import Generator, Mapping
from typing import Annotated, ClassVar

from pydantic import Field

from daq.contract.scan import SensorState
from daq.sensors.base import MS, Address, Driver, Reading, SelfTestError, SensorSection, Wait

CONF, STATUS = 0x07, 0x0B  # RAW ANGLE follows STATUS
MAGNET, WEAK, STRONG = 0x20, 0x10, 0x08
TURN = 4096
SLOW_FILTER_2X = [0x03, 0x00]  # CONF, higher byte first: SF = 11
SETTLING_S = 0.000286


class EncoderConfig(SensorSection):
    """`[sensors.vane_alpha]`, `[sensors.vane_beta]`: AS5600. centre_count: raw count at which the vane points straight ahead."""

    driver: str = "as5600"
    address: Address = 0x36
    centre_count: Annotated[int, Field(ge=0, lt=TURN)] = 2048


def magnet_fault(status: int) -> str:
    """What STATUS says of the magnet; empty where it is right."""
    if not status & MAGNET:
        return "vane has no magnet: lost, or more than 3 mm away"
    if status & WEAK:
        return "vane's magnet is too weak or too far away"
    return "vane's magnet is too strong or too near" if status & STRONG else ""


class As5600(Driver):
    """Shaft angle [counts from the centre]."""

    name, groups, precedence = "as5600", ("vane_alpha", "vane_beta"), 1
    stuck_s: ClassVar[Mapping[str, float]] = {}  # at rest a good magnet stands on one count: AirTruth looks in flight
    _config: EncoderConfig

    def initialise(self) -> Generator[Wait, None, None]:
        yield 10 * MS  # power-up time, electrical characteristics
        self._bus.write_i2c_block_data(self._address, CONF, SLOW_FILTER_2X)
        yield 5 * MS
        if not self.intact():
            raise SelfTestError(f"AS5600 at 0x{self._address:02x} does not take its settings; check supply and wiring")
        fault = magnet_fault(self._bus.read_byte_data(self._address, STATUS))
        if fault:
            raise SelfTestError(f"{fault} (AS5600 at 0x{self._address:02x})")

    def read(self) -> Reading:
        status, high, low = self._bus.read_i2c_block_data(self._address, STATUS, 3)
        raw = (high & 0x0F) << 8 | low
        from_centre = (raw - self._config.centre_count + TURN // 2) % TURN - TURN // 2
        values = {self.group.replace("vane_", "") + "_encoder": from_centre}
        fault = magnet_fault(status)
        return Reading(values, SensorState.OUT_OF_RANGE, fault) if fault else Reading(values)

    def intact(self) -> bool:
        return self._bus.read_i2c_block_data(self._address, CONF, 2) == SLOW_FILTER_2X

    def metadata(self) -> dict[str, str]:
        return {
            "chip": "AS5600",
            "centre_count": str(self._config.centre_count),
            "filter_delay_s": repr(SETTLING_S / 2),
        }
