"""The pitching plane of the second truth: hidden effects of lift, drag, thrust, elevator, their instruments, across planes.

Physics with sizes, written from the textbook and sharing no code with `firmware_sim` or `estimation`. Angles of attack count
from level flight at 16.5 m/s. `second_truth` flies it: coefficients are expressions of one flight, all else arrays over flights.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
DEG = np.pi / 180
LEVEL = 0.09  # rad
DISC = 0.0507  # m2, of a 10 inch propeller

# Typical sizes (SI); one number per effect.
PITCH: Mapping[str, float] = {
    "CL_alphadot": 1.5, "Cm_alphadot": -0.4, "CL_alpha2": -4.0, "CL_alpha3": -15.0, "Cm_alpha2": -0.4, "Cm_alpha3": 2.0,
    "CL_de3": -3.0, "Cm_de3": 1.0, "Cm_alpha_de": 0.8, "CD_CL": -0.03, "CD_alpha4": 8.0, "CD_de2": 0.5, "CD_q": 0.2,
    "thrust_z": 0.02, "thrust_tilt": 3.0 * DEG, "thrust_scale": 0.08, "thrust_lag": 0.2, "propwash_elevator": 0.3,
    "propwash_CL": 0.1, "elevator_delay": 0.025, "elevator_lag": 0.04, "elevator_deadzone": 0.3 * DEG,
    "elevator_backlash": 0.6 * DEG, "elevator_compliance": 0.15, "wing_compliance": 0.15, "alpha_scale": 0.1,
    "alpha_bias": 0.5 * DEG, "alpha_position": 0.4, "alpha_lag": 0.035, "V_scale": 0.03, "V_alpha": 0.3, "imu_x": 0.08,
    "imu_z": 0.08, "imu_tilt": 1.0 * DEG, "q_scale": 0.03, "theta_lag": 0.04,
}  # fmt: skip
CROSS: Mapping[str, float] = {
    "Cm_beta2": 0.3, "CL_beta2": -1.0, "CD_beta2": 0.4, "CL_da2": 0.3, "CD_da2": 0.3, "Cm_da2": 0.3,
    "Cl_alpha_da": 0.2, "Cn_alpha_da": 0.1, "Cn_alpha_dr": 0.2, "Cl_alpha_p": 1.0, "Cn_alpha_p": 0.3,
}  # fmt: skip
PITCH_UNKNOWN: tuple[str, ...] = (
    "alpha_friction",
    "stale_alpha",
    "q_clip",
    "vertical_burst",
    "pitch_slosh",
    "theta_acceleration_error",
)


class Elevator:
    """What lies between the potentiometer and the elevator: dead time, lag, play, dead zone, one flight per column."""

    def __init__(self, e: Mapping[str, Array], first: Array, rate: int, steps: int) -> None:
        self.e, self.h = e, 1.0 / rate
        self.past = np.zeros((steps, first.size))
        self.late = np.round((e["elevator_delay"] + e["servo_delay"]) * rate).astype(int)
        self.follows, self.rests = first.copy(), first.copy()

    def step(self, k: int, arm: Array) -> Array:
        """(flights,) elevator at step k for the position of its arm."""
        self.past[k] = arm
        seen = self.past[np.maximum(k - self.late, 0), np.arange(arm.size)]
        tau = self.e["elevator_lag"] + self.e["servo_lag"]
        self.follows = np.where(tau > 0, self.follows + self.h / np.maximum(tau, 1e-3) * (seen - self.follows), seen)
        half = 0.5 * self.e["elevator_backlash"]
        self.rests = np.clip(self.rests, self.follows - half, self.follows + half)
        dead = self.e["elevator_deadzone"]
        moved = np.where(half > 0, self.rests, self.follows)
        return np.where(dead > 0, np.sign(moved) * np.maximum(np.abs(moved) - dead, 0.0), moved)


def lift(d: Mapping[str, float], e: Mapping[str, float], over: Any, al: Any, be: Any, da: Any, de: Any, qd: Any,
         wash: Any) -> Any:  # fmt: skip
    """Lift beyond the linear one. over: angle of attack above LEVEL; wash: T/(q A) of the propeller's disc."""
    wing = d["CL_alpha"] * al
    made = e["CL_alpha2"] * over**2 + e["CL_alpha3"] * over**3 + e["CL_de3"] * de**3
    made = made + e["CL_beta2"] * be**2 + e["CL_da2"] * da**2
    made = made + wing * (e["propwash_CL"] * wash - e["wing_compliance"] * (qd / 200.0 - 1.0))
    return made + d["CL_de"] * de * _elevator_gain(e, qd, wash)


def _elevator_gain(e: Mapping[str, float], qd: Any, wash: Any) -> Any:
    return e["propwash_elevator"] * wash - e["elevator_compliance"] * (qd / 200.0 - 1.0)


def drag(e: Mapping[str, float], CL: Any, al: Any, be: Any, da: Any, de: Any, qh: Any) -> Any:
    """Drag beyond the parabolic polar."""
    return (
        e["CD_CL"] * CL
        + e["CD_alpha4"] * al**4
        + e["CD_de2"] * de**2
        + e["CD_q"] * qh
        + e["CD_beta2"] * be**2
        + e["CD_da2"] * da**2
    )


