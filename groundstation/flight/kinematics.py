"""Rates of the attitude and acceleration in earth axes, from body axes x forward, y right, z down and the Euler angles yaw,
pitch, roll (Etkin, eq. 4.4)."""

from typing import Protocol

import numpy as np

from daq.utilities.constants import GRAVITY
from groundstation.flight.arrays import Array


class ByName(Protocol):
    """Columns by name: a mapping or a flight."""

    def __getitem__(self, column: str) -> Array: ...


GYROS = {"phi": "p", "theta": "q", "psi": "r"}  # angle of attitude -> the gyro that turns it most


def _rate_about_vertical(c: ByName) -> Array:
    """Rate [rad/s] about the z axis of the frame turned by yaw and pitch, before roll."""
    return c["q"] * np.sin(c["phi"]) + c["r"] * np.cos(c["phi"])


def heading_rate(c: ByName) -> Array:
    """Rate of psi [rad/s] from q, r, phi, theta."""
    return np.asarray(_rate_about_vertical(c) / np.cos(c["theta"]))


def roll_rate(c: ByName) -> Array:
    """Rate of phi [rad/s] from p, q, r, phi, theta."""
    return np.asarray(c["p"] + np.tan(c["theta"]) * _rate_about_vertical(c))


def pitch_rate(c: ByName) -> Array:
    """Rate of theta [rad/s] from q, r, phi."""
    return np.asarray(c["q"] * np.cos(c["phi"]) - c["r"] * np.sin(c["phi"]))


EULER_RATES = {"phi": roll_rate, "theta": pitch_rate, "psi": heading_rate}
"""Angle of attitude -> function that gives its rate from columns."""


def attitude_rates(p: Array, q: Array, r: Array, phi: Array, theta: Array) -> dict[str, Array]:
    """Rates of phi, theta, psi [rad/s] from body rates [rad/s] and attitude [rad]."""
    columns = {"p": p, "q": q, "r": r, "phi": phi, "theta": theta}
    return {angle: rate(columns) for angle, rate in EULER_RATES.items()}


def earth_acceleration(c: ByName) -> tuple[Array, Array, Array]:
    """Acceleration north, east, down [m/s2] from specific force in body axes and attitude."""
    sf, cf, st, ct = np.sin(c["phi"]), np.cos(c["phi"]), np.sin(c["theta"]), np.cos(c["theta"])
    sp, cp = np.sin(c["psi"]), np.cos(c["psi"])
    forward = c["ax"] * ct + (c["ay"] * sf + c["az"] * cf) * st
    right = c["ay"] * cf - c["az"] * sf
    down = -c["ax"] * st + (c["ay"] * sf + c["az"] * cf) * ct + GRAVITY
    return forward * cp - right * sp, forward * sp + right * cp, down
