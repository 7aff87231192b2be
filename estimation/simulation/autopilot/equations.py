"""The equations of two simulators in our own statement: ArduPilot's SITL model `plane`, and Gazebo's AdvancedLiftDrag."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from estimation.aircraft import Aircraft
from estimation.simulation.autopilot.linear import FlightStates
from estimation.simulation.oracle import Array

# ArduPilot's SITL model `plane`: our statement of `SIM_Plane`'s equations (ArduPilot master, December 2025).
#
# Inputs are -1 to 1 of full throw; +aileron rolls right, +elevator nose up, +rudder nose right. Flow angles are atan2(w, u) and
# atan2(v, u). Forces act on 2 kg. Moments are taken as angular accelerations, for 1 kg m2 about each axis, without products of
# inertia and gyroscopic terms. Airspeed is equivalent airspeed: true airspeed and dynamic pressure are right only at sea level.

MASS = 2.0  # kg
CLAMP = 0.8  # rad from the stall, to which the angle of attack of lift is clamped
BUILT_IN: Mapping[str, float] = MappingProxyType({
    "s": 0.45, "b": 1.88, "c": 0.24, "c_lift_0": 0.56, "c_lift_deltae": 0.0, "c_lift_a": 6.9, "c_lift_q": 0.0,
    "mcoeff": 50.0, "oswald": 0.9, "alpha_stall": 0.4712, "c_drag_q": 0.0, "c_drag_deltae": 0.0, "c_drag_p": 0.1,
    "c_y_0": 0.0, "c_y_b": -0.98, "c_y_p": 0.0, "c_y_r": 0.0, "c_y_deltaa": 0.0, "c_y_deltar": -0.2,
    "c_l_0": 0.0, "c_l_p": -1.0, "c_l_b": -0.12, "c_l_r": 0.14, "c_l_deltaa": 0.25, "c_l_deltar": -0.037,
    "c_m_0": 0.045, "c_m_a": -0.7, "c_m_q": -20.0, "c_m_deltae": 1.0,
    "c_n_0": 0.0, "c_n_b": 0.25, "c_n_p": 0.022, "c_n_r": -1.0, "c_n_deltaa": 0.0, "c_n_deltar": 0.1,
    "deltaa_max": 0.3491, "deltae_max": 0.3491, "deltar_max": 0.3491,
})  # fmt: skip
"""SITL's values for keys that a file leaves out (its skywalker_2013.json)."""
OFFSET = (-0.15, 0.0, -0.05)  # m, its CGOffset likewise
FULL: Mapping[str, str] = {"delta_e": "deltae_max", "delta_a": "deltaa_max", "delta_r": "deltar_max"}
"""Surface -> key of its full throw [rad]."""


@dataclass(frozen=True)
class SitlPlane:
    """A file of coefficients. values: each key of BUILT_IN; offset: CGOffset, from the centre of gravity to the reference point
    of the coefficients [m], body axes. real: mass, geometry and inertia of the real aircraft from our own comments. notes:
    sentences for the user.
    """

    values: Mapping[str, float]
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    real: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def blend(alpha: Array, stall: float, sharpness: float) -> Array:
    """Share of the flat plate in lift, 0 to 1."""
    lower_exponential, upper_exponential = np.exp(-sharpness * (alpha - stall)), np.exp(sharpness * (alpha + stall))
    return np.asarray(
        (1.0 + lower_exponential + upper_exponential) / ((1.0 + lower_exponential) * (1.0 + upper_exponential))
    )


def lift(plane: SitlPlane, alpha: Array) -> Array:
    """(N,) CL by angle of attack (N,) [rad], stall included."""
    k = plane.values
    clamped_alpha = np.clip(alpha, k["alpha_stall"] - CLAMP, k["alpha_stall"] + CLAMP)
    share = blend(clamped_alpha, k["alpha_stall"], k["mcoeff"])
    plate = 2.0 * np.sign(clamped_alpha) * np.sin(clamped_alpha) ** 2 * np.cos(clamped_alpha)
    return np.asarray((1.0 - share) * (k["c_lift_0"] + k["c_lift_a"] * clamped_alpha) + share * plate)


