"""A smooth function of one variable as text of a model: penalised cubic splines.

Cubic B-splines over the range flown, constant outside, with a penalty on the second differences of their coefficients (Eilers &
Marx 1996, Statistical Science 11, 89-121): a Gaussian prior on the penalty's eigenvectors. The penalty leaves a constant and a
line free. These belong to the base model and are removed, so that increment and base are not confounded (Brynjarsdottir &
O'Hagan 2014). The same columns exist as numbers (`columns`) and as equation lines (`lines`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from estimation.engine.kernel import Array

INNER = 7  # knots inside the range flown: features down to an eighth of it
KEPT = 6  # smoothest eigenvectors: the penalty holds the rougher ones at zero anyway
DEGREE = 3
FINE = 401  # points for orthogonalising the columns and converting them to powers: exact for cubics between knots


@dataclass(frozen=True)
class Basis:
    """Columns over u in -1..1. knots: (INNER,) inner ones. powers: (columns, 4 + INNER) weights of 1, u, u^2, u^3 and
    max(0, u - knot)^3. spread: (columns,) prior standard deviation of each column's weight, 1 for the smoothest one."""

    knots: Array
    powers: Array
    spread: Array

    def columns(self, u: Array) -> Array:
        """(N, columns) at u (N,), constant outside -1..1."""
        return _powers(np.clip(u, -1.0, 1.0), self.knots) @ self.powers.T


def _powers(u: Array, knots: Array) -> Array:
    """(N, 4 + knots): 1, u, u^2, u^3 and the truncated cubes."""
    truncated = np.maximum(u[:, None] - knots, 0.0) ** DEGREE
    return np.concatenate([u[:, None] ** np.arange(DEGREE + 1), truncated], axis=1)


@cache
def basis() -> Basis:
    """The columns of every increment: unit rms over -1..1, free of constant and line, smoothest first."""
    from scipy.interpolate import BSpline  # here: long to import

    knots = np.linspace(-1.0, 1.0, INNER + 2)
    padded = np.concatenate([np.full(DEGREE, -1.0), knots, np.full(DEGREE, 1.0)])
    count = INNER + DEGREE + 1
    u = np.linspace(-1.0, 1.0, FINE)
    splines = np.nan_to_num(BSpline(padded, np.eye(count), DEGREE)(u))
    second = np.diff(np.eye(count), n=2, axis=0)
    values, vectors = np.linalg.eigh(second.T @ second)
    selected = slice(2, 2 + KEPT)  # the first two are not penalised: constant and line
    columns = splines @ vectors[:, selected]
    straight = np.stack([np.ones(FINE), u], axis=1)
    columns -= straight @ np.linalg.lstsq(straight, columns, rcond=None)[0]
    columns /= np.sqrt(np.mean(columns**2, axis=0))
    inner = knots[1:-1]
    powers = np.linalg.lstsq(_powers(u, inner), columns, rcond=None)[0].T
    return Basis(inner, powers, np.sqrt(values[2] / values[selected]))


@dataclass(frozen=True)
class Range:
    """The range of a variable on the flights."""

    low: float
    high: float

    @classmethod
    def of(cls, courses: Sequence[Array]) -> "Range":
        return cls(min(float(c.min()) for c in courses), max(float(c.max()) for c in courses))

    @property
    def middle(self) -> float:
        return 0.5 * (self.low + self.high)

    @property
    def half(self) -> float:
        return 0.5 * (self.high - self.low)

    def scaled(self, x: Array) -> Array:
        """x scaled to -1..1 over the range."""
        return (x - self.middle) / self.half

    def inside(self, x: Array) -> float:
        """Share of the samples x (N,) that lie in the range."""
        return float(np.mean((x >= self.low) & (x <= self.high)))


def lines(tag: str, variable: str, weights: Sequence[str]) -> tuple[str, ...]:
    """Equation lines of an increment named `tag`: the sum of all columns, each times its weight (names or numbers).

    `<tag>_low` and `<tag>_high` limit the variable, `<tag>_middle` and `<tag>_half` scale it. They are parameters, so that the
    text, and the compiled model, is the same for every range.
    """
    shape = basis()
    u = f"{tag}_u"
    texts = [f"{u} = (min(max({variable}, {tag}_low), {tag}_high) - {tag}_middle)/{tag}_half"]
    texts += [f"{u}_{k} = max(0, {u} - {_number(knot)})^3" for k, knot in enumerate(shape.knots, 1)]
    pieces = ["1", u, f"{u}^2", f"{u}^3", *(f"{u}_{k}" for k in range(1, INNER + 1))]
    for j, row in enumerate(shape.powers, 1):
        texts.append(f"{tag}_{j} = " + " + ".join(f"{_number(a)}*{p}" for a, p in zip(row, pieces, strict=True)))
    total = " + ".join(f"{w}*{tag}_{j}" for j, w in enumerate(weights[:KEPT], 1))
    for piece, weight in zip((u, "1"), weights[KEPT:], strict=False):
        total += f" + {weight}*{piece}"
    return (*texts, f"{tag} = {total}")


def polynomial(weights: Array, straight: Sequence[float] = ()) -> Array:
    """(4 + INNER,) weights of the powers of a sum of columns. straight: weights of u and of 1, if any."""
    coefficients = basis().powers.T @ weights
    for k, value in zip((1, 0), straight, strict=False):
        coefficients[k] += value
    return np.asarray(coefficients)


def curve_lines(tag: str, variable: str, flown: Range, powers: Array) -> tuple[str, ...]:
    """Equation lines of one curve with numbers, for a model that a person reads. powers: from `polynomial`."""
    u = f"{tag}_u"
    clipped = f"min(max({variable}, {_number(flown.low)}), {_number(flown.high)})"
    pieces = ["1", u, f"{u}^2", f"{u}^3", *(f"max(0, {u} - {_number(k)})^3" for k in basis().knots)]
    total = " + ".join(f"{_number(a)}*{p}" for a, p in zip(powers, pieces, strict=True))
    return f"{u} = ({clipped} - {_number(flown.middle)})/{_number(flown.half)}", f"{tag} = {total}"


def _number(value: float) -> str:
    """A number as text that reads back the same; negative ones in brackets."""
    return f"({value:.17g})" if value < 0.0 else f"{value:.17g}"
