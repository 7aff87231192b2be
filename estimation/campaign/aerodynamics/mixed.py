"""All parameters of many flights in one mixed model: y_i = X_i b + u_i + e_i, by restricted maximum likelihood.

y_i: (k,) estimates of one flight; e_i: their errors, of known full corrected covariance V_i; u_i: differences between flights,
of one variance for each parameter; b: coefficients of the forms, those of a spline random with a common variance. Restricted
likelihood after Henderson's equations (Searle, Casella and McCulloch, Variance Components, 1992, ch. 7). With one parameter and a
constant this is `pooling.pool`, the random-effects mean of a meta-analysis.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.flight import Array

Mask = NDArray[np.bool_]

LEAST, MOST = 1e-7, 1e7  # bounds of the search, in units of a flight's variance; the least stands for none
NEGLIGIBLE = 1e-2  # of a flight's variance: a smaller one is set to none where the likelihood is no lower
ROUNDS = 60  # of the search, which ends after 10 to 20
FIRST_GUESS = 0.1  # least variance to start from, in units of a flight's variance


@dataclass(frozen=True)
class MixedData:
    """y: (flights, k) estimates; V: (flights, k, k) covariances; known: (flights, k), which parameters each flight has."""

    y: Array
    V: Array
    known: Mask

    def part(self, keep: Mask) -> "MixedData":
        return MixedData(self.y[keep], self.V[keep], self.known[keep])

    def one(self, parameter: int) -> "MixedData":
        """One parameter by itself, with all flights, known or not."""
        j = slice(parameter, parameter + 1)
        return MixedData(self.y[:, j], self.V[:, j, j], self.known[:, j])


@dataclass(frozen=True)
class MixedDesign:
    """X: (flights, k, p), rows of unknown parameters zero; owner: (p,) index of the parameter of each column; penalty: (p,) -1
    for a free column, else index of its spline variance."""

    X: Array
    owner: NDArray[np.intp]
    penalty: NDArray[np.intp]

    @classmethod
    def from_columns(cls, columns: Sequence[Array], penalties: Sequence[Sequence[int]], known: Mask) -> "MixedDesign":
        """From the columns (flights, terms) and penalties of each parameter's form. known: (flights, k)."""
        count = sum(c.shape[1] for c in columns)
        X = np.zeros((*known.shape, count))
        owner, penalty = np.zeros(count, np.intp), np.zeros(count, np.intp)
        first, splines = 0, 0
        for j, (c, column_penalties) in enumerate(zip(columns, penalties, strict=True)):
            place = slice(first, first + c.shape[1])
            X[:, j, place] = c * known[:, j, None]
            owner[place] = j
            penalty[place] = [p if p < 0 else p + splines for p in column_penalties]
            first, splines = place.stop, splines + 1 + max(column_penalties)
        return cls(X, owner, penalty)

    @property
    def splines(self) -> int:
        return int(self.penalty.max(initial=-1)) + 1

    def part(self, keep: Mask) -> "MixedDesign":
        return MixedDesign(self.X[keep], self.owner, self.penalty)


@dataclass(frozen=True)
class MixedFit:
    """b: (p,) coefficients; covariance: (p, p), Bayesian for splines, with Knapp and Hartung's factor of each parameter; tau2:
    (k,) variances between flights; smooth: (splines,) variances of spline coefficients; S: (flights, k, k) covariance of a
    flight's estimates about the curves; H: its part from the error of the coefficients; residual: (flights, k); freedom: (k,)."""

    b: Array
    covariance: Array
    tau2: Array
    smooth: Array
    S: Array
    H: Array
    residual: Array
    freedom: Array

    def left_out(self, known: Mask) -> Array:
        """(flights,) squared distance of each flight from the fit to the others: chi-square of as many as it has parameters."""
        middle = np.where(known[:, :, None] & known[:, None, :], self.S - self.H, np.eye(known.shape[1]))
        r = np.where(known, self.residual, 0.0)
        distance: Array = np.einsum("nk,nk->n", r, np.linalg.solve(middle, r[:, :, None])[:, :, 0])
        return distance

    def scores(self) -> Array:
        """(flights,) log density of each flight as predicted by the others, for a fit of one parameter."""
        s, predictive_share = self.S[:, 0, 0], (self.S - self.H)[:, 0, 0]
        density: Array = -0.5 * np.log(s**2 / predictive_share) - 0.5 * self.residual[:, 0] ** 2 / predictive_share
        return density