def air_of_sitl(motion: FlightStates) -> tuple[Array, Array, Array]:
    """Airspeed, angle of attack, sideslip as SITL defines them."""
    u, v, w = motion.velocity()
    return np.sqrt(u**2 + v**2 + w**2), np.arctan2(w, u), np.arctan2(v, u)


def sitl_forces(plane: SitlPlane, motion: FlightStates) -> dict[str, Array]:
    """X, Y, Z [N] on its 2 kg and L, M, N [N m] on its 1 kg m2, (N,) each, of a motion with true surfaces [rad]."""
    k = plane.values
    V, alpha, beta = air_of_sitl(motion)
    full = {name: -motion.values[name] / k[key] for name, key in FULL.items()}
    e, a, r = full["delta_e"], full["delta_a"], full["delta_r"]
    p_hat, r_hat = (motion.values[n] * k["b"] / (2.0 * V) for n in ("p", "r"))
    q_hat = motion.values["q"] * k["c"] / (2.0 * V)
    qbar_s = 0.5 * motion.values["rho"] * V**2 * k["s"]
    sine, cosine = np.sin(alpha), np.cos(alpha)
    CL = lift(plane, alpha)
    CD = k["c_drag_p"] + (k["c_lift_0"] + k["c_lift_a"] * alpha) ** 2 / (np.pi * k["oswald"] * k["b"] ** 2 / k["s"])
    added_lift = k["c_lift_q"] * q_hat + k["c_lift_deltae"] * e
    added_drag = k["c_drag_q"] * q_hat + k["c_drag_deltae"] * np.abs(e)
    X = qbar_s * (-CD * cosine + CL * sine - added_drag * cosine + added_lift * sine)
    Z = qbar_s * (-CD * sine - CL * cosine - added_drag * sine - added_lift * cosine)

    def lateral(c: str) -> Array:
        rates = k[f"{c}_p"] * p_hat + k[f"{c}_r"] * r_hat
        return np.asarray(k[f"{c}_0"] + k[f"{c}_b"] * beta + rates + k[f"{c}_deltaa"] * a + k[f"{c}_deltar"] * r)

    Y = qbar_s * lateral("c_y")
    L, N = qbar_s * k["b"] * lateral("c_l"), qbar_s * k["b"] * lateral("c_n")
    M = qbar_s * k["c"] * (k["c_m_0"] + k["c_m_a"] * alpha + k["c_m_q"] * q_hat + k["c_m_deltae"] * e)
    x, y, z = plane.offset
    return {"X": X, "Y": Y, "Z": Z, "L": L + y * Z - z * Y, "M": M + z * X - x * Z, "N": N + x * Y - y * X}


def sitl_accelerations(plane: SitlPlane, motion: FlightStates) -> dict[str, Array]:
    """Axis -> (N,) SITL's specific force [m/s2] or angular acceleration [rad/s2]."""
    force = sitl_forces(plane, motion)
    return {axis: value / MASS if axis in "XYZ" else value for axis, value in force.items()}


# Gazebo's AdvancedLiftDrag: our statement of the plugin's equations (gz-sim, with pull 3817 of July 2026).
#
# Link axes x forward, y left, z up are converted to x forward, y right, z down. Air data are those at `cp`; airspeed is the speed
# in the plane of symmetry; coefficients of surfaces are per degree of their joint. Without pull 3817, Cem0 and Cema are read but
# not used.

SHARPNESS = 15.0  # 1/rad, fixed in the plugin
KEYS: Mapping[str, float] = {
    "area": 1.0, "AR": 0.0, "mac": 0.0, "eff": 0.0, "air_density": 1.2041, "alpha_stall": np.pi / 2.0, "Cema_stall": 0.0,
    "CL0": 0.0, "CD0": 0.0, "Cem0": 0.0,
    **{f"{c}a": 0.0 for c in ("CL", "CY", "Cell", "Cem", "Cen")},
    **{f"{c}b": 0.0 for c in ("CL", "CY", "Cell", "Cem", "Cen")},
    **{f"{c}{rate}": 0.0 for rate in "pqr" for c in ("CD", "CY", "CL", "Cell", "Cem", "Cen")},
}  # fmt: skip
"""Numbers that the plugin reads -> its default."""
CONTROLS = ("CD_ctrl", "CY_ctrl", "CL_ctrl", "Cell_ctrl", "Cem_ctrl", "Cen_ctrl")


