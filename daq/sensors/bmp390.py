"""BMP390 (and BMP388): static pressure and temperature, recorded uncompensated.

Bosch datasheet BST-BMP390-DS002 revision 1.7 (BMP388: BST-BMP388-DS001). The counts mean nothing without the 21 trimming bytes of
the individual chip; they are read at set-up, recorded as `nvm`, and the compensation of section 8.4 to 8.6 is done on
the ground, so it can be repeated bit for bit. The chip runs in normal mode with its own filter off.

Self-test: identity; trimming bytes not all equal and as their checksum at 0x30 says (CRC-8, polynomial 0x1D, begun with 0xFF and
inverted: Bosch BMP3 sensor API, bmp3_selftest.c); no error flag. Plausibility: 0x800000 is "not measured" (stale), as is a
missing data-ready flag; 0 and 0xFFFFFF are out of range. A chip back in sleep mode has been reset.
"""

from collections.abc import Callable, Generator
from typing import Literal

import fastcrc
from pydantic import model_validator

from daq.contract.scan import SensorState
from daq.sensors.base import MS, SECOND, Driver, Reading, SelfTestError, SensorSection, Wait, WrongChipError

CHIP_ID, ERR, STATUS, DATA, PWR_CTRL = 0x00, 0x02, 0x03, 0x04, 0x1B
OSR, ODR, FILTER, NVM_CRC, NVM, CMD = 0x1C, 0x1D, 0x1F, 0x30, 0x31, 0x7E
NVM_LENGTH = 21
SOFT_RESET, NORMAL_BOTH, READY_BOTH = 0xB6, 0x33, 0x60
SKIPPED = 0x800000
IDENTITY = {"bmp390": 0x60, "bmp388": 0x50}
ODR_SELECT = {200: 0, 100: 1, 50: 2, 25: 3}


BMP581_LARGEST_HZ = {1: 498, 2: 374, 4: 255, 8: 155, 16: 87, 32: 46}
"""Samples a second by oversampling of the pressure, the temperature's being 1 (BST-BMP581-DS004, table 7)."""


class StaticConfig(SensorSection):
    """`[sensors.static]`: BMP390 or BMP388; driver `bmp581`: a BMP581 at 0x46 or 0x47."""

    driver: str = "bmp390"
    address: Literal[0x46, 0x47, 0x76, 0x77] = 0x77
    chip: Literal["bmp390", "bmp388"] = "bmp390"
    rate_hz: Literal[25, 50, 100, 200] = 50
    pressure_oversampling: Literal[1, 2, 4, 8, 16, 32] = 8
    temperature_oversampling: Literal[1, 2, 4, 8, 16, 32] = 1

    @model_validator(mode="after")
    def _at_its_address(self) -> "StaticConfig":
        sites = {"bmp390": (0x76, 0x77), "bmp581": (0x46, 0x47)}.get(self.driver, (self.address,))
        if self.address not in sites:
            places = " or ".join(f"0x{site:02x}" for site in sites)
            raise ValueError(f"a {self.driver.upper()} sits at {places}, not at 0x{self.address:02x}; set address")
        return self

    @model_validator(mode="after")
    def _fits_the_interval(self) -> "StaticConfig":
        if self.driver == "bmp581":
            if self.rate_hz > BMP581_LARGEST_HZ[self.pressure_oversampling]:
                raise ValueError(
                    f"a BMP581 makes at most {BMP581_LARGEST_HZ[self.pressure_oversampling]} samples a second with this"
                    " pressure_oversampling; lower it or rate_hz"
                )
            return self
        # BMP390 datasheet rev 1.7, section 3.9.2: conversion time by oversampling
        conversion = 234 + 392 + self.pressure_oversampling * 2020 + 163 + self.temperature_oversampling * 2020
        if conversion * self.rate_hz > 1_000_000:
            raise ValueError(
                f"a conversion takes {conversion / 1000:.1f} ms, longer than 1/rate_hz; lower the oversampling or rate_hz"
            )
        return self


