"""The aerodynamic database: each derivative over angle of attack and airspeed, from the estimates of many flights.

estimate_i = s(alpha_i, V_i) + u_i + e_i: s a polynomial of mean conditions, u differs from flight to flight (variance by
restricted maximum likelihood), e has the flight's corrected bound. The polynomial is chosen by leaving flights out: the one
with fewest terms whose predictions are not clearly worse than the best. Where nobody flew the answer is "not flown".
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from estimation.campaign import pooling
from estimation.campaign.groups import sound_series
from estimation.campaign.tasks import Row

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]

CONDITIONS = ("alpha", "V")
FORMS: tuple[tuple[tuple[int, int], ...], ...] = (
    ((0, 0),),
    ((0, 0), (1, 0)),
    ((0, 0), (0, 1)),
    ((0, 0), (1, 0), (0, 1)),
    ((0, 0), (1, 0), (2, 0)),
    ((0, 0), (0, 1), (0, 2)),
    ((0, 0), (1, 0), (0, 1), (2, 0)),
    ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)),
)
"""Powers of (alpha, V) in each candidate, fewest terms first."""
SPARE_FLIGHTS = 4  # beyond the terms: fewer leave nothing to judge a form by
LEAST_SPREAD = 1e-3  # of a condition, relative to its size: below, it was the same on all flights
GRID = 9  # values of each condition in the table
NEAR = 0.25  # of the range flown in each condition: how near a flight must be for "flown"


@dataclass(frozen=True)
class Surface:
    """A derivative over conditions. centre, half: (2,) that bring alpha [rad] and V [m/s] to -1 .. 1; score: mean logarithm
    of the density that the other flights predicted each flight with."""

    powers: tuple[tuple[int, int], ...]
    centre: Array
    half: Array
    fit: pooling.Pooled
    conditions: Array
    score: float

    def at(self, conditions: Array) -> tuple[Array, Array]:
        """(points,) value and standard error of the surface at (points, 2) alpha and V."""
        X = _terms(self.powers, (conditions - self.centre) / self.half)
        return X @ self.fit.b, np.sqrt(np.einsum("pi,ij,pj->p", X, self.fit.covariance, X))

    def flown(self, conditions: Array) -> NDArray[np.bool_]:
        """(points,) whether a flight was near enough."""
        away = np.abs(conditions[:, None, :] - self.conditions[None, :, :]) / self.half
        near: NDArray[np.bool_] = away.max(axis=2).min(axis=1) <= 2.0 * NEAR  # of a range that is 2 wide here
        return near

    @property
    def formula(self) -> str:
        """An expression of alpha and V that a model file takes."""
        scaled = [
            f"((alpha - {self.centre[0]:.6g})/{self.half[0]:.6g})",
            f"((V - {self.centre[1]:.6g})/{self.half[1]:.6g})",
        ]
        words = []
        for b, powers in zip(self.fit.b, self.powers, strict=True):
            factors = [x if n == 1 else f"{x}^{n}" for x, n in zip(scaled, powers, strict=True) if n]
            words.append("*".join([f"({b:.8g})", *factors]))
        return " + ".join(words)


def fit_surface(y: Array, v: Array, conditions: Array) -> Surface:
    """The form chosen by leaving flights out. y, v: (flights,); conditions: (flights, 2) mean alpha and V, finite.

    Needs SPARE_FLIGHTS more flights than a constant; conditions that did not change are not fitted over.
    """
    low, high = conditions.min(axis=0), conditions.max(axis=0)
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    changed = half > LEAST_SPREAD * np.maximum(np.abs(centre), LEAST_SPREAD)
    half = np.where(changed, half, 1.0)
    x = (conditions - centre) / half
    tried: list[tuple[Surface, Array]] = []
    for powers in FORMS:
        varies = any(n and not c for term in powers for n, c in zip(term, changed, strict=True))
        X = _terms(powers, x)
        if varies or y.size < X.shape[1] + SPARE_FLIGHTS or np.linalg.matrix_rank(X) < X.shape[1]:
            continue
        fit = pooling.pool(y, v, X)
        scores = _left_out(y, v + fit.tau2, X)
        tried.append((Surface(powers, centre, half, fit, conditions, float(scores.mean())), scores))
    best = max(tried, key=lambda t: t[0].score)[1]
    for surface, scores in tried:
        worse = best - scores
        if worse.mean() <= float(worse.std(ddof=1)) / np.sqrt(y.size):
            return surface
    raise ValueError("no form was tried: too few flights")


def _terms(powers: Sequence[tuple[int, int]], x: Array) -> Array:
    return np.column_stack([x[:, 0] ** a * x[:, 1] ** b for a, b in powers])


def _left_out(y: Array, variance: Array, X: Array) -> Array:
    """(flights,) log density of each estimate as the others predict it: residuals over one less the leverage."""
    information = np.linalg.inv((X / variance[:, None]).T @ X)
    leverage = np.einsum("ni,ij,nj->n", X, information, X) / variance
    b = information @ (X.T @ (y / variance))
    spread = variance / (1.0 - leverage)
    scores: Array = -0.5 * np.log(spread) - 0.5 * ((y - X @ b) / (1.0 - leverage)) ** 2 / spread
    return scores


def database_rows(results: "pa.Table", keys: Sequence[str]) -> list[Row]:
    """A grid over the conditions flown for each group, method and parameter with enough flights; outliers left out."""
    runs = results.select(["kind", "key", "manoeuvre", *CONDITIONS]).to_pylist()
    where: Mapping[tuple[str, str], tuple[float | None, float | None]] = {
        (r["key"], r["manoeuvre"] or ""): (r["alpha"], r["V"]) for r in runs if r["kind"] == "run"
    }
    rows: list[Row] = []
    for s in sound_series(results, keys):
        known = np.array([where[p] for p in s.places], float)
        keep = np.isfinite(known).all(axis=1)
        if keep.sum() < 1 + SPARE_FLIGHTS:
            continue
        surface = fit_surface(s.y[keep], s.v[keep], known[keep])
        rows += _grid_rows(surface, {"group": s.label, "method": s.method, "parameter": s.parameter, **s.group})
    return rows


def _grid_rows(surface: Surface, about: Row) -> list[Row]:
    axes = [np.linspace(c - h, c + h, GRID) for c, h in zip(surface.centre, surface.half, strict=True)]
    points = np.array([(a, v) for a in axes[0] for v in axes[1]])
    value, std = surface.at(points)
    half = pooling.t_quantile(1.0 - pooling.LEVEL / 2.0, surface.fit.freedom) * std
    common: Row = {
        **about,
        "flights": len(surface.conditions),
        "between": float(np.sqrt(surface.fit.tau2)),
        "formula": surface.formula,
    }
    return [
        {**common, "alpha": float(a), "V": float(v), "flown": bool(near)}
        | ({"estimate": float(e), "std": float(s), "low": float(e - h), "high": float(e + h)} if near else {})
        for (a, v), near, e, s, h in zip(points, surface.flown(points), value, std, half, strict=True)
    ]
