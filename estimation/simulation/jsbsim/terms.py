"""Sums of products, and JSBSim's tables as such sums: the form between JSBSim's functions and our equation text."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from xml.etree import ElementTree as ET

import numpy as np

from estimation.simulation.oracle import Array

# A factor is a self-contained piece of text (a symbol, a call, a bracket) with an integer power. So divisors cancel exactly, and
# a term that is a number times a regressor is recognised as one.

DIGITS = 15  # significant digits of a written number: a sixteenth would only show the rounding of unit conversions


@dataclass(frozen=True)
class Product:
    """A number times factors (text -> integer power, none of them zero)."""

    number: float
    factors: Mapping[str, int] = field(default_factory=dict)

    @property
    def key(self) -> frozenset[tuple[str, int]]:
        """The factors, hashable."""
        return frozenset(self.factors.items())

    def times(self, other: "Product") -> "Product":
        factors = dict(self.factors)
        for text, power in other.factors.items():
            factors[text] = factors.get(text, 0) + power
        return Product(self.number * other.number, {t: n for t, n in factors.items() if n})

    def to_power(self, power: int) -> "Product":
        return Product(self.number**power, {t: n * power for t, n in self.factors.items() if n * power})


@dataclass(frozen=True)
class Sum:
    """A sum of products, no two with the same factors, none of them zero."""

    products: tuple[Product, ...] = ()

    @property
    def number(self) -> float | None:
        """The value of a sum without factors; else None."""
        if not self.products:
            return 0.0
        return self.products[0].number if len(self.products) == 1 and not self.products[0].factors else None

    @property
    def single(self) -> Product | None:
        """The product of a sum of one; else None."""
        return self.products[0] if len(self.products) == 1 else None

    def plus(self, *others: "Sum") -> "Sum":
        return collected(p for part in (self, *others) for p in part.products)

    def times(self, other: "Sum") -> "Sum":
        """The product of two sums; where both are long, one stays in brackets."""
        a, b = (self, other) if len(self.products) <= len(other.products) else (other, self)
        if len(a.products) > 1:
            b = factor(f"({text_of(b)})")
        return collected(p.times(q) for p in a.products for q in b.products)

    def scaled(self, number: float) -> "Sum":
        return collected(Product(p.number * number, p.factors) for p in self.products)

    def inverse(self) -> "Sum":
        """One over the sum. Raises ZeroDivisionError for an empty sum."""
        if not self.products:
            raise ZeroDivisionError
        if self.single is not None:
            return Sum((self.single.to_power(-1),))
        return factor(f"({text_of(self)})", power=-1)


def collected(products: Iterable[Product]) -> Sum:
    """The sum of products, with those of equal factors added and zeros dropped."""
    by_factors: dict[frozenset[tuple[str, int]], Product] = {}
    for p in products:
        same = by_factors.get(p.key)
        by_factors[p.key] = p if same is None else Product(same.number + p.number, p.factors)
    return Sum(tuple(p for p in by_factors.values() if p.number != 0.0))


def constant(number: float) -> Sum:
    return Sum((Product(float(number)),)) if number else Sum()


def factor(text: str, number: float = 1.0, power: int = 1) -> Sum:
    """A number times one factor with its power."""
    return Sum((Product(number, {text: power}),))


def number_text(value: float) -> str:
    return repr(float(f"{value:.{DIGITS}g}"))


def text_of(terms: Sum) -> str:
    """Equation text; `0` for an empty sum."""
    text = "0"
    for i, p in enumerate(terms.products):
        sign = "-" if p.number < 0 else "" if i == 0 else "+"
        body = product_text(Product(abs(p.number), p.factors))
        text = f"{sign}{body}" if i == 0 else f"{text} {sign} {body}"
    return text


def product_text(p: Product) -> str:
    numerator = [_power(t, n) for t, n in p.factors.items() if n > 0]
    denominator = [_power(t, -n) for t, n in p.factors.items() if n < 0]
    number = float(f"{p.number:.{DIGITS}g}")
    if number != 1.0 or not numerator:
        numerator.insert(0, number_text(number))
    return "*".join(numerator) + "".join(f"/{t}" for t in denominator)


def _power(text: str, power: int) -> str:
    return text if power == 1 else f"{text}^{power}"


# JSBSim's tables are linear between their points and constant outside. In our text they are sums of `max(0, x - point)`.
#
# That is exact, not a fit: a table of one variable is its first value plus, at every point, the change of its slope; a table of
# several variables is linear in each, and its values along one variable are tables of the others.

Line = Callable[[Sum], Sum]
"""Writes a sum as its own line and returns the symbol of that line."""
MOST_TERMS = 60  # terms in one line: an expression has at most 4000 characters and 200 nested operations


class TableError(Exception):
    """A table for which our text has no form; the reason, in words."""


@dataclass(frozen=True)
class LookupTable:
    """Values at points of the last variable: numbers, or tables of the other variables."""

    points: Array
    values: "tuple[float | LookupTable, ...]"


def table_of(element: ET.Element) -> tuple[LookupTable, list[str]]:
    """The numbers of a <table> and the properties it is looked up by, the last one first. Raises TableError."""
    variables = {e.get("lookup", "row"): (e.text or "").strip() for e in element.findall("independentVar")}
    data = element.findall("tableData")
    lookups = ("row", "column", "table")[: len(variables)]
    if set(variables) != set(lookups) or not data or not variables:
        raise TableError("a table looked up in a way that is not known here")
    if len(variables) == 3:
        breaks = [_number(d.get("breakPoint", "")) for d in data]
        table = _checked_table(breaks, tuple(_table_of_two(d.text or "") for d in data))
    else:
        table = _table_of_two(data[0].text or "") if len(variables) == 2 else _table_of_one(data[0].text or "")
    return table, [variables[w] for w in reversed(lookups)]


def _checked_table(points: list[float], values: "tuple[float | LookupTable, ...]") -> LookupTable:
    """The table. Raises TableError unless its points rise."""
    if np.any(np.diff(points) <= 0.0):
        raise TableError("a table whose points do not rise")
    return LookupTable(np.array(points), values)


def _table_of_one(text: str) -> LookupTable:
    """A table of one variable: rows of point and value."""
    numbers = _numbers(text)
    if len(numbers) % 2 or not numbers:
        raise TableError("a table with a number missing")
    rows = np.array(numbers).reshape(-1, 2)
    return _checked_table(rows[:, 0].tolist(), tuple(rows[:, 1].tolist()))


def _table_of_two(text: str) -> LookupTable:
    """A table of two variables: a row of column points, then rows of point and values."""
    lines = [line for line in text.splitlines() if line.strip()]
    columns = _numbers(lines[0]) if lines else []
    rest = [n for line in lines[1:] for n in _numbers(line)]
    if not columns or not rest or len(rest) % (len(columns) + 1):
        raise TableError("a table with a number missing")
    rows = np.array(rest).reshape(-1, len(columns) + 1)
    parts = (_checked_table(rows[:, 0].tolist(), tuple(column)) for column in rows[:, 1:].T.tolist())
    return _checked_table(columns, tuple(parts))


def _numbers(text: str) -> list[float]:
    return [_number(word) for word in text.split()]


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError as error:
        raise TableError(f"a table with {word!r} for a number") from error


def looked_up(table: LookupTable, arguments: list[Sum], line: Line) -> Sum:
    """The value of a table at its variables, the last one first. A variable that is a number is interpolated here."""
    x, *further_arguments = arguments
    number = x.number
    needed = range(len(table.points)) if number is None else _bracketing(table.points, number)
    values = {}
    for i in needed:
        value = table.values[i]
        values[i] = constant(value) if isinstance(value, float) else looked_up(value, further_arguments, line)
    if number is not None:
        low, high = needed[0], needed[-1]
        if low == high:
            return values[low]
        share = float((number - table.points[low]) / (table.points[high] - table.points[low]))
        return values[low].scaled(1.0 - share).plus(values[high].scaled(share))
    numbers = [v.number for v in values.values()]
    if None not in numbers:
        return _kinked(table.points, np.array(numbers, float), x, line)
    nodes = [v if len(v.products) < 2 else line(v) for v in values.values()]
    parts = []
    for i, (a, b) in enumerate(pairwise(nodes)):
        low_point, high_point = float(table.points[i]), float(table.points[i + 1])
        share_of = (
            _ramp_above(x, low_point)
            .plus(_ramp_above(x, high_point).scaled(-1.0))
            .scaled(1.0 / (high_point - low_point))
        )
        step = b.plus(a.scaled(-1.0))
        if step.products:
            parts.append(step.times(share_of) if len(step.products) == 1 else line(step).times(share_of))
    return _in_lines(nodes[0].plus(*parts), line)


def _bracketing(points: Array, x: float) -> range:
    """Indices of the two points around x, or of one: a point at x, or the last point before x outside the table."""
    if x <= points[0] or len(points) == 1:
        return range(1)
    if x >= points[-1]:
        return range(len(points) - 1, len(points))
    high = int(np.searchsorted(points, x))
    return range(high, high + 1) if points[high] == x else range(high - 1, high + 1)


def _kinked(points: Array, values: Array, x: Sum, line: Line) -> Sum:
    """A table of one variable as its first value plus the changes of slope at its points."""
    if np.all(values == values[0]):
        return constant(float(values[0]))
    slopes = np.concatenate([[0.0], np.diff(values) / np.diff(points), [0.0]])
    kinks = [_ramp_above(x, p).scaled(float(d)) for p, d in zip(points, np.diff(slopes), strict=True)]
    return _in_lines(constant(float(values[0])).plus(*kinks), line)


def _ramp_above(x: Sum, point: float) -> Sum:
    """max(0, x - point)."""
    if point == 0.0:
        return factor(f"max(0, {text_of(x)})")
    return factor(f"max(0, {text_of(x)} {'-' if point > 0 else '+'} {number_text(abs(point))})")


def _in_lines(terms: Sum, line: Line) -> Sum:
    """A long sum as several lines."""
    if len(terms.products) <= MOST_TERMS:
        return line(terms) if len(terms.products) > 1 else terms
    parts: list[tuple[Product, ...]] = [
        terms.products[i : i + MOST_TERMS] for i in range(0, len(terms.products), MOST_TERMS)
    ]
    return _in_lines(Sum().plus(*(line(Sum(p)) for p in parts)), line)
