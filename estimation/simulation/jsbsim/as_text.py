"""A JSBSim aircraft as a model file: its functions become lines and parameters of the six-degree-of-freedom model.

A function that is a number times one regressor becomes a parameter under its usual name (`Cl_p`), any other function a line under
its name in JSBSim. JSBSim's forces are in wind axes at AERORP: lines rotate them and take their moment about the centre of
gravity. Lift may depend on the rate of alpha, which depends on lift; the line of that rate is solved for it.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from xml.etree import ElementTree as ET

from daq.utilities.constants import INCH
from estimation.aircraft import Aircraft
from estimation.models.base import Model
from estimation.models.expressions import names_in
from estimation.models.library import six_dof
from estimation.simulation.base_model import alpha_rate_solved
from estimation.simulation.jsbsim.coefficients import (
    AXES,
    SIZE_TEXTS,
    Text,
    coefficient_text,
    coefficients_of,
    named_terms,
    solved_lift,
)
from estimation.simulation.jsbsim.forces import ARM
from estimation.simulation.jsbsim.library import Follows
from estimation.simulation.jsbsim.reading import LIFT, Reader
from estimation.simulation.jsbsim.terms import constant, number_text
from estimation.simulation.oracle import ALPHA_RATE, SimulationError

SUTHERLAND = 110.4  # K, of the viscosity of air
FORCE_AXES = ("LIFT", "DRAG", "SIDE")
MOST_NAMED = 4  # functions in one message


@dataclass(frozen=True)
class StandardTroposphere:
    """A standard troposphere by one point. sound: speed of sound [m/s]; temperature [K]; rho: density [kg/m3]; power: of density,
    to which the speed of sound is proportional (temperature has twice that); viscosity: Sutherland's constant [kg/(m s K^.5)]."""

    sound: float
    temperature: float
    rho: float
    power: float
    viscosity: float


@dataclass(frozen=True)
class AircraftSource:
    """The aerodynamics section of an aircraft and what is needed beside it. arm: from the centre of gravity to AERORP [m, body
    axes]. values_of: as in `Reader`."""

    name: str
    spec: str
    aircraft: Aircraft
    section: ET.Element
    surfaces: Mapping[str, tuple[str, Follows]]
    arm: tuple[float, float, float]
    air: StandardTroposphere
    values_of: Callable[[str], list[float] | None]


@dataclass(frozen=True)
class Imported:
    """An aircraft as a model. held: properties that became numbers, though the aircraft could change them. standard, own: terms
    under their usual names and under JSBSim's. tables: number of tables of the aircraft."""

    model: Model
    held: Mapping[str, float]
    standard: tuple[str, ...]
    own: tuple[str, ...]
    tables: int

    def sentences(self) -> list[str]:
        """What the model contains, for the terminal."""
        held_numbers = ", ".join(f"{n} {v:g}" if math.isfinite(v) else n for n, v in self.held.items())
        return [
            f"by the field's names: {', '.join(self.standard) or 'nothing'}",
            f"by JSBSim's names: {', '.join(self.own) or 'nothing'}",
            *([f"{self.tables} tables: straight between their points, as max(0, x - point)"] if self.tables else []),
            *([f"numbers now, as JSBSim starts and far above ground: {held_numbers}"] if held_numbers else []),
        ]


def import_aircraft(source: AircraftSource) -> Imported:
    """The model. Raises SimulationError naming functions that have no exact form in our text."""
    skeleton = six_dof(source.aircraft)
    text = Text(taken=_reserved(skeleton))
    reader = Reader(source.section, source.surfaces, source.values_of, text.line)
    parts, reasons = coefficients_of(source.section, reader)
    rate = constant(0.0)
    if not reasons:
        parts["LIFT"], rate, reasons = solved_lift(parts.get("LIFT", {}))
    if reasons:
        reason_list = "; ".join(f"{n} {reason}" for n, reason in list(reasons.items())[:MOST_NAMED])
        reason_list += f"; and {len(reasons) - MOST_NAMED} more" if len(reasons) > MOST_NAMED else ""
        raise SimulationError(
            f"{source.spec}: cannot be written exactly as text ({reason_list}); run it as it is with --simulation {source.spec}"
        )
    sums = {axis: named_terms(AXES[axis], functions, text, source.spec) for axis, functions in parts.items()}
    force_terms = [t for axis in FORCE_AXES for t in sums.get(axis, [])]
    used_lines = _names_needed(text.lines, [*force_terms, *(n for t in force_terms for n in names_in(t))])
    rate_dependent = rate.products or any(ALPHA_RATE in t for t in (*force_terms, *(text.lines[n] for n in used_lines)))
    model = _model(skeleton, text, sums, coefficient_text(rate) if rate_dependent else "", source)
    standard = tuple(n for n in text.parameters if n.partition("_")[0] in AXES.values())
    lines = [n for n in model.definitions if n in text.lines and not re.fullmatch(r".*_\d+", n)]
    own_names = (*(n for n in text.parameters if n not in standard), *lines)
    return Imported(model, dict(reader.held), standard, own_names, sum(1 for _ in source.section.iter("table")))


