"""A step function down the rows of a table: compiled and interpreted alike, and right."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from estimation.engine.compiled import CHUNK, Chain
from estimation.engine.compiled_library import compiler


def filter_step() -> ca.Function:
    """A scalar filter with its variance: x + k (z - x), as a Kalman filter of a random walk has it."""
    s, row, fixed = ca.SX.sym("s", 2), ca.SX.sym("row", 2), ca.SX.sym("fixed", 2)
    spread = s[1] + fixed[0]
    gain = row[1] * spread / (spread + fixed[1])
    after = s[0] + gain * (row[0] - s[0])
    return ca.Function(
        "walk", [s, row, fixed], [ca.vertcat(after, (1 - gain) * spread), ca.vertcat(after, ca.log(spread))]
    )


def by_hand(start: np.ndarray, rows: np.ndarray, fixed: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    x, variance = start
    out = []
    for z, known in rows:
        spread = variance + fixed[0]
        gain = known * spread / (spread + fixed[1])
        x, variance = x + gain * (z - x), (1 - gain) * spread
        out.append((x, np.log(spread)))
    return np.array(out)


@pytest.fixture(params=["compiled", "interpreted"])
def chain(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Chain:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    if request.param == "interpreted":
        monkeypatch.setenv("SIDESLIP_COMPILER", "none")
    elif compiler() is None:
        pytest.skip("no C compiler here")
    made = Chain(filter_step())
    assert (made._compiled is None) == (request.param == "interpreted")
    return made


@pytest.mark.parametrize("count", [1, 7, CHUNK, CHUNK + 1, 3 * CHUNK - 5])
def test_as_by_hand_whatever_the_number_of_rows(chain: Chain, count: int) -> None:
    rng = np.random.default_rng(count)
    rows = np.column_stack([rng.normal(size=count), rng.integers(0, 2, count)])
    start, fixed = np.array([0.3, 2.0]), np.array([0.01, 0.5])
    np.testing.assert_allclose(chain.run(start, rows, fixed), by_hand(start, rows, fixed), rtol=1e-12, atol=1e-14)


def test_ends_at_the_row_that_is_not_finite(chain: Chain) -> None:
    rows = np.ones((40, 2))
    rows[25, 0] = np.inf
    out = chain.run(np.array([0.0, 1.0]), rows, np.array([0.1, 0.1]))
    assert len(out) == 26
    assert np.isfinite(out[:25]).all()
