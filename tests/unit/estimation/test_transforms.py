"""Play and lag of an input, all samples at once, against the same followed sample by sample."""

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.engine.transforms import FUNCTIONS


def course(count: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(count)
    return np.cumsum(rng.uniform(0.02, 0.06, count)), np.cumsum(0.1 * rng.standard_normal(count))


@pytest.mark.parametrize("count", [1, 2, 3, 40, 601])
@pytest.mark.parametrize("width", [0.0, 0.05, 5.0])
def test_play_is_taken_up_sample_by_sample(count: int, width: float) -> None:
    time, value = course(count)
    expected, now = [], value[0]
    for u in value:
        now = min(max(now, u - 0.5 * width), u + 0.5 * width)
        expected.append(now)
    np.testing.assert_array_equal(FUNCTIONS["backlash"][0](time, value, width), expected)


@pytest.mark.parametrize("count", [1, 2, 3, 40, 601])
@pytest.mark.parametrize("seconds", [0.0, 0.001, 0.03, 3.0])
def test_a_lag_follows_ramps_exactly(count: int, seconds: float) -> None:
    """e = u' - (u - T du/dt) dies away with exp(-t/T) while the input runs straight."""
    time, value = course(count)
    expected = [value[0]]
    for k in range(count - 1):
        slope = (value[k + 1] - value[k]) / (time[k + 1] - time[k])
        left = np.exp(-(time[k + 1] - time[k]) / seconds) if seconds else 0.0
        begin, end = value[k] - seconds * slope, value[k + 1] - seconds * slope
        expected.append(end + left * (expected[-1] - begin))
    np.testing.assert_allclose(FUNCTIONS["lag"][0](time, value, seconds), expected, atol=1e-12)
