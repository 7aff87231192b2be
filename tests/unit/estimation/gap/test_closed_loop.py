"""Controls that answer gusts: their gains, their answers, and what an effect seems to gain by them."""

import numpy as np
import pytest

from estimation.gap.fit.baseline import Baseline, fit_baseline
from estimation.gap.fit.spectra import Linear
from estimation.gap.records.flight_records import prepare_flights
from estimation.gap.significance import measured_again
from estimation.gap.significance.closed_loop import answer, feedback_of
from estimation.gap.significance.measured_again import MeasuredAgain
from estimation.gap.significance.transients import EventKind, possible_events
from estimation.gap.workflow import Options, _setting
from groundstation.flight import Flight
from tests.unit.estimation.gap.roll import ROLL

DEG = np.pi / 180
GAIN = -0.05  # s, of the aileron by roll rate
OPTIONS = Options(seed=1, nulls=10)


def rolling(seed: int, gust: float, gain: float = GAIN) -> Flight:
    """30 s of roll by doublets in gusts of rms `gust` [rad/s2] that the aileron answers by `gain`: p' = -6 p + 40 da + g."""
    rng = np.random.default_rng(seed)
    p, arm, g, rows = 0.0, 0.0, 0.0, []
    for k in range(30_000):
        t = 1e-3 * k
        doublet = 0.05 * (np.floor((t % 5.0) / 0.4) == 1) - 0.05 * (np.floor((t % 5.0) / 0.4) == 2)
        if k % 50 == 0:
            rows.append((p, arm))
        arm += 1e-3 / 0.035 * (doublet + gain * p - arm)
        g += -1e-3 / 0.3 * g + gust * np.sqrt(2e-3 / 0.3) * rng.standard_normal()
        p += 1e-3 * (-6.0 * p + 40.0 * arm + g)
    rates, arms = np.array(rows).T
    columns = {
        "p": rates + 0.2 * DEG * rng.standard_normal(rates.size),
        "delta_a": arms + 0.05 * DEG * rng.standard_normal(arms.size),
    }
    return Flight.build(f"roll{seed}", 0.05 * np.arange(rates.size), columns)


def fitted(gust: float, gain: float = GAIN) -> Baseline:
    flights = [rolling(seed, gust, gain) for seed in (51, 52, 53)]
    prepared = prepare_flights(ROLL, (), flights, (), OPTIONS.criteria, keep_feedback=True)
    setting = _setting(prepared, (), {}, {}, {}, OPTIONS, lambda what, share: None)
    return fit_baseline(setting.working, setting.clean, setting.prepared, setting.scatter)


@pytest.fixture(scope="module")
def gusty() -> Baseline:
    return fitted(1.5)


def test_gains_of_an_aileron_that_follows_roll_rate_and_none_of_one_that_does_not(gusty: Baseline) -> None:
    gains = feedback_of(gusty.problem.records, ROLL)["delta_a"]
    assert gains.sum() == pytest.approx(GAIN, rel=0.25)
    alone = fitted(1.5, gain=0.0)
    assert abs(feedback_of(alone.problem.records, ROLL).get("delta_a", np.zeros(2)).sum()) < 0.1 * abs(GAIN)


def test_a_constant_disturbance_settles_where_the_closed_loop_has_it() -> None:
    """x = d + (b/a) u and u = k x: x = d/(1 - k b/a)."""
    a, b, k, d = 2.0, 3.0, -0.4, 0.7
    one = np.ones((1, 1))
    linear = Linear(-a * one, b * one, one, 0.0 * one, ("delta_a",), 0.05, np.ones(1))
    answers = answer(np.full((400, 1), d), linear, {"delta_a": np.array([0.75 * k, 0.25 * k])})
    assert answers[0, 0] == pytest.approx(k * d)
    assert answers[-1, 0] == pytest.approx(k * d / (1.0 - k * b / a), rel=1e-6)


def test_a_loop_that_grows_without_limit_answers_nothing() -> None:
    one = np.ones((1, 1))
    linear = Linear(2.0 * one, 3.0 * one, one, 0.0 * one, ("delta_a",), 0.05, np.ones(1))
    assert not answer(np.full((400, 1), 0.1), linear, {"delta_a": np.array([0.5, 0.0])}).any()


def test_controls_answer_gusts_only_where_there_are_gusts_and_feedback(gusty: Baseline) -> None:
    assert MeasuredAgain(gusty, 1).answers_gusts
    for gust, gain in ((0.02, GAIN), (1.5, 0.0)):
        again = MeasuredAgain(fitted(gust, gain), 1)
        assert not again.answers_gusts
        assert again.closed_loop == ()


def test_flights_with_answers_have_the_noise_of_the_flights_and_controls_that_moved(gusty: Baseline) -> None:
    again = MeasuredAgain(gusty, 1)
    assert len(again.closed_loop) > measured_again.REPEATS // 2
    limits = [w.energy(r) for w, r in zip(gusty.problem.whiteners, gusty.fit.residuals, strict=True)]
    for simulated in again.closed_loop:
        assert sum(r.energy for r in simulated) == pytest.approx(sum(limits), rel=0.3)
    moved = np.std([r.inputs[:, 0] - gusty.problem.coarse[0].u[:, 0] for r, *_ in again.closed_loop])
    assert moved > 0.2 * DEG


def test_bursts_are_no_events_where_they_are_not_asked(gusty: Baseline) -> None:
    kinds = [{e.kind for e in possible_events(gusty.problem, bursts).events} for bursts in (True, False)]
    assert EventKind.BURST not in kinds[1]
    assert {EventKind.DRIFT, EventKind.SLIP} <= kinds[0] & kinds[1]
