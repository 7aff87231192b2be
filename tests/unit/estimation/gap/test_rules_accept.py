"""Rules of acceptance, each at its limit, on rounds and candidates made by hand: when a fitted hypothesis becomes an effect."""

from typing import Any

import numpy as np
import pytest

from estimation.gap.answer.result import HELD_OUT, Rejected
from estimation.gap.criteria import AS_SET
from estimation.gap.search import accept as accepting
from estimation.gap.search.accept import (
    accept,
    by_timing,
    doubtful,
    explains,
    followed_by_surfaces,
    is_strong,
    repeats_on_flights,
)
from estimation.gap.search.confirm import FittedHypothesis
from estimation.gap.search.select import Choice
from estimation.gap.search.state import Options
from estimation.gap.significance.measured_again import MeasuredAgain
from tests.unit.estimation.gap.candidates_by_hand import REST, ROUND, candidate, remainder, stub

SETTING: Any = stub(options=Options())


@pytest.mark.parametrize(("gain", "enough"), [(73.0, False), (77.0, True)])
def test_a_name_gains_three_quarters_of_what_a_nameless_term_does(gain: float, enough: bool) -> None:
    assert explains(gain, 100.0, AS_SET) is enough


@pytest.mark.parametrize(("score", "strong"), [(5.8, False), (6.2, True)])
def test_half_as_much_again_as_the_threshold_is_strong(score: float, strong: bool) -> None:
    assert is_strong(score, 4.0, AS_SET) is strong


@pytest.mark.parametrize(
    ("cross", "strong", "timing", "gains", "repeated"),
    [
        (1.0, False, False, (9.0, -5.0, -9.0), True),  # gains on flights it was not fitted to
        (-1.0, False, False, (9.0, 9.0), False),
        (-1.0, True, False, (9.0, 9.0), True),  # beyond linear theory: the joint fit speaks
        (-1.0, True, False, (90.0, -1.0), False),
        (None, False, False, (90.0, 1.0), True),  # nonlinear: without the flight that gains most
        (None, False, False, (90.0, -1.0), False),
        (None, False, True, (90.0, -1.0), True),  # the base had followed it by timing
        (None, False, False, (90.0,), True),  # one flight cannot be asked
    ],
)
def test_an_effect_repeats(
    cross: float | None, strong: bool, timing: bool, gains: tuple[float, ...], repeated: bool
) -> None:
    assert repeats_on_flights(cross, strong, timing, gains) is repeated


@pytest.mark.parametrize(("freed", "followed"), [(38.0, False), (45.0, True)])
def test_the_base_had_followed_where_timing_frees_enough_of_the_gain(freed: float, followed: bool) -> None:
    assert followed_by_surfaces(freed, 100.0, AS_SET) is followed


@pytest.mark.parametrize(("moved", "followed"), [(0.04, False), (0.06, True)])
def test_timing_is_freed_of_its_prior(moved: float, followed: bool) -> None:
    """A tenth of a second wide; 0.06 s costs 0.18 of the log-likelihood: 0.36 of a gain of 0.5 in twice of it."""
    problem = stub(free=("timing_delta_a",), prior=lambda name: (0.0, 0.1))
    baseline = stub(problem=problem, fit=stub(values={"timing_delta_a": moved}))
    found = candidate(gain=0.5)
    found.fit.values["timing_delta_a"] = 0.0
    assert by_timing(stub(baseline=baseline, criteria=AS_SET), found) is followed


