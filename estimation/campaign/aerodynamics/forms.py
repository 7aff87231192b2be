"""Forms of a derivative over the conditions flown: polynomials, and penalised splines on top of a straight line.

Conditions of a flight: mean alpha [rad], mean V [m/s], largest sideslip [rad], mean elevator [rad], each scaled to -1 .. 1.
A spline is Eilers and Marx's (1996, Stat. Sci. 11, 89-121): cubic B-splines with a penalty on second differences, written
as a mixed model, so that its smoothness is a variance estimated by restricted likelihood.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.flight import Array

CONDITIONS = ("alpha", "V", "beta_max", "delta_e")
LEAST_SPREAD = 1e-3  # of a condition, relative to its size: with less it counts as the same on all flights
MOST_POWER = 3  # of a condition: stronger bends are left to splines
PIECES = 8  # of a spline over the range flown: more are only set by the penalty
NEAR = 0.25  # of the range flown in each condition: a point this near to a flight counts as flown


@dataclass(frozen=True)
class ConditionScale:
    """Scales conditions (points, 4) to -1 .. 1. centre, half: (4,) of the ranges flown; changed: (4,) bool, not constant."""

    centre: Array
    half: Array
    changed: NDArray[np.bool_]

    @classmethod
    def from_conditions(cls, conditions: Array) -> "ConditionScale":
        """From the conditions of the flights (flights, 4). One that is NaN for any flight counts as unchanged."""
        measured = np.isfinite(conditions).all(axis=0)
        low = np.where(measured, np.nan_to_num(conditions).min(axis=0), 0.0)
        high = np.where(measured, np.nan_to_num(conditions).max(axis=0), 0.0)
        centre, half = 0.5 * (low + high), 0.5 * (high - low)
        changed = measured & (half > LEAST_SPREAD * np.maximum(np.abs(centre), LEAST_SPREAD))
        return cls(centre, np.where(changed, half, 1.0), changed)

    def scaled(self, conditions: Array) -> Array:
        """(points, 4), -1 .. 1 over the ranges flown; 0 for a condition that did not change."""
        x: Array = np.where(self.changed, (np.nan_to_num(conditions) - self.centre) / self.half, 0.0)
        return x


@dataclass(frozen=True)
class PolynomialForm:
    """powers: of the scaled conditions in each term, the constant first; splines: indices of conditions with a spline on top."""

    powers: tuple[tuple[int, ...], ...]
    splines: tuple[int, ...] = ()

    def columns(self, x: Array) -> Array:
        """(points, terms) at scaled conditions (points, 4), the penalised columns last."""
        polynomial_columns = [np.prod(x ** np.array(p), axis=1) for p in self.powers]
        bent = [spline_columns(x[:, c]) for c in self.splines]
        return np.column_stack([*polynomial_columns, *bent])

    @property
    def penalty(self) -> tuple[int, ...]:
        """For each column -1 where it is free, else the index of the spline whose variance it shares."""
        spline_size = PIECES + 1
        return (-1,) * len(self.powers) + tuple(k for k in range(len(self.splines)) for _ in range(spline_size))

    @property
    def size(self) -> int:
        """Number of free terms."""
        return len(self.powers)

    @property
    def words(self) -> str:
        """`1 + alpha + alpha V + spline(delta_e)`."""
        terms = [
            " ".join(n if p == 1 else f"{n}^{p}" for n, p in zip(CONDITIONS, powers, strict=True) if p) or "1"
            for powers in self.powers
        ]
        return " + ".join([*terms, *(f"spline({CONDITIONS[c]})" for c in self.splines)])

    def formula(self, scale: ConditionScale, b: Array) -> str | None:
        """An expression of alpha, V and delta_e for a model file; None where the form has splines or sideslip. b: (terms,)."""
        if self.splines or any(powers[CONDITIONS.index("beta_max")] for powers in self.powers):
            return None
        names = [f"(({n} - {c:.6g})/{h:.6g})" for n, c, h in zip(CONDITIONS, scale.centre, scale.half, strict=True)]
        terms = []
        for value, powers in zip(b, self.powers, strict=True):
            factors = [x if n == 1 else f"{x}^{n}" for x, n in zip(names, powers, strict=True) if n]
            terms.append("*".join([f"({value:.8g})", *factors]))
        return " + ".join(terms)


CONSTANT = PolynomialForm(((0,) * len(CONDITIONS),))


def spline_columns(x: Array) -> Array:
    """(points, PIECES + 1) columns of a cubic spline over -1 .. 1 without its straight line; coefficients have one variance."""
    from scipy.interpolate import BSpline

    spacing = 2.0 / PIECES
    knots = -1.0 + spacing * np.arange(-3, PIECES + 4)
    basis = BSpline.design_matrix(np.clip(x, -1.0, 1.0), knots, 3).toarray()
    difference = np.diff(np.eye(PIECES + 3), n=2, axis=0)
    columns: Array = basis @ difference.T @ np.linalg.inv(difference @ difference.T)
    return columns


def larger_forms(form: PolynomialForm, changed: NDArray[np.bool_]) -> Iterator[PolynomialForm]:
    """Forms with one addition: the next power, the product of two conditions in the form, or a spline on a straight line."""
    powers_present = set(form.powers)
    for c in np.flatnonzero(changed).tolist():
        highest = max(p[c] for p in form.powers if sum(p) == p[c])
        if highest < MOST_POWER and c not in form.splines:
            yield replace(form, powers=(*form.powers, _single_power(c, highest + 1)))
        if highest == 1 and c not in form.splines:
            yield replace(form, splines=(*form.splines, c))
        for second_condition in np.flatnonzero(changed[:c]).tolist():
            product = tuple(int(i in (c, second_condition)) for i in range(len(CONDITIONS)))
            if highest and _single_power(second_condition, 1) in powers_present and product not in powers_present:
                yield replace(form, powers=(*form.powers, product))


def _single_power(condition: int, power: int) -> tuple[int, ...]:
    return tuple(power if i == condition else 0 for i in range(len(CONDITIONS)))


def near_flights(points: Array, flights: Array, axes: NDArray[np.intp]) -> NDArray[np.bool_]:
    """(points,) whether a flight (flights, 4) was near a point (points, 4) in all conditions `axes`; both scaled."""
    if not axes.size:
        return np.ones(len(points), bool)
    distance = np.abs(points[:, None, axes] - flights[None, :, axes]).max(axis=2)
    within_reach: NDArray[np.bool_] = distance.min(axis=1) <= 2.0 * NEAR  # the scaled range is 2 wide
    return within_reach
