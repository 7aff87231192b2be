"""Rules of the search for a shape without a name, each at its limit."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimation.gap.criteria import AS_SET
from estimation.gap.shapes import search as searching
from estimation.gap.shapes.increment import HoldoutPrediction, closed, predicts_every_flight
from estimation.gap.shapes.places import Place, penalised, ranked, spread_of
from estimation.gap.shapes.search import as_good, runners_up
from estimation.gap.shapes.spline import KEPT, basis
from estimation.gap.significance.screen import Projected

PLACE = Place("Cn", "beta", lacks_line=False, lacks_constant=False)


def stub(**fields: Any) -> Any:
    """As much of a fit or formula as a rule looks at."""
    return SimpleNamespace(**fields)


def test_the_smoothest_part_may_be_as_large_as_the_coefficient_and_rougher_parts_are_smaller() -> None:
    spread = spread_of(PLACE, 0.004)
    assert spread == pytest.approx(0.004 * basis().spread)
    assert spread[0] == pytest.approx(0.004)
    assert (np.diff(spread) < 0.0).all()
    assert spread_of(Place("Cn", "delta_a", True, True), 0.004)[KEPT:] == pytest.approx([0.004, 0.004])


@pytest.mark.parametrize(("inside", "holds"), [(0.45, True), (0.55, False)])
def test_a_flight_that_lies_half_outside_what_the_others_flew_is_not_asked(inside: float, holds: bool) -> None:
    assert predicts_every_flight([HoldoutPrediction(0, 1.0, 50.0), HoldoutPrediction(1, inside, -3.0)], AS_SET) is holds


def test_one_flight_predicted_worse_is_enough_to_refuse_and_none_to_ask_is_no_confirmation() -> None:
    assert predicts_every_flight([HoldoutPrediction(0, 1.0, 50.0), HoldoutPrediction(1, 1.0, 0.1)], AS_SET)
    assert not predicts_every_flight([HoldoutPrediction(0, 1.0, 500.0), HoldoutPrediction(1, 1.0, -0.1)], AS_SET)
    assert not predicts_every_flight([HoldoutPrediction(0, 0.1, 50.0)], AS_SET)
    assert not predicts_every_flight([], AS_SET)


@pytest.mark.parametrize(("gain", "asked"), [(74.0, False), (76.0, True)])
def test_a_shape_gains_three_quarters_of_what_the_best_term_does(
    monkeypatch: pytest.MonkeyPatch, gain: float, asked: bool
) -> None:
    """An accelerometer that also shows bank: a side force that follows the ailerons closed a third of it, and all of what little
    of it the plain gap of eleven channels shows. Only terms count: restless seconds have no gain."""
    signals = (stub(kind="term", gain=100.0), stub(kind="time", gain=500.0))
    monkeypatch.setattr(searching, "examine", lambda round_: stub(leading=signals))
    monkeypatch.setattr(searching, "fit_increment", lambda baseline, increment: stub(gain=gain, fit=None))
    monkeypatch.setattr(searching.Increment, "of", lambda place, flown: None)
    monkeypatch.setattr(searching.MeasuredAgain, "share", lambda self, gain, fit: 1.0)
    left: list[float] = []
    monkeypatch.setattr(
        searching, "holdout_predictions", lambda baseline, fitted, flown: left.append(fitted.gain) or []
    )
    ranking = stub(order=[0], places=[PLACE], gains=[gain], scores=[9.0], threshold=4.0)
    shape, tried = searching._best(stub(baseline=None, criteria=AS_SET), stub(seed=1), stub(), ranking, 0.0)
    assert shape is None
    assert bool(left) is asked
    assert tried[0].why.endswith("explains only 74% of what a nameless term or swing does") is not asked


def test_a_shape_that_the_noise_of_the_controls_gives_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of a gain is its own: seven tenths of its score, here below the threshold."""
    monkeypatch.setattr(searching, "examine", lambda round_: stub(leading=()))
    monkeypatch.setattr(searching, "fit_increment", lambda baseline, increment: stub(gain=74.0, fit=None))
    monkeypatch.setattr(searching.Increment, "of", lambda place, flown: None)
    monkeypatch.setattr(searching.MeasuredAgain, "share", lambda self, gain, fit: 0.5)
    ranking = stub(order=[0], places=[PLACE], gains=[74.0], scores=[5.0], threshold=4.0)
    shape, tried = searching._best(stub(baseline=None, criteria=AS_SET), stub(seed=1), stub(), ranking, 0.0)
    assert shape is None
    reason = "gains nearly as much without it, where controls are measured again"
    assert tried[0].why == f"as a shape without a name: {reason}"


