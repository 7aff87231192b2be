"""Gazebo's AdvancedLiftDrag as it flies: an own statement of the plugin's equations (gz-sim, with pull 3817 of July 2026).

Link axes x forward, y left, z up are turned to x forward, y right, z down. Air data are those at `cp`, airspeed is the speed in
the plane of symmetry; coefficients of surfaces are per degree of their joint. Without pull
3817 Cem0 and Cema are read and not used.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimation.aircraft import Aircraft
from estimation.simulation.autopilot.ardupilot_equations import blend
from estimation.simulation.autopilot.linear import FlightStates
from estimation.simulation.oracle import Array

SHARPNESS = 15.0  # 1/rad, fixed in the plugin
KEYS: Mapping[str, float] = {
    "area": 1.0, "AR": 0.0, "mac": 0.0, "eff": 0.0, "air_density": 1.2041, "alpha_stall": np.pi / 2.0, "Cema_stall": 0.0,
    "CL0": 0.0, "CD0": 0.0, "Cem0": 0.0,
    **{f"{c}a": 0.0 for c in ("CL", "CY", "Cell", "Cem", "Cen")},
    **{f"{c}b": 0.0 for c in ("CL", "CY", "Cell", "Cem", "Cen")},
    **{f"{c}{rate}": 0.0 for rate in "pqr" for c in ("CD", "CY", "CL", "Cell", "Cem", "Cen")},
}  # fmt: skip
"""Numbers that the plugin reads, with what it takes where a file does not say."""
CONTROLS = ("CD_ctrl", "CY_ctrl", "CL_ctrl", "Cell_ctrl", "Cem_ctrl", "Cen_ctrl")


@dataclass(frozen=True)
class Hinged:
    """A control surface. joint: its name; values: each of CONTROLS per degree, times the direction. moves: what a unit of
    delta_e, delta_a, delta_r turns the joint by [rad/rad]; empty where nobody can tell."""

    joint: str
    values: Mapping[str, float]
    moves: Mapping[str, float]


@dataclass(frozen=True)
class GazeboPlane:
    """values: each of KEYS. cp: where the coefficients act, from the centre of gravity [m], x forward, y right, z down. aircraft:
    mass and inertia of all links together, area, span and chord of the plugin. notes: what a person should know."""

    values: Mapping[str, float]
    cp: tuple[float, float, float]
    surfaces: tuple[Hinged, ...]
    aircraft: Aircraft
    notes: tuple[str, ...] = ()


def gazebo_forces(plane: GazeboPlane, motion: FlightStates) -> dict[str, Array]:
    """X, Y, Z [N] and L, M, N [N m] about the centre of gravity, (N,) each, body axes x forward, y right, z down."""
    k, at = plane.values, motion.values
    x, y, z = plane.cp
    u, v, w = motion.velocity()
    p, q, r = at["p"], at["q"], at["r"]
    u, v, w = u + q * z - r * y, v + r * x - p * z, w + p * y - q * x
    V = np.sqrt(u**2 + w**2)
    alpha, beta = np.arctan2(w, u), np.arctan2(v, u)
    span, chord = np.sqrt(k["area"] * k["AR"]), k["mac"]
    hats = {"p": p * span / (2.0 * V), "q": q * chord / (2.0 * V), "r": r * span / (2.0 * V)}
    turned = {s.joint: np.degrees(sum(m * at[n] for n, m in s.moves.items())) for s in plane.surfaces}
    share = blend(alpha, k["alpha_stall"], SHARPNESS)
    sine, cosine = np.sin(alpha), np.cos(alpha)

    def rates(c: str) -> Array:
        return np.asarray(sum(k[f"{c}{n}"] * hat for n, hat in hats.items()))

    def control(c: str) -> Array:
        return np.asarray(sum((s.values[f"{c}_ctrl"] * turned[s.joint] for s in plane.surfaces), 0.0 * V))

    plate = 2.0 * np.sign(alpha) * sine**2 * cosine
    lifting = (1.0 - share) * (k["CL0"] + k["CLa"] * alpha) + share * plate + k["CLb"] * beta + control("CL")
    CL = lifting + rates("CL")
    flat = 2.0 / (1.0 + np.exp(-0.224 - 0.115 * max(k["AR"], 1.0 / k["AR"])))
    polar = k["CD0"] + lifting**2 / (np.pi * k["AR"] * k["eff"])
    CD = (1.0 - share) * polar + share * np.abs(flat * (0.5 - 0.5 * np.cos(2.0 * alpha))) + control("CD") + rates("CD")

    def linear(c: str) -> Array:
        return np.asarray(k[f"{c}a"] * alpha + k[f"{c}b"] * beta + control(c) + rates(c))

    beyond = np.sign(alpha) * np.maximum(np.abs(alpha) - k["alpha_stall"], 0.0)
    Cm = k["Cem0"] + linear("Cem") + (k["Cema_stall"] - k["Cema"]) * beyond
    area = 0.5 * k["air_density"] * V**2 * k["area"]
    X, Y, Z = area * (CL * sine - CD * cosine), area * linear("CY"), area * (-CL * cosine - CD * sine)
    L, M, N = area * span * linear("Cell"), area * chord * Cm, area * span * linear("Cen")
    return {"X": X, "Y": Y, "Z": Z, "L": L + y * Z - z * Y, "M": M + z * X - x * Z, "N": N + x * Y - y * X}


def air_of(motion: FlightStates) -> tuple[Array, Array, Array]:
    """Airspeed, angle of attack and sideslip as the plugin takes them where cp is the centre of gravity."""
    u, v, w = motion.velocity()
    return np.sqrt(u**2 + w**2), np.arctan2(w, u), np.arctan2(v, u)