def _reserved(skeleton: Model) -> set[str]:
    """Names that no line or parameter of the aircraft may have."""
    names = {*skeleton.state_names, *skeleton.input_names, *skeleton.output_names, *skeleton.constants}
    added_lines = "drag side mach Re temperature_of_rho CL_rate CL_all x_rp y_rp z_rp pi pressure"
    return {*names, *skeleton.definitions, *SIZE_TEXTS, LIFT, *added_lines.split()}


def _model(skeleton: Model, text: Text, sums: Mapping[str, list[str]], rate: str, source: AircraftSource) -> Model:
    """The model of six degrees of freedom with these terms. rate: text of lift over the rate of alpha, `0` where only other
    forces depend on that rate, empty where none does."""
    lines = {n: t for n, t in skeleton.definitions.items() if n not in (*AXES.values(), "CX", "CZ")}
    total = {AXES[axis]: " + ".join(terms).replace("+ -", "- ") or "0" for axis, terms in sums.items()}
    lift = "CL_all" if rate else "CL"
    arms = dict(zip(("x_rp", "y_rp", "z_rp"), source.arm, strict=True))
    aircraft_lines = dict(text.lines)
    aircraft_lines["CL"] = total.pop("CL", "0")
    if rate:
        aircraft_lines |= {"CL_rate": rate, "CL_all": f"CL + CL_rate*{ALPHA_RATE}"}
        lines[ALPHA_RATE] = alpha_rate_solved("CL", "CL_rate")
    aircraft_lines |= {LIFT: lift, "drag": total.pop("CD", "0"), "side": total.pop("CY", "0")}
    aircraft_lines |= {"CD": "drag*cos(beta) + side*sin(beta)", "CY": "side*cos(beta) - drag*sin(beta)"}
    aircraft_lines |= {"CX": f"{lift}*sin(alpha) - CD*cos(alpha)", "CZ": f"-{lift}*cos(alpha) - CD*sin(alpha)"}
    moment_arms = {"Cl": ("y_rp*CZ - z_rp*CY", "b"), "Cm": ("z_rp*CX - x_rp*CZ", "c"), "Cn": ("x_rp*CY - y_rp*CX", "b")}
    for name, (arm, length) in moment_arms.items():
        aircraft_lines[name] = f"{total.get(name, '0')} + ({arm})/{length}"
    air = source.air
    relative_density = f"(rho/{number_text(air.rho)})"
    temperature_power = number_text(2.0 * air.power)
    aircraft_lines["mach"] = f"V/({number_text(air.sound)}*{relative_density}^{number_text(air.power)})"
    aircraft_lines["temperature_of_rho"] = f"{number_text(air.temperature)}*{relative_density}^{temperature_power}"
    aircraft_lines["Re"] = (
        f"rho*V*c*(temperature_of_rho + {SUTHERLAND})/({number_text(air.viscosity)}*temperature_of_rho^1.5)"
    )
    lines |= aircraft_lines
    used_lines = _names_needed(
        lines, [*(f"{s}_dot" for s in skeleton.state_names), *skeleton.output_names, *AXES.values()]
    )
    return replace(
        skeleton,
        name=re.sub(r"[^A-Za-z0-9_.-]", "-", source.name),
        title=f"JSBSim aircraft {source.name}, six degrees of freedom",
        description=f"Written from {source.spec}: coefficients as its file has them",
        parameters=tuple(text.parameters.values()),
        constants={**skeleton.constants, **arms},
        equations=tuple(f"{n} = {t}" for n, t in lines.items() if n in used_lines),
    )


def _names_needed(lines: Mapping[str, str], names: list[str]) -> set[str]:
    """Names of the lines that `names` depend on, themselves included."""
    needed: set[str] = set()
    pending = list(names)
    while pending:
        name = pending.pop()
        if name in lines and name not in needed:
            needed.add(name)
            pending += names_in(lines[name])
    return needed


def arm_of(value_of: Callable[[str], float]) -> tuple[float, float, float]:
    """Arm from the centre of gravity to AERORP [m], body axes. value_of: name of a property -> value [in]."""
    x, y, z = (INCH * (value_of(a) - value_of(b)) for a, b in ARM)
    return x, y, z
