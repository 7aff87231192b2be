"""AK09916: the magnetometer inside the ICM-20948 package, read directly through the IMU's bypass.

AKM datasheet MS1547-E-02 (October 2014). Transfer function: 0.15 uT per count, +-4912 uT (section 8.3). Its die axes
are x as the IMU's, y and z reversed (ICM-20948 datasheet DS-000189 rev. 1.3, figures 12 and 13); the driver turns them
into the IMU's axes and then, by the IMU's mounting, into body axes. ST2 has to be read after the data: it releases the
next sample.

Self-test: both identity bytes; the mode is read back. Plausibility: ST2 bit 3 (sum of fields beyond the range) is out of
range; no data-ready bit is stale. Bypass is opened again on every set-up, because an IMU that was reset has closed it.
"""

from collections.abc import Generator
from struct import Struct
from typing import Literal

from daq.contract.scan import SensorState
from daq.sensors.base import (
    MS,
    Address,
    Driver,
    DriverContext,
    Reading,
    SelfTestError,
    SensorSection,
    Wait,
    WrongChipError,
)
from daq.sensors.bus import I2cBus
from daq.sensors.icm20948 import BYPASS, INT_PIN_CFG, USER_CTRL, ImuConfig
from daq.sensors.mounting import rotation

WIA1, ST1, CNTL2, CNTL3 = 0x00, 0x10, 0x31, 0x32
COMPANY, DEVICE = 0x48, 0x09
DATA_READY, OVERFLOW, SOFT_RESET = 0x01, 0x08, 0x01
MODE = {10: 0x02, 20: 0x04, 50: 0x06, 100: 0x08}

_BURST = Struct("<B3hxB")  # ST1, HX, HY, HZ, TMPS, ST2


class MagConfig(SensorSection):
    """`[sensors.mag]`: AK09916, reached through the IMU's bypass; it turns with the IMU's mounting."""

    driver: str = "ak09916"
    address: Address = 0x0C
    rate_hz: Literal[10, 20, 50, 100] = 100


class Ak09916(Driver):
    """Magnetic field in body axes [counts of 0.15 uT]."""

    name, groups, precedence = "ak09916", ("mag",), 4
    stuck_s = dict.fromkeys(("mag_x", "mag_y", "mag_z"), 3.0)
    needs = "imu"

    def __init__(self, config: MagConfig, imu: ImuConfig, bus: I2cBus) -> None:
        super().__init__(config, bus)
        self._imu_address = imu.address
        self._mode = MODE[config.rate_hz]
        self._turn = rotation(imu.mounting)
        self.max_rate_hz = config.rate_hz / 1.1  # the chip's clock may run 10 % slow

    @classmethod
    def build(cls, group: str, context: DriverContext) -> Driver:
        return cls(context.section(group), context.section("imu"), context.need_bus(group))

    def initialise(self) -> Generator[Wait, None, None]:
        bus, address = self._bus, self._address
        bus.write_byte_data(self._imu_address, USER_CTRL, 0)
        bus.write_byte_data(self._imu_address, INT_PIN_CFG, BYPASS)
        company, device = bus.read_i2c_block_data(address, WIA1, 2)
        if (company, device) != (COMPANY, DEVICE):
            raise WrongChipError("AK09916", address, COMPANY << 8 | DEVICE, company << 8 | device)
        bus.write_byte_data(address, CNTL3, SOFT_RESET)
        yield MS
        bus.write_byte_data(address, CNTL2, self._mode)
        yield 20 * MS
        if not self.intact():
            raise SelfTestError("AK09916 does not take its measurement mode; power-cycle the IMU board")

    def read(self) -> Reading:
        raw = bytes(self._bus.read_i2c_block_data(self._address, ST1, 9))
        status1, x, y, z, status2 = _BURST.unpack(raw)
        if not status1 & DATA_READY:
            return Reading(state=SensorState.STALE, detail="magnetometer has no new sample")
        body = self._turn(x, min(-y, 32767), min(-z, 32767))
        values = dict(zip(("mag_x", "mag_y", "mag_z", "mag_status"), (*body, status2), strict=True))
        if status2 & OVERFLOW:
            return Reading(values, SensorState.OUT_OF_RANGE, "magnetic field beyond the magnetometer's range")
        return Reading(values)

    def intact(self) -> bool:
        return self._bus.read_byte_data(self._address, CNTL2) == self._mode

    def metadata(self) -> dict[str, str]:
        return {"chip": "AK09916", "scale_t": "1.5e-07", "filter_delay_s": "0.0072"}
