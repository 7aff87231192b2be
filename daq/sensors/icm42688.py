"""ICM-42688-P: three-axis accelerometer and gyro.

TDK InvenSense data sheet DS-000347 revision 1.7 as ArduPilot's (Invensensev3), PX4's and Linux's (inv_icm42600) drivers have it.
Full scales and counts as of an ICM-20948; 500 samples a second. The filter against aliasing is at 213 Hz (table 5-1); the
user's is first order with half power at 500 Hz over 4, 5, 8, 10, 16, 20 or 40: it delays slow signals by 1/(2 pi bandwidth).
Die temperature 132.48 counts per kelvin, 0 at 25 degC, recorded in counts of the channel table. Switching of the gyro's range by
itself, which makes it stand still for 2 ms, is off (AFSR, as ArduPilot has it). There is no magnetometer in it.

Self-test: identity, reset done, settings of three banks read back, data. Plausibility: a count at the end of the range is out of
range; a data-ready bit that stays clear is stale; registers of a chip that was reset hold -32768.
"""

from collections.abc import Generator
from struct import Struct

from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.scan import SensorState
from daq.sensors.base import MS, Driver, Reading, SelfTestError, Wait, WrongChipError
from daq.sensors.icm20948 import ICM42688_LOWPASS_HZ, NAMES, ImuConfig, imu_facts
from daq.sensors.mounting import Rotation, rotation
from daq.utilities.constants import ZERO_CELSIUS

# bank 0
DEVICE_CONFIG, DATA, INT_STATUS, INTF_CONFIG1, PWR_MGMT0 = 0x11, 0x1D, 0x2D, 0x4D, 0x4E
GYRO_CONFIG1, ACCEL_CONFIG1, WHO_AM_I, BANK_SEL = 0x51, 0x53, 0x75, 0x76
GYRO_STATIC2, ACCEL_STATIC2 = 0x0B, 0x03  # banks 1 and 2

IDENTITY, RESET, RESET_DONE, READY = 0x47, 0x01, 0x10, 0x08
BOTH_ON, RATE_500_HZ, AFSR_OFF = 0x0F, 0x0F, 0x40
FULL_SCALE_G, FULL_SCALE_DPS = (16, 8, 4, 2), (2000, 1000, 500, 250)  # by setting
ALIAS_213_HZ = (5, 25, 10)  # DELT, DELTSQR, BITSHIFT

_BURST = Struct(">7h")
_LEAST, _MOST = -32768, 32767


