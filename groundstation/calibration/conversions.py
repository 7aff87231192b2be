"""From readings to SI: air data, vanes, inertial triads, attitude and the lever arms between sensors and CG.

Pressures in Pa, temperatures in K; body axes x forward, y right, z down. Arrays are (N,) per axis; sums are written out so that
a sample's result does not depend on how many are calibrated together. Speeds are those of isentropic compressible flow; below
30 m/s they agree with sqrt(2 q / rho) to 0.2 %. A vane sees the air that passes its own place: the free stream turned by the
aircraft (upwash, sidewash) plus the speed that rotation gives to that place, omega x r. A beta vane turns about the body z axis
and therefore reads the flank angle atan(v / u), not asin(v / V); at alpha = 0.2 rad the two differ by 2 %.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from daq.contract import bmp390
from daq.utilities.constants import GAS_CONSTANT, GRAVITY, LAPSE_RATE, SEA_LEVEL_PRESSURE, SEA_LEVEL_TEMPERATURE
from daq.utilities.constants import HEAT_RATIO as GAMMA
from groundstation.calibration.schema import CalibrationError, MountingAngles, Triad, Vane, Vector

Array = NDArray[np.float64]


class Bmp390Compensation(bmp390.Bmp390Trimming):
    """The chip's compensation; coefficients that cannot be used raise CalibrationError."""

    @classmethod
    def from_nvm(cls, nvm: bytes) -> "Bmp390Compensation":
        """Coefficients from the 21 bytes read at 0x31. Raises CalibrationError when they are not 21 or blank."""
        try:
            return super().from_nvm(nvm)
        except ValueError as error:
            raise CalibrationError(f"{error}; read the chip again or give nvm in static.toml") from error


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


Axes = tuple[Array, Array, Array]


def apply_triad(triad: Triad, reading: Axes, temperature: Array | None = None) -> Axes:
    """matrix (reading - bias - bias_per_kelvin (T - reference)), reading at data-sheet scale [output unit].

    With a temperature coefficient and no temperature the result is NaN.
    """
    unbiased = [reading[i] - triad.bias[i] for i in range(3)]
    if any(triad.bias_per_kelvin):
        warming = (
            np.full_like(unbiased[0], np.nan) if temperature is None else temperature - triad.reference_temperature
        )
        unbiased = [unbiased[i] - triad.bias_per_kelvin[i] * warming for i in range(3)]
    x, y, z = (row[0] * unbiased[0] + row[1] * unbiased[1] + row[2] * unbiased[2] for row in triad.matrix)
    return x, y, z


def at_cg(acceleration: Axes, rates: Axes, rate_derivatives: Axes | None, position: Vector) -> Axes:
    """Specific force at the CG [m/s2] from that at an IMU at `position` [m from the CG].

    a_cg = a_imu - omega_dot x r - omega x (omega x r). Without rate derivatives only the centripetal part is removed.
    """
    ax, ay, az = acceleration
    p, q, r = rates
    x, y, z = position
    projection = p * x + q * y + r * z
    square = p * p + q * q + r * r
    # omega x (omega x r) = omega (omega . r) - r (omega . omega)
    ax = ax - (p * projection - x * square)
    ay = ay - (q * projection - y * square)
    az = az - (r * projection - z * square)
    if rate_derivatives is not None:
        p_dot, q_dot, r_dot = rate_derivatives
        ax = ax - (q_dot * z - r_dot * y)
        ay = ay - (r_dot * x - p_dot * z)
        az = az - (p_dot * y - q_dot * x)
    return ax, ay, az


def point_in_earth_axes(position: Vector, attitude: Axes, rates: Axes) -> tuple[Axes, Axes]:
    """North, east, down of a point of the body from the CG [m], and its velocity relative to the CG [m/s].

    position: body axes [m]. attitude: phi, theta, psi [rad]. rates: p, q, r [rad/s].
    """
    p, q, r = rates
    x, y, z = position
    zero = np.zeros_like(p)
    velocity = (q * z - r * y, r * x - p * z, p * y - q * x)
    return to_earth_axes((zero + x, zero + y, zero + z), attitude), to_earth_axes(velocity, attitude)


def to_earth_axes(vector: Axes, attitude: Axes) -> Axes:
    """A vector in body axes turned into north, east, down by phi, theta, psi [rad]."""
    x, y, z = vector
    (cf, ct, cp), (sf, st, sp) = ([f(a) for a in attitude] for f in (np.cos, np.sin))
    level_x, level_y, down = x * ct + (y * sf + z * cf) * st, y * cf - z * sf, -x * st + (y * sf + z * cf) * ct
    return level_x * cp - level_y * sp, level_x * sp + level_y * cp, down


