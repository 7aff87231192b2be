"""Air, gravity and the earth's magnetic field around the flying site.

International Standard Atmosphere (ISO 2533) in the troposphere with a temperature offset: pressure follows the
standard lapse in pressure altitude, temperature is the standard one plus the offset. Everything accepts floats or arrays.
"""

import math
from dataclasses import dataclass

from daq.utilities.constants import EARTH_RADIUS, GAS_CONSTANT, GRAVITY, SEA_LEVEL_PRESSURE, SEA_LEVEL_TEMPERATURE
from daq.utilities.constants import LAPSE_RATE as LAPSE
from firmware_sim.physics.maths import Value

EXPONENT = GRAVITY / (GAS_CONSTANT * LAPSE)  # 5.2559


@dataclass(frozen=True, slots=True)
class Site:
    """The flying field: place, weather and magnetic field (NED, tesla).

    The default air is warm enough for the density of 1.17 kg/m3 at 60 m; the elevation is taken as zero, so heights
    above the sea read as heights above the field.
    """

    latitude_deg: float = 26.51
    longitude_deg: float = 80.23
    elevation_m: float = 0.0
    temperature_offset_k: float = 11.8
    magnetic_ned_t: tuple[float, float, float] = (35.1e-6, 0.5e-6, 31.6e-6)


@dataclass(frozen=True, slots=True)
class Air:
    """Static state of the air: pressure [Pa], temperature [K], density [kg/m3]."""

    pressure: Value
    temperature: Value
    density: Value


def air_at(altitude_m: Value, temperature_offset_k: Value) -> Air:
    """State of the air at a height above the sea [m] below 11 km; offset [K] from the standard temperature.

    Hydrostatic with the offset temperature: p = p0 (T / T0)^(g / R L) with T, T0 both shifted by the offset.
    """
    base = SEA_LEVEL_TEMPERATURE + temperature_offset_k
    temperature = base - LAPSE * altitude_m
    pressure = SEA_LEVEL_PRESSURE * (temperature / base) ** EXPONENT
    return Air(pressure, temperature, pressure / (GAS_CONSTANT * temperature))


def pressure_altitude(pressure_pa: Value) -> Value:
    """Height [m] at which the standard atmosphere has this pressure [Pa]: what an altimeter set to 1013.25 hPa shows."""
    return SEA_LEVEL_TEMPERATURE / LAPSE * (1.0 - (pressure_pa / SEA_LEVEL_PRESSURE) ** (1.0 / EXPONENT))


def geodetic(site: Site, north_m: Value, east_m: Value) -> tuple[Value, Value]:
    """Latitude and longitude [deg] of a point north and east [m] of the field, on a sphere (flights of some km)."""
    latitude = site.latitude_deg + north_m * (180.0 / math.pi) / EARTH_RADIUS
    meridian = EARTH_RADIUS * math.cos(math.radians(site.latitude_deg))
    return latitude, site.longitude_deg + east_m * (180.0 / math.pi) / meridian