def pitching(
    d: Mapping[str, float], e: Mapping[str, float], over: Any, be: Any, da: Any, de: Any, qd: Any, wash: Any
) -> Any:
    """Pitching moment coefficient beyond the linear one, without its part from the rate of angle of attack."""
    made = e["Cm_alpha2"] * over**2 + e["Cm_alpha3"] * over**3 + e["Cm_de3"] * de**3 + e["Cm_alpha_de"] * over * de
    made = made + e["Cm_beta2"] * be**2 + e["Cm_da2"] * da**2
    return made + d["Cm_de"] * de * _elevator_gain(e, qd, wash)


def rolling(e: Mapping[str, float], over: Any, da: Any, ph: Any) -> Any:
    return over * (e["Cl_alpha_da"] * da + e["Cl_alpha_p"] * ph)


def yawing(e: Mapping[str, float], over: Any, da: Any, dr: Any, ph: Any) -> Any:
    return over * (e["Cn_alpha_da"] * da + e["Cn_alpha_dr"] * dr + e["Cn_alpha_p"] * ph)


def schedule(
    u: Array,
    t: Array,
    rng: np.random.Generator,
    kind: str,
    multistep: Callable[[int, float, Sequence[float], float, int], None],
) -> None:
    """Elevator and throttle of `longitudinal` flights: 3-2-1-1, doublets of three sizes, a pull-up, throttle steps apart from
    them; of `all` flights what finds room between the lateral inputs. With `-advised` behind it short doublets are three times as
    large, up to 9 deg, as the answer asks for where it cannot tell a cube. Commands are rows 2 [rad] and 3 [N] of u."""
    w, s = rng.uniform(0.9, 1.1), 1 if rng.uniform() < 0.5 else -1
    jump = lambda x: x + rng.uniform(-0.3, 0.3)  # noqa: E731
    large = 3.0 if kind.endswith("-advised") else 1.0
    if kind.startswith("longitudinal"):
        multistep(2, jump(1.5), [0.9 * w, 0.6 * w, 0.3 * w, 0.3 * w], rng.uniform(1.4, 2.0) * DEG, s)
        multistep(2, jump(6.3), [0.4 * w, 0.4 * w], large * rng.uniform(2.4, 3.0) * DEG, -s)
        multistep(2, jump(10.6), [1.1 * w, 0.5 * w], rng.uniform(1.6, 2.2) * DEG, -1)
        multistep(2, jump(15.2), [0.35 * w] * 4, large * rng.uniform(1.2, 1.8) * DEG, s)
        multistep(2, jump(19.4), [0.9 * w, 0.6 * w, 0.3 * w, 0.3 * w], rng.uniform(1.8, 2.4) * DEG, -s)
        multistep(2, jump(24.6), [0.5 * w, 0.5 * w], large * rng.uniform(1.0, 1.6) * DEG, s)
        steps = ((4.0, 3.0), (8.6, -2.6), (13.4, 1.6), (17.4, -1.2), (22.6, 3.4), (27.0, -2.8))
    else:
        multistep(2, jump(9.0), [0.6 * w, 0.4 * w, 0.2 * w, 0.2 * w], rng.uniform(1.4, 2.0) * DEG, s)
        multistep(2, jump(19.9), [0.4 * w, 0.4 * w], large * rng.uniform(1.8, 2.4) * DEG, -1)
        multistep(2, jump(27.6), [0.35 * w, 0.35 * w], large * rng.uniform(1.4, 2.0) * DEG, s)
        steps = ((3.6, 2.6), (8.2, -2.4), (11.3, 1.4), (15.4, -1.8), (19.0, 2.8), (24.0, -2.2))
    for a, force in steps:
        u[3, t >= a] = force * rng.uniform(0.8, 1.2)


def bend(
    m: dict[str, Array],
    h: Mapping[str, Array],
    e: Mapping[str, float],
    x: Mapping[str, float],
    lagged: Callable[[Array, float], Array],
) -> None:
    """Instruments of the pitching plane; h: true signals over time of one flight, m: what is measured so far."""
    m["alpha"] = m["alpha"] * (1 + e["alpha_scale"]) + e["alpha_bias"] - e["alpha_position"] * h["q"] / h["V"]
    if e["alpha_lag"]:
        m["alpha"] = lagged(m["alpha"], e["alpha_lag"])
    m["V"] = m["V"] * (1 + e["V_scale"] + e["V_alpha"] * (h["alpha"] - LEVEL))
    x_arm, z_arm = e["imu_x"], e["imu_z"]
    ax = m["ax"] + z_arm * (h["qdot"] + h["p"] * h["r"]) - x_arm * (h["q"] ** 2 + h["r"] ** 2)
    az = m["az"] - x_arm * (h["qdot"] - h["p"] * h["r"]) - z_arm * (h["p"] ** 2 + h["q"] ** 2)
    c, s = np.cos(e["imu_tilt"]), np.sin(e["imu_tilt"])
    m["ax"], m["az"] = c * ax - s * az, c * az + s * ax
    m["q"] = m["q"] * (1 + e["q_scale"])
    if e["theta_lag"]:
        m["theta"] = lagged(m["theta"], e["theta_lag"])
    if x["q_clip"]:
        limit = np.quantile(np.abs(h["q"]), 0.93) / x["q_clip"]
        m["q"] = np.clip(m["q"], -limit, limit)
    if x["theta_acceleration_error"]:
        speeding = np.gradient(h["V"]) * 200.0 / 9.80665
        m["theta"] = m["theta"] + 0.5 * x["theta_acceleration_error"] * lagged(speeding, 1.5)
