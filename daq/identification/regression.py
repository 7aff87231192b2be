"""A regression as data: states that are simulated for the instruments, columns, and the terms of each equation.

With Q(x) = integral of the dynamic pressure times x over an interval between scans, every equation is linear in its derivatives:

    CY:  m / S  integral of ay                                                   = Q(1) CY_0 + Q(beta) CY_beta + ...
    Cl:  (Ixx dp - Ixz dr + integral of (Izz - Iyy) q r - Ixz p q) / (S b)       = Q(1) Cl_0 + ...
    Cn:  (Izz dr - Ixz dp + integral of (Iyy - Ixx) p q + Ixz q r) / (S b)       = Q(1) Cn_0 + ...
    CL:  integral of ((m ax - T) sin alpha - m az cos alpha) / S                 = Q(1) CL_0 + Q(alpha) CL_alpha + ...
    CD:  integral of (-(m ax - T) cos alpha - m az sin alpha) / S                = Q(1) CD_0 + Q(CL^2) CD_k
    Cm:  (Iyy dq - integral of (Izz - Ixx) p r - Ixz (p^2 - r^2)) / (S c)        = Q(1) Cm_0 + Q(alpha) Cm_alpha + ...

Derivatives are about the airframe's CG. With the CG d ahead of it, Cn gains integral of m d ay / (S b) on its left side, and Cm
loses integral of m d az / (S c). CL in a column of the drag is the measured one, and the simulated one in its instrument.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter

from daq.contract.channels import COLUMN_BY_NAME
from daq.identification.airframe import EQUATIONS, Airframe, Sample

Forces = Callable[[Airframe, Sample], tuple[float, ...]]
Gains = Callable[[Airframe, Sample, Sample], tuple[float, ...]]


@dataclass(frozen=True)
class Equation:
    """One equation. terms: derivative -> column, beside the constant. instant: holds at every instant, without an increment."""

    coefficient: str
    terms: Mapping[str, str]
    instant: bool = False

    @property
    def constant(self) -> str:
        """Name of its constant."""
        return f"{self.coefficient}_0"

    @property
    def derivatives(self) -> tuple[str, ...]:
        """The constant first."""
        return (self.constant, *self.terms)


@dataclass(frozen=True)
class PlaneRegression:
    """Columns in their order: the constant, states (with the length that makes a rate of each, empty for an angle), controls, the
    square of CL if wanted.

    states: signal -> attribute of the airframe that its rate is made with. controls: column -> signal. forces: left sides of all
    equations at one scan, what rates gain (gains) left out. motion: signals that the simulation needs besides. lags: rows over
    which residuals are taken to be correlated, half a second and more at 20 Hz. shortest_row [s]: shorter ones are joined.
    """

    name: str
    states: Mapping[str, str]
    controls: Mapping[str, str]
    equations: tuple[Equation, ...]
    forces: Forces
    gains: Gains
    motion: tuple[str, ...]
    square_of_lift: bool = False
    lags: int = 12
    shortest_row: float = 0.0

    def __deepcopy__(self, memo: object) -> "PlaneRegression":
        return self  # nothing of it changes, and estimators are copied

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return ("0", *self.states, *self.controls, *(("CL2",) if self.square_of_lift else ()))

    @property
    def width(self) -> int:
        """Columns of a row."""
        return len(self.columns)

    @property
    def total(self) -> int:
        """Numbers of a row: columns of the equations with increments, of those that hold at every instant, left sides."""
        return 2 * self.width + len(self.equations)

    @cached_property
    def forces_only(self) -> frozenset[str]:
        """Coefficients of the equations that hold at every instant."""
        return frozenset(e.coefficient for e in self.equations if e.instant)

    @cached_property
    def derivatives(self) -> tuple[str, ...]:
        """Every parameter, constants included."""
        return tuple(name for equation in self.equations for name in equation.derivatives)

    @property
    def shown(self) -> tuple[str, ...]:
        """Derivatives in the order in which they are shown; constants are kept, but nobody flies for them."""
        return tuple(name for equation in self.equations for name in equation.terms)

    @cached_property
    def signals(self) -> tuple[str, ...]:
        """Signals of a sample that it needs."""
        return tuple(dict.fromkeys((*self.states, *self.controls.values(), *self.motion)))

    @cached_property
    def _values(self) -> Callable[[Sample], tuple[float, ...]]:
        getter = attrgetter(*self.states, *self.controls.values())
        return getter

    def linear_values(self, sample: Sample) -> tuple[float, ...]:
        """Measured values of the linear columns, the constant's first."""
        return (1.0, *self._values(sample))

    @cached_property
    def _limits(self) -> tuple[tuple[str, float, float], ...]:
        return tuple((n, *COLUMN_BY_NAME[n].plausible) for n in self.signals)

    def credible(self, sample: Sample) -> bool:
        """Whether every value it needs is a number that an aircraft can show."""
        return math.isfinite(sample.time) and all(
            low <= getattr(sample, name) <= high for name, low, high in self._limits
        )