@dataclass(frozen=True)
class Hinged:
    """A control surface. joint: its name; values: each of CONTROLS per degree, times the direction. moves: joint angle per unit
    of delta_e, delta_a, delta_r [rad/rad]; empty where the surface's kind is not recognised."""

    joint: str
    values: Mapping[str, float]
    moves: Mapping[str, float]


@dataclass(frozen=True)
class GazeboPlane:
    """values: each of KEYS. cp: reference point of the coefficients from the centre of gravity [m], x forward, y right, z down.
    aircraft: mass and inertia of all links together, area, span and chord of the plugin. notes: sentences for the user."""

    values: Mapping[str, float]
    cp: tuple[float, float, float]
    surfaces: tuple[Hinged, ...]
    aircraft: Aircraft
    notes: tuple[str, ...] = ()


def gazebo_forces(plane: GazeboPlane, motion: FlightStates) -> dict[str, Array]:
    """X, Y, Z [N] and L, M, N [N m] about the centre of gravity, (N,) each, body axes x forward, y right, z down."""
    k, state = plane.values, motion.values
    x, y, z = plane.cp
    u, v, w = motion.velocity()
    p, q, r = state["p"], state["q"], state["r"]
    u, v, w = u + q * z - r * y, v + r * x - p * z, w + p * y - q * x
    V = np.sqrt(u**2 + w**2)
    alpha, beta = np.arctan2(w, u), np.arctan2(v, u)
    span, chord = np.sqrt(k["area"] * k["AR"]), k["mac"]
    hats = {"p": p * span / (2.0 * V), "q": q * chord / (2.0 * V), "r": r * span / (2.0 * V)}
    joint_angles = {s.joint: np.degrees(sum(m * state[n] for n, m in s.moves.items())) for s in plane.surfaces}
    share = blend(alpha, k["alpha_stall"], SHARPNESS)
    sine, cosine = np.sin(alpha), np.cos(alpha)

    def rates(c: str) -> Array:
        return np.asarray(sum(k[f"{c}{n}"] * hat for n, hat in hats.items()))

    def control(c: str) -> Array:
        return np.asarray(sum((s.values[f"{c}_ctrl"] * joint_angles[s.joint] for s in plane.surfaces), 0.0 * V))

    plate = 2.0 * np.sign(alpha) * sine**2 * cosine
    static_lift = (1.0 - share) * (k["CL0"] + k["CLa"] * alpha) + share * plate + k["CLb"] * beta + control("CL")
    CL = static_lift + rates("CL")
    plate_drag = 2.0 / (1.0 + np.exp(-0.224 - 0.115 * max(k["AR"], 1.0 / k["AR"])))  # of a flat plate across the flow
    polar = k["CD0"] + static_lift**2 / (np.pi * k["AR"] * k["eff"])
    stalled_drag = np.abs(plate_drag * (0.5 - 0.5 * np.cos(2.0 * alpha)))
    CD = (1.0 - share) * polar + share * stalled_drag + control("CD") + rates("CD")

    def linear(c: str) -> Array:
        return np.asarray(k[f"{c}a"] * alpha + k[f"{c}b"] * beta + control(c) + rates(c))

    excess_alpha = np.sign(alpha) * np.maximum(np.abs(alpha) - k["alpha_stall"], 0.0)
    Cm = k["Cem0"] + linear("Cem") + (k["Cema_stall"] - k["Cema"]) * excess_alpha
    area = 0.5 * k["air_density"] * V**2 * k["area"]
    X, Y, Z = area * (CL * sine - CD * cosine), area * linear("CY"), area * (-CL * cosine - CD * sine)
    L, M, N = area * span * linear("Cell"), area * chord * Cm, area * span * linear("Cen")
    return {"X": X, "Y": Y, "Z": Z, "L": L + y * Z - z * Y, "M": M + z * X - x * Z, "N": N + x * Y - y * X}


def air_of_gazebo(motion: FlightStates) -> tuple[Array, Array, Array]:
    """Airspeed, angle of attack and sideslip as the plugin defines them, with cp at the centre of gravity."""
    u, v, w = motion.velocity()
    return np.sqrt(u**2 + w**2), np.arctan2(w, u), np.arctan2(v, u)
