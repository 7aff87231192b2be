"""Sums of products as data, and tables of JSBSim as such sums: what functions become on their way to our equation text."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from xml.etree import ElementTree as ET

import numpy as np

from estimation.simulation.oracle import Array

# Sums of products as data: what functions of JSBSim become on their way to our equation text.
#
# A factor is a piece of text that stands by itself (a symbol, a call, a bracket) with a whole power; so that what is divided by
# cancels exactly, and a term that is a number times a regressor is seen to be one.

DIGITS = 15  # significant, of a written number: what sixteen would add is the rounding of unit conversions


@dataclass(frozen=True)
class Product:
    """A number times factors (text -> whole power, none of them zero)."""

    number: float
    factors: Mapping[str, int] = field(default_factory=dict)

    @property
    def key(self) -> frozenset[tuple[str, int]]:
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
    """Products, no two of the same factors, none of them zero."""

    products: tuple[Product, ...] = ()

    @property
    def number(self) -> float | None:
        """The number that it is, None where it is none."""
        if not self.products:
            return 0.0
        return self.products[0].number if len(self.products) == 1 and not self.products[0].factors else None

    @property
    def single(self) -> Product | None:
        """The one product that it is, None where it is none or several."""
        return self.products[0] if len(self.products) == 1 else None

    def plus(self, *others: "Sum") -> "Sum":
        return collected(p for part in (self, *others) for p in part.products)

    def times(self, other: "Sum") -> "Sum":
        """The product; of two long sums one stays in brackets."""
        a, b = (self, other) if len(self.products) <= len(other.products) else (other, self)
        if len(a.products) > 1:
            b = factor(f"({text_of(b)})")
        return collected(p.times(q) for p in a.products for q in b.products)

    def scaled(self, number: float) -> "Sum":
        return collected(Product(p.number * number, p.factors) for p in self.products)

    def inverse(self) -> "Sum":
        """One over it. Raises ZeroDivisionError for nothing."""
        if not self.products:
            raise ZeroDivisionError
        single_product = self.single
        return (
            Sum((single_product.to_power(-1),))
            if single_product is not None
            else Sum((Product(1.0, {f"({text_of(self)})": -1}),))
        )


def collected(products: Iterable[Product]) -> Sum:
    """A sum, equal products taken together and zeros left away."""
    found: dict[frozenset[tuple[str, int]], Product] = {}
    for p in products:
        same_product = found.get(p.key)
        found[p.key] = p if same_product is None else Product(same_product.number + p.number, p.factors)
    return Sum(tuple(p for p in found.values() if p.number != 0.0))


def constant(number: float) -> Sum:
    return Sum((Product(float(number)),)) if number else Sum()


def factor(text: str, number: float = 1.0) -> Sum:
    """A number times one factor."""
    return Sum((Product(number, {text: 1}),))


def number_text(value: float) -> str:
    return repr(float(f"{value:.{DIGITS}g}"))


def text_of(terms: Sum) -> str:
    """Equation text; `0` for nothing."""
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


# Tables of JSBSim in our equation text: straight between their points and flat outside, as sums of `max(0, x - point)`.
#
# That is exact, not a fit: a table of one variable is its first value and, at every point, the change of its slope; one of
# several is linear in each, and its values along one variable are tables of the others.

Line = Callable[[Sum], Sum]
"""Writes a sum as a line of its own and gives the symbol of that line."""
MOST = 60  # terms in one line: an expression has 4000 characters and 200 operations within one another at most


class TableError(Exception):
    """A table of a kind that our text has no form for; what of it, in words."""


@dataclass(frozen=True)
class LookupTable:
    """Values at points of the last variable; what stands there are numbers, or tables of the variables before."""

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
        table = _risen(breaks, tuple(_of_two(d.text or "") for d in data))
    else:
        table = _of_two(data[0].text or "") if len(variables) == 2 else _of_one(data[0].text or "")
    return table, [variables[w] for w in reversed(lookups)]


def _risen(points: list[float], values: "tuple[float | LookupTable, ...]") -> LookupTable:
    if np.any(np.diff(points) <= 0.0):
        raise TableError("a table whose points do not rise")
    return LookupTable(np.array(points), values)


def _of_one(text: str) -> LookupTable:
    numbers = _numbers(text)
    if len(numbers) % 2 or not numbers:
        raise TableError("a table with a number missing")
    rows = np.array(numbers).reshape(-1, 2)
    return _risen(rows[:, 0].tolist(), tuple(rows[:, 1].tolist()))


def _of_two(text: str) -> LookupTable:
    lines = [line for line in text.splitlines() if line.strip()]
    columns = _numbers(lines[0]) if lines else []
    rest = [n for line in lines[1:] for n in _numbers(line)]
    if not columns or not rest or len(rest) % (len(columns) + 1):
        raise TableError("a table with a number missing")
    rows = np.array(rest).reshape(-1, len(columns) + 1)
    parts = (_risen(rows[:, 0].tolist(), tuple(column)) for column in rows[:, 1:].T.tolist())
    return _risen(columns, tuple(parts))


def _numbers(text: str) -> list[float]:
    return [_number(word) for word in text.split()]


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError as error:
        raise TableError(f"a table with {word!r} for a number") from error


def looked_up(table: LookupTable, arguments: list[Sum], line: Line) -> Sum:
    """The value of a table at variables, the last one first; where one is a number, the table is looked up there and then."""
    x, *further_arguments = arguments
    number = x.number
    around = range(len(table.points)) if number is None else _around(table.points, number)
    inner = {
        i: v if isinstance(v, float) else looked_up(v, further_arguments, line)
        for i, v in enumerate(table.values)
        if i in around
    }
    values = {i: constant(v) if isinstance(v, float) else v for i, v in inner.items()}
    if number is not None:
        low, high = around[0], around[-1]
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


def _around(points: Array, x: float) -> range:
    """Places of the points between which x lies, or of the one where it is or beyond which it lies."""
    if x <= points[0] or len(points) == 1:
        return range(1)
    if x >= points[-1]:
        return range(len(points) - 1, len(points))
    high = int(np.searchsorted(points, x))
    return range(high, high + 1) if points[high] == x else range(high - 1, high + 1)


def _kinked(points: Array, values: Array, x: Sum, line: Line) -> Sum:
    """A table of one variable: its first value, and the change of slope at each point."""
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
    if len(terms.products) <= MOST:
        return line(terms) if len(terms.products) > 1 else terms
    parts: list[tuple[Product, ...]] = [terms.products[i : i + MOST] for i in range(0, len(terms.products), MOST)]
    return _in_lines(Sum().plus(*(line(Sum(p)) for p in parts)), line)
