"""The terms of a model beyond its simulation, sorted into those that belong into an aircraft and those that do not."""

import ast
from dataclasses import dataclass, replace

from estimation.aircraft import Aircraft
from estimation.models.base import InputTransform, Model
from estimation.models.expressions import names_in, parse
from estimation.models.library import BUILDERS
from estimation.simulation.along_flight import SIMULATION_PREFIX, coefficients_in
from estimation.simulation.base_model import DESCRIPTION
from estimation.simulation.oracle import SURFACES, SimulationError

KINEMATIC = ("V_dot", "alpha_dot", "beta_dot", "phi_dot", "theta_dot")
MOMENTS = ("roll", "yaw", "p_dot", "q_dot", "r_dot")
ANY_AIRCRAFT = Aircraft("none", 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0)  # to build the equations of built-in models


@dataclass(frozen=True)
class Addend:
    """A term of a line beyond the simulation's. name: of the parameters in it, joined."""

    line: str
    text: str
    name: str


@dataclass(frozen=True)
class Increments:
    """addends: to coefficients and moments. transforms: of surfaces. states: names of the effects' own states. left_out: phrases
    on what does not belong to an aircraft; physical: the model without that."""

    addends: tuple[Addend, ...]
    transforms: tuple[InputTransform, ...]
    states: tuple[str, ...]
    left_out: tuple[str, ...]
    physical: Model


def increments_of(model: Model) -> Increments:
    """The sorted terms of a model. Raises SimulationError without a simulation, or for a changed line that no aircraft has."""
    if not any(s.computed for s in model.inputs):
        raise SimulationError(
            f"model {model.name}: stands on no simulation; export one that 'sideslip gap --simulation jsbsim:...' wrote"
        )
    built_in = _built_in_beneath(model)
    coefficients = coefficients_in(built_in)
    lines, left_out, addends = dict(model.definitions), [], []
    for line in coefficients:
        texts = addends_of(model.definitions[line])
        by_slope = [t for t in texts if any(n.startswith(SIMULATION_PREFIX) for n in names_in(t))]
        if by_slope:
            texts = [t for t in texts if t not in by_slope]
            lines[line] = " + ".join(texts)
            left_out += [f"{t} in {line}: a share of what the simulation has itself" for t in by_slope]
        addends += [_named_addend(line, text, model) for text in texts]
    for line, text in built_in.definitions.items():
        added_text = _added_text(model, line, text) if line not in coefficients else ""
        if added_text and line in (*MOMENTS, "CX", "CZ"):
            addends += [_named_addend(line, part, model) for part in addends_of(added_text)]
        elif added_text and line in KINEMATIC:
            left_out.append(f"{added_text} in {line}: of the air's or the equations' motion")
            lines[line] = text
        elif added_text:
            raise SimulationError(
                f"model {model.name}: changes the line {line}, which has no place in a JSBSim aircraft"
            )
    instrument_lines = [
        n for n in lines if n.endswith("_measured") and n.removesuffix("_measured") in model.output_names
    ]
    left_out += [f"{n.removesuffix('_measured')} as shown ({lines.pop(n)}): of an instrument" for n in instrument_lines]
    left_out += [f"delay of {n}: of an instrument" for n in model.output_delays]
    of_surfaces = tuple(t for t in model.transforms if t.input in SURFACES)
    left_out += [f"{t.kind} of {t.input}: of an instrument" for t in model.transforms if t not in of_surfaces]
    physical = replace(
        model, transforms=of_surfaces, output_delays={}, equations=tuple(f"{n} = {text}" for n, text in lines.items())
    )
    used_names = _names_used(addends, physical)
    states = tuple(n for n in model.state_names if n not in built_in.state_names and n in used_names)
    return Increments(tuple(addends), of_surfaces, states, tuple(left_out), physical)


def simulation_named(model: Model) -> str:
    """The argument of `--simulation` that a model was found with; empty where it does not say."""
    begin = DESCRIPTION.format("")
    return model.description.removeprefix(begin).strip() if model.description.startswith(begin) else ""


def addends_of(text: str) -> list[str]:
    """The terms of a sum, each with its sign."""

    def split(tree: ast.expr, sign: float) -> list[tuple[float, ast.expr]]:
        match tree:
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                return [*split(left, sign), *split(right, sign)]
            case ast.BinOp(left=left, op=ast.Sub(), right=right):
                return [*split(left, sign), *split(right, -sign)]
        return [(sign, tree)]

    return [f"{'-' if sign < 0 else ''}({ast.unparse(part)})" for sign, part in split(parse(text), 1.0)]


def _built_in_beneath(model: Model) -> Model:
    """The built-in model whose lines a model extends. Raises SimulationError where there is none."""
    for build in BUILDERS.values():
        built_in = build(ANY_AIRCRAFT)
        other_lines = {n for n in built_in.definitions if n not in coefficients_in(built_in)}
        if set(built_in.state_names) <= set(model.state_names) and all(
            model.definitions.get(n, "").startswith(built_in.definitions[n]) for n in other_lines
        ) and set(coefficients_in(built_in)) == set(coefficients_in(model)):  # fmt: skip
            return built_in
    raise SimulationError(
        f"model {model.name}: is none of {', '.join(BUILDERS)} underneath; only these can be written for JSBSim"
    )


def _added_text(model: Model, line: str, text: str) -> str:
    """The part of a line after `text`."""
    return model.definitions[line].removeprefix(text).strip().removeprefix("+").strip()


def _named_addend(line: str, text: str, model: Model) -> Addend:
    names = names_in(text)
    return Addend(line, text, "_".join(p for p in model.parameter_names if p in names) or line)


def _names_used(addends: list[Addend], model: Model) -> set[str]:
    """Names that addends depend on, directly or through lines of the model."""
    used_names: set[str] = set()
    pending = [a.text for a in addends]
    while pending:
        new_names = names_in(pending.pop()) - used_names
        used_names |= new_names
        pending += [model.definitions[n] for n in new_names if n in model.definitions]
    return used_names
