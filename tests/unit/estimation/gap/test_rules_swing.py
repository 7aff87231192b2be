"""Something that swings: the oscillator as numbers and as text, what is asked, and the whole answer."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimation.gap.answer.result import GapVerdict
from estimation.gap.answer.shape import SwingingTerm
from estimation.gap.answer.words import describe_swing
from estimation.gap.criteria import AS_SET
from estimation.gap.decision.beside import DAMPING as DAMPING_NAME
from estimation.gap.decision.beside import FREQUENCY, as_fitted, hypothesis_of
from estimation.gap.decision.decide import Decision, as_unknown
from estimation.gap.effects import catalogue
from estimation.gap.fit.baseline import fit_baseline
from estimation.gap.records.flight_records import prepare_flights
from estimation.gap.shapes.lag_swing import DAMPING, SLOWEST, find_swing, frequencies, oscillator, rings
from estimation.gap.shapes.places import ModelMotion, Place, rank
from estimation.gap.shapes.search import alone
from estimation.gap.significance.calibration import screen_round
from estimation.gap.workflow import Options, _setting, run_gap
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth

FOUND = SwingingTerm("Cm", {"q_dot": 2e-3, "ax": -1e-3}, 9.0, 0.05, 300.0, 8.6, 3.4)


# ------------------------------------------------------------------------------------------------ the oscillator
@pytest.mark.parametrize(("frequency", "damping"), [(2.0, 0.02), (9.0, 0.1), (25.0, 0.4)])
def test_an_oscillator_answers_a_ramp_as_the_textbook_says(frequency: float, damping: float) -> None:
    """x'' + 2 z w x' + w^2 x = w^2 s t from rest: s (t - 2z/w + exp(-z w t) (2z/w cos v t + (2z^2 - 1)/v sin v t))."""
    time = 0.025 * np.arange(400)
    v = frequency * np.sqrt(1.0 - damping**2)
    die = np.exp(-damping * frequency * time)
    rings_on = 2 * damping / frequency * np.cos(v * time) + (2 * damping**2 - 1) / v * np.sin(v * time)
    expected = 7.0 + 3.0 * (time - 2 * damping / frequency + die * rings_on)
    assert oscillator(7.0 + 3.0 * time, time, frequency, damping) == pytest.approx(expected, abs=1e-9)


def test_frequencies_asked_are_between_a_swing_in_three_seconds_and_half_of_what_samples_show() -> None:
    fine = 0.025 * np.arange(1201)  # 20 Hz, and an instant between every two samples
    asked = frequencies(fine)
    assert asked[0] == SLOWEST
    assert 0.8 * 0.5 * np.pi * 20.0 < asked[-1] <= 0.5 * np.pi * 20.0
    width = 2.0 * DAMPING  # of a resonance at half its power, over its frequency
    assert np.all(np.diff(asked) / asked[:-1] <= width + 1e-9)
    assert frequencies(0.25 * np.arange(200))[0] == SLOWEST  # 2 Hz shows hardly one


@pytest.mark.parametrize(("score", "unknown"), [(5.5, False), (5.7, True)])
def test_a_swing_with_nothing_else_left_is_unknown_where_it_is_strong(score: float, unknown: bool) -> None:
    """Quantised instruments gave one of 3.90 with nothing hidden, of a threshold of 3.73; fuel and booms that swing 10 to 14."""
    assert alone(replace(FOUND, score=score, threshold=3.73), AS_SET) is unknown


@pytest.mark.parametrize(("gain", "unknown"), [(8.5, False), (9.5, True)])
def test_a_swing_that_gains_no_more_than_chance_is_none(gain: float, unknown: bool) -> None:
    """Multisines with nothing hidden gave one of 4.83 of 2.69 on the nulls that gained 4.0 (twice a log-likelihood)."""
    assert alone(replace(FOUND, gain=gain), AS_SET) is unknown


@pytest.mark.parametrize(("damping", "swings"), [(0.02, True), (0.49, True), (0.51, False), (0.8, False)])
def test_what_is_damped_by_more_than_half_of_critical_does_not_swing(damping: float, swings: bool) -> None:
    assert rings(damping, AS_SET) is swings


# ------------------------------------------------------------------------------------------------ as text of a model
@pytest.mark.parametrize("model", ["longitudinal", "six-dof"])
def test_a_swing_is_text_that_a_model_can_take(model: str) -> None:
    flown: Any = SimpleNamespace(scale={"Cm": 2e-3}, reach=lambda name: 4.0)
    hypothesis, start = hypothesis_of(FOUND, flown)
    made = hypothesis.form.added_to(load_model(model, "cdfp"), start)
    assert "nameless_swing" in made.definitions["Cm"]
    assert made.starts()[FREQUENCY] == 9.0
    assert made.starts()["nameless_swing_ax"] == -1e-3
    assert "nameless_swing_q_dot*q_dot + nameless_swing_ax*ax" in made.definitions["nameless_swing_rate_dot"]


