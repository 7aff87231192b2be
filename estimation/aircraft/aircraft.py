"""The aircraft as data: geometry, mass, sensor positions and prior derivatives.

Without numerical libraries, to load fast: the simulator reads geometry, mass, servos and engine from here, the estimators
their constants, starting values and the columns printed beside their results. Aircraft are TOML files (docs/aircraft.md); the
built-in ones are in this folder.

SI and radians; body axes x forward, y right, z down, origin at the CG. Derivatives are per radian, rates
non-dimensional as p b / 2V, q c / 2V, r b / 2V. Source of the built-in CDFP: The Aeronautical Journal (2018),
pp 889-912, doi 10.1017/aer.2018.36; what was not published is marked "engineering estimate" in the file.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from daq.utilities.constants import GRAVITY
from estimation.errors import AircraftError

SOURCES = ("wind tunnel", "engineering estimate", "flight", "computed", "handbook")

_KEYS = {
    **{"m": ("mass", "mass.mass"), "S": ("area", "geometry.area"), "b": ("span", "geometry.span")},
    **{"c": ("chord", "geometry.chord")},
    **{name: (name, f"mass.{name}") for name in ("Ixx", "Iyy", "Izz", "Ixz")},
}
"""Name in equations -> field of `Aircraft`, key in the file."""


@dataclass(frozen=True, slots=True)
class PriorDerivative:
    """The belief about one derivative before a flight: value and standard deviation [1/rad], and its source."""

    value: float
    std: float | None = None
    source: str = "engineering estimate"


@dataclass(frozen=True, slots=True)
class Servos:
    """Servos of a simulated aircraft. lag [s], first order; rate [rad/s]; limits: largest commands, both ways [rad]."""

    lag: float
    rate: float
    elevon_limit: float
    rudder_limit: float


@dataclass(frozen=True, slots=True)
class Engine:
    """Engine of a simulated aircraft: thrust at full throttle = static_thrust [N] - thrust_fall [N s/m] V; lag [s]."""

    static_thrust: float
    thrust_fall: float
    lag: float


@dataclass(frozen=True, slots=True)
class SimulatedFlight:
    """How a simulated aircraft flies. speed: trimmed with elevons in line; speed_range: slowest and fastest [m/s].

    derivatives: true ones where they differ from the believed ones [1/rad].
    """

    speed: float
    speed_range: tuple[float, float]
    derivatives: Mapping[str, float] = field(default_factory=dict)


LARGEST_NUMBER = 1e9
"""Largest size, mass or inertia of an aircraft in SI units: a hundred times those of the largest that have flown."""


@dataclass(frozen=True)
class Aircraft:
    """Geometry [m, m2], mass [kg, kg m2], sensor positions [m from the CG, body axes] and prior derivatives [1/rad].

    `Ixz` is the product of inertia as in the equations of motion (positive for a nose-down principal axis). Values missing in the
    file are NaN; `need` refuses them where they are used. throws: surface -> least and greatest deflection [rad]. uncertainty:
    field of geometry or mass -> relative 1 sigma. servos, engine, simulation: for a simulated aircraft only. text: of its file,
    empty for one made in a program.
    """

    name: str
    span: float
    area: float
    chord: float
    mass: float
    Ixx: float
    Iyy: float
    Izz: float
    Ixz: float
    derivatives: Mapping[str, PriorDerivative] = field(default_factory=dict)
    sensors: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    title: str = ""
    root_chord: float | None = None
    taper: float | None = None
    cg_from_nose: float | None = None
    servos: Servos | None = None
    engine: Engine | None = None
    simulation: SimulatedFlight | None = None
    throws: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    text: str = field(default="", compare=False, repr=False)

    def prior(self, name: str) -> PriorDerivative | None:
        """The prior of derivative `name`, None where there is none."""
        return self.derivatives.get(name)

    def constants(self) -> dict[str, float]:
        """Names and values of constants in the equations of a model: m S b c Ixx Iyy Izz Ixz g; NaN where not known."""
        return {**{name: float(getattr(self, field_)) for name, (field_, _) in _KEYS.items()}, "g": GRAVITY}

    @property
    def unknown(self) -> bool:
        """Whether neither geometry nor mass is known, as of `unknown_aircraft`."""
        return all(math.isnan(v) for n, v in self.constants().items() if n != "g")

    def need(self, names: Iterable[str], what: str) -> None:
        """Raise AircraftError where some of `names` (in equations) are not known. what: needs them, for the message."""
        constants = self.constants()
        missing = [_KEYS[n][1] for n in names if n in _KEYS and math.isnan(constants[n])]
        if missing:
            raise AircraftError(
                f"aircraft {self.name}: {', '.join(missing)} {'are' if len(missing) > 1 else 'is'} missing, and {what}"
                " cannot do without; add to its file (docs/aircraft.md)"
            )

    @property
    def impossible(self) -> str:
        """The first impossible value of geometry, mass and inertia, in words; empty where all are possible or unknown."""
        for name, (key, _) in _KEYS.items():
            value = float(getattr(self, key))
            if abs(value) > LARGEST_NUMBER or (name != "Ixz" and value <= 0.0):
                return f"{key} {value:g}"
        if self.Ixz**2 >= self.Ixx * self.Izz:
            return f"Ixz {self.Ixz:g} beside Ixx {self.Ixx:g} and Izz {self.Izz:g}"
        return ""

    def with_values(self, **changes: float) -> "Aircraft":
        """A copy with other geometry or mass, e.g. `with_values(Ixx=0.26)`."""
        return replace(self, **changes)  # type: ignore[arg-type]


def unknown_aircraft(name: str) -> Aircraft:
    """An aircraft of which only the name is known, for methods that need no more."""
    nan = math.nan
    return Aircraft(name, nan, nan, nan, nan, nan, nan, nan, nan)
