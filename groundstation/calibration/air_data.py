"""Air data: compensation of the pressure chip, density, altitude, calibrated and true airspeed.

Pressures in Pa, temperatures in K. The speeds are those of isentropic compressible flow; below 30 m/s they agree with
sqrt(2 q / rho) to 0.2 %.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.calibration.errors import CalibrationError

Array = NDArray[np.float64]

GAS_CONSTANT = 287.05287  # J/(kg K), ICAO Doc 7488/3
GAMMA = 1.4
GRAVITY = 9.80665
SEA_LEVEL_PRESSURE = 101325.0
SEA_LEVEL_TEMPERATURE = 288.15
LAPSE_RATE = 0.0065  # K/m
ZERO_CELSIUS = 273.15


@dataclass(frozen=True)
class Bmp390:
    """Compensation coefficients of one BMP390, from its 21 bytes of non-volatile memory at register 0x31.

    Layout and floating-point formulas: Bosch BST-BMP390-DS002, sections 3.11.1 and 8.4 to 8.6.
    """

    t1: float
    t2: float
    t3: float
    p: tuple[float, float, float, float, float, float, float, float, float, float, float]

    @classmethod
    def from_nvm(cls, nvm: bytes) -> "Bmp390":
        """Coefficients from the 21 bytes read at 0x31. Raises CalibrationError when they are not 21 or blank."""
        if len(nvm) != 21 or nvm in (bytes(21), b"\xff" * 21):
            raise CalibrationError(
                f"{len(nvm)} bytes of BMP390 coefficients ({nvm.hex() or 'none'}): 21 that are not blank are needed; "
                "read the chip again or give nvm in static.toml"
            )

        def unsigned(at: int) -> int:
            return int.from_bytes(nvm[at : at + 2], "little")

        def signed(at: int, size: int = 1) -> int:
            return int.from_bytes(nvm[at : at + size], "little", signed=True)

        return cls(
            t1=unsigned(0) * 2.0**8,
            t2=unsigned(2) / 2.0**30,
            t3=signed(4) / 2.0**48,
            p=(
                (signed(5, 2) - 2**14) / 2.0**20,
                (signed(7, 2) - 2**14) / 2.0**29,
                signed(9) / 2.0**32,
                signed(10) / 2.0**37,
                unsigned(11) * 2.0**3,
                unsigned(13) / 2.0**6,
                signed(15) / 2.0**8,
                signed(16) / 2.0**15,
                signed(17, 2) / 2.0**48,
                signed(19) / 2.0**48,
                signed(20) / 2.0**65,
            ),
        )

    def compensate(self, raw_pressure: Array, raw_temperature: Array) -> tuple[Array, Array]:
        """Pressure [Pa] and temperature [K] from the uncompensated 24-bit readings, (N,) each."""
        d1 = raw_temperature - self.t1
        t = d1 * self.t2 + d1 * d1 * self.t3  # degrees Celsius
        p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11 = self.p
        u = raw_pressure
        offset = p5 + t * (p6 + t * (p7 + t * p8))
        sensitivity = u * (p1 + t * (p2 + t * (p3 + t * p4)))
        curvature = u * u * (p9 + p10 * t) + u * u * u * p11
        return offset + sensitivity + curvature, t + ZERO_CELSIUS


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
