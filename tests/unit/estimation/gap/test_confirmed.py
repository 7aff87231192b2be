"""What held-out flights confirm of a small effect, which their gap does not show."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from estimation.gap.answer.result import HELD_OUT, Gap, GapVerdict, Rejected
from estimation.gap.answer.words import describe_step, not_in_held_out_gap, unconfirmed_in_words
from estimation.gap.criteria import AS_SET
from estimation.gap.decision.decide import Named, closed_by
from estimation.gap.search.state import Options
from estimation.gap.significance import measure
from estimation.gap.significance.measure import HeldOutLikelihood
from estimation.gap.workflow import run_gap
from estimation.models.load import load_model
from tests.studies import second_truth as truth
from tests.studies.gap_benchmark import flights, requests


def confirmed(gain: float, predicted: float) -> float | None:
    return HeldOutLikelihood(gain, predicted).confirmed(1.0, AS_SET)


@pytest.mark.parametrize("size", [0.3, 0.5, 0.7, 1.0, 1.3, 2.0])
def test_the_share_is_that_of_the_disagreement_along_the_predicted_change(size: float) -> None:
    """By projection, where the change has `size` times the length that the residual has along it."""
    rng = np.random.default_rng(3)
    change = rng.normal(size=400)
    residual = rng.normal(size=400) * 0.1 + change / size
    after = residual - change
    along = change / np.linalg.norm(change)
    before_part, after_part = (residual @ along) ** 2, (after @ along) ** 2
    gain = residual @ residual - after @ after
    expected = 1.0 - max(after_part - 1.0, 0.0) / (before_part - 1.0)
    assert confirmed(gain, change @ change) == pytest.approx(max(expected, 0.0))


def test_flights_that_speak_against_a_change_confirm_nothing_and_those_that_show_no_more_than_chance_cannot_tell() -> (
    None
):
    assert confirmed(-2.0, 30.0) == 0.0  # 6.5 before, 8.5 after
    assert confirmed(-2.0, 10.0) is None  # 1.6 before, 3.6 after
    assert confirmed(0.2, 0.0) is None


UNSEEN = Gap(1.40, 1.42, 1.30, highest=1.80, enough=0.7)


def test_a_gap_that_says_nothing_is_closed_by_what_the_likelihood_confirms() -> None:
    """A right `imu_lever_arm` of score 18 took the held-out gap from 1.429 to 1.430: `closed` was 0."""
    assert (UNSEEN.share, UNSEEN.to_json()["closed"], "confirmed" in UNSEEN.to_json()) == ("-", 0.0, False)
    assert replace(UNSEEN, gained=True).to_json()["closed"] == 1.0
    likely = replace(UNSEEN, confirmed=0.85)
    assert (likely.share, likely.to_json()["closed"], likely.to_json()["confirmed"]) == ("85%", 0.85, 0.85)
    seen = replace(UNSEEN, before=2.4, after=1.5, confirmed=0.2)
    assert seen.counted == seen.closed > 0.7


def test_a_gap_that_weather_makes_grow_beside_a_likelihood_that_confirms_says_nothing() -> None:
    """A right `aileron_lag` in gusts: the gap grew from 4.81 to 5.69, the likelihood gained 166 where it predicted 94."""
    grown = Gap(4.81, 5.69, 3.58, highest=4.72, enough=0.7)
    assert (grown.says_nothing, grown.counted) == (False, 0.0)
    assert replace(grown, confirmed=0.93).counted == 0.93
    unsure = replace(grown, gained=True)
    assert (unsure.share, unsure.counted) == ("-", 1.0)
    assert "neither for it nor against it" in not_in_held_out_gap(unsure)
    assert "grows (4.81 to 5.69)" in not_in_held_out_gap(replace(grown, confirmed=0.93))


def test_together_names_close_the_least_that_is_confirmed_of_one_and_what_training_flights_leave_open_counts() -> None:
    training = Gap(1.5, 1.3, 1.25, highest=1.4, enough=0.7)
    first = Named("a", 9.0, training, replace(UNSEEN, confirmed=0.9))
    last = Named("b", 9.0, training, replace(UNSEEN, confirmed=0.8))
    assert closed_by([first]) == pytest.approx(training.closed)
    assert closed_by([replace(first, gap=replace(training, after=1.25))]) == 0.9
    assert (
        closed_by([replace(first, gap=replace(training, after=1.25)), replace(last, gap=replace(training, after=1.25))])
        == 0.8
    )


def test_a_quarter_of_the_usual_side_force_is_confirmed_by_flights_whose_gap_does_not_show_it() -> None:
    flown = flights(truth.fly(requests({"CY_beta3": 0.25}, 66001007, 0.15, "rich")))
    result = run_gap(load_model("lateral", "cdfp"), flown[:3], flown[3:], options=Options(nulls=20))
    (step,) = result.steps
    assert (result.verdict, step.effect) == (GapVerdict.GAP_CLOSED, "CY_beta3")
    assert step.holdout is not None
    assert step.holdout.says_nothing
    assert step.holdout.after > step.holdout.before
    assert step.holdout.confirmed == pytest.approx(1.0, abs=0.1)
    assert "by their likelihood they confirm" in describe_step(step)


def test_what_only_the_held_out_flights_speak_against_is_said() -> None:
    weak, refused = Rejected("CY_da", "fits 5% of its usual size"), Rejected("Cl_beta3", f"closes nothing {HELD_OUT}")
    assert unconfirmed_in_words([weak]) == ""
    said = unconfirmed_in_words([weak, refused, refused])
    assert "(Cl_beta3 closes nothing on the held-out flights): fly once more" in said


def test_the_likelihood_of_two_models_has_the_determinants_of_both_covariances(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gusts act through the model. With the energies alone a right `indicial_lag` lost 10 where 5 was predicted."""

    def about(determinants: tuple[float, ...]) -> Any:
        problem = SimpleNamespace(whiteners=[SimpleNamespace(log_determinant=d) for d in determinants])
        return problem, SimpleNamespace(residuals=(np.zeros((4, 1)),))

    first, second = about((-100.0, 7.0)), about((-90.0, -21.0))
    products = iter([np.array([[50.0, 0.0], [0.0, 5.0]]), np.array([[60.0]])])
    monkeypatch.setattr(measure, "_products_given_training", lambda *given: next(products))
    before = SimpleNamespace(on_holdout=lambda noise: first)
    after = SimpleNamespace(noise=None, held_out=second)
    found = measure.held_out_likelihood(*cast(Any, (before, after)))
    assert found == HeldOutLikelihood(gain=(50.0 - 93.0) - (60.0 - 111.0), predicted=5.0)
