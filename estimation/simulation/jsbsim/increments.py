"""What a model has beyond the simulation it stands on, sorted by where it belongs: into an aircraft, or not."""

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
NOWHERE = Aircraft("none", 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0)


@dataclass(frozen=True)
class Addend:
    """A term that a line has beyond the simulation's. name: of the parameters in it."""

    line: str
    text: str
    name: str


@dataclass(frozen=True)
class Increments:
    """plain: the built-in model underneath. addends: to coefficients and moments. transforms: of surfaces. states: of the
    effects' own, with their rates. left_out: what is no aircraft's, in words. physical: the model without that."""

    plain: Model
    addends: tuple[Addend, ...]
    transforms: tuple[InputTransform, ...]
    states: tuple[str, ...]
    left_out: tuple[str, ...]
    physical: Model


def increments_of(model: Model) -> Increments:
    """Sort a model. Raises SimulationError where it stands on no simulation or changes what has no place in an aircraft."""
    if not any(s.computed for s in model.inputs):
        raise SimulationError(
            f"model {model.name}: stands on no simulation; export one that 'sideslip gap --simulation jsbsim:...' wrote"
        )
    built_in = _plain_of(model)
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
    ours = tuple(t for t in model.transforms if t.input in SURFACES)
    left_out += [f"{t.kind} of {t.input}: of an instrument" for t in model.transforms if t not in ours]
    states = tuple(n for n in model.state_names if n not in built_in.state_names)
    physical = replace(
        model, transforms=ours, output_delays={}, equations=tuple(f"{n} = {text}" for n, text in lines.items())
    )
    used_states = _states_used(addends, physical)
    states = tuple(n for n in states if n in used_states)
    return Increments(built_in, tuple(addends), ours, states, tuple(left_out), physical)


def simulation_named(model: Model) -> str:
    """The text after `--simulation` that a model was found with, or nothing."""
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


def _plain_of(model: Model) -> Model:
    for build in BUILDERS.values():
        built_in = build(NOWHERE)
        other_lines = {n for n in built_in.definitions if n not in coefficients_in(built_in)}
        if set(built_in.state_names) <= set(model.state_names) and all(
            model.definitions.get(n, "").startswith(built_in.definitions[n]) for n in other_lines
        ) and set(coefficients_in(built_in)) == set(coefficients_in(model)):  # fmt: skip
            return built_in
    raise SimulationError(
        f"model {model.name}: is none of {', '.join(BUILDERS)} underneath; only these can be written for JSBSim"
    )


def _added_text(model: Model, line: str, text: str) -> str:
    """What a line has beyond `text`."""
    return model.definitions[line].removeprefix(text).strip().removeprefix("+").strip()


def _named_addend(line: str, text: str, model: Model) -> Addend:
    names = {n.id for n in ast.walk(parse(text)) if isinstance(n, ast.Name)}
    own_parameters = [p for p in model.parameter_names if p in names]
    return Addend(line, text, "_".join(own_parameters) or line)


def _states_used(addends: list[Addend], model: Model) -> set[str]:
    """Symbols that addends are made of, through lines of the model."""
    used_names: set[str] = set()
    todo = [a.text for a in addends]
    while todo:
        for name in {n.id for n in ast.walk(parse(todo.pop())) if isinstance(n, ast.Name)} - used_names:
            used_names.add(name)
            if name in model.definitions:
                todo.append(model.definitions[name])
    return used_names
