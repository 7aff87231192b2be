"""MS4525DO: differential pressure of the pitot tube.

TE Connectivity datasheet MS4525DO (June 2013) and interface note "Interfacing to MEAS digital pressure modules". There
are no registers: a plain read of four bytes returns two status bits, 14 bits of pressure and 11 of temperature.
Transfer functions: type A spans 10 to 90 % of 16383 counts, p = (count - 0.1*16383) * (p_max - p_min) / (0.8*16383) +
p_min; type B 5 to 95 %; T = count*200/2047 - 50 degC. At +-1 psi type A: 1.052 Pa per count. The zero shifts by about
65 Pa per volt of supply, so the supply is recorded.

Self-test: two reads that agree; the part has no identity. Plausibility: status 3 is a fault of the bridge, 1 is reserved,
2 means the sample was fetched before; counts at the ends, and two reads further apart than 255 counts, are out of range.
"""

import math
from collections.abc import Generator
from typing import Literal

from pydantic import field_validator, model_validator

from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.scan import SensorState
from daq.sensors.base import MS, Address, Driver, Reading, SelfTestError, SensorSection, Wait
from daq.sensors.bus import read_raw
from daq.utilities.constants import INCH_OF_WATER, SEA_LEVEL_DENSITY

NORMAL, RESERVED, FETCHED, FAULT = range(4)
FULL = 0x3FFF
LARGEST_JUMP = 0xFF
JUMP_PA = 1578.0
"""Largest change of pressure from one sample to the next at 20 Hz."""
SDP_COUNTS_PER_PA = {"sdp33": 20, "sdp31": 60, "sdp32": 240}
"""Of the chips of `daq.sensors.sdp3x`: up to 1500, 500 and 125 Pa."""
DLVR_RANGE_PA = {f"l{inches:02d}d": inches * INCH_OF_WATER for inches in (1, 2, 5, 10, 20, 30, 60)}
"""Of `daq.sensors.dlvr`: to both sides, by the first part of the order code behind DLVR-."""
CHIPS = {"sdp3x": tuple(SDP_COUNTS_PER_PA), "dlvr": tuple(DLVR_RANGE_PA)}
SITES = {"sdp3x": (0x21, 0x22, 0x23), "ms5525": (0x76, 0x77)}
SPAN = {"A": (0.1, 0.8), "B": (0.05, 0.9)}


class PitotConfig(SensorSection):
    """`[sensors.pitot]`: MS4525DO; output type A spans 10 to 90 % of the counts, type B 5 to 95 %.

    driver `sdp3x`: an SDP31, SDP32 or SDP33 (left out), as `chip` says, at 0x21 to 0x23; `dlvr`: a DLVR of the range that `chip`
    says (`l10d`); `ms5525`: an MS5525DSO-PP001DS at 0x76 or 0x77; `autopilot`: its own pitot.
    """

    driver: str = "ms4525do"
    address: Address = 0x28
    output: Literal["A", "B"] = "A"
    range_pa: tuple[float, float] = (-6894.757, 6894.757)
    chip: str = ""

    @field_validator("range_pa")
    @classmethod
    def _rising(cls, range_pa: tuple[float, float]) -> tuple[float, float]:
        if range_pa[0] >= range_pa[1]:
            raise ValueError("range_pa must be [lowest, highest]")
        return range_pa

    @model_validator(mode="after")
    def _at_its_address(self) -> "PitotConfig":
        sites = SITES.get(self.driver, (self.address,))
        if self.address not in sites:
            places = " or ".join(f"0x{site:02x}" for site in sites)
            raise ValueError(f"an {self.driver.upper()} sits at {places}, not at 0x{self.address:02x}; set address")
        return self

    @model_validator(mode="after")
    def _known_chip(self) -> "PitotConfig":
        chips = CHIPS.get(self.driver, ())
        needed = self.driver == "dlvr" and not self.chip
        if needed or (self.chip and self.chip not in chips):
            written = "is missing" if needed else f"{self.chip!r} is none of driver {self.driver}"
            raise ValueError(f"chip {written}; write one of {', '.join(chips) or 'none: leave it out'}")
        return self

    @property
    def part(self) -> str:
        """Which chip of a family it is; the usual one where the configuration leaves it out."""
        return self.chip or next(iter(CHIPS.get(self.driver, ("",))))

    @property
    def span_pa(self) -> tuple[float, float]:
        """Lowest and highest pressure that is measured [Pa]."""
        reach = DLVR_RANGE_PA.get(self.part)
        return self.range_pa if reach is None else (-reach, reach)


