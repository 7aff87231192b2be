"""Equation text of a model as functions of JSBSim: expressions become XML, symbols become properties in feet and pounds.

Constant parts are computed, and products with zero vanish. Where a symbol is a line of the model, the line is written out.
"""

import ast
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any
from xml.etree import ElementTree as ET

from daq.utilities.constants import FOOT, POUND, SLUG
from estimation.models.base import Model
from estimation.models.expressions import NUMBERS, parse
from estimation.simulation.oracle import SimulationError

PASCAL = POUND / FOOT**2
PROPERTIES: Mapping[str, tuple[str, float]] = {
    "V": ("velocities/vt-fps", FOOT), "alpha": ("aero/alpha-rad", 1.0), "beta": ("aero/beta-rad", 1.0),
    "p": ("velocities/p-aero-rad_sec", 1.0), "q": ("velocities/q-aero-rad_sec", 1.0), "r": ("velocities/r-aero-rad_sec", 1.0),
    "phi": ("attitude/phi-rad", 1.0), "theta": ("attitude/theta-rad", 1.0), "psi": ("attitude/psi-rad", 1.0),
    "alpha_dot": ("aero/alphadot-rad_sec", 1.0), "beta_dot": ("aero/betadot-rad_sec", 1.0),
    "p_dot": ("accelerations/pdot-rad_sec2", 1.0), "q_dot": ("accelerations/qdot-rad_sec2", 1.0),
    "r_dot": ("accelerations/rdot-rad_sec2", 1.0), "rho": ("atmosphere/rho-slugs_ft3", SLUG / FOOT**3),
    "q_dyn": ("aero/qbar-psf", PASCAL), "thrust": ("forces/fbx-prop-lbs", POUND),
}  # fmt: skip
"""Symbol -> property, and the property's unit in SI."""
FORCES = {"ax": "forces/fbx-total-lbs", "ay": "forces/fby-total-lbs", "az": "forces/fbz-total-lbs"}
"""Specific force -> the force that makes it, over mass."""
NUMERIC: Mapping[str, Callable[..., float]] = {
    "sin": math.sin, "cos": math.cos, "tan": math.tan, "asin": math.asin, "acos": math.acos, "atan": math.atan,
    "atan2": math.atan2, "sinh": math.sinh, "cosh": math.cosh, "tanh": math.tanh, "sqrt": math.sqrt, "exp": math.exp,
    "log": math.log, "abs": abs, "min": min, "max": max, "sign": lambda x: math.copysign(1.0, x) if x else 0.0,
}  # fmt: skip
SAME_NAME = ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "abs", "exp", "min", "max")  # as ours in JSBSim

Term = float | ET.Element


def node(tag: str, *parts: Term | str) -> ET.Element:
    """An element with numbers, elements or one text inside."""
    element = ET.Element(tag)
    for part in parts:
        if isinstance(part, str):
            element.text = part
        else:
            element.append(part if isinstance(part, ET.Element) else node("value", repr(float(part))))
    return element


def prop(name: str, scale: float = 1.0) -> ET.Element:
    """A property, times a number."""
    return node("property", name) if scale == 1.0 else node("product", scale, node("property", name))


def product(*parts: Term) -> Term:
    """A product with its numbers multiplied; 0 where one is zero."""
    number = math.prod(p for p in parts if isinstance(p, float | int))
    rest = [p for p in parts if isinstance(p, ET.Element)]
    if number == 0.0 or not rest:
        return float(number)
    if number == 1.0 and len(rest) == 1:
        return rest[0]
    return node("product", *([] if number == 1.0 else [float(number)]), *rest)


def total(*parts: Term) -> Term:
    """A sum without its zeros."""
    number = sum(p for p in parts if isinstance(p, float | int))
    rest = [p for p in parts if isinstance(p, ET.Element)]
    if not rest:
        return float(number)
    if number == 0.0 and len(rest) == 1:
        return rest[0]
    return node("sum", *([] if number == 0.0 else [float(number)]), *rest)


