"""Tables of JSBSim in our equation text: straight between their points and flat outside, as sums of `max(0, x - point)`.

That is exact, not a fit: a table of one variable is its first value and, at every point, the change of its slope; one of several
is linear in each, and its values along one variable are tables of the others.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from xml.etree import ElementTree as ET

import numpy as np

from estimation.simulation.jsbsim.terms import Product, Sum, constant, factor, number_text, text_of
from estimation.simulation.oracle import Array

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
    wanted = ("row", "column", "table")[: len(variables)]
    if set(variables) != set(wanted) or not data or not variables:
        raise TableError("a table looked up in a way that is not known here")
    if len(variables) == 3:
        breaks = [_number(d.get("breakPoint", "")) for d in data]
        table = _risen(breaks, tuple(_of_two(d.text or "") for d in data))
    else:
        table = _of_two(data[0].text or "") if len(variables) == 2 else _of_one(data[0].text or "")
    return table, [variables[w] for w in reversed(wanted)]


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


def looked_up(table: LookupTable, at: list[Sum], line: Line) -> Sum:
    """The value of a table at variables, the last one first; where one is a number, the table is looked up there and then."""
    x, *others = at
    number = x.number
    around = range(len(table.points)) if number is None else _around(table.points, number)
    inner = {
        i: v if isinstance(v, float) else looked_up(v, others, line) for i, v in enumerate(table.values) if i in around
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
        share_of = _above(x, low_point).plus(_above(x, high_point).scaled(-1.0)).scaled(1.0 / (high_point - low_point))
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
    kinks = [_above(x, p).scaled(float(d)) for p, d in zip(points, np.diff(slopes), strict=True)]
    return _in_lines(constant(float(values[0])).plus(*kinks), line)


def _above(x: Sum, point: float) -> Sum:
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
