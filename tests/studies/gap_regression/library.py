"""The regressors that stand for each effect of the catalogue, form by form, in five equations of equation error.

An aerodynamic or propulsive effect is a term of one or more equations. An effect of a surface, an instrument or the
inertia is a correction of what is believed of the flight: its column is what the five equations change by when the
correction of usual size is made (every derivative, product and kinematic term with it), so that it enters each equation
with the weight physics gives it. Usual sizes are those of the catalogue.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import shift
from scipy.signal import lfilter

Array = NDArray[np.float64]
Signals = Mapping[str, Array | float]  # (N,) courses, and the constants of the aircraft
Terms = Mapping[str, Array]  # equation -> (N,) what is added to its right side

G = 9.80665


@dataclass(frozen=True)
class Hypothesis:
    """One form of one effect.

    terms: signals, derivatives as fitted -> what it adds to the right sides at its usual size; or
    corrected: signals -> those that are otherwise than recorded if the effect has its usual size. rates: whether they
    are the rates that the equations of moments differentiate.
    """

    effect: str
    form: str
    terms: Callable[[Signals, Mapping[str, float]], Terms] | None = None
    corrected: Callable[[Signals], Mapping[str, Array | float]] | None = None
    rates: bool = False


def _term(effect: str, make: Callable[..., Terms], form: str = "") -> Hypothesis:
    return Hypothesis(effect, form or effect, terms=make)


def _correction(effect: str, make: Callable[..., Mapping[str, Array | float]], form: str = "") -> Hypothesis:
    return Hypothesis(effect, form or effect, corrected=make)


def _gyro(effect: str, make: Callable[..., Mapping[str, Array | float]], form: str) -> Hypothesis:
    return Hypothesis(effect, form, corrected=make, rates=True)


def late(x: Array, delay: float, step: float) -> Array:
    """x(t - delay), by cubic splines; negative: x of later."""
    return np.asarray(shift(x, delay / step, order=3, mode="nearest"))


def lagged(x: Array, tau: float, step: float, begin: float | None = None) -> Array:
    """First-order lag of a signal that runs straight between its samples, exactly; begins at rest on its first value."""
    keep = float(np.exp(-step / tau))
    share = tau / step * (1.0 - keep)
    at = float(x[0]) if begin is None else begin
    state = np.array([at - (1.0 - share) * float(x[0])])
    return np.asarray(lfilter([1.0 - share, share - keep], [1.0, -keep], x, zi=state)[0])


def with_play(x: Array, width: float) -> Array:
    """What follows x through a play of that whole width."""
    out, at = np.empty_like(x), float(x[0])
    for k, target in enumerate(x):
        at = min(max(at, target - 0.5 * width), target + 0.5 * width)
        out[k] = at
    return out


def with_dead_zone(x: Array, half: float) -> Array:
    return np.asarray(np.sign(x) * np.maximum(np.abs(x) - half, 0.0))


def _separated(s: Signals) -> Array:
    return lagged(0.5 * (1.0 + np.tanh(25.0 * (s["alpha"] - 0.21))), 0.15, s["step"])


def _wake(s: Signals, d: Mapping[str, float]) -> Terms:
    behind = lagged(s["beta"], 0.12, s["step"]) - s["beta"]
    return {"Cl": d["Cl_beta"] * behind, "Cn": d["Cn_beta"] * behind}


def _soft(s: Signals, d: Mapping[str, float]) -> Terms:
    loss = -0.2 * s["q_dyn"] / 200.0
    return {
        "CY": loss * d["CY_dr"] * s["delta_r"],
        "Cl": loss * (d["Cl_da"] * s["delta_a"] + d["Cl_dr"] * s["delta_r"]),
        "Cn": loss * d["Cn_dr"] * s["delta_r"],
    }


def _slipstream(s: Signals, d: Mapping[str, float]) -> Terms:
    gain = 4.0 * s["thrust"] / s["qS"] * s["delta_r"]
    return {"CY": d["CY_dr"] * gain, "Cl": d["Cl_dr"] * gain, "Cn": d["Cn_dr"] * gain}


def _inertial_unit_later(s: Signals) -> Mapping[str, Array | float]:
    return {n: late(s[n], -0.07, s["step"]) for n in ("p", "q", "r", "ay")}


LIBRARY: tuple[Hypothesis, ...] = (
    _term("CY_da", lambda s, d: {"CY": 0.04 * s["delta_a"]}),
    _term("Cn_da", lambda s, d: {"Cn": 0.01 * s["delta_a"]}),
    _term("Cl_alpha_beta", lambda s, d: {"Cl": 0.75 * s["alpha"] * s["beta"]}),
    _term("Cn_alpha_beta", lambda s, d: {"Cn": 0.25 * s["alpha"] * s["beta"]}),
    _term("Cl_da_de", lambda s, d: {"Cl": 0.5 * s["delta_a"] * s["delta_e"]}),
    _term("Cl_beta3", lambda s, d: {"Cl": 2.0 * s["beta"] ** 3}),
    _term("Cn_beta3", lambda s, d: {"Cn": 1.0 * s["beta"] ** 3}),
    _term("CY_beta3", lambda s, d: {"CY": 4.0 * s["beta"] ** 3}),
    _term("Cl_da3", lambda s, d: {"Cl": 2.0 * s["delta_a"] ** 3}),
    _term("Cn_dr3", lambda s, d: {"Cn": 2.0 * s["delta_r"] ** 3}),
    _term("Cl_p_abs_p", lambda s, d: {"Cl": 1.5 * s["p_hat"] * abs(s["p_hat"])}),
    _term("stall_separation", lambda s, d: {"Cl": -_separated(s) * d["Cl_p"] * s["p_hat"]}, "roll damping"),
    _term("Cl_betadot", lambda s, d: {"Cl": 0.10 * s["beta_rate"] * s["b"] / (2 * s["V"])}),
    _term("Cn_betadot", lambda s, d: {"Cn": 0.03 * s["beta_rate"] * s["b"] / (2 * s["V"])}),
    _term("indicial_lag", _wake),
    _correction("Ixz_error", lambda s: {"Ixz": s["Ixz"] + 0.02}),
    _term(
        "lateral_cg", lambda s, d: {"Cl": -0.01 * s["m"] * s["az"] / s["qSb"], "Cn": 0.01 * s["m"] * s["ax"] / s["qSb"]}
    ),
    _term("prop_gyroscopic", lambda s, d: {"Cn": 0.15 * s["q"] / s["qSb"]}),
    _term("motor_torque", lambda s, d: {"Cl": 0.04 * s["thrust"] / s["qSb"]}),
    _term("slipstream_rudder", _slipstream),
    _term("p_factor", lambda s, d: {"Cn": 0.15 * s["thrust"] * s["alpha"] / s["qSb"]}),
    _correction("aileron_delay", lambda s: {"delta_a": late(s["delta_a"], 0.06, s["step"])}),
    _correction("rudder_delay", lambda s: {"delta_r": late(s["delta_r"], 0.06, s["step"])}),
    _correction("aileron_lag", lambda s: {"delta_a": lagged(s["delta_a"], 0.06, s["step"])}),
    _correction("rudder_lag", lambda s: {"delta_r": lagged(s["delta_r"], 0.06, s["step"])}),
    _correction("servo_delay", lambda s: {n: late(s[n], 0.06, s["step"]) for n in ("delta_a", "delta_r", "delta_e")}),
    _correction("servo_lag", lambda s: {n: lagged(s[n], 0.06, s["step"]) for n in ("delta_a", "delta_r", "delta_e")}),
    _correction("aileron_deadzone", lambda s: {"delta_a": with_dead_zone(s["delta_a"], 0.014)}),
    _correction("aileron_backlash", lambda s: {"delta_a": with_play(s["delta_a"], 0.017)}),
    _correction("rudder_backlash", lambda s: {"delta_r": with_play(s["delta_r"], 0.017)}),
    _term("surface_compliance", _soft, "all surfaces"),
    _term("surface_compliance", lambda s, d: {"Cl": -0.2 * s["q_dyn"] / 200.0 * d["Cl_da"] * s["delta_a"]}, "aileron"),
    _correction("beta_scale", lambda s: {"beta": s["beta"] / 1.1}),
    _correction("beta_lag", lambda s: {"beta": s["beta"] + 0.07 * s["beta_rate"]}),
    _correction("vane_position", lambda s: {"beta": s["beta"] - 0.35 * s["r"] / s["V"]}, "ahead"),
    _correction("vane_position", lambda s: {"beta": s["beta"] + 0.25 * s["p"] / s["V"]}, "below"),
    _correction("imu_lever_arm", lambda s: {"ay": s["ay"] + 0.06 * s["p_rate"]}, "below"),
    _correction("imu_lever_arm", lambda s: {"ay": s["ay"] - 0.10 * s["r_rate"]}, "ahead"),
    _gyro("gyro_misalignment", lambda s: {"p": s["p"] + 0.026 * s["r"], "r": s["r"] - 0.026 * s["p"]}, "about y"),
    _gyro("gyro_misalignment", lambda s: {"r": s["r"] + 0.026 * s["q"]}, "about x"),
    _gyro("gyro_scale", lambda s: {n: s[n] / 1.03 for n in ("p", "q", "r")}, "all axes"),
    _gyro("gyro_scale", lambda s: {"p": s["p"] / 1.03}, "roll"),
    _gyro("gyro_scale", lambda s: {"r": s["r"] / 1.03}, "yaw"),
    _correction(
        "attitude_lag", lambda s: {"phi": s["phi"] + 0.1 * s["phi_rate"], "theta": s["theta"] + 0.1 * s["theta_rate"]}
    ),
    _correction("airspeed_scale", lambda s: {"V": 1.06 * s["V"]}),
    _gyro("time_skew", _inertial_unit_later, "inertial unit"),
    _correction("time_skew", lambda s: {n: late(s[n], -0.07, s["step"]) for n in ("phi", "theta")}, "attitude"),
    _correction("time_skew", lambda s: {"beta": late(s["beta"], -0.07, s["step"])}, "air data"),
    _correction("time_skew", lambda s: {"ay": late(s["ay"], -0.07, s["step"])}, "accelerometers"),
    _term("wind_shear", lambda s, d: {"beta": -0.15 * np.cos(s["psi"]) * np.sin(s["theta"] - s["alpha"])}, "east wind"),
    _term("wind_shear", lambda s, d: {"beta": 0.15 * np.sin(s["psi"]) * np.sin(s["theta"] - s["alpha"])}, "north wind"),
)