def test_a_shape_gains_three_quarters_of_what_a_swing_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(searching, "examine", lambda round_: stub(leading=()))
    monkeypatch.setattr(searching, "fit_increment", lambda baseline, increment: stub(gain=74.0, fit=None))
    monkeypatch.setattr(searching.Increment, "of", lambda place, flown: None)
    ranking = stub(order=[0], places=[PLACE], gains=[74.0], scores=[9.0], threshold=4.0)
    _, tried = searching._best(stub(baseline=None, criteria=AS_SET), stub(seed=1), stub(), ranking, 100.0)
    assert tried[0].why == "as a shape without a name: explains only 74% of what a nameless term or swing does"


@pytest.mark.parametrize(("share", "good"), [(0.88, True), (0.86, False)])
def test_a_formula_is_offered_that_closes_no_less_but_for_three_hundredths(share: float, good: bool) -> None:
    formula, best = stub(gain=5.0), stub(gain=9.0)
    offered, refused = as_good([(formula, share), (best, 0.95)], 0.9, AS_SET)
    assert offered[0] == (best, 0.95)
    assert ((formula, share) in offered) is good
    assert ((formula, share) in refused) is not good


@pytest.mark.parametrize(("gain", "near"), [(74.0, False), (76.0, True)])
def test_a_place_that_gains_three_quarters_as_much_is_a_rival(gain: float, near: bool) -> None:
    best, other = stub(gain=100.0), stub(gain=gain)
    assert runners_up(best, [other], AS_SET) == ([other] if near else [])


def test_a_place_is_ranked_against_what_it_gains_on_nulls() -> None:
    """Two places, the second of which gains ten times as much on the nulls: its larger gain on the data is nothing."""
    rng = np.random.default_rng(3)
    nulls = rng.chisquare(3, (2, 400)) * np.array([[1.0], [10.0]])
    gains = np.concatenate([np.array([[60.0], [70.0]]), nulls], axis=1)
    places = (PLACE, Place("Cl", "alpha", False, False))
    found = ranked(places, gains, AS_SET)
    assert found.scores == pytest.approx(np.sqrt([60.0, 70.0] / np.median(nulls, axis=1)))
    assert found.order == [0]
    assert found.best_gain == pytest.approx(60.0 - np.median(nulls[0])), (
        "what so many unknowns gain by chance is no gain"
    )
    assert ranked((), gains[:0], AS_SET).best_gain == 0.0


def test_a_penalty_takes_from_the_gain_what_a_prior_would() -> None:
    """One column of information 4 and correlation 6: a flat prior gains 36/4, one of precision 8 gains 36/12."""
    projected = Projected(np.array([[4.0]]), np.array([[6.0, 2.0]]), np.zeros(2), np.ones(1))
    assert penalised(projected, [0], np.array([0.0])) == pytest.approx([9.0, 1.0])
    assert penalised(projected, [0], np.array([8.0])) == pytest.approx([3.0, 1.0 / 3.0])


def test_closed_is_the_share_of_what_lies_above_the_floor() -> None:
    assert closed(200.0, 120.0, 100.0) == pytest.approx(0.8)
    assert closed(200.0, 90.0, 100.0) == 1.0
    assert closed(200.0, 250.0, 100.0) == 0.0
    assert closed(90.0, 80.0, 100.0) == 0.0, "nothing was there to close"