def _terms(coefficient: str) -> dict[str, str]:
    return {f"{coefficient}_{column}": column for column in EQUATIONS[coefficient]}


def _lateral_forces(a: Airframe, s: Sample) -> tuple[float, ...]:
    per_span = 1.0 / (a.area * a.span)
    return (
        a.mass_as(s.mass) * s.ay / a.area,
        ((a.Izz - a.Iyy) * s.q * s.r - a.Ixz * s.p * s.q) * per_span,
        ((a.Iyy - a.Ixx) * s.p * s.q + a.Ixz * s.q * s.r + a.cg_ahead(s.cg_x) * a.mass_as(s.mass) * s.ay) * per_span,
    )


def _lateral_gains(a: Airframe, first: Sample, last: Sample) -> tuple[float, ...]:
    dp, dr, per_span = last.p - first.p, last.r - first.r, 1.0 / (a.area * a.span)
    return 0.0, (a.Ixx * dp - a.Ixz * dr) * per_span, (a.Izz * dr - a.Ixz * dp) * per_span


LATERAL = PlaneRegression(
    "lateral",
    {"beta": "", "p": "span", "r": "span"},
    {"da": "delta_a", "dr": "delta_r"},
    (
        Equation("CY", _terms("CY"), instant=True),
        Equation("Cl", _terms("Cl")),
        Equation("Cn", _terms("Cn")),
    ),
    _lateral_forces,
    _lateral_gains,
    ("q", "phi", "theta", "alpha", "V", "ay", "rho"),
)


def lift_and_drag(a: Airframe, s: Sample) -> tuple[float, float]:
    """Of the specific force at the CG, thrust taken out, per area [Pa]."""
    mass = a.mass_as(s.mass)
    x, z = mass * s.ax - s.thrust, mass * s.az
    sin, cos = math.sin(s.alpha), math.cos(s.alpha)
    return (x * sin - z * cos) / a.area, (-x * cos - z * sin) / a.area


def _longitudinal_forces(a: Airframe, s: Sample) -> tuple[float, ...]:
    coupling = (a.Izz - a.Ixx) * s.p * s.r - a.Ixz * (s.p * s.p - s.r * s.r)
    by_cg = a.cg_ahead(s.cg_x) * a.mass_as(s.mass) * s.az
    return *lift_and_drag(a, s), -(coupling + by_cg) / (a.area * a.chord)


def _longitudinal_gains(a: Airframe, first: Sample, last: Sample) -> tuple[float, ...]:
    return 0.0, 0.0, a.Iyy * (last.q - first.q) / (a.area * a.chord)


LONGITUDINAL = PlaneRegression(
    "longitudinal",
    {"alpha": "", "q": "chord"},
    {"de": "delta_e"},
    (
        Equation("CL", {"CL_alpha": "alpha", "CL_q": "q", "CL_de": "de"}, instant=True),
        Equation("CD", {"CD_k": "CL2"}, instant=True),
        Equation("Cm", {"Cm_alpha": "alpha", "Cm_q": "q", "Cm_de": "de"}),
    ),
    _longitudinal_forces,
    _longitudinal_gains,
    ("beta", "p", "r", "phi", "theta", "V", "ax", "ay", "az", "rho", "thrust"),
    square_of_lift=True,
    lags=24,  # what is left of the vane's noise lasts
    shortest_row=0.045,  # so that this is 1.1 s and more at every rate
)

REGRESSIONS: Mapping[str, tuple[PlaneRegression, ...]] = {
    "lateral": (LATERAL,),
    "longitudinal": (LONGITUDINAL,),
    "six-dof": (LATERAL, LONGITUDINAL),
}
"""By the model whose derivatives they tell."""
DEFAULT_MODEL = "lateral"


@dataclass(frozen=True)
class LiveAircraft:
    """An airframe with its beliefs, and what is estimated of it. sources: derivative -> who believes it (wind tunnel, flight,
    engineering estimate).

    modelled: what the gap monitor holds against flight, as beliefs of a model, with a standard deviation of zero where it states
    none; None: what the aircraft file believes. throws: control -> least and greatest deflection [rad], where known.
    """

    name: str
    airframe: Airframe
    sources: Mapping[str, str] = field(default_factory=dict)
    modelled: Airframe | None = None
    throws: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    regressions: tuple[PlaneRegression, ...] = (LATERAL,)

    @property
    def derivatives(self) -> tuple[str, ...]:
        """Every parameter, constants included."""
        return tuple(name for r in self.regressions for name in r.derivatives)

    @property
    def shown(self) -> tuple[str, ...]:
        """What is shown of each plane."""
        return tuple(name for r in self.regressions for name in r.shown)


AircraftSource = Callable[[str, str | None, str], LiveAircraft]
"""(name or file, text of the file that travelled with the recording or None, model or "") -> the aircraft, for stations that
know no aircraft files. Raises UserError where there is none, or where it lacks what the estimator needs."""
