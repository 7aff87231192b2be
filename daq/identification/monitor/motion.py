"""Lateral motion of many aircraft at once: arrays instead of floats, otherwise as `simulated_motion`.

Every quantity is an array that broadcasts to (models, flights): one model for the simulated flights, one for each effect of the
bank where the signatures are made. SI, rad.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.contract.constants import GRAVITY
from daq.identification.airframe import DERIVATIVES, Airframe

Array = NDArray[np.float64]
LONGEST_STEP = 0.026  # s; as in `simulated_motion`


class Inputs(NamedTuple):
    """What is measured, (flights,) each: pitch rate, attitude, angle of attack, airspeed, density, surfaces."""

    q: Array
    theta: Array
    alpha: Array
    V: Array
    rho: Array
    delta_a: Array
    delta_r: Array

    def between(self, other: "Inputs", part: float) -> "Inputs":
        """On the straight line to another."""
        return Inputs(*(a + part * (b - a) for a, b in zip(self, other, strict=True)))


class LateralMotion:
    """Rates of beta, p, r, phi and the side force. values: derivative -> array, `DERIVATIVES` and perhaps Cn_da, CY_da."""

    def __init__(self, airframe: Airframe, values: Mapping[str, Array]) -> None:
        self._a = airframe
        zero = np.zeros(1)
        self._d = {n: np.asarray(values.get(n, zero), float) for n in (*DERIVATIVES, "Cn_da", "CY_da")}
        self._inertia = airframe.Ixx * airframe.Izz - airframe.Ixz**2

    def side_force(self, x: Array, u: Inputs, gust: Array | float = 0.0) -> Array:
        """Specific force ay [m/s2]. x: (4, models, flights); gust: sideslip that the air adds [rad]."""
        d, rate = self._d, self._a.span / (2.0 * u.V)
        CY = d["CY_0"] + d["CY_beta"] * (x[0] + gust) + rate * (d["CY_p"] * x[1] + d["CY_r"] * x[2])
        CY = CY + d["CY_dr"] * u.delta_r + d["CY_da"] * u.delta_a
        return np.asarray(0.5 * u.rho * u.V**2 * self._a.area / self._a.mass * CY)

    def rates(self, x: Array, u: Inputs, gust: Array | float = 0.0) -> Array:
        """(4, models, flights) of the state's rates."""
        a, d = self._a, self._d
        beta, p, r, phi = x
        rate = a.span / (2.0 * u.V)
        q_sb = 0.5 * u.rho * u.V**2 * a.area * a.span
        air = beta + gust
        Cl = d["Cl_0"] + d["Cl_beta"] * air + rate * (d["Cl_p"] * p + d["Cl_r"] * r)
        Cl = Cl + d["Cl_da"] * u.delta_a + d["Cl_dr"] * u.delta_r
        Cn = d["Cn_0"] + d["Cn_beta"] * air + rate * (d["Cn_p"] * p + d["Cn_r"] * r)
        Cn = Cn + d["Cn_dr"] * u.delta_r + d["Cn_da"] * u.delta_a
        roll = q_sb * Cl + a.Ixz * p * u.q - (a.Izz - a.Iyy) * u.q * r
        yaw = q_sb * Cn - a.Ixz * u.q * r - (a.Iyy - a.Ixx) * p * u.q
        side = self.side_force(x, u, gust) + GRAVITY * np.cos(u.theta) * np.sin(phi)
        return np.stack(
            np.broadcast_arrays(
                p * np.sin(u.alpha) - r * np.cos(u.alpha) + side / u.V,
                (a.Izz * roll + a.Ixz * yaw) / self._inertia,
                (a.Ixx * yaw + a.Ixz * roll) / self._inertia,
                p + np.tan(u.theta) * (u.q * np.sin(phi) + r * np.cos(phi)),
            )
        )

    def advance(self, x: Array, drive: Callable[[float], Inputs], dt: float, gust: Array | float = 0.0) -> Array:
        """The state `dt` seconds later: classical Runge-Kutta. drive: inputs where a part of the interval has passed."""
        steps = max(1, math.ceil(dt / LONGEST_STEP))
        h = dt / steps
        u2 = drive(0.0)
        for k in range(steps):
            u0, u1, u2 = u2, drive((k + 0.5) / steps), drive((k + 1.0) / steps)
            k1 = self.rates(x, u0, gust)
            k2 = self.rates(x + 0.5 * h * k1, u1, gust)
            k3 = self.rates(x + 0.5 * h * k2, u1, gust)
            k4 = self.rates(x + h * k3, u2, gust)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return x
