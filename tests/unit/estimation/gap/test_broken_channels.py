"""Channels that are dead or stuck on a flight, and held-out flights that are unlike the others: no answer may pass over them."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.gap.answer.result import Gap, GapVerdict
from estimation.gap.answer.words import conclude, describe_not_predicted, describe_step
from estimation.gap.criteria import AS_SET
from estimation.gap.decision import unnamed
from estimation.gap.decision.unnamed import held_out_step, not_predicted
from estimation.gap.effects import catalogue
from estimation.gap.fit.linear_motion import rms_measured
from estimation.gap.pages.report import next_steps
from estimation.gap.records.channels import (
    broken_in_words,
    compared,
    dead_everywhere,
    not_compared,
    unmoved_in_words,
    without_stuck,
)
from estimation.gap.significance.measure import odd_flights, repeatability
from estimation.gap.workflow import Options, run_gap
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import flights, requests

LATERAL = load_model("lateral", "cdfp")
TIME: Array = np.arange(400) / 20.0
MOVING = ("p", "r", "phi", "beta", "ay", "delta_a", "delta_r", "V", "alpha", "rho")


def moving(name: str, still: tuple[str, ...] = (), stuck: tuple[str, ...] = ()) -> Flight:
    """Noise of its own on every channel, but for those that stand still all the time, or from 12 s on."""
    columns = {}
    for k, column in enumerate(MOVING):
        noise = np.random.default_rng([k, len(name)]).standard_normal(TIME.size)
        columns[column] = 10.0 + 0.1 * noise
        if column in still:
            columns[column] = np.full(TIME.size, 0.5)
        if column in stuck:
            columns[column][TIME >= 12.0] = columns[column][240]
    return Flight.build(name, TIME, columns)


def words(*flown: Flight) -> list[str]:
    return broken_in_words(flown, LATERAL)


def test_a_dead_output_is_named_with_its_flights() -> None:
    assert words(moving("a"), moving("bb")) == []
    assert words(moving("a", ("beta",)), moving("bb"), moving("ccc", ("beta",))) == [
        "beta stands still on a and ccc: a dead channel, not compared there"
    ]
    assert words(moving("a", ("p",)), moving("bb", ("p",))) == [
        "p stands still on every flight: a dead channel, not compared there"
    ]


def test_an_input_that_is_dead_on_one_flight_is_named_and_one_that_nobody_moved_is_not() -> None:
    assert words(moving("a", ("delta_a",)), moving("bb")) == [
        "delta_a stands still on a and moves elsewhere: is its sensor dead there?"
    ]
    unmoved = moving("a", ("delta_r",)), moving("bb", ("delta_r",))
    assert words(*unmoved) == []
    assert unmoved_in_words(unmoved, LATERAL).startswith("delta_r never moved: nothing is known")
    assert unmoved_in_words((unmoved[0], moving("bb")), LATERAL) == ""


@pytest.mark.parametrize(("column", "what"), [("beta", "not compared there"), ("delta_a", "those times are left out")])
def test_what_a_channel_shows_while_it_is_stuck_is_no_measurement(column: str, what: str) -> None:
    given = moving("a", stuck=(column,))
    assert words(given) == [f"{column} is stuck on a (between 12.0 and 19.9 s at {given[column][240]:.3g}): {what}"]
    read = without_stuck(given, MOVING)
    assert np.array_equal(np.isnan(read[column]), TIME >= 12.0)
    for other in set(MOVING) - {column}:
        np.testing.assert_array_equal(read[other], given[other])
    sound = moving("a")
    assert without_stuck(sound, MOVING) is sound


def test_a_model_is_not_compared_in_what_is_dead_on_every_flight() -> None:
    flown = [moving("a", ("beta",)), moving("bb", ("beta",))]
    model, _ = compared(LATERAL, flown)
    assert "beta" not in model.output_names
    assert not_compared(LATERAL, model) == "Not measured, and so not compared: beta."
    assert compared(LATERAL, [flown[0], moving("bb")])[0] == LATERAL
    dead = tuple(s.source for s in LATERAL.outputs)
    assert dead_everywhere(LATERAL, [moving("a", dead)]) == [], "that is for the fit to refuse"


def test_nothing_stands_out_of_a_channel_that_a_record_did_not_measure() -> None:
    """Its scatter had been no number, and with it what a surface does to the outputs."""
    values = np.array([[3.0, np.nan, np.nan], [4.0, np.nan, 2.0]])
    assert rms_measured(values).tolist() == [np.sqrt(12.5), np.inf, 2.0]


# ------------------------------------------------------------------------------------------------ held-out flights


def judged(monkeypatch: pytest.MonkeyPatch, gap: float) -> Any:
    """Of a held-out record with that gap, where nothing hidden leaves up to 2; off in its second output from 5 to 8 s."""
    residuals = np.full((TIME.size, 2), 0.1)
    residuals[(TIME >= 5.0) & (TIME <= 8.0), 1] = 5.0
    monkeypatch.setattr(unnamed, "rms_over_noise", lambda *a: gap)
    monkeypatch.setattr(unnamed, "plain_residuals", lambda *a: residuals)
    problem = SimpleNamespace(records=[SimpleNamespace(flight=3, time=TIME)])
    fit = SimpleNamespace(diverged=False, residuals=[residuals])
    model = SimpleNamespace(output_names=("p", "beta"))
    baseline = SimpleNamespace(held_out=(problem, fit), scatter=np.ones(2), criteria=AS_SET, model=model)
    prepared = SimpleNamespace(names=("f0", "f1", "f2", "f3"))
    floor = SimpleNamespace(highest=2.0, holdout_median=1.5, criteria=AS_SET)
    return not_predicted(*cast(Any, (baseline, prepared, floor)))


def test_a_held_out_flight_is_unlike_the_others_half_as_far_again_as_nothing_hidden(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    farthest = 2.0 * AS_SET.another_flight
    assert judged(monkeypatch, farthest) is None
    found = judged(monkeypatch, farthest + 0.01)
    assert (found.flight, found.channels, found.highest) == ("f3", ("beta",), 2.0)
    ((start, end),) = found.segments
    assert (start, end) == pytest.approx((5.0, 8.0), abs=0.6)


def test_without_held_out_flights_nothing_is_said_of_them() -> None:
    baseline = SimpleNamespace(held_out=None)
    assert not_predicted(*cast(Any, (baseline, None, None))) is None


def test_the_words_on_such_a_flight_say_which_where_and_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    found = judged(monkeypatch, 9.0)
    floor = cast(Any, SimpleNamespace(highest=2.0, holdout_median=1.5, criteria=AS_SET))
    step = held_out_step(found, Gap(1.2, 1.2, 1.2), floor)
    text = describe_step(replace(step, text=""))
    assert text.startswith(
        "The training flights show nothing, but the model does not predict the held-out f3: a gap of 9"
    )
    assert "mostly in beta, for example at" in text
    assert "Look at the instruments" in text
    form = json.loads(json.dumps(step.to_json()))["form"]
    assert (form["kind"], form["flight"], form["gap"], form["highest"]) == ("held_out", "f3", 9.0, 2.0)
    page = cast(Any, SimpleNamespace(steps=(step,), verdict=GapVerdict.UNKNOWN))
    assert next_steps(page) == ["Look at the instruments and the configuration of f3, or hold another flight out."]
    beside = conclude(GapVerdict.CANNOT_TELL, (), {}, (), (), True, unlike=describe_not_predicted(found))
    assert "And the model does not predict the held-out f3" in beside


def test_an_aileron_of_the_wrong_sign_on_the_held_out_flight_is_no_gap_no_more() -> None:
    """It had been `no_gap`: held-out flights were asked of names only, and there was none."""
    four = flights(truth.fly(requests({}, 9301, 0.15, "rich")))
    four[3] = four[3].with_columns(delta_a=-four[3]["delta_a"])
    near = [e for e in catalogue(model=LATERAL) if e.name in ("Cn_da", "beta_lag")]
    result = run_gap(LATERAL, four[:3], four[3:], near, Options(seed=1, nulls=20))
    assert result.verdict.value == "unknown_effect"
    (step,) = result.steps
    assert step.to_json()["form"]["flight"] == "f3"
    assert "p" in step.where.channels


def test_the_odd_flight_comes_first_where_something_unknown_stands_out() -> None:
    """It had been the last sentence but one, behind what that flight makes of the model."""
    texts = {v: conclude(v, (), {}, (), (), True, ["f1"], flights=3) for v in GapVerdict}
    first = {v for v, text in texts.items() if text.startswith("f1 does not repeat the other training flights")}
    assert GapVerdict.UNKNOWN in first
    assert GapVerdict.NO_GAP not in first
    assert all("f1 does not repeat" in text for text in texts.values())


# ------------------------------------------------------------------------------------------------ which training flight it is


def round_of(values: tuple[float, ...]) -> Any:
    """Flights that each measure one number a hundred times, exactly what is given; nulls scatter by one bound."""
    rng = np.random.default_rng(7)
    grams = []
    for value in values:
        z = np.concatenate([[value], 0.1 * rng.standard_normal(200)])
        gram = np.zeros((1 + z.size, 1 + z.size))
        gram[0, 0], gram[0, 1:], gram[1:, 0] = 100.0, 100.0 * z, 100.0 * z
        grams.append(gram)

    def total(flights: list[int] | None = None) -> Array:
        return np.sum([g for k, g in enumerate(grams) if flights is None or k in flights], axis=0)

    screen = SimpleNamespace(n=1, k=0, flights=tuple(range(len(values))), total=total)
    return SimpleNamespace(screen=screen, criteria=AS_SET)


@pytest.mark.parametrize(
    ("values", "odd"),
    [
        ((0.0, 0.1, -0.1), []),
        ((0.0, 9.0, 0.1), ["b"]),  # that pulls the others away from their joint fit
        ((0.0, 9.0, -4.0), ["a", "b", "c"]),  # each has a number of its own
        ((0.0, 9.0, 0.1, -0.1), ["b"]),
        ((0.0, 9.0), ["a", "b"]),  # of two nobody can tell
    ],
)
def test_the_one_flight_without_which_the_others_repeat_each_other_is_odd_alone(
    values: tuple[float, ...], odd: list[str]
) -> None:
    assert odd_flights(repeatability(round_of(values), ("a", "b", "c", "d"))) == odd
