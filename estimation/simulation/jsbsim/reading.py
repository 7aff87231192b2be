"""Reads functions of a JSBSim aircraft as sums of products in our symbols, exactly or not at all."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from xml.etree import ElementTree as ET

from daq.utilities.constants import FOOT, SLUG
from estimation.simulation.jsbsim.library import Follows
from estimation.simulation.jsbsim.terms import (
    Product,
    Sum,
    TableError,
    constant,
    factor,
    looked_up,
    table_of,
    text_of,
)

DEGREE = 180.0 / math.pi
LENGTHS = {"metrics/Sw-sqft": "area", "metrics/bw-ft": "span", "metrics/cbarw-ft": "chord"}
LIFT = "lift"
STALL = "aero/stall-hyst-norm"
CONSTANTS = ("metrics/", "inertia/")  # begin properties that are constant for any aircraft
HEIGHTS = ("aero/h_b-mac-ft", "aero/h_b-cg-ft")  # above ground, in spans
FAR_ABOVE = 1e3  # spans above ground: out of ground effect, where JSBSim is evaluated
NEGLIGIBLE = 1e-300  # smaller values are what JSBSim leaves in a switch that never ran


def _symbols() -> dict[str, Sum]:
    v = {"u": {"cos(alpha)": 1, "cos(beta)": 1}, "v": {"sin(beta)": 1}, "w": {"sin(alpha)": 1, "cos(beta)": 1}}
    symbols = {f"velocities/{n}{mid}-fps": Sum((Product(1.0 / FOOT, {"V": 1, **factors}),))
            for n, factors in v.items() for mid in ("", "-aero")}  # fmt: skip
    symbols |= {f"velocities/{n}{mid}-rad_sec": factor(n) for n in "pqr" for mid in ("", "-aero")}
    for n in ("alpha", "beta"):
        symbols |= {f"aero/{n}-rad": factor(n), f"aero/{n}-deg": factor(n, DEGREE),
                 f"aero/mag-{n}-rad": factor(f"abs({n})"), f"aero/mag-{n}-deg": factor(f"abs({n})", DEGREE)}  # fmt: skip
    symbols |= {name: factor(text) for name, text in LENGTHS.items()}
    return symbols | {
        "velocities/vt-fps": factor("V", 1.0 / FOOT), "velocities/mach": factor("mach"), "aero/Re": factor("Re"),
        "atmosphere/rho-slugs_ft3": factor("rho", FOOT**3 / SLUG), "aero/qbar-psf": factor("pressure"),
        "aero/qbar-area": Sum((Product(1.0, {"pressure": 1, "area": 1}),)),
        "aero/bi2vel": factor("spans"), "aero/ci2vel": factor("chords"), "aero/cl-squared": Sum((Product(1.0, {LIFT: 2}),)),
        "aero/alphadot-rad_sec": factor("alpha_dot"), "aero/alphadot-deg_sec": factor("alpha_dot", DEGREE),
        STALL: Sum(), **dict.fromkeys(HEIGHTS, constant(FAR_ABOVE)),
    }  # fmt: skip


SYMBOLS: Mapping[str, Sum] = _symbols()
"""Property -> its form in our symbols. `area`, `span`, `chord` [ft2, ft], `pressure` [lbs/ft2], `spans` (b/2V) and `chords`
(c/2V) remain symbols until the end, so that they cancel."""
CALLS: Mapping[str, tuple[str, Callable[..., float]]] = {
    "abs": ("abs", abs), "sin": ("sin", math.sin), "cos": ("cos", math.cos), "tan": ("tan", math.tan), "exp": ("exp", math.exp),
    "asin": ("asin", math.asin), "acos": ("acos", math.acos), "atan": ("atan", math.atan), "ln": ("log", math.log),
    "sqrt": ("sqrt", math.sqrt), "atan2": ("atan2", math.atan2), "min": ("min", min), "max": ("max", max),
}  # fmt: skip
OPERATIONS = ("sum", "difference", "product", "quotient", "pow", *CALLS)
COMMENTS = ("description", "documentation")


class NotExact(Exception):
    """A function without an exact form in our text; the reason, in words."""


@dataclass
class Reader:
    """Reads functions of one aircraft.

    section: its aerodynamics. surfaces: property -> (our column, function from our value to its). values_of: name of a property
    -> its values at several states (None where it does not exist); one that never changes counts as a number. line: writes a sum
    as a line of the given name and returns its symbol.
    """

    section: ET.Element
    surfaces: Mapping[str, tuple[str, Follows]]
    values_of: Callable[[str], list[float] | None]
    line: Callable[[str, Sum], Sum]
    held: dict[str, float] = field(default_factory=dict)
    """Properties that were taken as numbers, though an aircraft could change them."""
    _values: dict[str, Sum] = field(default_factory=dict)
    _path: tuple[str, ...] = ()

    def function(self, element: ET.Element) -> Sum:
        """The value of a <function>. Raises NotExact."""
        name = element.get("name", "")
        if name in self._values:
            return self._values[name]
        if name in self._path:
            raise NotExact("builds on itself")
        outer_path, self._path = self._path, (*self._path, name) if name else self._path
        try:
            parts = [e for e in element if e.tag not in COMMENTS]
            if len(parts) != 1:
                raise NotExact("is not made of one operation")
            value = self.sum_of(parts[0])
        finally:
            self._path = outer_path
        if name:
            self._values[name] = value
        return value

    def sum_of(self, element: ET.Element) -> Sum:
        """The value of any operation. Raises NotExact."""
        text = (element.text or "").strip()
        match element.tag:
            case "value" | "v":
                return constant(_number(text))
            case "property" | "p":
                return self.property(text)
            case "table":
                return self._table(element)
            case "function":
                return self.function(element)
        if element.tag not in OPERATIONS:
            raise NotExact(f"has <{element.tag}>, which our text has no form for")
        parts = [self.sum_of(e) for e in element if e.tag not in COMMENTS]
        if not parts:
            raise NotExact(f"has <{element.tag}> with nothing in it")
        return _operated(element.tag, parts)

    def property(self, text: str) -> Sum:
        """A property, with its sign. Raises NotExact."""
        name = text.lstrip("-").strip()
        sign = -1.0 if text.startswith("-") else 1.0
        return self._property(name).scaled(sign)

    def _property(self, name: str) -> Sum:
        if name in self.surfaces:
            return _surface(*self.surfaces[name])
        if name in SYMBOLS:
            if name in (STALL, *HEIGHTS):
                self.held[name] = 0.0 if name == STALL else math.inf
            return SYMBOLS[name]
        for function in self.section.iter("function"):
            if function.get("name") == name:
                return self.function(function)
        values = self.values_of(name)
        if values is None:
            raise NotExact(f"reads {name}, which JSBSim does not know")
        if any(a != b for a, b in pairwise(values)) or not math.isfinite(values[0]):
            raise NotExact(f"reads {name}, which airspeed, flow angles, rates, surfaces and density do not say")
        value = values[0] if abs(values[0]) > NEGLIGIBLE else 0.0
        if not name.startswith(CONSTANTS):
            self.held[name] = value
        return constant(value)

    def _table(self, element: ET.Element) -> Sum:
        try:
            table, names = table_of(element)
            arguments = [self.property(n) for n in names]
            return looked_up(
                table, arguments, lambda terms: self.line(self._path[-1] if self._path else "table", terms)
            )
        except TableError as error:
            raise NotExact(f"has {error}") from error


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise NotExact(f"has {text!r} for a number") from error


def _surface(column: str, follows: Follows) -> Sum:
    """A position in terms of our column: proportional to it, to its magnitude, or with two slopes that meet at zero."""
    positive, negative = follows(1.0), follows(-1.0)
    if positive == -negative:
        return factor(column, positive)
    if positive == negative:
        return factor(f"abs({column})", positive)
    return factor(f"max(0, {column})", positive).plus(factor(f"min(0, {column})", -negative))


def _operated(tag: str, parts: list[Sum]) -> Sum:
    numbers = [p.number for p in parts]
    first, *rest = parts
    match tag:
        case "sum":
            return first.plus(*rest)
        case "difference":
            return first.plus(*(p.scaled(-1.0) for p in rest))
        case "product":
            for p in rest:
                first = first.times(p)
            return first
        case "quotient" if len(parts) == 2:
            try:
                return first.times(rest[0].inverse())
            except ZeroDivisionError:
                raise NotExact("divides by nothing") from None
        case "pow" if len(parts) == 2:
            return _power(first, rest[0])
    if tag not in CALLS:
        raise NotExact(f"has <{tag}> of {len(parts)}")
    word, calculate = CALLS[tag]
    if all(n is not None for n in numbers):
        try:
            return constant(calculate(*numbers))
        except (TypeError, ValueError, OverflowError) as error:
            raise NotExact(f"has <{tag}> of a number that has none") from error
    texts = [text_of(p) for p in parts]
    if tag in ("min", "max"):
        while len(texts) > 2:
            texts[-2:] = [f"{word}({texts[-2]}, {texts[-1]})"]
    return factor(f"{word}({', '.join(texts)})")


def _power(base: Sum, exponent: Sum) -> Sum:
    power, number, base_product = exponent.number, base.number, base.single
    if power is not None and number is not None:
        try:
            value = number**power
        except (ZeroDivisionError, OverflowError) as error:
            raise NotExact("has <pow> of a number that has none") from error
        if isinstance(value, complex):
            raise NotExact("has <pow> of a number that has none")
        return constant(value)
    if power is not None and power == int(power):
        if base_product is not None and base.products:
            return Sum((base_product.to_power(int(power)),)) if power else constant(1.0)
        return factor(f"({text_of(base)})", power=int(power)) if power else constant(1.0)
    return factor(f"(({text_of(base)})^({text_of(exponent)}))")