def fit(data: MixedData, design: MixedDesign, start: Array | None = None) -> MixedFit:
    """The fit of largest restricted likelihood, for more flights than free terms. start: (k + splines,) variances to start
    from."""
    from scipy.optimize import minimize

    data, unit = _scaled(data)
    size = data.y.shape[1]
    default_start = np.concatenate(
        [_first_guess(data, design), np.full(design.splines, FIRST_GUESS * np.maximum(1.0, np.var(data.y)))]
    )
    begin = (
        default_start
        if start is None
        else np.maximum(start / np.concatenate([unit, _spline_units(unit, design)]) ** 2, LEAST)
    )

    def cost(log_variances: Array) -> tuple[float, Array]:
        variances = np.exp(log_variances)
        value, slope = _likelihood(data, design, variances[:size], variances[size:])
        return value, slope * variances

    bounds = [(np.log(LEAST), np.log(MOST))] * begin.size
    minimum = minimize(
        cost, np.log(begin), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": ROUNDS, "ftol": 1e-10}
    )
    variances = np.exp(minimum.x)
    reduced_variances = np.where(variances < NEGLIGIBLE, LEAST, variances)
    # towards zero the likelihood is flat, so that the search ends long before it gets there
    if cost(np.log(reduced_variances))[0] <= minimum.fun:
        variances = reduced_variances
    tau2 = np.where(variances[:size] > LEAST, variances[:size], 0.0)
    return _in_units(_fit_at(data, design, tau2, variances[size:]), unit, design)


def predicted(mixed_fit: MixedFit, columns: Array, owner: NDArray[np.intp], parameter: int) -> tuple[Array, Array]:
    """(points,) value and standard error of one parameter; columns: (points, terms) of its form."""
    place = np.flatnonzero(owner == parameter)
    C = mixed_fit.covariance[np.ix_(place, place)]
    return columns @ mixed_fit.b[place], np.sqrt(np.maximum(np.einsum("pi,ij,pj->p", columns, C, columns), 0.0))


def replicates(
    data: MixedData, design: MixedDesign, mixed_fit: MixedFit, count: int, rng: np.random.Generator
) -> Array:
    """(at most count, p) coefficients of bootstrapped flights with the variances of `mixed_fit`: a check of its covariance."""
    X, y = design.X, np.where(data.known, data.y, 0.0)
    weighted = inverses(mixed_fit.S, data.known) @ X
    prior = np.diag([0.0 if p < 0 else 1.0 / mixed_fit.smooth[p] for p in design.penalty])
    flight_counts = rng.multinomial(len(y), np.full(len(y), 1.0 / len(y)), size=count)
    free = design.penalty < 0
    replicate_b = np.full((count, X.shape[2]), np.nan)
    for number, times in enumerate(flight_counts):
        A = np.einsum("n,nkp,nkq->pq", times, weighted, X) + prior
        if np.linalg.matrix_rank(A[np.ix_(free, free)]) == free.sum():  # a draw may hold too few different flights
            replicate_b[number] = np.linalg.solve(A, np.einsum("n,nkp,nk->p", times, weighted, y))
    return replicate_b[np.isfinite(replicate_b[:, 0])]


# ------------------------------------------------------------------------------------------------------ inside


def _scaled(data: MixedData) -> tuple[MixedData, Array]:
    """The data with each parameter in units of its median bound, so that variances are near one; and (k,) these units."""
    bounds = np.where(data.known, np.sqrt(np.diagonal(data.V, axis1=1, axis2=2)), np.nan)
    unit = np.nanmedian(bounds, axis=0)
    y = np.where(data.known, data.y, 0.0) / unit
    V = np.where(data.known[:, :, None] & data.known[:, None, :], data.V, 0.0) / np.outer(unit, unit)
    return MixedData(y, V, data.known), unit


def _first_guess(data: MixedData, design: MixedDesign) -> Array:
    """(k,) variances between flights by the scatter about plain least squares."""
    guess = np.full(data.y.shape[1], FIRST_GUESS)
    for j in range(guess.size):
        rows = data.known[:, j]
        X = design.X[rows, j][:, (design.owner == j) & (design.penalty < 0)]
        b, *_ = np.linalg.lstsq(X, data.y[rows, j], rcond=None)
        excess = float(np.mean((data.y[rows, j] - X @ b) ** 2) - np.mean(data.V[rows, j, j]))
        guess[j] = max(guess[j], excess)
    return guess


