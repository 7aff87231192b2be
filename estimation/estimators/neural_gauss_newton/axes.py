"""Models with a Neural Gauss-Newton formulation, and the coefficients of each axis from measured motion and from parameters.

Lateral: side force, rolling and yawing moment (The Aeronautical Journal (2018), pp 889-912). Longitudinal: lift, drag, pitching
moment. SI, radians, body axes x forward, y right, z down; rates non-dimensional as p b/2V, q c/2V, r b/2V. All arrays are over
samples. `inertial` gives coefficients times dynamic pressure: forces and moments divided by reference area (and length). This
module does not import torch.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.aircraft import Aircraft
from estimation.models.library import LATERAL_DERIVATIVES, LONGITUDINAL_DERIVATIVES

LATERAL, LONGITUDINAL = ("lateral", "lateral-simple"), ("longitudinal",)


def unsupported_model(model: str, parameters: Collection[str] | None = None) -> str:
    """Why a model of that name and with those parameters cannot be used; empty where it can."""
    if model not in (*LATERAL, *LONGITUDINAL):
        models = "lateral, lateral-simple and longitudinal"
        return f"model {model}: Neural Gauss-Newton has a formulation for {models}; use method ml"
    names = LATERAL_DERIVATIVES if model in LATERAL else LONGITUDINAL_DERIVATIVES
    if parameters is not None and (extra := [n for n in parameters if n not in names]):
        return f"model {model}: Neural Gauss-Newton has no formulation with {', '.join(extra)}; use method ml"
    return ""


Array = NDArray[np.float64]
Signals = Mapping[str, Array]


def dynamic_pressure(s: Signals) -> Array:
    """rho V^2 / 2 [Pa]."""
    return 0.5 * s["rho"] * s["V"] ** 2


@dataclass(frozen=True)
class LateralAxis:
    """C_Y, C_l, C_n with the sixteen derivatives of the paper.

    motion: predicted by the network, `optional` of it may be missing; accelerations: specific forces that it predicts too;
    angular_rates: rates whose increments determine the moments; columns: all that are needed; controls: those that may step;
    linear: whether the coefficients are linear in the parameters. `inertial`: (N, 3) coefficients times dynamic pressure, from
    accelerations, rates and their derivatives; `aerodynamic`: (N, 3) coefficients of the model, and their derivatives (N, 3, n)
    by the parameters.
    """

    aircraft: Aircraft
    name: str = "lateral"
    motion: tuple[str, ...] = ("beta", "phi", "psi", "p", "r")
    optional: tuple[str, ...] = ("psi",)
    accelerations: tuple[str, ...] = ("ay",)
    angular_rates: tuple[str, ...] = ("p", "r")
    columns: tuple[str, ...] = ("beta", "phi", "psi", "p", "q", "r", "ay", "V", "rho", "delta_a", "delta_r")
    controls: tuple[str, ...] = ("delta_a", "delta_r")
    coefficients: tuple[str, ...] = ("CY", "Cl", "Cn")
    linear: bool = True
    parameters: tuple[str, ...] = LATERAL_DERIVATIVES

    def inertial(self, s: Signals, rate_derivatives: Signals) -> Array:
        """C_Y by eq. 4 of the paper; C_l and C_n by the moment equations of a body with Ixz."""
        a = self.aircraft
        p, q, r = s["p"], s["q"], s["r"]
        p_dot, r_dot = rate_derivatives["p"], rate_derivatives["r"]
        side = a.mass * s["ay"] / a.area
        roll = (a.Ixx * p_dot - a.Ixz * (r_dot + p * q) - (a.Iyy - a.Izz) * q * r) / (a.area * a.span)
        yaw = (a.Izz * r_dot - a.Ixz * (p_dot - q * r) + (a.Iyy - a.Ixx) * q * p) / (a.area * a.span)
        return np.column_stack([side, roll, yaw])

    def aerodynamic(self, s: Signals, theta: Array) -> tuple[Array, Array]:
        """Linear in all parameters."""
        p_hat = s["p"] * self.aircraft.span / (2 * s["V"])
        r_hat = s["r"] * self.aircraft.span / (2 * s["V"])
        ones = np.ones_like(p_hat)
        regressors = np.zeros((p_hat.size, 3, len(self.parameters)))
        regressors[:, 0, 0:5] = np.column_stack([ones, s["beta"], p_hat, r_hat, s["delta_r"]])
        regressors[:, 1, 5:11] = np.column_stack([ones, s["beta"], p_hat, r_hat, s["delta_a"], s["delta_r"]])
        regressors[:, 2, 11:16] = np.column_stack([ones, s["beta"], p_hat, r_hat, s["delta_r"]])
        return regressors @ theta, regressors


@dataclass(frozen=True)
class LongitudinalAxis:
    """C_L, C_D, C_m; drag polar C_D = CD_0 + CD_k C_L^2. Fields as in `LateralAxis`."""

    aircraft: Aircraft
    name: str = "longitudinal"
    motion: tuple[str, ...] = ("alpha", "theta", "q", "V")
    optional: tuple[str, ...] = ()
    accelerations: tuple[str, ...] = ("ax", "az")
    angular_rates: tuple[str, ...] = ("q",)
    columns: tuple[str, ...] = ("alpha", "theta", "q", "V", "p", "r", "ax", "az", "thrust", "rho", "delta_e")
    controls: tuple[str, ...] = ("delta_e", "thrust")
    coefficients: tuple[str, ...] = ("CL", "CD", "Cm")
    linear: bool = False  # because of the polar
    parameters: tuple[str, ...] = LONGITUDINAL_DERIVATIVES

    def inertial(self, s: Signals, rate_derivatives: Signals) -> Array:
        """Lift and drag from specific force less thrust, turned to wind axes; C_m from the pitching equation."""
        a = self.aircraft
        force_x = (a.mass * s["ax"] - s["thrust"]) / a.area
        force_z = a.mass * s["az"] / a.area
        sin, cos = np.sin(s["alpha"]), np.cos(s["alpha"])
        p, r = s["p"], s["r"]
        moment = a.Iyy * rate_derivatives["q"] + (a.Ixx - a.Izz) * p * r + a.Ixz * (p**2 - r**2)
        lift, drag = force_x * sin - force_z * cos, -force_x * cos - force_z * sin
        return np.column_stack([lift, drag, moment / (a.area * a.chord)])

    def aerodynamic(self, s: Signals, theta: Array) -> tuple[Array, Array]:
        """Linear but for the polar, whose derivatives by the lift parameters are 2 k C_L times those of lift."""
        q_hat = s["q"] * self.aircraft.chord / (2 * s["V"])
        columns = np.column_stack([np.ones_like(q_hat), s["alpha"], q_hat, s["delta_e"]])
        lift = columns @ theta[0:4]
        slopes = np.zeros((q_hat.size, 3, len(self.parameters)))
        slopes[:, 0, 0:4] = columns
        slopes[:, 1, 4] = 1.0
        slopes[:, 1, 5] = lift**2
        slopes[:, 1, 0:4] = 2 * theta[5] * lift[:, None] * columns
        slopes[:, 2, 6:10] = columns
        drag = theta[4] + theta[5] * lift**2
        return np.column_stack([lift, drag, columns @ theta[6:10]]), slopes


Axis = LateralAxis | LongitudinalAxis


def axis_for(name: str, aircraft: Aircraft) -> Axis | None:
    """The axis of a model name; None where Neural Gauss-Newton has no formulation."""
    if name in LATERAL:
        return LateralAxis(aircraft)
    if name in LONGITUDINAL:
        return LongitudinalAxis(aircraft)
    return None
