"""Functions of a JSBSim aircraft as terms of coefficients: made non-dimensional, and named.

A number times one regressor becomes a parameter under its usual name (`Cl_p`) where that is free, else under JSBSim's. Any longer
function becomes a line under JSBSim's name.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from xml.etree import ElementTree as ET

from daq.utilities.constants import FOOT, SLUG
from estimation.models.base import Parameter
from estimation.models.expressions import FUNCTIONS
from estimation.models.parts import usual_role
from estimation.simulation.jsbsim.reading import LIFT, NotExact, Reader
from estimation.simulation.jsbsim.terms import Product, Sum, collected, factor, number_text, text_of
from estimation.simulation.oracle import ALPHA_RATE

AXES = {"LIFT": "CL", "DRAG": "CD", "SIDE": "CY", "ROLL": "Cl", "PITCH": "Cm", "YAW": "Cn"}
LENGTHS = {"CL": (), "CD": (), "CY": (), "Cl": ("span",), "Cm": ("chord",), "Cn": ("span",)}
"""Coefficient -> length by which a moment is divided, beside pressure and area."""
REGRESSORS: Mapping[frozenset[tuple[str, int]], tuple[str, str, str]] = {
    frozenset(factors.items()): (ending, text, unit)
    for factors, ending, text, unit in (
        ({}, "0", "", "1"), ({"alpha": 1}, "alpha", "alpha", "1/rad"), ({"beta": 1}, "beta", "beta", "1/rad"),
        ({"p": 1, "spans": 1}, "p", "p_hat", "1/rad"), ({"q": 1, "chords": 1}, "q", "q_hat", "1/rad"),
        ({"r": 1, "spans": 1}, "r", "r_hat", "1/rad"), ({"delta_e": 1}, "de", "delta_e", "1/rad"),
        ({"delta_a": 1}, "da", "delta_a", "1/rad"), ({"delta_r": 1}, "dr", "delta_r", "1/rad"),
        ({"alpha_dot": 1, "chords": 1}, "alphadot", "alpha_dot*c/(2*V)", "1/rad"),
        ({"alpha": 2}, "alpha2", "alpha^2", "1/rad2"), ({"beta": 2}, "beta2", "beta^2", "1/rad2"),
    )
}  # fmt: skip
"""Factors of a term -> ending of the usual name, regressor in our text, unit."""
SIZE_TEXTS = {
    "spans": "(b/(2*V))",
    "chords": "(c/(2*V))",
    "span": f"(b/{FOOT})",
    "chord": f"(c/{FOOT})",
    "area": f"(S/{FOOT**2!r})",
}
"""Symbol of `reading` for a size in JSBSim's units -> our text for it."""
PRESSURE = Product(0.5 * FOOT / SLUG, {"rho": 1, "V": 2})  # lbs/ft2


@dataclass
class Text:
    """Lines and parameters of the model under construction. taken: all names in use."""

    lines: dict[str, str] = field(default_factory=dict)
    parameters: dict[str, Parameter] = field(default_factory=dict)
    taken: set[str] = field(default_factory=set)

    def name(self, preferred: str) -> str:
        """A free name, made from `preferred`."""
        base = re.sub(r"\W", "_", preferred.rpartition("/")[2]) or "term"
        base = f"f_{base}" if base[0].isdigit() or base in FUNCTIONS else base
        free_name, count = base, 1
        while free_name in self.taken:
            count += 1
            free_name = f"{base}_{count}"
        self.taken.add(free_name)
        return free_name

    def line(self, preferred: str, terms: Sum) -> Sum:
        """Add a sum as a line; returns the line's symbol."""
        name = self.name(preferred)
        self.lines[name] = coefficient_text(terms)
        return factor(name)


