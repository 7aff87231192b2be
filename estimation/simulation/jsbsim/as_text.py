"""A JSBSim aircraft as a model in our own text: its functions as lines and parameters of the six degrees of freedom.

A function that is a number times one regressor becomes a parameter under the field's name (`Cl_p`); every other one a line under
the name it has in JSBSim. Forces are in JSBSim's wind axes at AERORP: lines turn them and take their moment about the centre of
gravity. Lift may depend on the rate of alpha that it makes itself; the line of that rate is solved for it.
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
from estimation.simulation.jsbsim.coefficients import (
    AXES,
    WHOLE,
    Text,
    coefficient_text,
    coefficients_of,
    named_terms,
    solved_lift,
)
from estimation.simulation.jsbsim.library import Follows
from estimation.simulation.jsbsim.reading import LIFT, Reader
from estimation.simulation.jsbsim.terms import constant, number_text
from estimation.simulation.oracle import ALPHA_RATE, SimulationError

SUTHERLAND = 110.4  # K
MADE_OF = ("LIFT", "DRAG", "SIDE")
MOST_TOLD = 4  # functions named in one sentence
SOLVED = (  # the equation of motion in alpha with that lift on its left side which goes with alpha_dot
    "(q - tan(beta)*(p*cos(alpha) + r*sin(alpha)) + (g*(cos(theta)*cos(phi)*cos(alpha) + sin(theta)*sin(alpha))"
    " - thrust/m*sin(alpha) - q_dyn*S/m*CL)/(V*cos(beta)))/(1 + q_dyn*S/(m*V*cos(beta))*CL_rate)"
)


@dataclass(frozen=True)
class StandardTroposphere:
    """A standard troposphere from one point of it. sound: its speed [m/s]; temperature [K]; rho: density [kg/m3]; power: that of
    density with which the speed of sound goes, half of that of temperature; viscosity: Sutherland's constant [kg/(m s K^.5)]."""

    sound: float
    temperature: float
    rho: float
    power: float
    viscosity: float


@dataclass(frozen=True)
class AircraftSource:
    """What is known of an aircraft beside its XML. arm: of AERORP from the centre of gravity [m, body axes]. asked: see
    `Reader`."""

    name: str
    spec: str
    aircraft: Aircraft
    section: ET.Element
    surfaces: Mapping[str, tuple[str, Follows]]
    arm: tuple[float, float, float]
    air: StandardTroposphere
    asked: Callable[[str], list[float] | None]


@dataclass(frozen=True)
class Imported:
    """model: see above. held: properties that stand in it as numbers, which the aircraft could change. standard, own: terms by
    the field's names and by JSBSim's. tables: how many tables the aircraft has."""

    model: Model
    held: Mapping[str, float]
    standard: tuple[str, ...]
    own: tuple[str, ...]
    tables: int

    def sentences(self) -> list[str]:
        held_numbers = ", ".join(f"{n} {v:g}" if math.isfinite(v) else n for n, v in self.held.items())
        return [
            f"by the field's names: {', '.join(self.standard) or 'nothing'}",
            f"by JSBSim's names: {', '.join(self.own) or 'nothing'}",
            *([f"{self.tables} tables: straight between their points, as max(0, x - point)"] if self.tables else []),
            *([f"numbers now, as JSBSim starts and far above ground: {held_numbers}"] if held_numbers else []),
        ]


