"""Pooled estimates of many flights: y = X b + u + e, a random-effects model.

y: one estimate a flight; e: its error, of known variance v (the corrected bound squared); u: difference of the flight from the
others, of variance tau2 >= 0 by restricted maximum likelihood (Viechtbauer 2005, J. Educ. Behav. Stat. 30, 261-293). Standard
errors after Knapp and Hartung (2003, Stat. Med. 22, 2693-2710), never below those of known variances.
"""

from dataclasses import dataclass

import numpy as np

from groundstation.flight import Array

LEVEL = 0.05
"""Two-sided, of every test and interval here."""
WANTED_POWER = 0.8  # of a difference that is called detectable: the usual convention
ROBUST = 1.4826  # standard deviation of a normal variable over its median absolute deviation
CERTAIN = 30.0  # standard errors from which a difference is found for certain; scipy's noncentral t fails out there
ONE_SIDED = 3.0  # standard errors from which the other tail is below 1e-7; scipy often gives nan for it


@dataclass(frozen=True)
class Pooled:
    """b: (terms,); covariance: (terms, terms) with Knapp and Hartung's factor; tau2: variance between flights; q, p: Cochran's
    statistic for no variance between flights, and its probability; freedom: flights less terms."""

    b: Array
    covariance: Array
    tau2: float
    q: float
    p: float
    freedom: int

    @property
    def std(self) -> Array:
        deviation: Array = np.sqrt(np.diag(self.covariance))
        return deviation

    def interval(self, term: int = 0) -> tuple[float, float]:
        """95 % interval of one term."""
        half = t_quantile(1.0 - LEVEL / 2.0, self.freedom) * float(self.std[term])
        return float(self.b[term]) - half, float(self.b[term]) + half

    def probability(self, term: int) -> float:
        """Two-sided probability of an estimate this large of a term that is zero."""
        return two_sided(float(self.b[term] / self.std[term]), self.freedom)


def pool(y: Array, v: Array, X: Array | None = None) -> Pooled:
    """Weighted regression with variance between flights. y, v: (flights,), v > 0; X: (flights, terms), ones by default.

    Needs more flights than terms.
    """
    from scipy.special import chdtrc

    X = np.ones((y.size, 1)) if X is None else X
    freedom = y.size - X.shape[1]
    tau2 = restricted_variance(y, v, X)
    b, known_covariance, residual = _weighted(y, v + tau2, X)
    factor = max(1.0, float(np.sum(residual**2 / (v + tau2))) / freedom)
    _, _, fixed = _weighted(y, v, X)
    q = float(np.sum(fixed**2 / v))
    return Pooled(b, factor * known_covariance, tau2, q, float(chdtrc(freedom, q)), freedom)


def _weighted(y: Array, v: Array, X: Array) -> tuple[Array, Array, Array]:
    """Coefficients, their covariance for known variances v, residuals."""
    root = 1.0 / np.sqrt(v)
    covariance: Array = np.linalg.inv((X * root[:, None] ** 2).T @ X).astype(np.float64)
    b: Array = covariance @ (X.T @ (y * root**2))
    return b, covariance, y - X @ b


def restricted_likelihood(tau2: Array, y: Array, v: Array, X: Array) -> Array:
    """(candidates,) logarithms of the restricted likelihood, without its constant, at (candidates,) values of tau2."""
    w = 1.0 / (v + tau2[:, None])
    information = np.einsum("gn,ni,nj->gij", w, X, X)
    b = np.linalg.solve(information, np.einsum("gn,ni,n->gi", w, X, y)[:, :, None])[:, :, 0]
    residual = y - b @ X.T
    likelihood: Array = 0.5 * (
        np.log(w).sum(axis=1) - np.linalg.slogdet(information)[1] - np.sum(w * residual**2, axis=1)
    )
    return likelihood


def restricted_variance(y: Array, v: Array, X: Array) -> float:
    """tau2 at the largest restricted likelihood: the best of zero and a logarithmic grid, then refined; zero where that is best.

    The grid is in units of the mean of v plus the variance of y.
    """
    from scipy.optimize import minimize_scalar

    scale = float(np.mean(v)) + float(np.var(y))
    # steps of a quarter decade: the likelihood is smooth
    grid = np.concatenate([[0.0], scale * np.logspace(-8, 1, 37)])
    best_index = int(np.argmax(restricted_likelihood(grid, y, v, X)))
    if best_index == 0:
        return 0.0
    ends = float(grid[best_index - 1]), float(grid[min(best_index + 1, grid.size - 1)])
    refined = minimize_scalar(
        lambda t: -float(restricted_likelihood(np.array([t]), y, v, X)[0]),
        bounds=ends,
        method="bounded",
        options={"xatol": 1e-9 * scale},
    )
    return float(refined.x)


def outliers(y: Array, v: Array) -> Array:
    """(flights,) distance of each estimate from the median, in bounds widened to the scatter of the middle half."""
    z = (y - np.median(y)) / np.sqrt(v)
    scale = max(1.0, ROBUST * float(np.median(np.abs(z))))  # sound bounds need no widening
    distance: Array = np.abs(z) / scale
    return distance


def outlier_limit(flights: int) -> float:
    """Distance that one of this many sound flights exceeds with probability LEVEL."""
    return t_quantile(1.0 - LEVEL / (2.0 * flights), max(1, flights - 1))


def two_sided(t: float, freedom: int) -> float:
    """Probability of a Student's t beyond +-|t|."""
    from scipy.special import stdtr

    return float(2.0 * stdtr(freedom, -abs(t)))


def detectable(std: float, freedom: int, tests: int = 1) -> float:
    """The least difference found with WANTED_POWER at LEVEL, corrected for this many tests. std: of the difference."""
    return std * (t_quantile(1.0 - LEVEL / (2.0 * tests), freedom) + t_quantile(WANTED_POWER, freedom))


def power(difference: float, std: float, freedom: int, tests: int = 1) -> float:
    """Probability that a true difference is found at LEVEL, corrected for this many tests. std: of the difference."""
    from scipy.special import nctdtr

    limit, size = t_quantile(1.0 - LEVEL / (2.0 * tests), freedom), abs(difference) / std
    if size > CERTAIN:
        return 1.0
    other_tail = nctdtr(freedom, size, -limit) if size < ONE_SIDED else 0.0
    return float(1.0 - nctdtr(freedom, size, limit) + other_tail)


def t_quantile(probability: float, freedom: int) -> float:
    """Quantile of Student's t."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, probability))
