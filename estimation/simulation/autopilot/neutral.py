"""An aircraft's full aerodynamic model, nonlinear terms included, as JSON for the user's own simulator (keys: docs/export.md).

Expressions are trees, `["+", "CL_0", ["*", "CL_alpha", "alpha"]]`: twenty lines read them in any language, without running text
as code.
"""

import ast
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estimation.aircraft import Aircraft
from estimation.models.base import Model
from estimation.models.expressions import NUMBERS, names_in, parse
from estimation.models.library import not_in_model, six_dof, stated_terms
from estimation.models.numeric import FUNCTIONS
from estimation.simulation.autopilot.gathering import (
    FIELDS,
    MINOR,
    NEEDED,
    MissingPartsError,
    Stated,
    lines_named,
    missing_body_keys,
    missing_parts_message,
    model_and_body,
    static_thrust,
)
from estimation.simulation.autopilot.linear import LINES
from estimation.simulation.oracle import ALPHA_RATE, COEFFICIENTS, Array, SimulationError

FORMAT, VERSION = "sideslip-neutral", 1
VARIABLES: Mapping[str, tuple[str, str]] = {
    "V": ("m/s", "true airspeed"), "alpha": ("rad", "angle of attack, atan2(w, u)"), "beta": ("rad", "sideslip, asin(v/V)"),
    "p": ("rad/s", "roll rate about x"), "q": ("rad/s", "pitch rate about y"), "r": ("rad/s", "yaw rate about z"),
    "delta_e": ("rad", "elevator, + trailing edge down, noses down"),
    "delta_a": ("rad", "aileron, half of right less left, + trailing edge down, rolls left"),
    "delta_r": ("rad", "rudder, + trailing edge to port, noses left"), "thrust": ("N", "thrust along x"),
    "rho": ("kg/m3", "density of the air"), ALPHA_RATE: ("rad/s", "rate of alpha"),
}  # fmt: skip
ABOUT = {
    "axes": "body axes x forward, y right, z down, origin at the centre of gravity; SI and radians",
    "forces": "X = q S CX + thrust, Y = q S CY, Z = q S CZ [N], q = rho V^2 / 2; aerodynamics along body axes",
    "moments": "L = q S b Cl, M = q S c Cm, N = q S b Cn [N m] about the centre of gravity",
    "inertia": "Ixz is + integral of x z dm: p_dot = (Izz L' + Ixz N') / (Ixx Izz - Ixz^2)",
    "trees": "a number, a name (variable, constant or earlier line), or [operator, argument, ...]; lines in their order",
    "operators": "+ - * / ** (binary), neg, < <= > >=, sin cos tan asin acos atan atan2 sinh cosh tanh sqrt exp log abs sign"
    " min max, where(condition, value, other)",
}
_BINARY = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
_COMPARE = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}
_OPERATORS: Mapping[str, Callable[..., Any]] = {
    **FUNCTIONS, "+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b, "/": lambda a, b: a / b,
    "**": lambda a, b: a**b, "neg": lambda a: -a, "<": lambda a, b: a < b, "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b, ">=": lambda a, b: a >= b,
}  # fmt: skip
UNITS = {"area": "m2", "span": "m", "chord": "m", "mass": "kg"}
Tree = float | str | list[Any]


def tree_of(expression: str) -> Tree:
    """The tree of an expression. Raises SimulationError for an operation without a place in a tree."""
    return _tree(parse(expression))


def _tree(node: ast.AST) -> Tree:
    match node:
        case ast.Constant(value=value):
            return float(value)  # type: ignore[arg-type]
        case ast.Name(id=name):
            return NUMBERS.get(name, name)
        case ast.UnaryOp(op=op, operand=inner):
            return ["neg", _tree(inner)] if isinstance(op, ast.USub) else _tree(inner)
        case ast.BinOp(left=left, op=op, right=right):
            return [_BINARY[type(op)], _tree(left), _tree(right)]
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            return [_COMPARE[type(op)], _tree(left), _tree(right)]
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return [name, *map(_tree, arguments)]
    raise SimulationError(f"an expression holds {type(node).__name__}, which has no place in a tree")


def value_of(tree: Any, known: Mapping[str, Any]) -> Any:
    """The value of a tree, numbers or arrays. Raises KeyError for a name or operator that is not known."""
    if isinstance(tree, int | float):
        return tree
    if isinstance(tree, str):
        return known[tree]
    return _OPERATORS[tree[0]](*(value_of(argument, known) for argument in tree[1:]))


@dataclass(frozen=True)
class BuildUp:
    """An aerodynamic model. definitions: line -> text; numbers: constants and parameters -> value; units: of those with one."""

    name: str
    title: str
    definitions: Mapping[str, str]
    numbers: Mapping[str, float]
    units: Mapping[str, str]