def test_a_swing_that_a_fit_damps_away_or_stops_at_a_limit_is_none_and_a_runaway_fit_says_nothing() -> None:
    fit: Any = SimpleNamespace(
        diverged=False,
        values={"nameless_swing_q_dot": 1e-3, "nameless_swing_ax": 2e-3, FREQUENCY: 8.5, DAMPING_NAME: 0.06},
        std=lambda: {FREQUENCY: 0.04, DAMPING_NAME: 0.01},
    )
    fitted = as_fitted(FOUND, fit, AS_SET)
    assert isinstance(fitted, SwingingTerm)
    assert (fitted.frequency, fitted.damping, fitted.frequency_std, fitted.by["ax"]) == (8.5, 0.06, 0.04, 2e-3)
    inside = fit.values
    for there in ({DAMPING_NAME: 0.6}, {DAMPING_NAME: 0.005}, {FREQUENCY: 18.0}, {FREQUENCY: 4.5}):  # FOUND at 9 rad/s
        fit.values = {**inside, **there}
        assert as_fitted(FOUND, fit, AS_SET) is None
    fit.diverged = True
    assert as_fitted(FOUND, fit, AS_SET) is FOUND


# ------------------------------------------------------------------------------------------------ the answer
def test_a_swing_is_told_with_its_frequency_and_without_a_name() -> None:
    shape = replace(FOUND, frequency_std=0.0314, damping_std=0.004)
    assert isinstance(shape, SwingingTerm)
    told = shape.to_json()
    assert (told["kind"], told["nameless"], told["output"]) == ("swing", True, "Cm")
    assert told["variables"] == ["q_dot", "ax"]
    assert (told["frequency"], told["frequency_std"], told["damping"]) == (9.0, 0.0314, 0.05)
    assert "swinging at 1.43 +- 0.005 Hz with a damping of 0.05, driven by q_dot and ax" in describe_swing(shape)
    bare = FOUND
    assert "swinging at 1.4 Hz with" in describe_swing(bare)


def test_a_swing_alone_makes_an_answer_unknown() -> None:
    assert as_unknown(Decision(GapVerdict.NO_GAP, 0, ())) == Decision(GapVerdict.UNKNOWN, 0, ())


def flights(effects: dict[str, float], seed: int) -> list[Flight]:
    """Three pitching flights with fuel that swings, or without."""
    asked = [
        truth.Request(seed + i, v, effects, manoeuvres="longitudinal") for i, v in enumerate((14.5, 16.5, 19.0, 17.0))
    ]
    return [
        Flight.build(f"f{i}", c["time"], {k: v for k, v in c.items() if k != "time"})
        for i, c in enumerate(truth.fly(asked))
    ]


# what looks like fuel that swings; all of them are asked by the benchmark
NEAR = ("thrust_z", "thrust_tilt", "propwash_CL", "propwash_elevator", "Cm_alphadot", "imu_x", "elevator_lag", "gust")


def test_a_part_of_a_coefficient_changes_the_outputs_as_a_small_step_of_it_does() -> None:
    model, options = load_model("longitudinal", "cdfp"), Options(seed=1, nulls=40)
    near = tuple(e for e in catalogue(model=model) if e.name in NEAR)
    prepared = prepare_flights(model, near, flights({}, 5200)[:2], (), options.criteria)
    setting = _setting(prepared, near, {}, {}, {}, options, lambda what, share: None)
    baseline = fit_baseline(setting.working, setting.clean, setting.prepared, setting.scatter)
    flown = ModelMotion.of(baseline.problem, baseline.fit)
    course = oscillator(flown.courses[1]["q_dot"], flown.segments[1].time, 9.0, 0.05)
    course /= np.abs(course).max()
    (linear,) = flown.changes(1, [("Cm", course)])
    step, segment, own = 0.05 * flown.scale["Cm"], flown.segments[1], baseline.fit.locals[1]
    shaken = segment.u.copy()
    shaken[:, flown.simulator.model.input_names.index("increment_Cm")] += step * course
    values = {**baseline.fit.values, **own.parameters}
    two = [flown.simulator.run_by_middles(replace(segment, u=u), values, own.x0).y for u in (shaken, segment.u)]
    secant = (two[0] - two[1])[:, : linear.shape[1]] / step
    assert np.abs(linear - secant).max() < 0.01 * np.abs(secant).max()
    round_ = screen_round(baseline, setting.prepared, near, setting.errors, 40, 1)
    assert find_swing(flown, round_) is None  # nothing swings in these
    # with the engine off a thrust multiplies nothing; its columns were no numbers, and no product stood out of such nulls
    off = replace(flown, courses=tuple({**c, "V": np.zeros_like(c["V"])} for c in flown.courses))
    products = rank(off, round_, [Place("Cm", "alpha", True, True, by) for by in ("V", "delta_e")])
    assert [p.by for p in products.places] == ["delta_e"]
    assert np.isfinite(products.scores).all()
    assert 0.0 < products.threshold < 10.0


def test_fuel_that_swings_is_no_thrust_line() -> None:
    """Fuel at 9 rad/s, moved by thrust: followed slowly it is a thrust line 5 mm too high that closes four fifths."""
    four = flights({"pitch_slosh": 1.0}, 5210)
    model = load_model("longitudinal", "cdfp")
    near = tuple(e for e in catalogue(model=model) if e.name in NEAR)
    result = run_gap(model, four[:3], four[3:], near, Options(seed=1, nulls=20))
    assert result.verdict is GapVerdict.UNKNOWN
    assert [s.effect for s in result.steps] == ["unknown"]
    shape = result.steps[0].shape
    assert isinstance(shape, SwingingTerm)
    assert shape.line == "Cm"
    assert shape.frequency_std is not None
    assert abs(shape.frequency - 9.0) < 0.2 + 2.0 * shape.frequency_std
    assert shape.damping < 0.15
