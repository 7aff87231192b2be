"""ICM-20948: three-axis accelerometer and gyro of the nine-axis IMU.

Datasheet TDK InvenSense DS-000189 revision 1.3 (June 2017). Transfer functions (table 1 and 2, section 3):
accelerometer 16384/8192/4096/2048 counts per g at +-2/4/8/16 g; gyro 131/65.5/32.8/16.4 counts per deg/s at
+-250/500/1000/2000 deg/s; die temperature 333.87 counts per kelvin, 0 at 21 degC. Output rate 1125/(1 + divider) Hz.
Low-pass filters (tables 16 and 18) behave as first order, so they delay slow signals by 1/(2 pi bandwidth).

Self-test: identity, settings read back, and data that are not all zero (a sleeping chip's are). Plausibility: a count
at the end of the range is out of range; a data-ready bit that stays clear is stale; after all zeros the driver checks
whether the chip has been reset.
"""

import math
from collections.abc import Generator
from struct import Struct
from typing import Any, Literal

from pydantic import field_validator, model_validator

from daq.contract.scan import SensorState
from daq.sensors.base import (
    MS,
    Address,
    Driver,
    Positive,
    Reading,
    SelfTestError,
    SensorSection,
    Wait,
    WrongChipError,
)
from daq.sensors.mounting import AS_PRINTED, Mounting, Rotation, check_mounting, rotation
from daq.utilities.constants import GRAVITY

# bank 0
WHO_AM_I, USER_CTRL, PWR_MGMT_1, PWR_MGMT_2, INT_PIN_CFG, INT_STATUS_1 = 0x00, 0x03, 0x06, 0x07, 0x0F, 0x1A
ACCEL_XOUT_H, REG_BANK_SEL = 0x2D, 0x7F
# bank 2
GYRO_SMPLRT_DIV, GYRO_CONFIG_1 = 0x00, 0x01
ACCEL_SMPLRT_DIV_1, ACCEL_CONFIG = 0x10, 0x14

IDENTITY = 0xEA
RESET, AUTO_CLOCK, SLEEP, BYPASS = 0x80, 0x01, 0x40, 0x02

GYRO_LOWPASS_HZ = (196.6, 151.8, 119.5, 51.2, 23.9, 11.6, 5.7, 361.4)  # by DLPF setting, table 16
ACCEL_LOWPASS_HZ = (246.0, 246.0, 111.4, 50.4, 23.9, 11.5, 5.7, 473.0)  # table 18
COUNTS_PER_DPS = {250: 131.0, 500: 65.5, 1000: 32.8, 2000: 16.4}
COUNTS_PER_G = {2: 16384.0, 4: 8192.0, 8: 4096.0, 16: 2048.0}

_BURST = Struct(">7h")
_LEAST, _MOST = -32768, 32767
NAMES = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "imu_temperature")


ICM42688_LOWPASS_HZ = (125.0, 100.0, 62.5, 50.0, 31.25, 25.0, 12.5)
"""3 dB bandwidths of an ICM-42688-P at 500 samples a second, by setting from 1."""


def imu_facts(config: "ImuConfig") -> dict[str, str]:
    """What the ground needs to know of a chip with first-order low passes: mounting, scales and delays, as metadata text."""
    delay = {"gyro": config.gyro_lowpass_hz, "accel": config.accel_lowpass_hz}
    return {
        "mounting": " ".join(config.mounting),
        "accel_scale_m_s2": repr(GRAVITY / COUNTS_PER_G[config.accel_range_g]),
        "gyro_scale_rad_s": repr(math.radians(1 / COUNTS_PER_DPS[config.gyro_range_dps])),
        **{f"{k}_lowpass_hz": repr(v) for k, v in delay.items()},
        **{f"{k}_delay_s": repr(round(1 / (2 * math.pi * v), 6)) for k, v in delay.items()},
        "filter_delay_s": repr(round(1 / (2 * math.pi * min(delay.values())), 6)),
    }


