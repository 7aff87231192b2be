"""The motions that are predicted, many models and flights at once: rolling and yawing, and the pitching plane.

Every quantity is an array that broadcasts to (models, flights): one model for the simulated flights, one for each effect of the
bank where the signatures are made. SI, rad.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Airframe
from daq.identification.monitor.bank import MonitoredPlane
from daq.utilities.constants import GRAVITY

Array = NDArray[np.float64]
LONGEST_STEP = 0.026  # s; as in `simulated_motion`


class Inputs(NamedTuple):
    """What is measured for rolling and yawing, (flights,) each: attitude, airspeed, density, surfaces."""

    q: Array
    theta: Array
    alpha: Array
    V: Array
    rho: Array
    delta_a: Array
    delta_r: Array


class ElevatorInputs(NamedTuple):
    """What is measured for the pitching plane, (flights,) each: the lateral motion, airspeed, density, thrust [N], elevator."""

    beta: Array
    p: Array
    r: Array
    phi: Array
    V: Array
    rho: Array
    thrust: Array
    delta_e: Array


AnyInputs = Inputs | ElevatorInputs
Measured = TypeVar("Measured", Inputs, ElevatorInputs)


def between(first: Measured, last: Measured, part: float) -> Measured:
    """On the straight line from one to another."""
    return type(first)(*(a + part * (b - a) for a, b in zip(first, last, strict=True)))


class MotionOfPlane(ABC, Generic[Measured]):
    """States and forces of a plane, in the order of its channels. values: derivative -> array, what is missing zero."""

    def __init__(self, airframe: Airframe, values: Mapping[str, Array], plane: MonitoredPlane) -> None:
        zero = np.zeros(1)
        self._a = airframe
        self._d = {n: np.asarray(values.get(n, zero), float) for n in plane.parameters}

    @abstractmethod
    def rates(self, x: Array, u: Measured, gust: Array | float = 0.0) -> Array:
        """(states, models, flights) of the state's rates. gust: angle of the vane that the air adds [rad]."""

    @abstractmethod
    def forces(self, x: Array, u: Measured, gust: Array | float = 0.0) -> Array:
        """(forces, models, flights) specific forces [m/s2]."""

    def advance(self, x: Array, drive: Callable[[float], Measured], dt: float, gust: Array | float = 0.0) -> Array:
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


class LateralMotion(MotionOfPlane[Inputs]):
    """Rates of beta, p, r, phi and the side force ay."""

    def forces(self, x: Array, u: Inputs, gust: Array | float = 0.0) -> Array:
        d, rate = self._d, self._a.span / (2.0 * u.V)
        CY = d["CY_0"] + d["CY_beta"] * (x[0] + gust) + rate * (d["CY_p"] * x[1] + d["CY_r"] * x[2])
        CY = CY + d["CY_dr"] * u.delta_r + d["CY_da"] * u.delta_a
        return np.asarray(0.5 * u.rho * u.V**2 * self._a.area / self._a.mass * CY)[None]

    def rates(self, x: Array, u: Inputs, gust: Array | float = 0.0) -> Array:
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
        side = self.forces(x, u, gust)[0] + GRAVITY * np.cos(u.theta) * np.sin(phi)
        inertia = a.Ixx * a.Izz - a.Ixz**2
        return np.stack(
            np.broadcast_arrays(
                p * np.sin(u.alpha) - r * np.cos(u.alpha) + side / u.V,
                (a.Izz * roll + a.Ixz * yaw) / inertia,
                (a.Ixx * yaw + a.Ixz * roll) / inertia,
                p + np.tan(u.theta) * (u.q * np.sin(phi) + r * np.cos(phi)),
            )
        )


class PitchMotion(MotionOfPlane[ElevatorInputs]):
    """Rates of alpha, q, theta and the forces ax, az; airspeed, thrust and the lateral motion are measured."""

    def forces(self, x: Array, u: ElevatorInputs, gust: Array | float = 0.0) -> Array:
        a, d = self._a, self._d
        CL = d["CL_0"] + d["CL_alpha"] * (x[0] + gust) + d["CL_q"] * x[1] * a.chord / (2.0 * u.V)
        CL = CL + d["CL_de"] * u.delta_e
        CD = d["CD_0"] + d["CD_k"] * CL * CL
        q_s, sin, cos = 0.5 * u.rho * u.V**2 * a.area, np.sin(x[0]), np.cos(x[0])
        ax, az = (q_s * (CL * sin - CD * cos) + u.thrust) / a.mass, q_s * (-CL * cos - CD * sin) / a.mass
        return np.stack(np.broadcast_arrays(ax, az))

    def rates(self, x: Array, u: ElevatorInputs, gust: Array | float = 0.0) -> Array:
        a, d = self._a, self._d
        alpha, q, theta = x
        sin, cos = np.sin(alpha), np.cos(alpha)
        ax, az = self.forces(x, u, gust)
        gx, gz = ax - GRAVITY * np.sin(theta), az + GRAVITY * np.cos(theta) * np.cos(u.phi)
        sideways = np.tan(u.beta) * (u.p * cos + u.r * sin)
        Cm = d["Cm_0"] + d["Cm_alpha"] * (alpha + gust) + d["Cm_q"] * q * a.chord / (2.0 * u.V)
        Cm = Cm + d["Cm_de"] * u.delta_e
        moment = 0.5 * u.rho * u.V**2 * a.area * a.chord * Cm
        moment = moment + (a.Izz - a.Ixx) * u.p * u.r - a.Ixz * (u.p**2 - u.r**2)
        return np.stack(
            np.broadcast_arrays(
                q - sideways + (gz * cos - gx * sin) / (u.V * np.cos(u.beta)),
                moment / a.Iyy,
                q * np.cos(u.phi) - u.r * np.sin(u.phi),
            )
        )


def motion_of(plane: MonitoredPlane, airframe: Airframe, values: Mapping[str, Array]) -> LateralMotion | PitchMotion:
    """The motion of a plane."""
    return (LateralMotion if plane.name == "lateral" else PitchMotion)(airframe, values, plane)


def inputs_of(plane: MonitoredPlane) -> type[Inputs] | type[ElevatorInputs]:
    """What its motion is driven by."""
    return Inputs if plane.name == "lateral" else ElevatorInputs
