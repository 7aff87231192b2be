"""The pooled value of a meta-analysis by its closed forms, correlated estimates, and what the search ends at."""

import numpy as np
import pytest
from scipy.optimize import minimize

from estimation.campaign import pooling
from estimation.campaign.aerodynamics.mixed import MixedData, MixedDesign, fit, replicates


def constant(known: np.ndarray) -> MixedDesign:
    """One mean for each parameter."""
    return MixedDesign.from_columns([np.ones((len(known), 1))] * known.shape[1], [(-1,)] * known.shape[1], known)


def one(y: np.ndarray, v: np.ndarray) -> MixedData:
    return MixedData(y[:, None], v[:, None, None], np.ones((y.size, 1), bool))


def test_equal_bounds_give_the_closed_form_of_a_random_effects_mean(rng: np.random.Generator) -> None:
    """Where all bounds are equal every estimator of a meta-analysis (DerSimonian and Laird's, Paule and Mandel's that
    statsmodels' combine_effects iterates, restricted likelihood) is s^2 - v, the mean and s / sqrt(n)."""
    y, v = -0.4 + 0.03 * rng.standard_normal(12), 0.01**2
    found = fit(one(y, np.full(12, v)), constant(np.ones((12, 1), bool)))
    assert found.tau2[0] == pytest.approx(y.var(ddof=1) - v, rel=1e-4)
    assert found.b[0] == pytest.approx(y.mean(), rel=1e-9)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(y.std(ddof=1) / np.sqrt(12), rel=1e-4)


def test_at_its_own_variance_it_is_the_formula_of_combine_effects(rng: np.random.Generator) -> None:
    """statsmodels: weights 1 / (v + tau2), mean sum(w y) / sum(w), and with Hartung and Knapp's scale q / (n - 1)."""
    v = rng.uniform(0.005, 0.02, 25) ** 2
    y = -0.4 + rng.standard_normal(25) * np.sqrt(v + 0.015**2)
    found = fit(one(y, v), constant(np.ones((25, 1), bool)))
    w = 1.0 / (v + found.tau2[0])
    mean = float(np.sum(w * y) / np.sum(w))
    scale = max(1.0, float(np.sum(w * (y - mean) ** 2)) / 24)
    assert found.b[0] == pytest.approx(mean, rel=1e-9)
    assert found.covariance[0, 0] == pytest.approx(scale / np.sum(w), rel=1e-9)
    old = pooling.pool(y, v)
    assert found.tau2[0] == pytest.approx(old.tau2, rel=1e-3)
    assert found.freedom[0] == pytest.approx(24.0)


def test_no_variance_between_flights_is_found_where_bounds_explain_the_scatter() -> None:
    y = np.array([-0.40, -0.41, -0.39, -0.402, -0.398])
    found = fit(one(y, np.full(5, 0.02**2)), constant(np.ones((5, 1), bool)))
    assert found.tau2[0] == 0.0
    assert found.covariance[0, 0] == pytest.approx(0.02**2 / 5, rel=1e-6)


def correlated(rng: np.random.Generator) -> MixedData:
    """Thirty flights of two parameters, correlated 0.8; five flights tell the first alone."""
    V = np.array([[1.0, 0.8], [0.8, 1.0]]) * rng.uniform(0.5, 2.0, 30)[:, None, None]
    e = np.einsum("nij,nj->ni", np.linalg.cholesky(V), rng.standard_normal((30, 2)))
    y = np.array([3.0, -2.0]) + e + rng.standard_normal((30, 2)) * np.array([0.7, 0.4])
    known = np.ones((30, 2), bool)
    known[25:, 1] = False
    y[25:, 1] = np.nan
    return MixedData(y, V, known)


def test_two_correlated_parameters_are_as_one_long_regression(rng: np.random.Generator) -> None:
    """The same likelihood written with one dense covariance of all numbers, and searched by another method."""
    data = correlated(rng)
    found = fit(data, constant(data.known))
    place = [(i, j) for i in range(30) for j in range(2) if data.known[i, j]]
    y = np.array([data.y[p] for p in place])
    X = np.array([[float(j == 0), float(j == 1)] for _, j in place])

    def dense(tau2: np.ndarray) -> np.ndarray:
        S = np.array([[data.V[i, j, k] + tau2[j] * (j == k) if i == h else 0.0 for h, k in place] for i, j in place])
        return S

    def cost(log_tau2: np.ndarray) -> float:
        S = dense(np.exp(log_tau2))
        inverse = np.linalg.inv(S)
        A = X.T @ inverse @ X
        r = y - X @ np.linalg.solve(A, X.T @ inverse @ y)
        return float(np.linalg.slogdet(S)[1] + np.linalg.slogdet(A)[1] + r @ inverse @ r)

    best = minimize(cost, np.log([0.3, 0.3]), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-10})
    assert found.tau2 == pytest.approx(np.exp(best.x), rel=1e-3, abs=1e-4)
    inverse = np.linalg.inv(dense(found.tau2))
    A = np.linalg.inv(X.T @ inverse @ X)
    assert found.b == pytest.approx(A @ X.T @ inverse @ y, rel=1e-9)
    assert np.all(np.diag(found.covariance) >= np.diag(A) * (1.0 - 1e-9))
    assert found.covariance[0, 1] / np.sqrt(found.covariance[0, 0] * found.covariance[1, 1]) == pytest.approx(
        A[0, 1] / np.sqrt(A[0, 0] * A[1, 1])
    )


def test_distance_of_a_flight_is_from_what_the_others_say(rng: np.random.Generator) -> None:
    """Left out for good: the others' mean and its error, at the same variances."""
    v = rng.uniform(0.5, 2.0, 10)
    y = rng.standard_normal(10) * np.sqrt(v + 1.0)
    data = one(y, v)
    found = fit(data, constant(data.known))
    w = 1.0 / (v + found.tau2[0])
    rest = np.arange(10) != 3
    mean = np.sum((w * y)[rest]) / np.sum(w[rest])
    spread = 1.0 / w[3] + 1.0 / np.sum(w[rest])
    assert found.left_out(data.known)[3] == pytest.approx((y[3] - mean) ** 2 / spread)
    assert found.scores()[3] == pytest.approx(-0.5 * np.log(spread) - 0.5 * (y[3] - mean) ** 2 / spread)


def test_flights_drawn_again_scatter_as_the_covariance_says(rng: np.random.Generator) -> None:
    v = rng.uniform(0.5, 2.0, 200)
    x = rng.uniform(-1.0, 1.0, 200)
    data = one(1.0 + 2.0 * x + rng.standard_normal(200) * np.sqrt(v + 0.5), v)
    design = MixedDesign.from_columns([np.column_stack([np.ones(200), x])], [(-1, -1)], data.known)
    found = fit(data, design)
    drawn = replicates(data, design, found, 400, rng)
    assert drawn.std(axis=0) == pytest.approx(np.sqrt(np.diag(found.covariance)), rel=0.2)
