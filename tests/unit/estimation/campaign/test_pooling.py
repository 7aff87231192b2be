"""Pooling against closed forms, a brute-force likelihood, published numbers and many seeds."""

import numpy as np
import pytest
from scipy import stats

from estimation.campaign import pooling

EFFECTS = np.array([0.1, 0.3, 0.35, 0.65, 0.45, 0.15])
EQUAL = np.full(6, 0.01)


def test_with_equal_variances_the_variance_between_flights_is_that_of_the_sample_less_the_bound() -> None:
    fit = pooling.pool(EFFECTS, EQUAL)
    assert fit.tau2 == pytest.approx(EFFECTS.var(ddof=1) - 0.01, rel=1e-6)
    assert fit.b[0] == pytest.approx(EFFECTS.mean(), rel=1e-12)
    assert fit.std[0] == pytest.approx(EFFECTS.std(ddof=1) / np.sqrt(6), rel=1e-6)


def test_without_variance_between_flights_it_is_the_weighted_mean() -> None:
    y, v = np.array([1.0, 1.1, 0.9, 1.02]), np.array([0.04, 0.09, 0.01, 0.25])
    fit = pooling.pool(y, v)
    w = 1.0 / v
    assert fit.tau2 == 0.0
    assert fit.b[0] == pytest.approx(np.sum(w * y) / np.sum(w), rel=1e-12)
    assert fit.std[0] == pytest.approx(1.0 / np.sqrt(np.sum(w)), rel=1e-12)
    assert fit.q == pytest.approx(np.sum(w * (y - fit.b[0]) ** 2), rel=1e-12)
    assert fit.p == pytest.approx(stats.chi2.sf(fit.q, 3), rel=1e-9)


def test_with_unequal_variances_no_other_variance_is_more_likely(rng: np.random.Generator) -> None:
    v = rng.uniform(0.01, 0.3, 15)
    y = 2.0 + rng.standard_normal(15) * np.sqrt(v + 0.1)
    X = np.column_stack([np.ones(15), np.arange(15.0)])
    fit = pooling.pool(y, v, X)

    def density(tau2: float) -> float:
        """The restricted likelihood as the density of contrasts free of X, by scipy."""
        contrasts = np.linalg.svd(X)[0][:, 2:]
        covariance = contrasts.T @ np.diag(v + tau2) @ contrasts
        return float(stats.multivariate_normal(np.zeros(13), covariance).logpdf(contrasts.T @ y))

    others = np.linspace(0.0, 1.0, 2001)
    assert (
        abs(fit.tau2 - others[int(np.argmax([density(t) for t in others]))]) < 6e-4
    )  # half a step of the grid and a little


def test_intervals_cover_what_they_say_whatever_differs_between_flights() -> None:
    rng = np.random.default_rng(5)
    covered, runs = {0.0: 0, 0.3: 0}, 300
    for between in covered:
        for _ in range(runs):
            v = rng.uniform(0.01, 0.1, 8)
            y = 1.0 + rng.standard_normal(8) * np.sqrt(v + between**2)
            low, high = pooling.pool(y, v).interval()
            covered[between] += low < 1.0 < high
    assert 0.93 * runs < covered[0.3] < 0.98 * runs
    assert covered[0.0] > 0.94 * runs  # never narrower than known variances allow, so a little wide here


def test_power_is_the_share_of_differences_found() -> None:
    rng = np.random.default_rng(6)
    n, std = 10, 0.05
    X = np.column_stack([np.ones(2 * n), np.repeat([0.0, 1.0], n)])
    v = np.full(2 * n, std**2)
    error = std * np.sqrt(2.0 / n)
    difference = pooling.detectable(error, 2 * n - 2)
    assert pooling.power(difference, error, 2 * n - 2) == pytest.approx(0.8, abs=0.02)
    found = 0
    for _ in range(300):
        y = X @ [1.0, difference] + std * rng.standard_normal(2 * n)
        found += pooling.pool(y, v, X).probability(1) < pooling.LEVEL
    assert 0.7 * 300 < found < 0.9 * 300
    assert pooling.power(0.0, error, 18) == pytest.approx(pooling.LEVEL, rel=1e-6)
    assert pooling.power(10.0, error, 18) == 1.0


def test_power_is_a_number_at_every_size_and_rises_to_one() -> None:
    """Against draws of Student's noncentral distribution at one size."""
    sizes = np.linspace(0.0, 40.0, 400)
    for freedom in (5, 37, 38, 40, 200):
        found = np.array([pooling.power(float(s), 1.0, freedom, 3) for s in sizes])
        assert np.all(np.diff(found) > -1e-6)
        assert found[0] == pytest.approx(pooling.LEVEL / 3, rel=1e-6)
        assert found[-1] == pytest.approx(1.0)
    rng = np.random.default_rng(1)
    t = (rng.standard_normal(200_000) + 2.6) / np.sqrt(rng.chisquare(12, 200_000) / 12)
    limit = pooling.t_quantile(1.0 - pooling.LEVEL / 6, 12)
    assert pooling.power(2.6, 1.0, 12, 3) == pytest.approx(np.mean(np.abs(t) > limit), abs=0.005)
    assert pooling.power(pooling.detectable(1.0, 200, 3), 1.0, 200, 3) == pytest.approx(0.8, abs=0.01)
