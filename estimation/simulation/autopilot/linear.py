"""A linear aircraft: derivatives, geometry, mass and throws, and its coefficients at any state.

    C = C_0 + C_alpha alpha + C_beta beta + C_p p^ + C_q q^ + C_r r^ + C_de delta_e + C_da delta_a + C_dr delta_r
    for C of CL CY Cl Cm Cn; CD likewise, and CD_k CL^2

per rad, rates as p b/2V, q c/2V, r b/2V; body axes x forward, y right, z down; lift and drag in the plane of symmetry along
stability axes, side force and moments along body axes, about the centre of gravity.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from daq.utilities.constants import GRAVITY, SEA_LEVEL_DENSITY
from estimation.aircraft import Aircraft
from estimation.simulation.oracle import SURFACES, Array

SLOPES: Mapping[str, str] = {
    "alpha": "alpha", "beta": "beta", "p": "p_hat", "q": "q_hat", "r": "r_hat", "de": "delta_e", "da": "delta_a",
    "dr": "delta_r", "alphadot": "alphadot_hat",
}  # fmt: skip
"""Ending of a derivative -> the variable that it multiplies."""
LINES = ("CL", "CD", "CY", "Cl", "Cm", "Cn")
AXES = ("X", "Y", "Z", "L", "M", "N")
CONSTANT = "0"
POLAR = "CD_k"


@dataclass(frozen=True)
class LinearAircraft:
    """derivatives: name -> value [1/rad]; an absent one is zero. sources: name -> source of the value. throws: surface -> least
    and greatest deflection [rad]. thrust: static, at full throttle [N], None where unknown. notes: assumptions."""

    name: str
    title: str
    aircraft: Aircraft
    derivatives: Mapping[str, float]
    sources: Mapping[str, str] = field(default_factory=dict)
    throws: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    thrust: float | None = None
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> float:
        return float(self.derivatives.get(name, 0.0))

    @property
    def stated(self) -> tuple[str, ...]:
        """Names of the derivatives that are not zero, coefficient by coefficient."""
        order = [f"{line}_{ending}" for line in LINES for ending in (CONSTANT, "k", *SLOPES)]
        return tuple(name for name in order if self[name] != 0.0)

    def without(self, names: tuple[str, ...]) -> "LinearAircraft":
        return replace(self, derivatives={n: v for n, v in self.derivatives.items() if n not in names})


@dataclass(frozen=True)
class FlightStates:
    """N states of flight. values: `V` [m/s], `alpha`, `beta`, surfaces [rad], `p`, `q`, `r` [rad/s] and `rho` [kg/m3] -> (N,)."""

    values: Mapping[str, Array]

    def __len__(self) -> int:
        return int(self.values["V"].size)

    @property
    def surfaces(self) -> Mapping[str, Array]:
        return {name: self.values[name] for name in SURFACES}

    def velocity(self) -> tuple[Array, Array, Array]:
        """(N,) each: u, v, w along body axes [m/s]."""
        V, alpha, beta = (self.values[n] for n in ("V", "alpha", "beta"))
        return V * np.cos(alpha) * np.cos(beta), V * np.sin(beta), V * np.sin(alpha) * np.cos(beta)

    def with_air(self, V: Array, alpha: Array, beta: Array) -> "FlightStates":
        """The same states with other definitions of the air data [m/s, rad]."""
        return FlightStates({**self.values, "V": V, "alpha": alpha, "beta": beta})


def coefficients(
    linear: LinearAircraft, motion: FlightStates, induced: tuple[str, ...] | None = None
) -> dict[str, Array]:
    """Each of LINES -> coefficient (N,). induced: endings of the terms of lift that enter induced drag, by default all."""
    state = motion.values
    span, chord = linear.aircraft.span, linear.aircraft.chord
    hats = {"p_hat": state["p"] * span, "q_hat": state["q"] * chord, "r_hat": state["r"] * span}
    regressors = {**state, **{n: v / (2.0 * state["V"]) for n, v in hats.items()}}
    regressors["alphadot_hat"] = state.get("alphadot_hat", np.zeros(len(motion)))

    def sum_of_terms(name: str, endings: tuple[str, ...]) -> Array:
        terms = [linear[f"{name}_{ending}"] * regressors[SLOPES[ending]] for ending in endings if ending != CONSTANT]
        constant = linear[f"{name}_{CONSTANT}"] if CONSTANT in endings else 0.0
        return np.asarray(sum(terms, np.full(len(motion), constant)))

    all_endings = (CONSTANT, *SLOPES)
    values = {name: sum_of_terms(name, all_endings) for name in LINES}
    values["CD"] = values["CD"] + linear[POLAR] * sum_of_terms("CL", induced or all_endings) ** 2
    return values


def forces(linear: LinearAircraft, motion: FlightStates, induced: tuple[str, ...] | None = None) -> dict[str, Array]:
    """Each of AXES -> (N,): aerodynamic force [N] and moment about the centre of gravity [N m] in body axes."""
    c = coefficients(linear, motion, induced)
    state, a = motion.values, linear.aircraft
    sine, cosine = np.sin(state["alpha"]), np.cos(state["alpha"])
    q_s = 0.5 * state["rho"] * state["V"] ** 2 * a.area
    return {
        "X": q_s * (c["CL"] * sine - c["CD"] * cosine),
        "Y": q_s * c["CY"],
        "Z": q_s * (-c["CL"] * cosine - c["CD"] * sine),
        "L": q_s * a.span * c["Cl"],
        "M": q_s * a.chord * c["Cm"],
        "N": q_s * a.span * c["Cn"],
    }


def accelerations(aircraft: Aircraft, force: Mapping[str, Array]) -> dict[str, Array]:
    """Each of AXES -> (N,): specific force [m/s2] and angular acceleration [rad/s2] without gyroscopic terms."""
    inertia = aircraft.Ixx * aircraft.Izz - aircraft.Ixz**2
    axes = {axis: force[axis] / aircraft.mass for axis in ("X", "Y", "Z")}
    axes["L"] = (aircraft.Izz * force["L"] + aircraft.Ixz * force["N"]) / inertia
    axes["M"] = force["M"] / aircraft.Iyy
    axes["N"] = (aircraft.Ixx * force["N"] + aircraft.Ixz * force["L"]) / inertia
    return axes


def gyroscopic(aircraft: Aircraft, motion: FlightStates) -> dict[str, Array]:
    """L, M, N -> (N,): angular accelerations [rad/s2] by gyroscopic and inertia coupling."""
    p, q, r = (motion.values[n] for n in ("p", "q", "r"))
    roll = aircraft.Ixz * p * q - (aircraft.Izz - aircraft.Iyy) * q * r
    pitch = (aircraft.Izz - aircraft.Ixx) * p * r - aircraft.Ixz * (p**2 - r**2)
    yaw = -aircraft.Ixz * q * r - (aircraft.Iyy - aircraft.Ixx) * p * q
    zeros = np.zeros(len(motion))
    angular_rates = accelerations(aircraft, {"X": zeros, "Y": zeros, "Z": zeros, "L": roll, "M": pitch, "N": yaw})
    return {axis: angular_rates[axis] for axis in ("L", "M", "N")}


STATES = 200  # random ones, at which two forms of an aircraft are compared
SEED = 20261127  # fixed, so that a comparison is repeatable
ALPHAS = (-0.1, 0.2)  # rad: the range in which an aircraft is linear
LARGEST = {"beta": 0.2, "p": 1.0, "q": 0.6, "r": 0.6}  # rad, rad/s
DEFLECTION = 0.3  # rad, or the throw if that is less
CRUISE = 0.4  # lift coefficient that sets the cruise speed
SPEEDS = (0.7, 1.8)  # range of speeds over the cruise speed


def random_motion(
    linear: LinearAircraft, alphas: tuple[float, float] = ALPHAS, rho: float = SEA_LEVEL_DENSITY, count: int = STATES
) -> FlightStates:
    """Random states in which the aircraft may fly, at a density [kg/m3] and in a range of the angle of attack [rad]."""
    rng, aircraft = np.random.default_rng(SEED), linear.aircraft
    cruise = math.sqrt(2.0 * aircraft.mass * GRAVITY / (SEA_LEVEL_DENSITY * aircraft.area * CRUISE))
    values = {n: rng.uniform(-size, size, count) for n, size in LARGEST.items()}
    for name in SURFACES:
        lowest, greatest = linear.throws.get(name, (-DEFLECTION, DEFLECTION))
        values[name] = rng.uniform(max(lowest, -DEFLECTION), min(greatest, DEFLECTION), count)
    values["V"], values["alpha"] = cruise * rng.uniform(*SPEEDS, count), rng.uniform(*alphas, count)
    values["rho"] = np.full(count, rho)
    return FlightStates(values)


@dataclass(frozen=True)
class Body:
    """mass [kg], centre (3,) [m], inertia (3, 3) about the centre [kg m2], all along the same axes."""

    mass: float
    centre: Array
    inertia: Array

    def about(self, point: Array) -> Array:
        """(3, 3) inertia about a point."""
        d = self.centre - point
        return np.asarray(self.inertia + self.mass * (np.dot(d, d) * np.eye(3) - np.outer(d, d)))


def combined_body(bodies: Sequence[Body]) -> Body:
    """Several rigidly connected bodies as one."""
    mass = sum(b.mass for b in bodies)
    centre = np.asarray(sum(b.mass * b.centre for b in bodies)) / mass
    return Body(mass, centre, np.asarray(sum(b.about(centre) for b in bodies)))


def remaining_body(total: Body, parts: Sequence[Body]) -> Body:
    """The body that makes `total` together with the parts."""
    mass = total.mass - sum(b.mass for b in parts)
    moment = total.mass * total.centre - sum(b.mass * b.centre for b in parts)
    centre = np.asarray(moment / mass)
    point = Body(mass, centre, np.zeros((3, 3)))
    inertia = total.inertia - sum(b.about(total.centre) for b in parts) - point.about(total.centre)
    return Body(mass, centre, np.asarray(inertia))


def rotation_matrix(roll: float, pitch: float, yaw: float) -> Array:
    """(3, 3) matrix from the axes of a pose to those of its parent; roll, pitch, yaw about the parent's fixed axes [rad]."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", (roll, pitch, yaw)).as_matrix())
