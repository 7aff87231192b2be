"""NAU7802: 24-bit converter of the thrust load cell.

Nuvoton datasheet revision 1.7 (January 2012). Transfer function: full scale is +-0.5 V_reference / gain, so
count = 2^24 * gain * (V_in / V_reference), two's complement (section 7.2); newtons come from the load cell's
calibration file, so nothing here depends on that factor.

Self-test: revision code 0xF in register 0x1F; power-up ready; offset calibration ends without error. Plausibility: CR clear
is stale; end codes are out of range. The first six conversions after set-up are thrown away (settling of the filter).
"""

from collections.abc import Generator
from typing import Annotated, Literal

from daq.contract.scan import SensorState
from daq.sensors.base import (
    MS,
    SECOND,
    Address,
    Driver,
    Reading,
    SelfTestError,
    SensorSection,
    Wait,
    WrongChipError,
    one_of,
    signed,
)

PU_CTRL, CTRL1, CTRL2, ADC, ADC_SETTINGS, PGA_POWER, REVISION = 0x00, 0x01, 0x02, 0x12, 0x15, 0x1C, 0x1F
RR, PUD, PUA, PUR, CS, CR, AVDDS = (1 << bit for bit in (0, 1, 2, 3, 4, 5, 7))
CALS, CAL_ERROR = 0x04, 0x08
CHOPPER_OFF, PGA_CAPACITOR = 0x30, 0x80
RATE_SELECT = {10: 0, 20: 1, 40: 2, 80: 3, 320: 7}
SUPPLY_SELECT = {4.5: 0, 4.2: 1, 3.9: 2, 3.6: 3, 3.3: 4, 3.0: 5, 2.7: 6, 2.4: 7}
RUNNING = PUD | PUA | CS | AVDDS
_SETTLING = 6
_CALIBRATION_POLLS = 20


class ThrustConfig(SensorSection):
    """`[sensors.thrust]`: load cell on a NAU7802."""

    driver: str = "nau7802"
    address: Address = 0x2A
    gain: Literal[1, 2, 4, 8, 16, 32, 64, 128] = 128
    rate_hz: Literal[10, 20, 40, 80, 320] = 80
    supply_v: Annotated[float, one_of(*sorted(SUPPLY_SELECT))] = 3.0


class Nau7802(Driver):
    """Load cell [24-bit signed counts]."""

    name, groups, precedence = "nau7802", ("thrust",), 6
    stuck_s = {"thrust_load": 1.0}  # noqa: RUF012
    _config: ThrustConfig

    def _derive_settings(self) -> None:
        config = self._config
        self._ctrl1 = SUPPLY_SELECT[config.supply_v] << 3 | config.gain.bit_length() - 1
        self._ctrl2 = RATE_SELECT[config.rate_hz] << 4
        self.max_rate_hz = config.rate_hz / 1.1

    def initialise(self) -> Generator[Wait, None, None]:
        bus, address = self._bus, self._address
        revision = bus.read_byte_data(address, REVISION) & 0x0F
        if revision != 0x0F:
            raise WrongChipError("NAU7802", address, 0x0F, revision)
        bus.write_byte_data(address, PU_CTRL, RR)
        yield MS
        bus.write_byte_data(address, PU_CTRL, PUD)
        yield MS  # 200 us until power-up ready
        if not bus.read_byte_data(address, PU_CTRL) & PUR:
            raise SelfTestError("NAU7802 does not report power-up ready; check its supply")
        bus.write_byte_data(address, PU_CTRL, PUD | PUA | AVDDS)
        bus.write_i2c_block_data(address, CTRL1, [self._ctrl1, self._ctrl2])
        bus.write_byte_data(address, ADC_SETTINGS, CHOPPER_OFF)
        bus.write_byte_data(address, PGA_POWER, PGA_CAPACITOR)
        # regulator and bridge settle, as long as the makers of boards wait: SparkFun's and Adafruit's libraries
        yield 250 * MS
        yield from self._calibrate()
        bus.write_byte_data(address, PU_CTRL, RUNNING)
        yield _SETTLING * SECOND // self._config.rate_hz

    def _calibrate(self) -> Generator[Wait, None, None]:
        """The chip's own offset calibration, inputs shorted inside."""
        self._bus.write_byte_data(self._address, CTRL2, self._ctrl2 | CALS)
        for _ in range(_CALIBRATION_POLLS):
            yield 50 * MS
            state = self._bus.read_byte_data(self._address, CTRL2)
            if not state & CALS:
                if state & CAL_ERROR:
                    raise SelfTestError("NAU7802 offset calibration failed; check the load cell's wiring")
                return
        raise SelfTestError("NAU7802 offset calibration does not end; power-cycle the load cell board")

    def read(self) -> Reading:
        if not self._bus.read_byte_data(self._address, PU_CTRL) & CR:
            return Reading(state=SensorState.STALE, detail="load cell has no new sample")
        count = signed(int.from_bytes(self._bus.read_i2c_block_data(self._address, ADC, 3), "big"), 24)
        values = {"thrust_load": count}
        if count in (-(1 << 23), (1 << 23) - 1):
            return Reading(values, SensorState.OUT_OF_RANGE, "load cell beyond its range or disconnected")
        return Reading(values)

    def intact(self) -> bool:
        power, ctrl1, ctrl2 = self._bus.read_i2c_block_data(self._address, PU_CTRL, 3)
        return power & RUNNING == RUNNING and (ctrl1, ctrl2 & ~CAL_ERROR) == (self._ctrl1, self._ctrl2)

    def metadata(self) -> dict[str, str]:
        return {
            "chip": "NAU7802",
            "gain": str(self._config.gain),
            "filter_delay_s": repr(round(2.0 / self._config.rate_hz, 6)),
        }
