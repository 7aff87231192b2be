"""Air data: compensation of the pressure chip, density, altitude, calibrated and true airspeed.

Pressures in Pa, temperatures in K. The speeds are those of isentropic compressible flow; below 30 m/s they agree with
sqrt(2 q / rho) to 0.2 %.
"""

import numpy as np
from numpy.typing import NDArray

from daq.contract import bmp390
from daq.contract.constants import GAS_CONSTANT, GRAVITY, LAPSE_RATE, SEA_LEVEL_PRESSURE, SEA_LEVEL_TEMPERATURE
from daq.contract.constants import HEAT_RATIO as GAMMA
from groundstation.calibration.errors import CalibrationError

Array = NDArray[np.float64]


class Bmp390Compensation(bmp390.Bmp390Trimming):
    """The chip's compensation, where coefficients that cannot be used are an error of the calibration."""

    @classmethod
    def from_nvm(cls, nvm: bytes) -> "Bmp390Compensation":
        """Coefficients from the 21 bytes read at 0x31. Raises CalibrationError when they are not 21 or blank."""
        try:
            return super().from_nvm(nvm)
        except ValueError as error:
            raise CalibrationError(f"{error}; read the chip again or give nvm in static.toml") from error


def density(static_pressure: Array, temperature: Array) -> Array:
    """Density of dry air [kg/m3]."""
    return static_pressure / (GAS_CONSTANT * temperature)


def pressure_altitude(static_pressure: Array, sea_level_pressure: float = SEA_LEVEL_PRESSURE) -> Array:
    """Altitude in the standard atmosphere below 11 km [m] (ICAO Doc 7488/3, eq 12 solved for the height)."""
    exponent = GAS_CONSTANT * LAPSE_RATE / GRAVITY
    return SEA_LEVEL_TEMPERATURE / LAPSE_RATE * (1 - np.power(static_pressure / sea_level_pressure, exponent))


def true_airspeed(impact_pressure: Array, static_pressure: Array, temperature: Array) -> Array:
    """True airspeed [m/s] of isentropic flow brought to rest; 0 where the impact pressure is not positive."""
    return _speed(impact_pressure / static_pressure, GAMMA * GAS_CONSTANT * temperature)


def impact_pressure(airspeed: float, static_pressure: float, temperature: float) -> float:
    """Impact pressure [Pa] of a true airspeed [m/s]: the inverse of `true_airspeed`."""
    mach_squared = airspeed**2 / (GAMMA * GAS_CONSTANT * temperature)
    return float(static_pressure * np.expm1(GAMMA / (GAMMA - 1) * np.log1p((GAMMA - 1) / 2 * mach_squared)))


def calibrated_airspeed(impact_pressure: Array) -> Array:
    """Calibrated airspeed [m/s]: the true airspeed that the same impact pressure has at standard sea level."""
    return _speed(impact_pressure / SEA_LEVEL_PRESSURE, np.float64(GAMMA * GAS_CONSTANT * SEA_LEVEL_TEMPERATURE))


def _speed(pressure_ratio: Array, speed_of_sound_squared: Array | np.float64) -> Array:
    # expm1(k log1p(x)) instead of (1 + x)^k - 1: at 15 m/s x is 0.001, and the difference would cost four digits
    rise = np.expm1((GAMMA - 1) / GAMMA * np.log1p(np.maximum(pressure_ratio, 0.0)))
    return np.sqrt(2 / (GAMMA - 1) * speed_of_sound_squared * rise)