def import_aircraft(source: AircraftSource) -> Imported:
    """The model. Raises SimulationError naming every function that has no exact form in our text."""
    skeleton = six_dof(source.aircraft)
    text = Text(taken=_reserved(skeleton))
    reader = Reader(source.section, source.surfaces, source.asked, text.line)
    parts, reasons = coefficients_of(source.section, reader)
    rate = constant(0.0)
    if not reasons:
        parts["LIFT"], rate, problem = solved_lift(parts.get("LIFT", {}))
        reasons = {**reasons, **problem}
    if reasons:
        reason_list = "; ".join(f"{n} {reason}" for n, reason in list(reasons.items())[:MOST_TOLD])
        reason_list += f"; and {len(reasons) - MOST_TOLD} more" if len(reasons) > MOST_TOLD else ""
        raise SimulationError(
            f"{source.spec}: cannot be written exactly as text ({reason_list}); run it as it is with --simulation {source.spec}"
        )
    sums = {axis: named_terms(AXES[axis], functions, text, source.spec) for axis, functions in parts.items()}
    force_terms = [t for axis in MADE_OF for t in sums.get(axis, [])]
    used_lines = _names_needed(text.lines, [*force_terms, *(n for t in force_terms for n in names_in(t))])
    rate_dependent = rate.products or any(ALPHA_RATE in t for t in (*force_terms, *(text.lines[n] for n in used_lines)))
    model = _model(skeleton, text, sums, coefficient_text(rate) if rate_dependent else "", source)
    standard = tuple(n for n in text.parameters if n.partition("_")[0] in AXES.values())
    lines = [n for n in model.definitions if n in text.lines and not re.fullmatch(r".*_\d+", n)]
    own_names = (*(n for n in text.parameters if n not in standard), *lines)
    return Imported(model, dict(reader.held), standard, own_names, sum(1 for _ in source.section.iter("table")))


def _reserved(skeleton: Model) -> set[str]:
    """Names that no line or parameter of the aircraft's own may take."""
    names = {*skeleton.state_names, *skeleton.input_names, *skeleton.output_names, *skeleton.constants}
    ours = "drag side mach Re temperature_of_rho CL_rate CL_all x_rp y_rp z_rp pi pressure"
    return {*names, *skeleton.definitions, *WHOLE, LIFT, *ours.split()}


def _model(skeleton: Model, text: Text, sums: Mapping[str, list[str]], rate: str, source: AircraftSource) -> Model:
    """rate: lift over the rate of alpha, `0` where only other forces go with that, nothing where none does."""
    lines = {n: t for n, t in skeleton.definitions.items() if n not in (*AXES.values(), "CX", "CZ")}
    total = {AXES[axis]: " + ".join(terms).replace("+ -", "- ") or "0" for axis, terms in sums.items()}
    lift = "CL_all" if rate else "CL"
    arms = dict(zip(("x_rp", "y_rp", "z_rp"), source.arm, strict=True))
    aircraft_lines = dict(text.lines)
    aircraft_lines["CL"] = total.pop("CL", "0")
    if rate:
        aircraft_lines |= {"CL_rate": rate, "CL_all": f"CL + CL_rate*{ALPHA_RATE}"}
        lines[f"{ALPHA_RATE}"] = SOLVED
    aircraft_lines |= {LIFT: lift, "drag": total.pop("CD", "0"), "side": total.pop("CY", "0")}
    aircraft_lines |= {"CD": "drag*cos(beta) + side*sin(beta)", "CY": "side*cos(beta) - drag*sin(beta)"}
    aircraft_lines |= {"CX": f"{lift}*sin(alpha) - CD*cos(alpha)", "CZ": f"-{lift}*cos(alpha) - CD*sin(alpha)"}
    moment_arms = {"Cl": ("y_rp*CZ - z_rp*CY", "b"), "Cm": ("z_rp*CX - x_rp*CZ", "c"), "Cn": ("x_rp*CY - y_rp*CX", "b")}
    for name, (arm, length) in moment_arms.items():
        aircraft_lines[name] = f"{total.get(name, '0')} + ({arm})/{length}"
    air = source.air
    thinner = f"(rho/{number_text(air.rho)})"
    aircraft_lines["mach"] = f"V/({number_text(air.sound)}*{thinner}^{number_text(air.power)})"
    aircraft_lines["temperature_of_rho"] = f"{number_text(air.temperature)}*{thinner}^{number_text(2.0 * air.power)}"
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


def _names_needed(lines: Mapping[str, str], todo: list[str]) -> set[str]:
    used_names: set[str] = set()
    while todo:
        name = todo.pop()
        if name in lines and name not in used_names:
            used_names.add(name)
            todo += names_in(lines[name])
    return used_names


def arm_of(of: Callable[[str], float]) -> tuple[float, float, float]:
    """AERORP from the centre of gravity [m], body axes; structural inches run aft, right and up."""
    x = of("inertia/cg-x-in") - of("metrics/aero-rp-x-in")
    y = of("metrics/aero-rp-y-in") - of("inertia/cg-y-in")
    z = of("inertia/cg-z-in") - of("metrics/aero-rp-z-in")
    return x * INCH, y * INCH, z * INCH
