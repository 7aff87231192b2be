"""An aircraft's whole build-up, nonlinear as it is, as plain JSON for a simulator of one's own (docs/neutral.md has every key).

Expressions are trees, `["+", "CL_0", ["*", "CL_alpha", "alpha"]]`: twenty lines read them in any language, and none has to be run
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
from estimation.models.expressions import NUMBERS, names_in, parse
from estimation.models.numeric import FUNCTIONS
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
    """An expression of a model's text as a tree."""
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
    """Lines by name, in text; numbers: of constants and parameters; units of those that have one."""

    name: str
    title: str
    definitions: Mapping[str, str]
    numbers: Mapping[str, float]
    units: Mapping[str, str]


def neutral(model: BuildUp, craft: Aircraft, more: Mapping[str, Any]) -> dict[str, Any]:
    """The content of a file. more: what is told beside it (throws, thrust, sources, notes). Raises SimulationError where the
    coefficients depend on what no aircraft's motion is."""
    outputs = [c for c in ("CL", "CD") if c in model.definitions] + list(COEFFICIENTS)
    lines = _in_order(model, outputs)
    numbers = model.numbers
    used = frozenset[str]().union(*(names_in(text) for text in lines.values())) - set(lines)
    strange = sorted(used - set(numbers) - set(VARIABLES))
    if strange:
        raise SimulationError(
            f"model {model.name}: its coefficients depend on {', '.join(strange)}; a build-up may depend on airspeed, flow"
            " angles, rates, surfaces, thrust and density"
        )
    return {
        "format": FORMAT, "version": VERSION, "name": model.name, "title": model.title, "about": ABOUT,
        "body": {f: {"value": getattr(craft, f), "unit": UNITS.get(f, "kg m2")}
                 for f in ("mass", "Ixx", "Iyy", "Izz", "Ixz", "area", "span", "chord")},
        "variables": [{"name": n, "unit": unit, "meaning": meaning} for n, (unit, meaning) in VARIABLES.items()],
        "constants": {n: {"value": numbers[n], "unit": model.units.get(n, "")} for n in sorted(used & set(numbers))},
        "lines": [{"name": n, "text": text, "tree": tree_of(text)} for n, text in lines.items()],
        "outputs": outputs, **more,
    }  # fmt: skip


def _in_order(model: BuildUp, outputs: Iterable[str]) -> dict[str, str]:
    """The lines that the outputs need, each behind those it needs."""
    done: dict[str, str] = {}
    waiting = list(outputs)[::-1]
    while waiting:
        name = waiting[-1]
        needed = [n for n in names_in(model.definitions[name]) if n in model.definitions and n not in done]
        if name in done or not needed:
            done[waiting.pop()] = model.definitions[name]
        else:
            waiting += sorted(needed)
    return done


def evaluated(content: Mapping[str, Any], motion: Mapping[str, Array]) -> dict[str, Array]:
    """Each output -> (N,), as a reader of the file has it."""
    known: dict[str, Any] = {**motion, **{n: c["value"] for n, c in content["constants"].items()}}
    for line in content["lines"]:
        known[line["name"]] = value_of(line["tree"], known)
    count = motion["V"].shape
    return {n: np.broadcast_to(np.asarray(known[n], float), count) for n in content["outputs"]}


def read_back(path: Path) -> dict[str, Any]:
    """The content of a file that was just written."""
    content = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise SimulationError(f"{path}: not what 'sideslip export --to neutral' writes")
    return content
