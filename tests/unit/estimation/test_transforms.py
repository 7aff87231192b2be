"""Play and lag of an input, all samples at once, against the same followed sample by sample; delays against finer records."""

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


INTERVAL, FINER = 0.05, 100
TIME = INTERVAL * np.arange(200)
STEPS = 0.1 * np.repeat(np.random.default_rng(7).choice([-1.0, 0.0, 1.0], 20), 10)
DELAY, LAG = FUNCTIONS["delay"][0], FUNCTIONS["lag"][0]


@pytest.mark.parametrize("intervals", [-1.0, 0.0, 1.0])
def test_a_delay_has_one_slope_on_both_sides_of_whole_intervals(intervals: float) -> None:
    """A fit of a delay that is nearly none does not settle on a kink."""
    at, little = intervals * INTERVAL, 1e-6
    middle, later, earlier = (DELAY(TIME, STEPS, at + s) for s in (0.0, little, -little))
    assert np.abs((later - middle) - (middle - earlier)).max() < 1e-3 * np.abs(later - middle).max()


@pytest.mark.parametrize("intervals", [-0.5, 0.1, 0.5, 1.5])
def test_what_follows_a_delayed_input_is_late_by_that(intervals: float) -> None:
    """Behind two lags, against the record moved on a grid a hundred times as fine; straight lines are .0035 off half-way."""
    fine = INTERVAL / FINER * np.arange(FINER * (TIME.size - 1) + 1)
    moved = np.interp(fine - intervals * INTERVAL, TIME, STEPS)
    expected = LAG(fine, LAG(fine, moved, 0.5), 0.3)[::FINER]
    reached = LAG(TIME, LAG(TIME, DELAY(TIME, STEPS, intervals * INTERVAL), 0.5), 0.3)
    assert np.sqrt(np.mean((reached - expected)[5:-5] ** 2)) < 0.002 * expected.std()


@pytest.mark.parametrize("count", [1, 2, 40])
def test_a_delay_of_nothing_is_the_record(count: int) -> None:
    time, value = course(count)
    np.testing.assert_allclose(DELAY(time, value, 0.0), value, rtol=1e-14)
