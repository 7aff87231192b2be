"""BMP581: static pressure and temperature, compensated by the chip.

Bosch data sheet BST-BMP581-DS004 as Bosch's own driver (bmp5_defs.h, version 1.1.1) and ArduPilot's have it. Pressure: 24 bits of
1/64 Pa; temperature: 24 bits with sign of 1/65536 degC, recorded plus 2^23. Oversampling and filter (here bypassed) are taken in
standby only; deep standby is switched off (DEEP_DIS), so that settings stay. Largest rates by oversampling: table 7.

Self-test: identity, power-up done, non-volatile memory ready and without error, rate possible (ODR_IS_VALID). Plausibility:
0x7F7F7F is "not measured" (stale), as is a missing data-ready flag; 300 to 1250 hPa.
"""

from collections.abc import Generator

from daq.contract.scan import SensorState
from daq.sensors.base import MS, SECOND, Driver, Reading, SelfTestError, Wait, WrongChipError, signed
from daq.sensors.bmp390 import BMP581_LARGEST_HZ, StaticConfig
from daq.utilities.constants import ZERO_CELSIUS

CHIP_ID, INT_SOURCE, DATA, INT_STATUS, STATUS = 0x01, 0x15, 0x1D, 0x27, 0x28
DSP_IIR, OSR, ODR, OSR_EFF, CMD = 0x31, 0x36, 0x37, 0x38, 0x7E
IDENTITY, SOFT_RESET = 0x50, 0xB6
READY, POWERED_UP = 0x01, 0x10  # of INT_STATUS
NVM_READY, NVM_ERROR = 0x02, 0x04  # of STATUS
PRESSURE_ON, DEEP_OFF, NORMAL, RATE_VALID = 0x40, 0x80, 0x01, 0x80
ODR_SELECT = {200: 0x02, 100: 0x0A, 50: 0x0F, 25: 0x14}  # 199.1, 100.2, 50, 25 Hz
SKIPPED = 0x7F7F7F
LOWEST, HIGHEST = 30_000 * 64, 125_000 * 64
MIDDLE = 1 << 23


class Bmp581(Driver):
    """Pressure [1/64 Pa] and temperature [1/65536 K from its middle]."""

    name, groups, precedence = "bmp581", ("static",), 5
    _config: StaticConfig

    def _derive_settings(self) -> None:
        config = self._config
        steps = (config.pressure_oversampling.bit_length() - 1, config.temperature_oversampling.bit_length() - 1)
        self._osr = PRESSURE_ON | steps[0] << 3 | steps[1]
        self._odr = DEEP_OFF | ODR_SELECT[config.rate_hz] << 2 | NORMAL
        self._unread = False
        self.max_rate_hz = config.rate_hz / 1.1

    def initialise(self) -> Generator[Wait, None, None]:
        bus, address = self._bus, self._address
        identity = bus.read_byte_data(address, CHIP_ID)
        if identity != IDENTITY:
            raise WrongChipError("BMP581", address, IDENTITY, identity)
        bus.write_byte_data(address, CMD, SOFT_RESET)
        yield 5 * MS  # 2 ms
        powered_up, status = bus.read_i2c_block_data(address, INT_STATUS, 2)
        if not powered_up & POWERED_UP or status & (NVM_READY | NVM_ERROR) != NVM_READY:
            raise SelfTestError(
                f"BMP581 is not ready after its reset (0x{powered_up:02x}, memory 0x{status:02x}); check its supply"
            )
        bus.write_byte_data(address, ODR, DEEP_OFF)
        yield 3 * MS  # into standby: 2.5 ms
        bus.write_byte_data(address, OSR, self._osr)
        bus.write_byte_data(address, DSP_IIR, 0)
        bus.write_byte_data(address, INT_SOURCE, READY)
        bus.write_byte_data(address, ODR, self._odr)
        yield SECOND // self._config.rate_hz + 20 * MS
        if not bus.read_byte_data(address, OSR_EFF) & RATE_VALID:
            raise SelfTestError("BMP581 cannot keep this rate; lower sensors.static.pressure_oversampling or rate_hz")
        if not self.intact():
            raise SelfTestError("BMP581 does not hold its settings; check supply and wiring")

    def read(self) -> Reading:
        # reading the status clears it: the repetition of a failed burst must not take the sample for an old one
        self._unread = bool(self._bus.read_byte_data(self._address, INT_STATUS) & READY) or self._unread
        data = bytes(self._bus.read_i2c_block_data(self._address, DATA, 6))
        fresh, self._unread = self._unread, False
        temperature, pressure = int.from_bytes(data[:3], "little"), int.from_bytes(data[3:], "little")
        if not fresh or SKIPPED in (pressure, temperature):
            return Reading(state=SensorState.STALE, detail="static pressure sensor has no new sample")
        values = {"static_pressure": pressure, "static_temperature": signed(temperature, 24) + MIDDLE}
        if not LOWEST <= pressure <= HIGHEST:
            words = f"static pressure {pressure / 64:.0f} Pa beyond the sensor's range"
            return Reading(values, SensorState.OUT_OF_RANGE, words)
        return Reading(values)

    def intact(self) -> bool:
        smoothing, *_, osr, odr = self._bus.read_i2c_block_data(self._address, DSP_IIR, ODR - DSP_IIR + 1)
        return (smoothing, osr, odr) == (0, self._osr, self._odr)

    def metadata(self) -> dict[str, str]:
        conversion_s = 1 / BMP581_LARGEST_HZ[self._config.pressure_oversampling]
        age_s = 0.5 / self._config.rate_hz  # a sample is between 0 and one interval old when read
        transfer = {"scale_pa": 1 / 64, "scale_k": 1 / 65536, "offset_k": ZERO_CELSIUS - MIDDLE / 65536}
        facts = {"chip": "BMP581", "filter_delay_s": repr(round(conversion_s / 2 + age_s, 6))}
        return {**facts, **{key: repr(value) for key, value in transfer.items()}}
