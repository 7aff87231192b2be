"""The standard atmosphere's troposphere, and density of the air from what a flight measures (ICAO Doc 7488/3)."""

import numpy as np

from daq.utilities.constants import (
    GAS_CONSTANT,
    LAPSE_RATE,
    SEA_LEVEL_DENSITY,
    SEA_LEVEL_PRESSURE,
    SEA_LEVEL_TEMPERATURE,
)
from groundstation.flight.arrays import Array

_EXPONENT = 5.255876  # g / (R lapse)

OUTSIDE_TEMPERATURE = 25.0
"""[K] from the standard atmosphere beyond which a temperature beside a barometer is its board's, not the air's."""


def density(p_static: Array, temperature: Array) -> Array:
    """Density [kg/m3] of dry air from static pressure [Pa] and temperature [K]."""
    return np.asarray(p_static / (GAS_CONSTANT * temperature))


def standard_temperature(p_static: Array) -> Array:
    """Temperature [K] of the standard atmosphere where its pressure is p_static [Pa]."""
    share = np.maximum(p_static, 1.0) / SEA_LEVEL_PRESSURE
    return np.asarray(SEA_LEVEL_TEMPERATURE * share ** (1.0 / _EXPONENT))


def is_of_the_air(p_static: Array, temperature: Array) -> bool:
    """Whether a temperature [K] can be that of the air at a static pressure [Pa], not of a board that is warm."""
    return abs(float(np.nanmedian(temperature - standard_temperature(p_static)))) < OUTSIDE_TEMPERATURE


def density_at_pressure(p_static: Array) -> Array:
    """Density [kg/m3] at a static pressure [Pa], the temperature being the standard one: 3.5 % off for each 10 K of error."""
    return density(p_static, standard_temperature(p_static))


def pressure_at_altitude(altitude: Array) -> Array:
    """Static pressure [Pa] of the standard atmosphere at an altitude [m]."""
    share = 1.0 - LAPSE_RATE / SEA_LEVEL_TEMPERATURE * altitude
    return np.asarray(SEA_LEVEL_PRESSURE * np.maximum(share, 0.0) ** _EXPONENT)


def density_at_altitude(altitude: Array) -> Array:
    """Density [kg/m3] at an altitude above mean sea level [m]."""
    share = 1.0 - LAPSE_RATE / SEA_LEVEL_TEMPERATURE * altitude
    return np.asarray(SEA_LEVEL_DENSITY * np.maximum(share, 0.0) ** (_EXPONENT - 1.0))
