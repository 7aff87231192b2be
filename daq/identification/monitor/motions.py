"""The motions that the gap monitor predicts, for many models and flights at once: the lateral and the longitudinal plane.

Every quantity is an array that broadcasts to (models, flights): one model for the simulated flights, or one model for each effect
of the bank. SI, rad. The equations are those of `simulated_motion`, which computes one model and one flight in plain floats.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Airframe
from daq.identification.monitor.bank import MonitoredPlane
from daq.identification.simulated_motion import LONGEST_STEP
from daq.utilities.constants import GRAVITY

Array = NDArray[np.float64]
AS_STATED = np.ones(1)  # mass over the airframe's, of every flight
NOT_MOVED = np.zeros(1)  # m, how far the CG is ahead of the airframe's


class Inputs(NamedTuple):
    """Measured inputs of the lateral plane, (flights,) each: pitch rate, attitude, airspeed, density, surfaces; mass over the
    airframe's; how far the CG is ahead of the airframe's [m]."""

    q: Array
    theta: Array
    alpha: Array
    V: Array
    rho: Array
    delta_a: Array
    delta_r: Array
    mass_ratio: Array = AS_STATED
    cg_ahead: Array = NOT_MOVED


class ElevatorInputs(NamedTuple):
    """Measured inputs of the longitudinal plane, (flights,) each: the lateral motion, airspeed, density, thrust [N], elevator;
    mass over the airframe's; how far the CG is ahead of the airframe's [m]."""

    beta: Array
    p: Array
    r: Array
    phi: Array
    V: Array
    rho: Array
    thrust: Array
    delta_e: Array
    mass_ratio: Array = AS_STATED
    cg_ahead: Array = NOT_MOVED


AnyInputs = Inputs | ElevatorInputs
Measured = TypeVar("Measured", Inputs, ElevatorInputs)


def instants(dt: float) -> Array:
    """(instants, 1, 1) fractions of an interval of `dt` seconds at the begin, middle and end of each Runge-Kutta step."""
    return np.linspace(0.0, 1.0, 2 * max(1, math.ceil(dt / LONGEST_STEP)) + 1)[:, None, None]


def between(first: Measured, last: Measured, parts: Array) -> Measured:
    """(instants, 1, flights): linear interpolation between two samples at fractions of their interval."""
    return type(first)(*(a + parts * (b - a) for a, b in zip(first, last, strict=True)))


class MotionOfPlane(ABC, Generic[Measured]):
    """States and forces of a plane, in the order of its channels. values: derivative -> array; a missing derivative is zero."""

    def __init__(self, airframe: Airframe, values: Mapping[str, Array], plane: MonitoredPlane) -> None:
        zero = np.zeros((1, 1))
        self._a = airframe
        self._d = {n: np.asarray(values.get(n, zero), float) for n in plane.parameters}

    @abstractmethod
    def conditions(self, u: Measured) -> tuple[Array, ...]:
        """The parts of `rates` that do not depend on the state, in the order in which `rates` unpacks them; fields of u:
        (..., 1 or models, flights)."""

    @abstractmethod
    def rates(
        self, x: Array, conditions: Sequence[Array], gust: Array | float = 0.0, rolling: Array | float = 0.0
    ) -> Array:
        """(states, models, flights) rates of change of the state. gust: change of the flow angle by the motion of the air [rad];
        rolling: roll rate of the air itself [rad/s]."""

    @abstractmethod
    def forces(self, x: Array, u: Measured, gust: Array | float = 0.0) -> Array:
        """(forces, models, flights) specific forces [m/s2]."""

    def advance(
        self, x: Array, u: Measured, dt: float, gust: Array | float = 0.0, rolling: Array | float = 0.0
    ) -> Array:
        """The state `dt` seconds later: classical Runge-Kutta. u: at the `instants` of the interval, along the first axis."""
        conditions = list(zip(*self.conditions(u), strict=True))
        h = dt / (len(conditions) // 2)
        for c0, c1, c2 in zip(conditions[:-2:2], conditions[1:-1:2], conditions[2::2], strict=True):
            k1 = self.rates(x, c0, gust, rolling)
            k2 = self.rates(x + 0.5 * h * k1, c1, gust, rolling)
            k3 = self.rates(x + 0.5 * h * k2, c1, gust, rolling)
            k4 = self.rates(x + h * k3, c2, gust, rolling)
            x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        return x


class LateralMotion(MotionOfPlane[Inputs]):
    """Rates of beta, p, r, phi and the side force ay."""

    def __init__(self, airframe: Airframe, values: Mapping[str, Array], plane: MonitoredPlane) -> None:
        super().__init__(airframe, values, plane)
        self._rows = {n: self._accelerations(n) for n in ("0", "beta", "p", "r", "da", "dr")}

    def _accelerations(self, term: str) -> Array:
        """(3, models, flights): side force, roll and yaw acceleration by one term of the three coefficients, per dynamic pressure
        times area."""
        a, d = self._a, self._d
        inertia = a.Ixx * a.Izz - a.Ixz**2
        Cl, Cn = d[f"Cl_{term}"] * (a.span / inertia), d[f"Cn_{term}"] * (a.span / inertia)
        rows = (d[f"CY_{term}"], a.Izz * Cl + a.Ixz * Cn, a.Ixx * Cn + a.Ixz * Cl)
        return np.stack(np.broadcast_arrays(*rows))

    def _about_cg(self, u: Inputs) -> Mapping[str, Array]:
        """The same, (..., 3, models, flights), about the present CG, to which the side force has an arm."""
        if not np.any(u.cg_ahead):
            return self._rows
        a = self._a
        yaw = -u.cg_ahead / (a.Ixx * a.Izz - a.Ixz**2)
        arms = np.stack((np.zeros_like(yaw), a.Ixz * yaw, a.Ixx * yaw), axis=-3)
        return {n: row + arms * row[0] for n, row in self._rows.items()}

    def conditions(self, u: Inputs) -> tuple[Array, ...]:
        a, rows = self._a, self._about_cg(u)
        # gyroscopic moments: roll Ixz p q - (Izz - Iyy) q r, yaw -Ixz q r - (Iyy - Ixx) p q
        turning = u.q / (a.Ixx * a.Izz - a.Ixz**2)
        p_in_roll, r_in_roll = a.Ixz * (a.Izz - a.Iyy + a.Ixx), a.Izz * (a.Iyy - a.Izz) - a.Ixz**2
        p_in_yaw, r_in_yaw = a.Ixz**2 - a.Ixx * (a.Iyy - a.Ixx), a.Ixz * (a.Iyy - a.Izz - a.Ixx)
        p_rows = np.sin(u.alpha), p_in_roll * turning, p_in_yaw * turning
        r_rows = -np.cos(u.alpha), r_in_roll * turning, r_in_yaw * turning
        q_s = 0.5 * u.rho * u.V**2 * a.area
        scale = np.stack((q_s / (a.mass * u.mass_ratio * u.V), q_s, q_s), axis=-3)
        rate = scale * (a.span / (2.0 * u.V))[..., None, :, :]
        fixed = scale * (rows["0"] + rows["da"] * u.delta_a[..., None, :, :] + rows["dr"] * u.delta_r[..., None, :, :])
        by_p, by_r = (rate * rows[n] + np.stack(k, axis=-3) for n, k in (("p", p_rows), ("r", r_rows)))
        return fixed, scale * rows["beta"], by_p, by_r, GRAVITY * np.cos(u.theta) / u.V, np.tan(u.theta), u.q

    def forces(self, x: Array, u: Inputs, gust: Array | float = 0.0) -> Array:
        d, rate = self._d, self._a.span / (2.0 * u.V)
        CY = d["CY_0"] + d["CY_beta"] * (x[0] + gust) + rate * (d["CY_p"] * x[1] + d["CY_r"] * x[2])
        CY = CY + d["CY_dr"] * u.delta_r + d["CY_da"] * u.delta_a
        return np.asarray(0.5 * u.rho * u.V**2 * self._a.area / (self._a.mass * u.mass_ratio) * CY)[None]

    def rates(
        self, x: Array, conditions: Sequence[Array], gust: Array | float = 0.0, rolling: Array | float = 0.0
    ) -> Array:
        fixed, by_beta, by_p, by_r, gravity, tan_theta, q = conditions
        beta, p, r, phi = x
        sin = np.sin(phi)
        accelerations = fixed + by_beta * (beta + gust) + by_p * (p - rolling) + by_r * r
        rates = np.empty((4, *accelerations.shape[1:]))
        rates[:3] = accelerations
        rates[0] += gravity * sin
        rates[3] = p + tan_theta * (q * sin + r * np.cos(phi))
        return rates


class PitchMotion(MotionOfPlane[ElevatorInputs]):
    """Rates of alpha, q, theta and the forces ax, az; airspeed, thrust and the lateral motion are measured."""

    def conditions(self, u: ElevatorInputs) -> tuple[Array, ...]:
        a, d = self._a, self._d
        q_s, rate = 0.5 * u.rho * u.V**2 * a.area, a.chord / (2.0 * u.V)
        along, scale = 1.0 / (u.V * np.cos(u.beta)), q_s * a.chord / a.Iyy
        mass = a.mass * u.mass_ratio
        lift = along * q_s / mass
        gyroscopic = ((a.Izz - a.Ixx) * u.p * u.r - a.Ixz * (u.p**2 - u.r**2)) / a.Iyy
        ahead = u.cg_ahead / a.chord
        # about the CG where it is now; the force across the body is taken to be the lift
        Cm = {n: d[f"Cm_{n}"] - ahead * d[f"CL_{n}"] for n in ("0", "alpha", "q", "de")}
        return (
            -lift * (d["CL_0"] + d["CL_de"] * u.delta_e),
            -lift * d["CL_alpha"],
            1.0 - lift * rate * d["CL_q"],
            scale * (Cm["0"] + Cm["de"] * u.delta_e) + gyroscopic,
            scale * Cm["alpha"],
            scale * rate * Cm["q"],
            along * GRAVITY * np.cos(u.phi),
            np.tan(u.beta) * u.p,
            along * u.thrust / mass + np.tan(u.beta) * u.r,
            along * GRAVITY,
            np.cos(u.phi),
            u.r * np.sin(u.phi),
        )

    def forces(self, x: Array, u: ElevatorInputs, gust: Array | float = 0.0) -> Array:
        a, d = self._a, self._d
        CL = d["CL_0"] + d["CL_alpha"] * (x[0] + gust) + d["CL_q"] * x[1] * a.chord / (2.0 * u.V)
        CL = CL + d["CL_de"] * u.delta_e
        CD = d["CD_0"] + d["CD_k"] * CL * CL
        q_s, sin, cos = 0.5 * u.rho * u.V**2 * a.area, np.sin(x[0]), np.cos(x[0])
        mass = a.mass * u.mass_ratio
        ax, az = (q_s * (CL * sin - CD * cos) + u.thrust) / mass, q_s * (-CL * cos - CD * sin) / mass
        return np.stack(np.broadcast_arrays(ax, az))

    def rates(
        self, x: Array, conditions: Sequence[Array], gust: Array | float = 0.0, rolling: Array | float = 0.0
    ) -> Array:
        """Rates of alpha, q, theta; drag acts along the flow and does not enter the rate of alpha."""
        lift, lift_alpha, lift_q, moment, moment_alpha, moment_q, upright, sideways, forward, weight, cos_phi, turn = (
            conditions
        )
        alpha, q, theta = x
        sin, cos, air = np.sin(alpha), np.cos(alpha), alpha + gust
        alpha_rate = lift + lift_alpha * air + lift_q * q - sideways * cos - forward * sin
        alpha_rate = alpha_rate + upright * np.cos(theta) * cos + weight * np.sin(theta) * sin
        return np.stack(np.broadcast_arrays(alpha_rate, moment + moment_alpha * air + moment_q * q, q * cos_phi - turn))


def motion_of(plane: MonitoredPlane, airframe: Airframe, values: Mapping[str, Array]) -> LateralMotion | PitchMotion:
    """The equations of motion of a plane with derivatives `values`."""
    return (LateralMotion if plane.name == "lateral" else PitchMotion)(airframe, values, plane)


def inputs_of(plane: MonitoredPlane) -> type[Inputs] | type[ElevatorInputs]:
    """The type of the inputs that drive its motion."""
    return Inputs if plane.name == "lateral" else ElevatorInputs