trimming_crc: Callable[[bytes], int] = fastcrc.crc8.sae_j1850
"""The checksum that the chip stores before its trimming bytes."""


class Bmp390(Driver):
    """Uncompensated pressure and temperature [24-bit counts]."""

    name, groups, precedence = "bmp390", ("static",), 5
    stuck_s = {"static_pressure": 1.0}  # noqa: RUF012
    max_step = {"static_pressure": 40000.0}  # noqa: RUF012
    _config: StaticConfig

    def _derive_settings(self) -> None:
        config = self._config
        self._osr = (
            config.pressure_oversampling.bit_length() - 1 | (config.temperature_oversampling.bit_length() - 1) << 3
        )
        self._nvm = b""
        self.max_rate_hz = config.rate_hz / 1.1

    def initialise(self) -> Generator[Wait, None, None]:
        bus, address = self._bus, self._address
        identity = bus.read_byte_data(address, CHIP_ID)
        if identity != IDENTITY[self._config.chip]:
            raise WrongChipError(self._config.chip.upper(), address, IDENTITY[self._config.chip], identity)
        bus.write_byte_data(address, CMD, SOFT_RESET)
        yield 5 * MS
        nvm = bytes(bus.read_i2c_block_data(address, NVM, NVM_LENGTH))
        stored = bus.read_byte_data(address, NVM_CRC)
        if len(set(nvm)) == 1:
            raise SelfTestError(f"BMP390 trimming bytes are all 0x{nvm[0]:02x}; the chip is damaged")
        if trimming_crc(nvm) != stored:
            raise SelfTestError(
                f"BMP390 trimming bytes do not match their checksum (0x{trimming_crc(nvm):02x}, stored 0x{stored:02x}):"
                " read wrongly, or the chip is damaged; check supply and wiring"
            )
        self._nvm = nvm
        bus.write_byte_data(address, OSR, self._osr)
        bus.write_byte_data(address, ODR, ODR_SELECT[self._config.rate_hz])
        bus.write_byte_data(address, FILTER, 0)
        bus.write_byte_data(address, PWR_CTRL, NORMAL_BOTH)
        yield SECOND // self._config.rate_hz + 20 * MS
        error = bus.read_byte_data(address, ERR)
        if error:
            raise SelfTestError(f"BMP390 reports error flags 0x{error:02x}; lower oversampling or rate_hz")

    def read(self) -> Reading:
        status, *data = self._bus.read_i2c_block_data(self._address, STATUS, 7)
        if status & READY_BOTH != READY_BOTH:
            return Reading(state=SensorState.STALE, detail="static pressure sensor has no new sample")
        pressure = int.from_bytes(data[0:3], "little")
        temperature = int.from_bytes(data[3:6], "little")
        if SKIPPED in (pressure, temperature):
            return Reading(state=SensorState.STALE, detail="static pressure sensor skipped a measurement")
        values = {"static_pressure": pressure, "static_temperature": temperature}
        if pressure in (0, 0xFFFFFF) or temperature in (0, 0xFFFFFF):
            return Reading(values, SensorState.OUT_OF_RANGE, "static pressure at the end of the sensor's range")
        return Reading(values)

    def intact(self) -> bool:
        power, osr, odr, _, smoothing = self._bus.read_i2c_block_data(self._address, PWR_CTRL, 5)
        return (power, osr, odr, smoothing) == (NORMAL_BOTH, self._osr, ODR_SELECT[self._config.rate_hz], 0)

    def metadata(self) -> dict[str, str]:
        conversion_us = 234 + 392 + 2020 * self._config.pressure_oversampling
        age_us = 500_000 / self._config.rate_hz  # a sample is between 0 and one interval old when read
        return {
            "chip": self._config.chip.upper(),
            "nvm": self._nvm.hex(),
            "filter_delay_s": repr(round((conversion_us / 2 + age_us) * 1e-6, 6)),
        }