def euler_angles(w: Array, x: Array, y: Array, z: Array, attitude: MountingAngles) -> Axes:
    """phi, theta, psi [rad] of the body from the quaternion NED to IMU axes (any length), psi in (-pi, pi].

    The boresight turns body axes into IMU axes (yaw, pitch, roll in turn); declination is added to psi.
    """
    length = np.sqrt(w * w + x * x + y * y + z * z)
    length = np.where(length > 0, length, np.nan)
    w, x, y, z = w / length, x / length, y / length, z / length
    if any(attitude.boresight):
        bw, bx, by, bz = _quaternion(attitude.boresight)
        # body attitude = IMU attitude turned back by the boresight: q (*) conj(b)
        w, x, y, z = (
            w * bw + x * bx + y * by + z * bz,
            -w * bx + x * bw - y * bz + z * by,
            -w * by + x * bz + y * bw - z * bx,
            -w * bz - x * by + y * bx + z * bw,
        )
    phi = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    theta = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    psi = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    if attitude.declination:
        psi = wrap(psi + attitude.declination)
    return phi, theta, psi


def continuous_quaternion(values: Mapping[str, Array]) -> dict[str, Array]:
    """The quaternion with signs chosen so that no component jumps from one sample to the next: q and -q are the same attitude."""
    names = [f"quaternion_{axis}" for axis in "wxyz"]
    q = np.stack([values[n] for n in names])
    dot = np.sum(q[:, 1:] * q[:, :-1], axis=0)
    sign = np.concatenate([[1.0], np.cumprod(np.where(dot < 0, -1.0, 1.0))])
    return {n: q[i] * sign for i, n in enumerate(names)}


def wrap(angle: Array) -> Array:
    """An angle brought into [-pi, pi) [rad]."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _quaternion(angles: Vector) -> tuple[float, float, float, float]:
    """w, x, y, z of the rotation by roll, pitch, yaw [rad], turned in the order yaw, pitch, roll."""
    c = [float(np.cos(a / 2)) for a in angles]
    s = [float(np.sin(a / 2)) for a in angles]
    return (
        c[0] * c[1] * c[2] + s[0] * s[1] * s[2],
        s[0] * c[1] * c[2] - c[0] * s[1] * s[2],
        c[0] * s[1] * c[2] + s[0] * c[1] * s[2],
        c[0] * c[1] * s[2] - s[0] * s[1] * c[2],
    )


LOWEST_SPEED = 5.0
"""Airspeed [m/s] below which a vane does not follow the wind: its angle is then given without correction."""


def undo_wash(local: Array, vane: Vane) -> Array:
    """Flow angle at the vane's place [rad] without the upwash or sidewash of the aircraft."""
    return (local - vane.wash_offset) / vane.wash_factor


def flow_angles(
    alpha_local: Array, beta_local: Array, speed: Array, rates: Axes, alpha_vane: Vane, beta_vane: Vane
) -> tuple[Array, Array]:
    """alpha and beta at the CG [rad] from the vane angles (wash undone), true airspeed [m/s] and rates [rad/s].

    With r the place of a vane, its wind is (u, v, w) + omega x r. Then w = u ta + dw and v = u tb + dv, where ta, tb are
    the tangents of the vane angles, and u follows from u^2 + v^2 + w^2 = V^2. NaN where speed or a rate is not measured.
    """
    p, q, r = rates
    xa, ya, za = alpha_vane.position
    xb, yb, zb = beta_vane.position
    ta, tb = np.tan(alpha_local), np.tan(beta_local)
    dw = (q * za - r * ya) * ta - (p * ya - q * xa)
    dv = (q * zb - r * yb) * tb - (r * xb - p * zb)
    a = 1 + ta * ta + tb * tb
    b = ta * dw + tb * dv
    c = dw * dw + dv * dv - speed * speed
    with np.errstate(invalid="ignore"):
        u = (np.sqrt(b * b - a * c) - b) / a
        alpha = np.arctan2(u * ta + dw, u)
        beta = np.arcsin((u * tb + dv) / speed)
    slow = speed < LOWEST_SPEED
    return np.where(slow, alpha_local, alpha), np.where(slow, beta_local, beta)