def nominal_transfer(config: object) -> tuple[float, float]:
    """Pascal for each count, and pascal at count zero, as data sheet or driver have it; NaN for a sensor of one's own."""
    if not isinstance(config, PitotConfig):
        return math.nan, math.nan
    (low, high), (start, span) = config.span_pa, SPAN[config.output]
    if config.driver == "sdp3x":
        counts = SDP_COUNTS_PER_PA[config.part]
        return 1.0 / counts, -32768.0 / counts
    if config.driver == "dlvr":  # 10 to 90 % of 16384
        return 1.25 * (high - low) / 16384, low - (high - low) / 8
    if config.driver != "ms4525do":  # 16 bits over the range, end to end
        return (high - low) / 0xFFFF, low
    per_count = (high - low) / (span * FULL)
    return per_count, low - start * FULL * per_count


def indicated_airspeed(dynamic_pressure: float) -> float:
    """Airspeed [m/s] that a dynamic pressure [Pa] means at sea level; 0 where it is not positive."""
    return math.sqrt(max(0.0, 2.0 * dynamic_pressure / SEA_LEVEL_DENSITY))


def temperature_count(kelvin: float) -> int:
    """A temperature [K] in counts of the channel table."""
    return max(0, CHANNEL_BY_NAME["pitot_temperature"].count_of(kelvin))


def split(data: bytes) -> tuple[int, int, int]:
    """Status, pressure count and temperature count of the four bytes."""
    return data[0] >> 6, (data[0] & 0x3F) << 8 | data[1], data[2] << 3 | data[3] >> 5


class Ms4525do(Driver):
    """Differential pressure and die temperature [counts]."""

    name, groups, precedence, starts_first, title = "ms4525do", ("pitot",), 2, True, "MS4525DO"
    stuck_s = {"pitot_pressure": 3.0}  # noqa: RUF012
    max_step = {"pitot_pressure": 1500.0}  # noqa: RUF012 - JUMP_PA at 1.05 Pa a count
    _config: PitotConfig

    def _derive_settings(self) -> None:
        self._unconfirmed: tuple[int, int] | None = None  # fetched, but the confirming read failed

    def initialise(self) -> Generator[Wait, None, None]:
        read_raw(self._bus, self._address, 4)
        yield 10 * MS  # power-up to first data: 8.4 ms
        status, first, _ = split(read_raw(self._bus, self._address, 4))
        yield 2 * MS
        _, second, temperature = split(read_raw(self._bus, self._address, 4))
        if status in (RESERVED, FAULT):
            raise SelfTestError(f"{self.title} reports status {status} (bridge fault); replace it")
        if abs(second - first) > LARGEST_JUMP or temperature in (0, 0x7FF):
            raise SelfTestError(
                f"{self.title} pressure jumps from {first} to {second} counts between two reads, temperature {temperature};"
                " check hoses, supply and wiring"
            )

    def read(self) -> Reading:
        status, pressure, temperature = split(read_raw(self._bus, self._address, 4))
        if status in (RESERVED, FAULT):
            return Reading(state=SensorState.FAULT, detail=f"pitot sensor reports status {status}")
        if status == FETCHED:
            if self._unconfirmed is None:
                return Reading(state=SensorState.STALE, detail="pitot sensor has no new sample")
            pressure, temperature = self._unconfirmed
        self._unconfirmed = pressure, temperature
        second_status, repeated, _ = split(read_raw(self._bus, self._address, 4))
        self._unconfirmed = None
        values = {"pitot_pressure": pressure, "pitot_temperature": temperature}
        if pressure in (0, FULL) or temperature in (0, 0x7FF):
            return Reading(values, SensorState.OUT_OF_RANGE, "pitot pressure at the end of the sensor's range")
        if second_status in (NORMAL, FETCHED) and abs(repeated - pressure) > LARGEST_JUMP:
            return Reading(
                values, SensorState.OUT_OF_RANGE, f"pitot pressure jumps from {pressure} to {repeated} counts"
            )
        return Reading(values)

    def metadata(self) -> dict[str, str]:
        scale, offset = nominal_transfer(self._config)
        return {
            "chip": self.title,
            "scale_pa": repr(scale),
            "offset_pa": repr(offset),
            "filter_delay_s": "0.0005",
        }