@pytest.fixture
def own_gains(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Share of the gain of each hypothesis that the noise of the controls does not give it: all of it where nothing is said."""
    shares: dict[str, float] = {}
    monkeypatch.setattr(MeasuredAgain, "share", lambda self, gain, fit: shares.get(str(gain), 1.0))
    return shares


@pytest.mark.parametrize(("share", "stands"), [(0.9, True), (0.1, False)])
def test_what_the_noise_of_the_controls_gives_is_no_effect(
    monkeypatch: pytest.MonkeyPatch, own_gains: dict[str, float], share: float, stands: bool
) -> None:
    monkeypatch.setattr(accepting, "confirmed", lambda *_: ("child", ""))
    one = candidate("a", evidence=50.0)
    own_gains[str(one.gain)] = share
    finding, said = accept(SETTING, ROUND, Choice((one,), {}, ()), remainder(ROUND))
    assert (finding is not None) is stands
    assert stands or "controls are measured again" in said[0].why
    assert finding is None or finding.candidate.score == pytest.approx(one.score * np.sqrt(share))


def test_the_first_candidate_that_is_confirmed_becomes_the_effect(
    monkeypatch: pytest.MonkeyPatch, own_gains: dict[str, float]
) -> None:
    asked: list[tuple[str, float]] = []

    def confirmed(setting: Any, round_: Any, one: FittedHypothesis, nameless: float) -> tuple[Any, str]:
        asked.append((one.hypothesis.label, nameless))
        return ("child", "") if one.hypothesis.label == "b" else (None, "no")

    monkeypatch.setattr(accepting, "confirmed", confirmed)
    rivals = tuple(candidate(n, evidence=50.0) for n in ("a", "b", "c"))
    finding, said = accept(SETTING, ROUND, Choice(rivals, {}, ()), remainder(ROUND))
    assert asked == [("a", 80.0), ("b", 80.0)], "a nameless term is the strongest term, not a burst"
    assert finding is not None
    assert (finding.candidate, finding.child) == (rivals[1], "child")
    assert finding.choice.weights == pytest.approx({"b": 0.5, "c": 0.5})
    assert said == [Rejected("a", "no")]


def test_controls_are_measured_again_only_where_a_bound_of_the_nameless_gain_refuses_a_candidate(
    monkeypatch: pytest.MonkeyPatch, own_gains: dict[str, float]
) -> None:
    """The answer is that of the gain itself: the bound is never below it."""
    asked: list[float] = []
    monkeypatch.setattr(accepting, "confirmed", lambda *given: (asked.append(given[3]), ("child", ""))[1])
    one = candidate(score=8.0)  # gains 64
    sufficient, too_large = remainder(ROUND, one.gain / 0.75), remainder(ROUND, one.gain / 0.74)
    del vars(sufficient)["omnibus"]  # a stub of a round has none to be examined
    for rest in (sufficient, too_large):
        accept(SETTING, ROUND, Choice((one,), {}, ()), rest)
    assert asked == [pytest.approx(one.gain / 0.75), REST.leading[0].gain]


@pytest.mark.parametrize(("score", "named"), [(6.9, "explains only 74% of what a does"), (7.0, "")])
def test_behind_one_that_the_held_out_flights_do_not_confirm_only_as_good_an_explanation_is_asked(
    monkeypatch: pytest.MonkeyPatch, own_gains: dict[str, float], score: float, named: str
) -> None:
    """In gusts of 0.9 deg a hidden `Cl_beta3` of score 7.6 closed nothing held out, and a `Cl_p_abs_p` of 5.7 did."""

    def confirmed(setting: Any, round_: Any, one: FittedHypothesis, nameless: float) -> tuple[Any, str]:
        return ("child", "") if one.hypothesis.label == "b" else (None, f"closes nothing {HELD_OUT}")

    monkeypatch.setattr(accepting, "confirmed", confirmed)
    rivals = (candidate("a", score=8.0), candidate("b", score=score))
    finding, said = accept(SETTING, ROUND, Choice(rivals, {}, ()), remainder(ROUND))
    assert (finding is None) is bool(named)
    assert [r.why for r in said[1:]] == ([named] if named else [])


@pytest.mark.parametrize(
    ("gain", "shape", "doubted"),
    [(4880.0, 5000.0, False), (4800.0, 5000.0, True), (75.0, 90.0, False), (75.0, 107.0, False), (75.0, 109.0, True)],
)
def test_a_name_is_doubted_where_a_shape_gains_clearly_more_and_by_what_is_significant(
    gain: float, shape: float, doubted: bool
) -> None:
    """Scores are of half the gain: an inflation of two, so that twice the square of the threshold is significant."""
    assert doubtful(candidate(gain=gain, score=float(np.sqrt(gain / 2.0))), shape, 4.0, AS_SET) is doubted


def test_nothing_below_the_threshold_is_asked() -> None:
    rivals = (candidate(score=3.9),)
    assert accept(SETTING, ROUND, Choice(rivals, {}, ()), remainder(ROUND)) == (None, [])


@pytest.mark.parametrize(("shape", "nameless"), [(30.0, 80.0), (900.0, 900.0)])
def test_a_name_is_held_against_a_shape_without_one(
    monkeypatch: pytest.MonkeyPatch, own_gains: dict[str, float], shape: float, nameless: float
) -> None:
    asked: list[float] = []

    def confirmed(setting: Any, round_: Any, one: FittedHypothesis, nameless: float) -> tuple[Any, str]:
        asked.append(nameless)
        return None, "no"

    monkeypatch.setattr(accepting, "confirmed", confirmed)
    accept(SETTING, ROUND, Choice((candidate(evidence=50.0),), {}, ()), remainder(ROUND), lambda: shape)
    assert asked == [nameless]
    accept(
        SETTING,
        ROUND,
        Choice((candidate(score=3.9),), {}, ()),
        remainder(ROUND),
        lambda: pytest.fail("asked for nothing"),
    )
