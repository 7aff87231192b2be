"""A step inside limits against a general solver, the conditions of its optimum, and closed forms."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from estimation.estimators.normal_equations import solved, step_within


def test_a_free_optimum_inside_the_box_is_the_free_step() -> None:
    rng = np.random.default_rng(1)
    columns = rng.normal(size=(40, 6))
    information, gradient = columns.T @ columns, rng.normal(size=6)
    wide = np.full(6, 1e3)
    assert step_within(information, gradient, -wide, wide) == pytest.approx(solved(information, gradient), rel=1e-12)


def test_two_correlated_unknowns_of_which_one_is_at_its_limit() -> None:
    """Minimum of x'Hx/2 - g'x over x0 <= 0.5 by hand: x0 = 0.5, x1 = (g1 - H10 x0) / H11."""
    information, gradient = np.array([[2.0, 1.9], [1.9, 2.0]]), np.array([3.0, 1.0])
    high = np.array([0.5, 10.0])
    found = step_within(information, gradient, np.array([-10.0, -10.0]), high)
    assert found == pytest.approx([0.5, (1.0 - 1.9 * 0.5) / 2.0])
    cut = np.minimum(solved(information, gradient), high)
    assert gradient @ found - 0.5 * found @ information @ found > gradient @ cut - 0.5 * cut @ information @ cut + 1.0


@pytest.mark.parametrize("seed", range(60))
def test_as_a_general_solver_finds_it(seed: int) -> None:
    """lsq_linear by bounded-variable least squares (Stark and Parker 1995), columns nearly dependent and of any units."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 25))
    units = 10.0 ** rng.uniform(-3, 3, n)
    columns = (rng.normal(size=(80, n)) + 3.0 * rng.normal(size=(80, 1))) * units
    right = columns @ (rng.normal(size=n) / units) + rng.normal(size=80)
    low, high = -rng.uniform(0, 1.0, n) / units, rng.uniform(0, 1.0, n) / units
    low[rng.uniform(size=n) < 0.2] = 0.0  # begins at its limit
    high[rng.uniform(size=n) < 0.2] = np.inf
    found = step_within(columns.T @ columns, columns.T @ right, low, high)
    assert np.all((low <= found) & (found <= high))
    expected = lsq_linear(columns, right, (low, np.where(high == low, high + 1e-300, high)), method="bvls", tol=1e-14)
    ours = 0.5 * float(np.sum((columns @ found - right) ** 2))
    assert ours <= expected.cost * (1 + 1e-9) + 1e-9


def test_what_the_data_do_not_see_stays() -> None:
    information = np.diag([1.0, 0.0, 4.0])
    found = step_within(information, np.array([1.0, 0.0, 8.0]), np.full(3, -1.0), np.full(3, 1.0))
    assert found == pytest.approx([1.0, 0.0, 1.0])


def test_nothing_to_step() -> None:
    empty = np.zeros(0)
    assert step_within(np.zeros((0, 0)), empty, empty, empty).shape == (0,)