def setting(lowpass_index: int, range_index: int) -> int:
    """GYRO_CONFIG_1 or ACCEL_CONFIG: filter setting, full scale, filter on."""
    return lowpass_index << 3 | range_index << 1 | 1


class ImuConfig(SensorSection):
    """`[sensors.imu]`: ICM-20948 accelerometer and gyro; driver `icm42688`: an ICM-42688-P.

    mounting: the chip axis that lies along body x (forward), y (right) and z (down).
    lowpass: 3 dB bandwidths of the chip's filters [Hz]; one value of the datasheet's list.
    """

    driver: str = "icm20948"
    address: Address = 0x68
    accel_range_g: Literal[2, 4, 8, 16] = 8
    gyro_range_dps: Literal[250, 500, 1000, 2000] = 500
    accel_lowpass_hz: Positive = 11.5
    gyro_lowpass_hz: Positive = 11.6
    mounting: Mounting = AS_PRINTED

    _rotation = field_validator("mounting")(check_mounting)

    @model_validator(mode="before")
    @classmethod
    def _lowpass_default_of_chip(cls, section: Any) -> Any:
        if isinstance(section, dict) and section.get("driver") == "icm42688":
            return {"accel_lowpass_hz": ICM42688_LOWPASS_HZ[-1], "gyro_lowpass_hz": ICM42688_LOWPASS_HZ[-1], **section}
        return section

    @model_validator(mode="after")
    def _lowpass_of_chip(self) -> "ImuConfig":
        choices = {"accel_lowpass_hz": ACCEL_LOWPASS_HZ, "gyro_lowpass_hz": GYRO_LOWPASS_HZ}
        for key, bandwidths in choices.items():
            possible = ICM42688_LOWPASS_HZ if self.driver == "icm42688" else bandwidths
            if getattr(self, key) not in possible:
                words = ", ".join(f"{f:g}" for f in sorted(set(possible), reverse=True))
                raise ValueError(f"{key} must be one of {words}")
        return self


