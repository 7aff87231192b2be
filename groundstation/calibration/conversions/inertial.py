"""Accelerometer, gyro and magnetometer triads, attitude, and the step from the IMU's place to the CG.

Body axes x forward, y right, z down. All arrays are (N,) per axis; sums are written out so that a sample's result
does not depend on how many are calibrated together.
"""

import numpy as np
from numpy.typing import NDArray

from groundstation.calibration.schema import MountingAngles, Triad, Vector

Array = NDArray[np.float64]
Axes = tuple[Array, Array, Array]


def apply_triad(triad: Triad, reading: Axes, temperature: Array | None = None) -> Axes:
    """matrix (reading - bias - bias_per_kelvin (T - reference)), reading at data-sheet scale [output unit].

    With a temperature coefficient and no temperature the result is NaN: it cannot be corrected.
    """
    free = [reading[i] - triad.bias[i] for i in range(3)]
    if any(triad.bias_per_kelvin):
        warm = np.full_like(free[0], np.nan) if temperature is None else temperature - triad.reference_temperature
        free = [free[i] - triad.bias_per_kelvin[i] * warm for i in range(3)]
    x, y, z = (row[0] * free[0] + row[1] * free[1] + row[2] * free[2] for row in triad.matrix)
    return x, y, z


def at_cg(acceleration: Axes, rates: Axes, rate_derivatives: Axes | None, position: Vector) -> Axes:
    """Specific force at the CG [m/s2] from that at an IMU at `position` [m from the CG].

    a_cg = a_imu - omega_dot x r - omega x (omega x r). Without rate derivatives only the centripetal part is removed.
    """
    ax, ay, az = acceleration
    p, q, r = rates
    x, y, z = position
    along = p * x + q * y + r * z
    square = p * p + q * q + r * r
    # omega x (omega x r) = omega (omega . r) - r (omega . omega)
    ax = ax - (p * along - x * square)
    ay = ay - (q * along - y * square)
    az = az - (r * along - z * square)
    if rate_derivatives is not None:
        p_dot, q_dot, r_dot = rate_derivatives
        ax = ax - (q_dot * z - r_dot * y)
        ay = ay - (r_dot * x - p_dot * z)
        az = az - (p_dot * y - q_dot * x)
    return ax, ay, az


def point_in_earth_axes(position: Vector, attitude: Axes, rates: Axes) -> tuple[Axes, Axes]:
    """North, east, down of a point of the body from the CG [m], and its speed against the CG [m/s].

    position: body axes [m]. attitude: phi, theta, psi [rad]. rates: p, q, r [rad/s].
    """
    p, q, r = rates
    x, y, z = position
    zero = np.zeros_like(p)
    turning = (q * z - r * y, r * x - p * z, p * y - q * x)
    return to_earth_axes((zero + x, zero + y, zero + z), attitude), to_earth_axes(turning, attitude)


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


def wrap(angle: Array) -> Array:
    """An angle brought into [-pi, pi) [rad]."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _quaternion(angles: Vector) -> tuple[float, float, float, float]:
    c = [float(np.cos(a / 2)) for a in angles]
    s = [float(np.sin(a / 2)) for a in angles]
    return (
        c[0] * c[1] * c[2] + s[0] * s[1] * s[2],
        s[0] * c[1] * c[2] - c[0] * s[1] * s[2],
        c[0] * s[1] * c[2] + s[0] * c[1] * s[2],
        c[0] * c[1] * s[2] - s[0] * s[1] * c[2],
    )
