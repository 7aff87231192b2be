"""What the recursive estimator is told: the airframe, what is believed of its derivatives, and one sample of its motion.

Body axes x forward, y right, z down, at the centre of gravity; SI and radians; derivatives per radian, rates as
p b / 2V and r b / 2V. +delta_r trailing edge to port, +delta_a rolls left.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from daq.contract.channels import COLUMN_BY_NAME

COLUMNS = ("0", "beta", "p", "r", "da", "dr")
"""Columns of the regression, as they end the name of a derivative; `0` is the constant."""

EQUATIONS: Mapping[str, tuple[str, ...]] = {
    "CY": ("beta", "p", "r", "dr"),
    "Cl": ("beta", "p", "r", "da", "dr"),
    "Cn": ("beta", "p", "r", "dr"),
}
"""Coefficient -> columns that its derivatives stand for, beside the constant."""

CONTROLS: Mapping[str, str] = {"da": "delta_a", "dr": "delta_r"}
"""Column of the regression -> signal of the control."""

DERIVATIVES = tuple(f"{coefficient}_{c}" for coefficient, terms in EQUATIONS.items() for c in ("0", *terms))
"""Every parameter of the three equations, constants included."""


class Sample(NamedTuple):
    """One calibrated scan: time [s], angles [rad], rates [rad/s], V true airspeed [m/s], ax ay az at the CG [m/s2], rho [kg/m3],
    thrust [N]. What only the pitching plane needs is NaN where it is not known. mass: now [kg]; cg_x: of the CG now, ahead of
    the airframe's [m]; NaN where nobody measures them."""

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
        """Whether every value of the lateral motion is a number that an aircraft can show: a scan with a silent or raving sensor
        makes no row."""
        return math.isfinite(self.time) and all(
            low <= x <= high for x, (low, high) in zip(self[1:LATERAL_FIELDS], _RANGES, strict=True)
        )


LATERAL_FIELDS = 13
SIGNALS = Sample._fields[1:LATERAL_FIELDS]
"""Signals of the lateral motion, in the order of a sample; names are those of the flight's columns."""
PITCH_SIGNALS = Sample._fields[LATERAL_FIELDS:-2]
"""Those that come to them for the pitching plane."""

MASS = "mass"
"""Flight column of the whole aircraft's mass [kg] as fuel is burnt, where there is one."""
FARTHEST_MASS = 2.0  # times the stated one, or a part of it: further off a unit is wrong (pounds are 2.2)
CG = "cg_x"
"""Flight column of the place of the centre of gravity, ahead of the aircraft file's [m], where there is one."""
FARTHEST_CG = 0.1  # of the span, either way, some half of the chord: no aircraft flies further off, a wrong unit does

_RANGES = tuple(COLUMN_BY_NAME[name].plausible for name in SIGNALS)


@dataclass(frozen=True, slots=True)
class Belief:
    """What is believed of one derivative before flying: value and standard deviation [1/rad]."""

    value: float
    std: float


@dataclass(frozen=True)
class Airframe:
    """Geometry [m, m2], mass [kg], moments of inertia [kg m2], and beliefs by name (`DERIVATIVES`).

    `Ixz` as it stands in the equations of motion (positive for a nose-down principal axis). servo_lag [s]: first-order lag of the
    servos, None where not known; surfaces are then drawn through their samples. chord [m]: NaN where only the lateral plane is
    asked for. Raises ValueError for a value that no airframe has, naming it.
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
        """Of a mass [kg] to the airframe's; 1 for one that is not known (NaN), or that this airframe cannot have."""
        ratio = mass / self.mass
        return ratio if 1.0 / FARTHEST_MASS < ratio < FARTHEST_MASS else 1.0

    def mass_as(self, measured: float) -> float:
        """The airframe's mass [kg] as measured in flight; as stated where that is not known (NaN), or none that it can have."""
        return self.mass * self.mass_ratio(measured)

    def cg_ahead(self, measured: float) -> float:
        """How far the CG is ahead of the airframe's [m]; 0 where that is not known (NaN), or none that it can have."""
        return measured if abs(measured) < FARTHEST_CG * self.span else 0.0

    def believed(self, name: str) -> float:
        """The believed value of a derivative, zero where nothing is believed."""
        belief = self.beliefs.get(name)
        return 0.0 if belief is None else belief.value
