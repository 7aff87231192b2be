"""The standard atmosphere's troposphere, and density of the air from what a flight measures (ICAO Doc 7488/3)."""

from collections.abc import Callable
from dataclasses import dataclass

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

OUTSIDE_TEMPERATURE = (-55.0, 25.0)
"""[K] from the standard atmosphere beyond which a temperature beside a barometer is its board's, not the air's: a board is warmer
than the air, and the coldest winters are 55 K below standard."""
GUESSED_DENSITY = (0.9, 1.2)
"""Times the standard density that air of unknown temperature has: 30 K warmer on a day of 1 000 hPa, 45 K colder at 1 035 hPa."""


def density(p_static: Array, temperature: Array) -> Array:
    """Density [kg/m3] of dry air from static pressure [Pa] and temperature [K]."""
    return np.asarray(p_static / (GAS_CONSTANT * temperature))


def standard_temperature(p_static: Array) -> Array:
    """Temperature [K] of the standard atmosphere where its pressure is p_static [Pa]."""
    share = np.maximum(p_static, 1.0) / SEA_LEVEL_PRESSURE
    return np.asarray(SEA_LEVEL_TEMPERATURE * share ** (1.0 / _EXPONENT))


def is_of_the_air(p_static: Array, temperature: Array) -> bool:
    """Whether a temperature [K] can be that of the air at a static pressure [Pa], not of a board that is warm."""
    warmer = float(np.nanmedian(temperature - standard_temperature(p_static)))
    return OUTSIDE_TEMPERATURE[0] < warmer < OUTSIDE_TEMPERATURE[1]


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


def _density_above_sea(altitude: Array, temperature: Array) -> Array:
    return density(pressure_at_altitude(altitude), temperature)


def _of_the_air_above_sea(altitude: Array, temperature: Array) -> bool:
    return is_of_the_air(pressure_at_altitude(altitude), temperature)


@dataclass(frozen=True)
class DensityWay:
    """One way to the density of the air. build: (N,) density of the needed columns (N,). credible: whether those can be what
    their names say. guesses: whether the temperature is a guess, the standard one."""

    needs: tuple[str, ...]
    build: Callable[..., Array]
    credible: Callable[..., bool]

    @property
    def guesses(self) -> bool:
        return "temperature" not in self.needs


def _always(*columns: Array) -> bool:
    return True


DENSITY_WAYS = (
    DensityWay(("p_static", "temperature"), density, is_of_the_air),
    DensityWay(("p_static",), density_at_pressure, _always),
    DensityWay(("altitude", "temperature"), _density_above_sea, _of_the_air_above_sea),
    DensityWay(("altitude",), density_at_altitude, _always),
    DensityWay(("altitude_gnss", "temperature"), _density_above_sea, _of_the_air_above_sea),
    DensityWay(("altitude_gnss",), density_at_altitude, _always),
)
"""The best first: for estimates, contradictions and imports alike. Never from 2 p_dynamic / V^2: an autopilot makes V from
p_dynamic with a ratio of its own, and the two then say nothing of the air."""