class Icm20948(Driver):
    """Accelerometer and gyro in body axes [counts]; also opens the bypass to the magnetometer."""

    name, groups, precedence, starts_first = "icm20948", ("imu",), 1, True
    stuck_s = dict.fromkeys(NAMES[:6], 1.0)
    max_step = {**dict.fromkeys(NAMES[:3], 20000.0), **dict.fromkeys(NAMES[3:6], 30000.0)}  # noqa: RUF012
    max_rate_hz = 1125.0
    _config: ImuConfig

    def _derive_settings(self) -> None:
        config = self._config
        self._unread = False
        self._other_bank = False  # than that of the data may be selected
        self._turn: Rotation = rotation(config.mounting)
        self._gyro_setting = setting(
            GYRO_LOWPASS_HZ.index(config.gyro_lowpass_hz), tuple(COUNTS_PER_DPS).index(config.gyro_range_dps)
        )
        self._accel_setting = setting(
            ACCEL_LOWPASS_HZ.index(config.accel_lowpass_hz), tuple(COUNTS_PER_G).index(config.accel_range_g)
        )

    def initialise(self) -> Generator[Wait, None, None]:
        bus, address = self._bus, self._address
        bus.write_byte_data(address, REG_BANK_SEL, 0)
        identity = bus.read_byte_data(address, WHO_AM_I)
        if identity != IDENTITY:
            raise WrongChipError("ICM-20948", address, IDENTITY, identity)
        bus.write_byte_data(address, PWR_MGMT_1, RESET)
        yield 100 * MS  # start-up time for register access, table 3: 100 ms worst case
        bus.write_byte_data(address, PWR_MGMT_1, AUTO_CLOCK)
        yield 40 * MS  # gyro start-up from sleep, table 1: 35 ms
        bus.write_byte_data(address, PWR_MGMT_2, 0)
        bus.write_byte_data(address, USER_CTRL, 0)  # auxiliary master off: the magnetometer is read directly
        bus.write_byte_data(address, INT_PIN_CFG, BYPASS)
        yield from self._configure()
        yield 20 * MS
        if not any(bus.read_i2c_block_data(address, ACCEL_XOUT_H, 12)):
            raise SelfTestError("ICM-20948 delivers only zeros after start-up; power-cycle it or replace it")

    def _configure(self) -> Generator[Wait, None, None]:
        bus, address = self._bus, self._address
        bus.write_byte_data(address, REG_BANK_SEL, 2 << 4)
        bus.write_byte_data(address, GYRO_SMPLRT_DIV, 0)
        bus.write_byte_data(address, GYRO_CONFIG_1, self._gyro_setting)
        bus.write_i2c_block_data(address, ACCEL_SMPLRT_DIV_1, [0, 0])
        bus.write_byte_data(address, ACCEL_CONFIG, self._accel_setting)
        yield 0
        gyro = bus.read_byte_data(address, GYRO_CONFIG_1)
        accel = bus.read_byte_data(address, ACCEL_CONFIG)
        bus.write_byte_data(address, REG_BANK_SEL, 0)
        if (gyro, accel) != (self._gyro_setting, self._accel_setting):
            raise SelfTestError(
                f"ICM-20948 holds ranges 0x{gyro:02x} 0x{accel:02x} instead of 0x{self._gyro_setting:02x} "
                f"0x{self._accel_setting:02x}; check supply and wiring"
            )

    def read(self) -> Reading:
        bus = self._bus
        if self._other_bank:
            self._select_data_bank()
        # Reading the status clears it: should the burst then fail, the repetition must not take the sample for an old one.
        self._unread = bool(bus.read_byte_data(self._address, INT_STATUS_1) & 1) or self._unread
        raw = _BURST.unpack(bytes(bus.read_i2c_block_data(self._address, ACCEL_XOUT_H, 14)))
        fresh, self._unread = self._unread, False
        lowest, highest = min(raw[:6]), max(raw[:6])
        if lowest == highest == 0:
            return self._explain_zeros()
        if not fresh:
            return Reading(state=SensorState.STALE, detail="IMU has no new sample")
        values = dict(zip(NAMES, (*self._turn(*raw[0:3]), *self._turn(*raw[3:6]), raw[6]), strict=True))
        if lowest > _LEAST and highest < _MOST:
            return Reading(values)
        clipped = [name for name, count in zip(NAMES[:6], raw[:6], strict=True) if count in (_LEAST, _MOST)]
        return Reading(values, SensorState.OUT_OF_RANGE, f"IMU beyond its range ({clipped[0][:-2]})")

    def _explain_zeros(self) -> Reading:
        asleep = self._bus.read_byte_data(self._address, PWR_MGMT_1) & SLEEP
        return Reading(state=SensorState.FAULT, detail="IMU was reset" if asleep else "IMU delivers only zeros")

    def intact(self) -> bool:
        bus, address = self._bus, self._address
        if bus.read_byte_data(address, PWR_MGMT_1) != AUTO_CLOCK:
            return False
        self._other_bank = True
        bus.write_byte_data(address, REG_BANK_SEL, 2 << 4)
        gyro, accel = (bus.read_byte_data(address, r) for r in (GYRO_CONFIG_1, ACCEL_CONFIG))
        self._select_data_bank()
        return (gyro, accel) == (self._gyro_setting, self._accel_setting)

    def _select_data_bank(self) -> None:
        """A transfer that failed in another bank leaves the chip there until this one succeeds."""
        self._bus.write_byte_data(self._address, REG_BANK_SEL, 0)
        self._other_bank = False

    def metadata(self) -> dict[str, str]:
        return {"chip": "ICM-20948", **imu_facts(self._config)}
