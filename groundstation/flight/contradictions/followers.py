"""Pairs of flight columns of which one is the integral of the other: a signal, and its rate from other sensors.

They are checked in the order of FOLLOWERS; a column that has failed (`failing`) is not used for those after it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from daq.utilities.constants import GAS_CONSTANT, GRAVITY, SEA_LEVEL_TEMPERATURE
from groundstation.flight.arrays import Array, integral, unwrapped
from groundstation.flight.contradictions.fits import Columns
from groundstation.flight.kinematics import EULER_RATES, GYROS, earth_acceleration

SHORT, LONG = 4.0, 10.0
"""Lengths [s] of a block in which signal and integral are compared: in a longer one an error of attitude spoils the integrated
accelerations; velocities of a GPS need a turn or a change of speed, for which a shorter one is often too short."""


@dataclass(frozen=True)
class Follower:
    """A signal that follows the integral of a rate. failing: columns at fault where the signal stands still; drivers: columns at
    fault where the integral does; needs: all columns of the pair; pairs: time and columns (N,) -> signals and integrals (N,);
    block: length [s] of a comparison; cure: what to do."""

    failing: tuple[str, ...]
    drivers: tuple[str, ...]
    needs: tuple[str, ...]
    pairs: Callable[[Array, Columns], Sequence[tuple[Array, Array]]]
    block: float
    cure: str


def _angle(name: str) -> Follower:
    def pairs(time: Array, c: Columns) -> list[tuple[Array, Array]]:
        return [(unwrapped(c[name]), _integral(time, EULER_RATES[name](c)))]

    gyro = GYROS[name]
    return Follower(
        (name,), (gyro,), ("p", "q", "r", "phi", "theta", name), pairs, SHORT, "take another sensor's instance"
    )


def _along_ground(time: Array, c: Columns) -> list[tuple[Array, Array]]:
    """V, and the integrated change of ground velocity along the nose, in which a constant wind cancels."""
    level = np.cos(c["theta"])
    nose = (level * np.cos(c["psi"]), level * np.sin(c["psi"]), -np.sin(c["theta"]))
    steps = [
        np.diff(c[n], prepend=c[n][:1]) * (0.5 * (u + np.roll(u, 1)))
        for n, u in zip(("vn", "ve", "vd"), nose, strict=True)
    ]
    change = np.sum(steps, axis=0)
    return [(c["V"], np.where(np.isfinite(change), np.cumsum(np.nan_to_num(change)), np.nan))]


def _airspeed(time: Array, c: Columns) -> list[tuple[Array, Array]]:
    """V, and the integrated acceleration along the path; alpha counts as zero where it is not measured."""
    a = c.get("alpha", np.zeros_like(c["V"]))
    forward = c["ax"] - GRAVITY * np.sin(c["theta"])
    down = c["az"] + GRAVITY * np.cos(c["theta"]) * np.cos(c["phi"])
    return [(c["V"], _integral(time, forward * np.cos(a) + down * np.sin(a)))]


def _side_velocity(time: Array, c: Columns) -> list[tuple[Array, Array]]:
    """V sin(beta), and the integrated acceleration along body y."""
    a = c.get("alpha", np.zeros_like(c["V"]))
    turn = c["V"] * (c["p"] * np.sin(a) - c["r"] * np.cos(a))
    force = c["ay"] + GRAVITY * np.sin(c["phi"]) * np.cos(c["theta"])
    return [(c["V"] * np.sin(c["beta"]), _integral(time, turn + force))]


def _down_velocity(time: Array, c: Columns) -> list[tuple[Array, Array]]:
    """V sin(alpha), and the integrated acceleration along body z."""
    slip = c.get("beta", np.zeros_like(c["V"]))
    turn = c["V"] * (c["q"] * np.cos(c["alpha"]) - c["p"] * slip)
    force = c["az"] + GRAVITY * np.cos(c["theta"]) * np.cos(c["phi"])
    return [(c["V"] * np.sin(c["alpha"]), _integral(time, turn + force))]


def _velocity(time: Array, c: Columns) -> list[tuple[Array, Array]]:
    return [(c[n], _integral(time, a)) for n, a in zip(("vn", "ve", "vd"), earth_acceleration(c), strict=True)]


def _height(time: Array, c: Columns) -> list[tuple[Array, Array]]:
    return [(c["altitude"], _integral(time, -c["vd"]))]


def _pressure_height(time: Array, c: Columns) -> list[tuple[Array, Array]]:
    scale = GAS_CONSTANT * SEA_LEVEL_TEMPERATURE / GRAVITY
    return [(-scale * np.log(np.maximum(c["p_static"], 1.0)), _integral(time, -c["vd"]))]


VELOCITY, FORCE, ATTITUDE = ("vn", "ve", "vd"), ("ax", "ay", "az"), ("phi", "theta", "psi")
RECONSTRUCT = "or reconstruct it (sideslip reconstruct) from what else is measured"
FOLLOWERS = (
    *map(_angle, ("phi", "theta", "psi")),
    *(
        Follower(VELOCITY, FORCE, (*VELOCITY, *FORCE, *ATTITUDE), _velocity, block, "or leave velocities out")
        for block in (SHORT, LONG)
    ),
    Follower(("V",), (), ("V", "theta", "psi", *VELOCITY), _along_ground, LONG, RECONSTRUCT),
    Follower(("V",), (), ("V", "ax", "az", "theta", "phi"), _airspeed, SHORT, RECONSTRUCT),
    Follower(("beta",), (), ("beta", "V", "ay", "p", "r", "phi", "theta"), _side_velocity, SHORT, RECONSTRUCT),
    Follower(("alpha",), (), ("alpha", "V", "az", "q", "p", "phi", "theta"), _down_velocity, SHORT, RECONSTRUCT),
    Follower(("altitude",), (), ("altitude", "vd"), _height, LONG, "or give rho"),
    Follower(("p_static",), (), ("p_static", "vd"), _pressure_height, LONG, "or give rho"),
)
"""In the order of checking."""


def _integral(time: Array, rate: Array) -> Array:
    """Running integral in which missing rates count as zero; NaN where the rate is."""
    return np.where(np.isfinite(rate), integral(time, np.nan_to_num(rate)), np.nan)