def inverses(S: Array, known: Mask) -> Array:
    """(flights, k, k) inverses of S over the known parameters of each flight, zero elsewhere."""
    pair_known = known[:, :, None] & known[:, None, :]
    padded = np.where(pair_known, S, np.eye(S.shape[1]))
    inverse: Array = np.where(pair_known, np.linalg.inv(padded), 0.0)
    return inverse


def _solved(data: MixedData, design: MixedDesign, tau2: Array, smooth: Array) -> tuple[Array, ...]:
    """S, W, W X, A, A^-1, b, residual at given variances."""
    S = data.V + np.where(data.known, tau2, 0.0)[:, :, None] * np.eye(tau2.size)
    W = inverses(S, data.known)
    WX = W @ design.X
    count = design.X.shape[2]
    A = design.X.reshape(-1, count).T @ WX.reshape(-1, count)
    A[np.diag_indices(count)] += [0.0 if p < 0 else 1.0 / smooth[p] for p in design.penalty]
    inverse: Array = np.asarray(np.linalg.inv(A), np.float64)
    b: Array = inverse @ np.einsum("nkp,nk->p", WX, data.y)
    residual: Array = np.where(data.known, data.y - design.X @ b, 0.0)
    return S, W, WX, A, inverse, b, residual


def _likelihood(data: MixedData, design: MixedDesign, tau2: Array, smooth: Array) -> tuple[float, Array]:
    """Minus the restricted log likelihood without its constant, and its slope (k + splines,) over the variances."""
    S, W, WX, A, inverse, b, residual = _solved(data, design, tau2, smooth)
    padded = np.where(data.known[:, :, None] & data.known[:, None, :], S, np.eye(tau2.size))
    Wr = np.einsum("nkl,nl->nk", W, residual)
    sizes = np.bincount(design.penalty[design.penalty >= 0], minlength=smooth.size) if smooth.size else np.zeros(0)
    squares, traces = np.zeros(smooth.size), np.zeros(smooth.size)
    for s in range(smooth.size):
        spline_columns = design.penalty == s
        squares[s], traces[s] = np.sum(b[spline_columns] ** 2), np.sum(np.diag(inverse)[spline_columns])
    value = 0.5 * float(
        np.linalg.slogdet(padded)[1].sum()
        + np.linalg.slogdet(A)[1]
        + np.sum(sizes * np.log(smooth))
        + np.sum(residual * Wr)
        + np.sum(squares / smooth)
    )
    explained = np.einsum("nkp,pq,nkq->k", WX, inverse, WX, optimize=True)
    between_slope = 0.5 * (np.einsum("nkk->k", W) - explained - np.sum(Wr**2, axis=0))
    return value, np.concatenate([between_slope, 0.5 * (sizes / smooth - (traces + squares) / smooth**2)])


def _fit_at(data: MixedData, design: MixedDesign, tau2: Array, smooth: Array) -> MixedFit:
    S, W, _, _, inverse, b, residual = _solved(data, design, tau2, smooth)
    H = np.einsum("nkp,pq,nlq->nkl", design.X, inverse, design.X, optimize=True)
    freedom_used = np.einsum("nkl,nlk->k", W, H)
    freedom = np.maximum(data.known.sum(axis=0) - freedom_used, 1.0)
    spread = np.where(data.known, np.einsum("nkk->nk", S), 1.0)
    factor = np.sqrt(np.maximum(1.0, np.sum(residual**2 / spread, axis=0) / freedom))[design.owner]
    return MixedFit(b, inverse * np.outer(factor, factor), tau2, smooth, S, H, residual, freedom)


def _in_units(mixed_fit: MixedFit, unit: Array, design: MixedDesign) -> MixedFit:
    """The fit in the parameters' units. unit: (k,) of each parameter."""
    of_b, two = unit[design.owner], np.outer(unit, unit)
    smooth = mixed_fit.smooth * _spline_units(unit, design) ** 2
    return MixedFit(
        mixed_fit.b * of_b,
        mixed_fit.covariance * np.outer(of_b, of_b),
        mixed_fit.tau2 * unit**2,
        smooth,
        mixed_fit.S * two,
        mixed_fit.H * two,
        mixed_fit.residual * unit,
        mixed_fit.freedom,
    )


def _spline_units(unit: Array, design: MixedDesign) -> Array:
    """(splines,) unit of the parameter that each spline is of."""
    return np.array([unit[design.owner[design.penalty == s][0]] for s in range(design.splines)])
