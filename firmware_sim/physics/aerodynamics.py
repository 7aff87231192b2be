"""Aerodynamic forces and moments of the true aircraft, and where its derivatives come from.

Coefficients per radian with non-dimensional rates p_hat = p b / 2V, q_hat = q c / 2V, r_hat = r b / 2V. Lift and drag
turn with alpha only; CY is the body-axis side-force coefficient m a_y / (q S) (The Aeronautical Journal (2018),
pp 889-912, eq 4); moments are about body axes at the CG. The derivatives are those of the aircraft's file.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from daq.utilities.constants import GRAVITY
from estimation.aircraft import Aircraft, SimulatedFlight
from firmware_sim.tables import ScenarioError

if TYPE_CHECKING:
    from firmware_sim.physics.motion import Motion

LATERAL = tuple("CY_0 CY_beta CY_p CY_r CY_dr Cl_0 Cl_beta Cl_p Cl_r Cl_da Cl_dr Cn_0 Cn_beta Cn_p Cn_r Cn_dr".split())
LONGITUDINAL = ("CL_0", "CL_alpha", "CL_q", "CL_de", "CD_0", "CD_k", "Cm_0", "Cm_alpha", "Cm_q", "Cm_de")
REFERENCE_DENSITY = 1.17  # kg/m3


def true_derivatives(aircraft: Aircraft, overrides: Mapping[str, float]) -> dict[str, float]:
    """The derivatives the simulated aircraft flies with: those believed, then those of [simulation], then `overrides`.

    Cm_0 is set so that the elevator is in line at the trim speed, unless overridden. Raises ScenarioError for a
    derivative this aircraft does not have, or does not state and needs.
    """
    simulation = simulation_of(aircraft)
    known_values = {**{n: p.value for n, p in aircraft.derivatives.items()}, **simulation.derivatives, **overrides}
    names = (*LATERAL, *LONGITUDINAL)
    unknown = sorted(set(overrides) - set(names))
    if unknown:
        raise ScenarioError(f"derivatives.{unknown[0]}: no such derivative; known are {', '.join(names)}")
    missing = [n for n in names if n not in known_values and n != "Cm_0"]
    if missing:
        raise ScenarioError(
            f"aircraft {aircraft.name!r}: derivative {', '.join(missing)} missing, needed to fly it; add to"
            " [derivatives] or [simulation.derivatives] of its file"
        )
    values = {name: known_values.get(name, 0.0) for name in names}
    if "Cm_0" not in overrides:
        pressure = 0.5 * REFERENCE_DENSITY * simulation.speed**2
        lift = aircraft.mass * GRAVITY / (pressure * aircraft.area)
        values["Cm_0"] = -values["Cm_alpha"] * (lift - values["CL_0"]) / values["CL_alpha"]
    return values


def simulation_of(aircraft: Aircraft) -> SimulatedFlight:
    """How an aircraft flies in simulation. Raises ScenarioError where its file does not say, or lacks geometry or mass."""
    if aircraft.simulation is None:
        raise ScenarioError(
            f"aircraft {aircraft.name!r} cannot be flown: its file has no [simulation]; add it (docs/aircraft.md)"
        )
    aircraft.need(("m", "S", "b", "c", "Ixx", "Iyy", "Izz"), "a simulated flight")
    return aircraft.simulation


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
