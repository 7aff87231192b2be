"""The standard atmosphere up to the tropopause (ICAO Doc 7488/3), and the density of the air from columns of a flight."""

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
"""[K] difference from the standard atmosphere within which a measured temperature can be the air's: the coldest winters are 55 K
below standard, and a barometer's board is warmer than the air."""
GUESSED_DENSITY = (0.9, 1.2)
"""Range of air density over the standard one: air 30 K warmer on a day of 1 000 hPa, 45 K colder at 1 035 hPa."""


def density(p_static: Array, temperature: Array) -> Array:
    """Density [kg/m3] of dry air from static pressure [Pa] and temperature [K]."""
    return np.asarray(p_static / (GAS_CONSTANT * temperature))


def standard_temperature(p_static: Array) -> Array:
    """Temperature [K] of the standard atmosphere where its pressure is p_static [Pa]."""
    ratio = np.maximum(p_static, 1.0) / SEA_LEVEL_PRESSURE
    return np.asarray(SEA_LEVEL_TEMPERATURE * ratio ** (1.0 / _EXPONENT))


def is_of_the_air(p_static: Array, temperature: Array) -> bool:
    """Whether a temperature (N,) [K] can be that of the air at a static pressure (N,) [Pa], and not of a warm board."""
    difference = float(np.nanmedian(temperature - standard_temperature(p_static)))
    return OUTSIDE_TEMPERATURE[0] < difference < OUTSIDE_TEMPERATURE[1]


def density_at_pressure(p_static: Array) -> Array:
    """Density [kg/m3] at a static pressure [Pa] with the standard temperature; 3.5 % wrong for each 10 K of difference."""
    return density(p_static, standard_temperature(p_static))


def pressure_at_altitude(altitude: Array) -> Array:
    """Static pressure [Pa] of the standard atmosphere at an altitude [m]."""
    ratio = 1.0 - LAPSE_RATE / SEA_LEVEL_TEMPERATURE * altitude  # of temperatures
    return np.asarray(SEA_LEVEL_PRESSURE * np.maximum(ratio, 0.0) ** _EXPONENT)


def density_at_altitude(altitude: Array) -> Array:
    """Density [kg/m3] of the standard atmosphere at an altitude above mean sea level [m]."""
    ratio = 1.0 - LAPSE_RATE / SEA_LEVEL_TEMPERATURE * altitude  # of temperatures
    return np.asarray(SEA_LEVEL_DENSITY * np.maximum(ratio, 0.0) ** (_EXPONENT - 1.0))


def _density_above_sea(altitude: Array, temperature: Array) -> Array:
    return density(pressure_at_altitude(altitude), temperature)


def _of_the_air_above_sea(altitude: Array, temperature: Array) -> bool:
    return is_of_the_air(pressure_at_altitude(altitude), temperature)


@dataclass(frozen=True)
class DensityWay:
    """One way to calculate the density of the air. needs: columns. build: their values (N,) -> density (N,) [kg/m3]. credible:
    their values -> whether they can be quantities of the air."""

    needs: tuple[str, ...]
    build: Callable[..., Array]
    credible: Callable[..., bool]

    @property
    def guesses(self) -> bool:
        """Whether the temperature is that of the standard atmosphere."""
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
"""The best first; used by estimates, contradictions and imports. 2 p_dynamic / V^2 is not used, since an autopilot calculates V
from p_dynamic with its own ratio."""
