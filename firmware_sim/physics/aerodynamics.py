"""Aerodynamic forces and moments of the true aircraft, and where its derivatives come from.

Coefficients per radian with non-dimensional rates p_hat = p b / 2V, q_hat = q c / 2V, r_hat = r b / 2V. Lift and drag
turn with alpha only; CY is the body-axis side-force coefficient m a_y / (q S) (The Aeronautical Journal (2018),
pp 889-912, eq 4); moments are about body axes at the CG. Lateral truth: means of the maximum-likelihood estimates of
four flights (same source, Table 5). Longitudinal derivatives are engineering estimates from the aircraft file.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from estimation.aircraft import Aircraft
from firmware_sim.errors import ScenarioError

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion

TABLE_5_ML_MEANS: Mapping[str, float] = {
    "CY_0": 0.0001, "CY_beta": -0.1152, "CY_p": -0.0529, "CY_r": 0.1103, "CY_dr": 0.4174,
    "Cl_0": -0.0001, "Cl_beta": -0.0894, "Cl_p": -0.4951, "Cl_r": 0.091, "Cl_da": -0.0948, "Cl_dr": -0.0193,
    "Cn_0": 0.0002, "Cn_beta": 0.0263, "Cn_p": 0.0245, "Cn_r": -0.0472, "Cn_dr": -0.0327,
}  # fmt: skip

LONGITUDINAL = ("CL_0", "CL_alpha", "CL_q", "CL_de", "CD_0", "CD_k", "Cm_0", "Cm_alpha", "Cm_q", "Cm_de")
REFERENCE_SPEED = 17.0  # m/s at which the aircraft is rigged to fly level with the elevons in line
REFERENCE_DENSITY = 1.17  # kg/m3


def true_derivatives(aircraft: Aircraft, overrides: Mapping[str, float]) -> dict[str, float]:
    """The derivatives the simulated aircraft flies with: Table 5 and the aircraft file, then `overrides`.

    Cm_0 is set so that the elevator is in line at the reference speed, unless overridden. Raises ScenarioError for a
    derivative this aircraft does not have.
    """
    values = dict(TABLE_5_ML_MEANS)
    for name in LONGITUDINAL:
        prior = aircraft.prior(name)
        if prior is None:
            raise ScenarioError(f"aircraft {aircraft.name!r}: derivative {name} is missing, needed to fly it")
        values[name] = prior.value
    unknown = sorted(set(overrides) - set(values))
    if unknown:
        raise ScenarioError(f"derivatives.{unknown[0]}: no such derivative; known are {', '.join(values)}")
    values.update(overrides)
    if "Cm_0" not in overrides:
        pressure = 0.5 * REFERENCE_DENSITY * REFERENCE_SPEED**2
        lift = aircraft.mass * 9.80665 / (pressure * aircraft.area)
        values["Cm_0"] = -values["Cm_alpha"] * (lift - values["CL_0"]) / values["CL_alpha"]
    return values


class Aerodynamics:
    """Linear aerodynamics with per-flight derivatives; hidden effects add to what this puts into the Motion."""

    def __init__(self, derivatives: Mapping[str, object]) -> None:
        for name, value in derivatives.items():
            setattr(self, name, value)

    def coefficients(self, m: "Motion") -> None:
        """Set CL CD Cm CY Cl Cn of `m` from its flow angles, rates and surface positions."""
        a, b, p, q, r = m.alpha, m.beta, m.p_hat, m.q_hat, m.r_hat
        de, da, dr = m.surface_e, m.surface_a, m.surface_r
        d = self.__dict__
        m.CL = d["CL_0"] + d["CL_alpha"] * a + d["CL_q"] * q + d["CL_de"] * de
        m.CD = d["CD_0"] + d["CD_k"] * m.CL * m.CL
        m.Cm = d["Cm_0"] + d["Cm_alpha"] * a + d["Cm_q"] * q + d["Cm_de"] * de
        m.CY = d["CY_0"] + d["CY_beta"] * b + d["CY_p"] * p + d["CY_r"] * r + d["CY_dr"] * dr
        m.Cl = d["Cl_0"] + d["Cl_beta"] * b + d["Cl_p"] * p + d["Cl_r"] * r + d["Cl_da"] * da + d["Cl_dr"] * dr
        m.Cn = d["Cn_0"] + d["Cn_beta"] * b + d["Cn_p"] * p + d["Cn_r"] * r + d["Cn_dr"] * dr
