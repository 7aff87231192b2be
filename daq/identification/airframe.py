"""Input of the recursive estimator: the airframe, prior values of its derivatives, and one sample of its motion.

Body axes x forward, y right, z down, at the centre of gravity; SI and radians; derivatives per radian, rates as
p b / 2V and r b / 2V. +delta_r trailing edge to port, +delta_a rolls left.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from daq.contract.channels import COLUMN_BY_NAME

COLUMNS = ("0", "beta", "p", "r", "da", "dr")
"""Columns of the regression, the endings of the derivatives' names; `0` is the constant."""

EQUATIONS: Mapping[str, tuple[str, ...]] = {
    "CY": ("beta", "p", "r", "dr"),
    "Cl": ("beta", "p", "r", "da", "dr"),
    "Cn": ("beta", "p", "r", "dr"),
}
"""Coefficient -> columns of its derivatives, besides the constant."""

CONTROLS: Mapping[str, str] = {"da": "delta_a", "dr": "delta_r"}
"""Column of the regression -> signal of the control."""

DERIVATIVES = tuple(f"{coefficient}_{c}" for coefficient, terms in EQUATIONS.items() for c in ("0", *terms))
"""Every parameter of the three equations, constants included."""


class Sample(NamedTuple):
    """One calibrated scan: time [s], angles [rad], rates [rad/s], V true airspeed [m/s], ax ay az at the CG [m/s2], rho [kg/m3],
    thrust [N]. Values that only the pitching plane needs are NaN where not known. mass: present [kg]; cg_x: present CG, ahead of
    the airframe's [m]; NaN where not measured."""

    time: float
    beta: float
    p: float
    q: float
    r: float
    phi: float
    theta: float
    alpha: float
    V: float
    ay: float
    delta_a: float
    delta_r: float
    rho: float
    ax: float = math.nan
    az: float = math.nan
    delta_e: float = math.nan
    thrust: float = math.nan
    mass: float = math.nan
    cg_x: float = math.nan

    @property
    def credible(self) -> bool:
        """Whether every value of the lateral motion is finite and plausible, so that no failed sensor enters the regression."""
        return math.isfinite(self.time) and all(
            low <= x <= high for x, (low, high) in zip(self[1:LATERAL_FIELDS], _RANGES, strict=True)
        )


LATERAL_FIELDS = 13
SIGNALS = Sample._fields[1:LATERAL_FIELDS]
"""Signals of the lateral motion, in the order of a sample; names are those of the flight's columns."""
PITCH_SIGNALS = Sample._fields[LATERAL_FIELDS:-2]
"""Further signals of the pitching plane."""

MASS = "mass"
"""Optional flight column: present mass of the whole aircraft [kg]."""
FARTHEST_MASS = 2.0  # largest ratio to the stated mass, either way; beyond it the unit is wrong (pounds: 2.2)
CG = "cg_x"
"""Optional flight column: position of the centre of gravity, ahead of the aircraft file's [m]."""
FARTHEST_CG = 0.1  # largest distance in spans, either way, some half of the chord; beyond it the unit is wrong

_RANGES = tuple(COLUMN_BY_NAME[name].plausible for name in SIGNALS)


@dataclass(frozen=True, slots=True)
class Belief:
    """Prior of one derivative: value and standard deviation [1/rad]."""

    value: float
    std: float


@dataclass(frozen=True)
class Airframe:
    """Geometry [m, m2], mass [kg], moments of inertia [kg m2], and priors by name (`DERIVATIVES`).

    Ixz: as in the equations of motion (positive for a nose-down principal axis). servo_lag: first-order lag of the servos [s],
    None where not known; surfaces are then interpolated between samples. chord [m]: NaN where only the lateral plane is needed.
    Raises ValueError, naming the field, for a value that no airframe has.
    """

    span: float
    area: float
    mass: float
    Ixx: float
    Iyy: float
    Izz: float
    Ixz: float
    beliefs: Mapping[str, Belief] = field(default_factory=dict)
    servo_lag: float | None = None
    chord: float = math.nan

    def __post_init__(self) -> None:
        for name in ("span", "area", "mass", "Ixx", "Iyy", "Izz"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value:g}; it must be a positive number")
        if not self.Ixz**2 < self.Ixx * self.Izz:
            raise ValueError(f"Ixz is {self.Ixz:g}; its square must be less than Ixx Izz")

    def mass_ratio(self, mass: float) -> float:
        """Ratio of a mass [kg] to the airframe's; 1 for NaN, or for an implausible mass (FARTHEST_MASS)."""
        ratio = mass / self.mass
        return ratio if 1.0 / FARTHEST_MASS < ratio < FARTHEST_MASS else 1.0

    def mass_as(self, measured: float) -> float:
        """The measured mass [kg], or the stated one where that is NaN or implausible."""
        return self.mass * self.mass_ratio(measured)

    def cg_ahead(self, measured: float) -> float:
        """Distance of the measured CG ahead of the stated one [m]; 0 where it is NaN or implausible (FARTHEST_CG)."""
        return measured if abs(measured) < FARTHEST_CG * self.span else 0.0

    def believed(self, name: str) -> float:
        """The prior value of a derivative, zero without a prior."""
        belief = self.beliefs.get(name)
        return 0.0 if belief is None else belief.value
