"""Rules by which something does not fit: thresholds from nulls, nameless signals, repeatability, the kinematic check."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import gumbel_r, kurtosis

from daq.utilities.constants import GRAVITY
from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment
from estimation.gap.criteria import AS_SET
from estimation.gap.effects.base import EffectParameter
from estimation.gap.fit.spikes import beside_neighbours
from estimation.gap.significance.calibration import (
    like_the_flights,
    null_inflation,
    significant_above,
    unknown_above,
)
from estimation.gap.significance.instruments import kinematic_model, origin_of_error
from estimation.gap.significance.measure import Floors, usual_and_limit
from estimation.gap.significance.nulls import heavy_tails
from estimation.gap.significance.omnibus import (
    OmnibusSignal,
    beside_others,
    energy_with_activity,
    pooled,
    restless_times,
    standardised,
    summed_up,
    window_energy,
)
from estimation.gap.significance.screen import HypothesisColumn, Projected, Screen, one_sided
from tests.unit.estimation.gap.roll import ROLL


def stub(**fields: Any) -> Any:
    """As much of a round, problem or hypothesis as a rule looks at."""
    return SimpleNamespace(**fields)


GRID = (np.arange(4000) + 0.5) / 4000
LARGEST = np.asarray(gumbel_r.ppf(GRID, loc=3.0, scale=0.3))  # largest scores of nulls, exactly of that law


# ------------------------------------------------------------------------------------------------ tails of the noise
TAILED = 600  # samples


def tails_of(values: Array) -> tuple[Array | None, ...]:
    segment = Segment(0, 0.05 * np.arange(TAILED), np.zeros((TAILED, 1)), np.zeros((TAILED, 1)), np.zeros(1))
    return heavy_tails(stub(model=ROLL, coarse=[segment], criteria=AS_SET), stub(residuals=[values[:, None]]))


def with_kurtosis(wanted: float) -> Array:
    """Noise whose distances from its neighbours have an excess kurtosis."""
    white, low, high = np.random.default_rng(3).standard_normal(TAILED), 0.0, 1.0
    for _ in range(60):
        bend = 0.5 * (low + high)
        values = white + bend * white**3
        low, high = (bend, high) if kurtosis(beside_neighbours(values)) < wanted else (low, bend)
    return values


@pytest.mark.parametrize(("tails", "heavy"), [(0.85, False), (1.15, True)])
def test_noise_of_heavy_tails_is_simulated_with_them(tails: float, heavy: bool) -> None:
    (quantiles,) = tails_of(with_kurtosis(tails))
    assert (quantiles is not None) is heavy
    if quantiles is not None:
        assert np.std(quantiles) == pytest.approx(1.0)
        assert kurtosis(quantiles) == pytest.approx(tails, abs=0.01)


# ------------------------------------------------------------------------------------------------ nulls that ran away
def test_nulls_with_a_seventh_more_energy_than_the_flights_ran_away() -> None:
    energy = np.array([3000.0, *np.linspace(2800.0, 3090.0, 30), 3400.0, 3500.0, 9e4])
    assert like_the_flights(energy, AS_SET).tolist() == [True] * 31 + [False, False]
    assert like_the_flights(energy[:31], AS_SET).all()  # nothing is left out of ordinary ones


def test_where_hardly_a_null_stays_all_of_them_count() -> None:
    few = np.array([3000.0, *[2900.0] * 16, *[9e4] * 84])
    assert np.count_nonzero(like_the_flights(few, AS_SET)) == 16
    assert like_the_flights(np.array([3000.0, *[2900.0] * 14, *[9e4] * 86]), AS_SET).all()
    assert like_the_flights(np.array([3000.0, *[2900.0] * 25, *[9e4] * 75]), AS_SET).sum() == 25
    assert like_the_flights(np.array([3000.0, 9e4, 9e4]), AS_SET).all()


def test_a_screen_without_some_nulls_is_what_it_would_have_been_without_them() -> None:
    rng = np.random.default_rng(4)
    columns = rng.standard_normal((60, 3 + 2 + 1 + 5))  # shared, hypotheses, the flights, nulls
    kept = np.array([True, False, True, True, False])
    index = np.flatnonzero(np.concatenate([np.ones(6, dtype=bool), kept]))
    parameter = EffectParameter("x", "1", 1.0, -9.0, 9.0)
    hypotheses = (HypothesisColumn(0, parameter), HypothesisColumn(1, parameter))
    whole, fewer = (
        Screen(("a", "b", "c"), (), hypotheses, (c.T @ c,), np.eye(c.shape[1]), (0,))
        for c in (columns, columns[:, index])
    )
    np.testing.assert_allclose(whole.with_nulls(kept).projected().scores(), fewer.projected().scores(), rtol=1e-12)
    np.testing.assert_allclose(whole.with_nulls(kept).projected().energy, fewer.projected().energy, rtol=1e-12)


# ------------------------------------------------------------------------------------------------ thresholds
SIGNIFICANT = 1.25 * (3.0 - 0.3 * np.log(-np.log(0.975)))


def test_significant_is_a_quarter_more_than_one_set_of_nulls_in_forty_shows() -> None:
    assert significant_above(LARGEST, AS_SET) == pytest.approx(SIGNIFICANT, abs=0.005)


def test_a_nameless_signal_or_an_event_is_unknown_a_third_above_one_set_of_nulls_in_a_hundred() -> None:
    signals = [OmnibusSignal("term", "p", "beta", 4.0), OmnibusSignal("time", "r", "burst", 6.0)]
    omnibus = summed_up(signals, LARGEST, AS_SET)
    assert omnibus.threshold == pytest.approx(1.3 * (3.0 - 0.3 * np.log(-np.log(0.99))), abs=0.005)
    assert omnibus.threshold == unknown_above(LARGEST, AS_SET)
    assert omnibus.score == 6.0
    assert [s.place for s in omnibus.leading] == ["r", "p"]
    assert omnibus.significant
    assert not summed_up([], LARGEST, AS_SET).significant


def test_the_scatter_on_nulls_inflates_and_never_deflates() -> None:
    b = np.concatenate([np.zeros((2, 1)), np.array([[3.0, -3.0], [0.5, -0.5]])], axis=1)
    projected = Projected(np.eye(2), b, np.zeros(3), np.ones(2))
    screen = stub(hypotheses=(1, 2), projected=lambda: projected, span=lambda h: [h])
    assert null_inflation(screen, 2) == pytest.approx([9.0, 1.0])


@pytest.mark.parametrize(("lower", "one"), [(-0.14, True), (-0.16, False)])
def test_an_effect_that_can_hardly_go_the_other_way_has_one_sign(lower: float, one: bool) -> None:
    assert one_sided(EffectParameter("x", "1", 2.0, 2.0 * lower, 9.0), 0.0, AS_SET) is one


@pytest.mark.parametrize(("gap", "covered"), [(0.974, True), (0.976, False)])
def test_a_gap_is_nothing_where_39_of_40_nulls_leave_as_much(gap: float, covered: bool) -> None:
    assert Floors(np.linspace(0.0, 1.0, 1001), np.zeros(0), AS_SET).covers(gap) is covered


# ------------------------------------------------------------------------------------------------ the kinematic check
def test_gyros_and_accelerometer_are_believed_to_their_usual_errors() -> None:
    model = kinematic_model(AS_SET)
    names = ("bias_gyro_p", "bias_gyro_r", "scale_gyro_p", "scale_gyro_r", "bias_accelerometer_y")
    assert [model.parameter(n).prior_std for n in names] == pytest.approx([0.02, 0.02, 0.02, 0.02, 0.02 * GRAVITY])


@pytest.mark.parametrize(("score", "origin"), [(4.1, "sensor"), (3.9, "physics")])
def test_an_instrument_error_above_its_threshold_is_a_sensor_s(score: float, origin: str) -> None:
    hypotheses = (stub(label="gyro_scale"), stub(label="beta_lag"))
    round_ = stub(threshold=4.0, standardised=lambda: np.array([1.0, score]), screen=stub(hypotheses=hypotheses))
    found = origin_of_error(round_)
    assert (found.origin, found.best, found.score) == (origin, "beta_lag", score)


def test_without_an_instrument_to_ask_the_check_is_undecided() -> None:
    assert origin_of_error(stub(threshold=4.0, standardised=lambda: np.zeros(0))).origin == "undecided"


# ------------------------------------------------------------------------------------------------ nameless signals
@pytest.mark.parametrize(("left", "seen"), [(0.9e-3, False), (1.1e-3, True)])
def test_a_term_that_the_base_absorbs_says_nothing(left: float, seen: bool) -> None:
    projected = Projected(np.array([[left]]), np.array([[1.0, 0.01, -0.01]]), np.zeros(3), np.ones(1))
    z, standard = standardised(projected, AS_SET)
    assert z[0, 0] == pytest.approx(1.0 / np.sqrt(left))
    assert bool(standard[0, 0] > 0.0) is seen


def test_a_nameless_term_has_one_size_in_quiet_and_in_busy_records() -> None:
    """Of unit rms in each, what gusts make of a quiet record would count as a manoeuvre."""
    busy, quiet = np.array([3.0, -3.0, 3.0, -3.0]), np.array([0.1, -0.1])
    first, second = pooled(
        [{("p", "linear"): busy, ("r", "even"): 0.0 * busy}, {("p", "linear"): quiet, ("r", "even"): 0.0 * quiet}]
    )
    assert np.abs(first["p", "linear"]).max() / np.abs(second["p", "linear"]).max() == pytest.approx(30.0)
    whole = np.concatenate([first["p", "linear"], second["p", "linear"]])
    assert np.sqrt(np.mean(whole**2)) == pytest.approx(1.0)
    assert ("r", "even") not in first


def test_energy_is_looked_at_second_by_second() -> None:
    rng = np.random.default_rng(0)
    time = 0.05 * np.arange(400)
    series = rng.standard_normal((400, 1, 41))
    series[200:220, :, 0] *= 8.0  # from 10 to 11 s
    problem = stub(
        criteria=AS_SET, coarse=[stub(time=time)], records=[stub(flight=2)], model=stub(output_names=("beta",))
    )
    signals, largest = restless_times(problem, [series], 40)
    assert signals[0].span == pytest.approx((10.0, 10.95))
    assert (signals[0].flight, signals[0].place) == (2, "beta")
    assert signals[0].score > largest.max()


def test_window_energy_is_standardised_on_the_nulls_of_the_same_window() -> None:
    series = np.ones((20, 1, 4))
    series[:, :, 0], series[:, :, 1], series[:, :, 3] = np.e, np.exp(-0.5), np.exp(0.5)
    energy, z = window_energy(series, 10)
    assert energy[:, 0, 0] == pytest.approx([2.0, 2.0])
    assert z[:, 0, 0] == pytest.approx(2.0 / np.std([-1.0, 0.0, 1.0]))


@pytest.mark.parametrize(("wrong", "event"), [([4, 5], False), (range(4, 9), True)])
def test_two_wrong_values_in_a_second_are_no_event_and_five_are(wrong: Sequence[int], event: bool) -> None:
    """Two values of eight deviations, side by side, are found by no test of single ones, and were an unknown effect."""
    series = np.random.default_rng(5).standard_normal((20, 1, 201))
    series[list(wrong), 0, 0] = 8.0
    _, z = window_energy(series, 20)
    assert bool(z[0, 0, 0] > 5.0) is event


def test_a_null_is_measured_by_the_scatter_of_the_others() -> None:
    values = np.random.default_rng(3).standard_normal((2, 41))
    found = beside_others(values)
    for row, distances in zip(values, found, strict=True):
        assert distances[0] == pytest.approx((row[0] - row[1:].mean()) / row[1:].std())
        for i in range(1, 41):
            others = np.delete(row[1:], i - 1)
            assert distances[i] == pytest.approx((row[i] - others.mean()) / others.std())


def scatter_with(activity: float, white: float) -> float:
    """What one sample of that activity and whitened size adds, the 99 others still and quiet."""
    active, series = np.zeros(100), np.zeros((100, 1))
    active[7], series[7] = activity, white
    return float(energy_with_activity(active, series, AS_SET)[0])


def test_activity_and_energy_of_single_samples_count_up_to_a_limit() -> None:
    assert scatter_with(2.0, 3.0) == pytest.approx(2.0 * 0.99 * 9.0)
    assert scatter_with(50.0, 1.0) == pytest.approx(3.0 * 0.99)
    assert scatter_with(1.0, 50.0) == pytest.approx(0.99 * 9.0)


# ------------------------------------------------------------------------------------------------ repeatability
def test_a_flight_does_not_repeat_the_others_where_that_is_significant_on_the_nulls() -> None:
    nulls = np.array([LARGEST, np.full(LARGEST.size, np.median(LARGEST))]) / np.median(LARGEST)  # usual 1 and 1
    usual, limit = usual_and_limit(np.array([2.0, 3.0])[:, None] * nulls, AS_SET)
    assert usual == pytest.approx([2.0, 3.0])
    assert limit == pytest.approx(usual * significant_above(np.maximum(nulls[0], 1.0), AS_SET), rel=1e-6)


def test_largest_scores_are_of_the_law_the_tests_believe() -> None:
    values: Array = LARGEST
    assert float(np.std(values)) == pytest.approx(0.3 * np.pi / np.sqrt(6.0), rel=0.01)