@dataclass(frozen=True)
class Translator:
    """Translates expressions of one model. known: symbol -> element, which precedes all other meanings (surfaces, states of
    effects, the simulation's coefficients); values: symbol -> number."""

    model: Model
    known: Mapping[str, Term]
    values: Mapping[str, float] = field(default_factory=dict)

    def term(self, text: str) -> Term:
        """A number or an element for an expression. Raises SimulationError for what JSBSim has no property for."""
        return self.translated(parse(text), ())

    def translated(self, tree: ast.expr, path: tuple[str, ...]) -> Term:
        """The term of a parsed expression. path: names of the lines that are being written out."""
        match tree:
            case ast.Constant(value=value):
                return float(value)  # type: ignore[arg-type]
            case ast.Name(id=name):
                return self._symbol(name, path)
            case ast.UnaryOp(op=op, operand=inner):
                return product(-1.0 if isinstance(op, ast.USub) else 1.0, self.translated(inner, path))
            case ast.BinOp(left=left, op=op, right=right):
                return _arithmetic(op, self.translated(left, path), self.translated(right, path))
            case ast.Call(func=ast.Name(id="where"), args=[ast.Compare(left=a, ops=[op], comparators=[b]), yes, no]):
                sign = {ast.Lt: "lt", ast.LtE: "le", ast.Gt: "gt", ast.GtE: "ge"}[type(op)]
                return node(
                    "ifthen",
                    node(sign, self.translated(a, path), self.translated(b, path)),
                    self.translated(yes, path),
                    self.translated(no, path),
                )
            case ast.Call(func=ast.Name(id=name), args=arguments):
                return _function(name, [self.translated(a, path) for a in arguments])
        raise SimulationError(f"model {self.model.name}: {ast.unparse(tree)} cannot be written for JSBSim")

    def _symbol(self, name: str, path: tuple[str, ...]) -> Term:
        if name in self.known:
            return copied(self.known[name])
        if name in NUMBERS:
            return NUMBERS[name]
        if name in self.values:
            return float(self.values[name])
        if name in PROPERTIES:
            return prop(*PROPERTIES[name])
        if name in FORCES:
            return product(FOOT, node("quotient", prop(FORCES[name]), prop("inertia/mass-slugs")))
        if name in self.model.definitions and name not in path:
            return self.translated(parse(self.model.definitions[name]), (*path, name))
        raise SimulationError(f"model {self.model.name}: JSBSim has no property for {name}, on which an effect depends")


def copied(term: Term) -> Term:
    """A copy, because an element may have only one place in a tree."""
    return ET.fromstring(ET.tostring(term)) if isinstance(term, ET.Element) else term


def _arithmetic(op: ast.operator, left: Term, right: Term) -> Term:
    match op:
        case ast.Add():
            return total(left, right)
        case ast.Sub():
            return total(left, product(-1.0, right))
        case ast.Mult():
            return product(left, right)
        case ast.Div() if isinstance(right, float | int):
            return product(left, 1.0 / right)
        case ast.Div():
            return 0.0 if left == 0.0 else node("quotient", left, right)
    if isinstance(left, float | int) and isinstance(right, float | int):
        return float(left**right)
    return node("pow", left, right)


def _function(name: str, arguments: list[Term]) -> Term:
    if all(isinstance(a, float | int) for a in arguments):
        return float(NUMERIC[name](*arguments))
    x: Any = arguments[0]
    if name in SAME_NAME:
        return node(name, *arguments)
    if name == "log":
        return node("ln", x)
    if name == "sqrt":
        return node("pow", x, 0.5)
    if name == "sign":
        negative_branch = node("ifthen", node("lt", copied(x), 0.0), -1.0, 0.0)
        return node("ifthen", node("gt", x, 0.0), 1.0, negative_branch)
    if name == "tanh":  # by exp(-2 |x|), which may underflow but never overflows
        decay = node("exp", product(-2.0, node("abs", copied(x))))
        magnitude = node("quotient", node("difference", 1.0, decay), node("sum", 1.0, copied(decay)))
        return node("ifthen", node("lt", copied(x), 0.0), product(-1.0, magnitude), copied(magnitude))
    growing, decaying = node("exp", x), node("exp", product(-1.0, copied(x)))
    return product(0.5, node("sum" if name == "cosh" else "difference", growing, decaying))