def neutral(model: BuildUp, body: Aircraft, more: Mapping[str, Any]) -> dict[str, Any]:
    """The content of a file. more: further keys (throws, thrust, sources, notes). Raises SimulationError where coefficients
    depend on more than VARIABLES and constants."""
    outputs = [c for c in ("CL", "CD") if c in model.definitions] + list(COEFFICIENTS)
    lines = _in_order(model, outputs)
    numbers = model.numbers
    used_names = frozenset[str]().union(*(names_in(text) for text in lines.values())) - set(lines)
    unknown = sorted(used_names - set(numbers) - set(VARIABLES))
    if unknown:
        raise SimulationError(
            f"model {model.name}: its coefficients depend on {', '.join(unknown)}; a build-up may depend on airspeed, flow"
            " angles, rates, surfaces, thrust and density"
        )
    return {
        "format": FORMAT, "version": VERSION, "name": model.name, "title": model.title, "about": ABOUT,
        "body": {f: {"value": getattr(body, f), "unit": UNITS.get(f, "kg m2")}
                 for f in ("mass", "Ixx", "Iyy", "Izz", "Ixz", "area", "span", "chord")},
        "variables": [{"name": n, "unit": unit, "meaning": meaning} for n, (unit, meaning) in VARIABLES.items()],
        "constants": {n: {"value": numbers[n], "unit": model.units.get(n, "")} for n in sorted(used_names & set(numbers))},
        "lines": [{"name": n, "text": text, "tree": tree_of(text)} for n, text in lines.items()],
        "outputs": outputs, **more,
    }  # fmt: skip


def _in_order(model: BuildUp, outputs: Iterable[str]) -> dict[str, str]:
    """The lines that the outputs need, each after those it depends on."""
    ordered_lines: dict[str, str] = {}
    pending = list(outputs)[::-1]
    while pending:
        name = pending[-1]
        missing_lines = [
            n for n in names_in(model.definitions[name]) if n in model.definitions and n not in ordered_lines
        ]
        if name in ordered_lines or not missing_lines:
            ordered_lines[pending.pop()] = model.definitions[name]
        else:
            pending += sorted(missing_lines)
    return ordered_lines


def evaluated(content: Mapping[str, Any], motion: Mapping[str, Array]) -> dict[str, Array]:
    """Output -> (N,) value, computed from the file's content alone."""
    symbols: dict[str, Any] = {**motion, **{n: c["value"] for n, c in content["constants"].items()}}
    for line in content["lines"]:
        symbols[line["name"]] = value_of(line["tree"], symbols)
    count = motion["V"].shape
    return {n: np.broadcast_to(np.asarray(symbols[n], float), count) for n in content["outputs"]}


def read_back(path: Path) -> dict[str, Any]:
    """The content of a file that was just written."""
    content = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise SimulationError(f"{path}: not what 'sideslip export --to neutral' writes")
    return content


BODY_AXES = ("CX", "CZ")


def full_model(path: Path, stated: Stated) -> tuple[BuildUp, Aircraft, dict[str, Any]]:
    """Aerodynamic model, body, and further keys of the file. Raises MissingPartsError with the list of what is not stated,
    SimulationError where names clash."""
    model, stated_aircraft, body = model_and_body(path, stated)
    named_lines = lines_named(path, model) if model is not None else ()
    missing_coefficients = [c for c in LINES if c not in named_lines]
    beliefs = stated_aircraft.derivatives if stated_aircraft is not None else {}
    missing = missing_body_keys(body)
    missing += [n for line in missing_coefficients for n in NEEDED[line] if n not in beliefs]
    if missing:
        raise MissingPartsError(missing_parts_message(path, "a whole aircraft", missing, stated_aircraft))
    stated_by = (stated_aircraft or body).with_values(**{name: getattr(body, name) for name in FIELDS})
    base = stated_terms(six_dof(stated_by), stated_by)
    zero = [n for line in missing_coefficients for n in MINOR[line] if n not in beliefs]
    without_form = [n for n in not_in_model(base, stated_by) if n.partition("_")[0] in missing_coefficients]
    throws = {**(stated_aircraft.throws if stated_aircraft else {}), **stated.throws}
    more = {
        "throws": {n: list(t) for n, t in throws.items()},
        "thrust": static_thrust(stated_aircraft, stated),
        "sources": {n: beliefs[n].source for line in missing_coefficients for n in beliefs if n.split("_")[0] == line},
        "notes": _notes(zero, without_form),
    }
    return _completed(body, model, base, missing_coefficients), body, more


def _notes(zero: list[str], without_form: list[str]) -> list[str]:
    notes = [f"not stated, so zero: {', '.join(zero)}"] if zero else []
    return [*notes, f"left out, for no form of them is known: {', '.join(without_form)}"] if without_form else notes


def _completed(body: Aircraft, model: Model | None, base: Model, missing_coefficients: list[str]) -> BuildUp:
    """The model's own lines, and the base's for the coefficients that it lacks. Raises SimulationError where names clash."""
    body_lines = BODY_AXES if {"CL", "CD"} & set(missing_coefficients) else ()
    model_lines = model.definitions if model is not None else {}
    added_lines = {
        n: base.definitions[n]
        for n in (*missing_coefficients, *body_lines, *(("p_hat", "q_hat", "r_hat") if missing_coefficients else ()))
    }
    added_lines |= {n: base.definitions[n] for n in BODY_AXES if n not in model_lines}
    clash = [n for n in added_lines if n in model_lines and n not in body_lines and model_lines[n] != added_lines[n]]
    if clash:
        raise SimulationError(
            f"model {body.name}: its line {clash[0]} is not what the coefficients that it lacks mean by that name"
            f" ({added_lines[clash[0]]}); call it otherwise"
        )
    numbers = {**base.constants, **base.starts()}
    parameters = base.parameters
    if model is not None:
        numbers |= {**model.constants, **model.starts()}
        parameters = (*parameters, *model.parameters)
    return BuildUp(body.name, body.title, {**model_lines, **added_lines}, numbers, {p.name: p.unit for p in parameters})