def coefficients_of(section: ET.Element, reader: Reader) -> tuple[dict[str, dict[str, Sum]], dict[str, str]]:
    """Axis -> function -> coefficient; and function -> why it has no exact form."""
    parts: dict[str, dict[str, Sum]] = {axis: {} for axis in AXES}
    reasons: dict[str, str] = {}
    for shift in section.iter("aero_ref_pt_shift_x"):
        reasons[shift.tag] = "moves the point that forces act at"
    for axis in section.findall("axis"):
        name = axis.get("name", "").upper()
        if name not in AXES:
            reasons[f"axis {name}"] = "is none of wind axes and moments"
            continue
        inverse_size = Sum(
            (Product(1.0, {"pressure": 1, "area": 1} | dict.fromkeys(LENGTHS[AXES[name]], 1)),)
        ).inverse()
        for function in axis.findall("function"):
            function_name = function.get("name", "") or f"a function of {name}"
            try:
                value = _without_pressure(reader.function(function).times(inverse_size))
            except NotExact as reason:
                reasons[function_name] = str(reason)
                continue
            parts[name][function_name] = parts[name].get(function_name, Sum()).plus(value)
    return parts, reasons


def _without_pressure(value: Sum) -> Sum:
    """A sum with any remaining dynamic pressure written as density and speed, which may cancel."""
    return collected(
        p.times(Product(1.0, {"pressure": -p.factors.get("pressure", 0)})).times(
            PRESSURE.to_power(p.factors.get("pressure", 0))
        )
        for p in value.products
    )


def solved_lift(lift: Mapping[str, Sum]) -> tuple[dict[str, Sum], Sum, dict[str, str]]:
    """(function -> lift without the terms proportional to the rate of alpha; these terms over the rate; function -> why its lift
    depends on the rate of alpha, or on lift, in another way)."""
    static_lift, by_rate, reasons = {}, Sum(), {}
    for name, value in lift.items():
        rate_products = [p for p in value.products if p.factors.get(ALPHA_RATE) == 1]
        static_lift[name] = Sum(tuple(p for p in value.products if p not in rate_products))
        over_rate = Sum(tuple(rate_products)).times(factor(ALPHA_RATE).inverse())
        by_rate = by_rate.plus(over_rate)
        if re.search(rf"\b({ALPHA_RATE}|{LIFT})\b", f"{text_of(static_lift[name])} {text_of(over_rate)}"):
            reasons[name] = "is a lift that goes with the rate of alpha, or with lift, in another way than by a factor"
    return static_lift, by_rate, reasons


def named_terms(coefficient: str, functions: Mapping[str, Sum], text: Text, spec: str) -> list[str]:
    """The terms of one coefficient; the parameters and lines that they need are added to `text`."""
    terms = []
    for function_name, value in functions.items():
        single_product = value.single
        if single_product is None:
            terms += [text_of(text.line(function_name, value))] if value.products else []
            continue
        ending, regressor, unit = REGRESSORS.get(
            single_product.key, ("", coefficient_text(Sum((replace(single_product, number=1.0),))), "")
        )
        if text.lines.keys() & single_product.factors.keys():  # the line of a table, which contains its size
            terms.append(coefficient_text(value))
            continue
        standard = f"{coefficient}_{ending}"
        name = standard if ending and standard not in text.taken else text.name(function_name)
        text.taken.add(name)
        size = float(number_text(single_product.number))
        text.parameters[name] = Parameter(name, unit, size, reference=size, reference_source=f"{spec}, {function_name}",
                                          role=usual_role(name))  # fmt: skip
        terms.append(f"{name}*{regressor}" if regressor else name)
    return terms


def coefficient_text(terms: Sum) -> str:
    """Equation text of a sum, with its sizes in our symbols."""
    text = text_of(collected(_with_hats(p) for p in terms.products))
    for name, meaning in SIZE_TEXTS.items():
        text = re.sub(rf"\b{name}\b", meaning, text)
    return text


def _with_hats(p: Product) -> Product:
    """A product with rates times length over twice the airspeed as p_hat, q_hat, r_hat."""
    for rate, length in (("p", "spans"), ("q", "chords"), ("r", "spans")):
        if p.factors.get(rate, 0) > 0 and p.factors.get(length, 0) > 0:
            p = p.times(Product(1.0, {rate: -1, length: -1, f"{rate}_hat": 1}))
    return p