class Icm42688(Driver):
    """Accelerometer and gyro in body axes [counts]."""

    name, groups, precedence, starts_first = "icm42688", ("imu",), 1, True
    max_rate_hz = 500.0 / 1.1
    _config: ImuConfig

    def _derive_settings(self) -> None:
        config = self._config
        self._unread = False
        self._other_bank = False  # than that of the data may be selected
        self._turn: Rotation = rotation(config.mounting)
        accel, gyro = (ICM42688_LOWPASS_HZ.index(f) + 1 for f in (config.accel_lowpass_hz, config.gyro_lowpass_hz))
        self._ranges = tuple(
            scales.index(full_scale) << 5 | RATE_500_HZ
            for scales, full_scale in (
                (FULL_SCALE_DPS, config.gyro_range_dps),
                (FULL_SCALE_G, config.accel_range_g),
            )
        )
        self._bandwidth = accel << 4 | gyro
        self._settings: dict[int, bytes] = {}  # what each bank holds once it is set up

    def initialise(self) -> Generator[Wait, None, None]:
        bus, address = self._bus, self._address
        self._select_data_bank()
        identity = bus.read_byte_data(address, WHO_AM_I)
        if identity != IDENTITY:
            raise WrongChipError("ICM-42688-P", address, IDENTITY, identity)
        bus.write_byte_data(address, DEVICE_CONFIG, RESET)
        yield 10 * MS  # 1 ms
        if not bus.read_byte_data(address, INT_STATUS) & RESET_DONE:
            raise SelfTestError("ICM-42688-P does not finish its reset; power-cycle it or replace it")
        yield from self._configure()
        bus.write_byte_data(address, PWR_MGMT0, BOTH_ON)
        yield 80 * MS  # gyro from off: 60 ms
        self._settings = self._settings_read()
        wanted = bytes((BOTH_ON, *self._ranges))
        if self._settings[0][:3] != wanted or self._settings[0][4] != self._bandwidth:
            raise SelfTestError(
                f"ICM-42688-P holds {self._settings[0].hex(' ')} instead of {wanted.hex(' ')}; check supply and wiring"
            )
        raw = _BURST.unpack(bytes(bus.read_i2c_block_data(address, DATA, 14)))
        if len(set(raw[1:])) == 1:
            raise SelfTestError(
                f"ICM-42688-P delivers {raw[1]} on all axes after start-up; power-cycle it or replace it"
            )

    def _configure(self) -> Generator[Wait, None, None]:
        """While both parts are off, as they are after a reset (section 12.9)."""
        bus, address = self._bus, self._address
        afsr = bus.read_byte_data(address, INTF_CONFIG1) & 0x3F | AFSR_OFF
        gyro_order = bus.read_byte_data(address, GYRO_CONFIG1) & ~0x0C
        accel_order = bus.read_byte_data(address, ACCEL_CONFIG1) & ~0x18
        bus.write_i2c_block_data(
            address, INTF_CONFIG1, [afsr, 0, *self._ranges, gyro_order, self._bandwidth, accel_order]
        )
        delt, square, shift = ALIAS_213_HZ
        high = shift << 4 | square >> 8
        self._select_bank(1)
        on = bus.read_byte_data(address, GYRO_STATIC2) & ~0x03  # neither filter disabled
        bus.write_i2c_block_data(address, GYRO_STATIC2, [on, delt, square & 0xFF, high])
        yield 0
        self._select_bank(2)
        bus.write_i2c_block_data(address, ACCEL_STATIC2, [delt << 1, square & 0xFF, high])
        self._select_data_bank()
        yield 0

    def _settings_read(self) -> dict[int, bytes]:
        """Settings as the chip holds them: power to filters of bank 0, filters against aliasing of banks 1 and 2."""
        settings = {0: bytes(self._bus.read_i2c_block_data(self._address, PWR_MGMT0, 6))}
        for bank, register, length in ((1, GYRO_STATIC2, 4), (2, ACCEL_STATIC2, 3)):
            self._select_bank(bank)
            settings[bank] = bytes(self._bus.read_i2c_block_data(self._address, register, length))
        self._select_data_bank()
        return settings

    def read(self) -> Reading:
        bus = self._bus
        if self._other_bank:
            self._select_data_bank()
        # reading the status clears it: the repetition of a failed burst must not take the sample for an old one
        self._unread = bool(bus.read_byte_data(self._address, INT_STATUS) & READY) or self._unread
        temperature, *raw = _BURST.unpack(bytes(bus.read_i2c_block_data(self._address, DATA, 14)))
        fresh, self._unread = self._unread, False
        if set(raw) == {_LEAST}:
            return Reading(state=SensorState.FAULT, detail="IMU was reset")
        if not fresh:
            return Reading(state=SensorState.STALE, detail="IMU has no new sample")
        die = CHANNEL_BY_NAME["imu_temperature"].count_of(temperature / 132.48 + 25.0 + ZERO_CELSIUS)
        values = dict(zip(NAMES, (*self._turn(*raw[0:3]), *self._turn(*raw[3:6]), die), strict=True))
        clipped = [name for name, count in zip(NAMES[:6], raw, strict=True) if count in (_LEAST, _MOST)]
        if clipped:
            return Reading(values, SensorState.OUT_OF_RANGE, f"IMU beyond its range ({clipped[0][:-2]})")
        return Reading(values)

    def intact(self) -> bool:
        return self._settings_read() == self._settings

    def _select_bank(self, bank: int) -> None:
        self._other_bank = True
        self._bus.write_byte_data(self._address, BANK_SEL, bank)

    def _select_data_bank(self) -> None:
        """A transfer that failed in another bank leaves the chip there until this one succeeds."""
        self._select_bank(0)
        self._other_bank = False

    def metadata(self) -> dict[str, str]:
        return {"chip": "ICM-42688-P", **imu_facts(self._config)}
