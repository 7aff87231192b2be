"""Rules of the search, each at its limit, on rounds and candidates made by hand: which are fitted, how they are weighed, where a
fit begins."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimation.gap.criteria import AS_SET
from estimation.gap.decision.steps import misfit_of
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.fit.problem import freed_by
from estimation.gap.search import confirm
from estimation.gap.search import select as selecting
from estimation.gap.search.confirm import FittedHypothesis, assess, deflated, impossible, price
from estimation.gap.search.select import (
    Choice,
    credible_set,
    gain_along,
    held_first,
    leading,
    material,
    noise_candidates,
    promise,
    shared_inflation,
    within_reach,
    worth_comparing,
)
from estimation.gap.significance.measured_again import own_share
from estimation.gap.significance.omnibus import Omnibus
from estimation.gap.significance.screen import Hypothesis, Projected, equivalent_z
from estimation.models.base import Signal as Variable
from estimation.models.load import load_model
from tests.unit.estimation.gap.candidates_by_hand import BASE, candidate, fitted_with, hypothesis, screen, stub


# ------------------------------------------------------------------------------------------------ which are fitted in full
def test_none_is_fitted_that_promises_half_of_what_a_name_needs_at_the_most() -> None:
    linear = screen([hypothesis(f"x{i}") for i in range(4)])
    assert leading(linear, np.array([7.9, 7.9, 1.0, 0.0]), 4.0, AS_SET) == []
    assert leading(linear, np.array([7.9, 8.1, 8.2, 0.0]), 4.0, AS_SET) == [2, 1]


def test_others_are_fitted_where_they_promise_a_share_of_the_best() -> None:
    linear = screen([hypothesis(f"x{i}") for i in range(9)])
    near = np.array([100.0, 99.0, 98.0, 97.0, 17.0, 16.0, 14.0, 13.0, 12.0])
    assert leading(linear, near, 4.0, AS_SET) == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize(("cosine", "fitted"), [(0.88, False), (0.92, True)])
def test_what_is_tied_to_the_best_is_fitted_too(cosine: float, fitted: bool) -> None:
    gram = np.eye(13)
    gram[0, 11] = gram[11, 0] = cosine
    promised = np.array([100.0, *np.zeros(11)])
    tied = screen([hypothesis(f"x{i}") for i in range(12)], gram)
    assert (11 in leading(tied, promised, 4.0, AS_SET)) is fitted
    assert leading(tied, promised, 15.0, AS_SET) == [], "nor is anything tied to one that is hopeless"


def test_what_is_asked_further_is_fitted_however_little_it_promises() -> None:
    linear = screen([hypothesis(f"x{i}") for i in range(3)])
    assert leading(linear, np.array([100.0, 1.0, 2.0]), 4.0, AS_SET, further=[1]) == [0, 1]


def test_the_three_of_the_largest_gain_are_asked_whether_the_noise_holds_them() -> None:
    gains = np.array([60.0, 49.0, 70.0, 80.0, 90.0])
    assert noise_candidates(stub(gains=gains, criteria=AS_SET)) == [4, 3, 2]
    assert noise_candidates(stub(gains=np.array([49.0, 51.0, 0.0]), criteria=AS_SET)) == [1]


def test_what_holds_that_a_control_is_late_stands_beside_it_in_a_coefficient() -> None:
    """Not what multiplies a control: how far one moves the aircraft says nothing of when."""
    lateral = load_model("lateral", "cdfp")
    assert confirm.beside_controls(lateral, {"delta_a"}) == {
        "Cl_0",
        "Cl_beta",
        "Cl_p",
        "Cl_r",
        "beta",
        "p_hat",
        "r_hat",
    }
    by_rudder = confirm.beside_controls(lateral, {"delta_r"})
    assert {"CY_r", "Cl_p", "Cn_p"} < by_rudder
    assert not {"Cl_da", "Cl_dr", "Cn_dr"} & by_rudder


def test_a_lag_of_the_air_is_always_fitted() -> None:
    """Not one of an instrument, which linear theory tells."""
    wake = Variable("beta_wake", "rad", start="beta")
    parameter = EffectParameter("tau", "s", 0.1, 0.01, 0.6)
    air = Form("air", (parameter,), terms={"Cl": ("Cl_beta*(beta_wake - beta)",)}, states=(wake,))
    shown = Form("shown", (parameter,), outputs={"beta": "beta_wake"}, states=(wake,))
    effects = [Effect(f.label, "", Group.UNSTEADY, "", "", "", "", {}, "", (f,)) for f in (air, shown)]
    hypotheses = [*(hypothesis(f"x{i}") for i in range(12)), *(Hypothesis(e, e.forms[0]) for e in effects)]
    chosen = leading(screen(hypotheses), np.array([*(100.0 - np.arange(12.0)), 0.0, 0.0]), 4.0, AS_SET)
    assert (12 in chosen, 13 in chosen) == (True, False)


def test_what_a_small_step_does_not_tell_promises_what_it_gains_at_its_best_size(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And its scatter on the nulls, that of a small step, is not held against it."""
    monkeypatch.setattr(selecting, "gains_at_sizes", lambda round_: np.array([0.0, 40.0, 3.0]))
    kinds = screen([hypothesis("x"), hypothesis("play", "backlash"), hypothesis("late", "delay")])
    round_ = stub(screen=kinds, gains=np.array([8.0, 0.0, 10.0]), inflation=np.array([2.0, 9.0, 1.0]))
    assert promise(round_) == pytest.approx([4.0, 20.0, 10.0])


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ([[1.0, 0.0], [8.0, 0.0]], 25.0),  # between the sizes on one straight line: all of it
        ([[1.0, 0.0], [1.0, 9.0]], 9.0),  # away from the residuals beyond the first size: what that gains
        ([[0.0, 1.0], [8.0, 1.0]], 24.0),  # no small step gains anything; the usual size does
        ([[0.5, 0.0], [1.25, 0.0]], 25.0),  # beyond the last size, straight on
        ([[-1.0, 0.0], [-9.0, 0.0]], 0.0),  # the other way only
    ],
)
def test_the_gain_along_a_hypothesis_is_that_at_its_best_point(changes: list[list[float]], expected: float) -> None:
    """Residuals (5, 0): energy of 25 before."""
    columns, residuals = np.array(changes).T, np.array([5.0, 0.0])
    assert gain_along(columns.T @ columns, columns.T @ residuals) == pytest.approx(expected)


def test_sizes_of_a_control_made_late_or_with_play_are_followed_and_those_of_an_output_are_not() -> None:
    parameter = EffectParameter("x", "s", 0.1, 0.0, 1.0)
    assert selecting.strongly_nonlinear(hypothesis("late", "delay").form)
    assert selecting.strongly_nonlinear(hypothesis("play", "backlash").form)
    assert selecting.strongly_nonlinear(Form("flow", (parameter,), states=(Variable("wake", "rad", start="beta"),)))
    assert not selecting.strongly_nonlinear(Form("shown", (parameter,), output_delays={"beta": "x"}))
    assert not selecting.strongly_nonlinear(hypothesis("x").form)


# ------------------------------------------------------------------------------------------------ how they are weighed
@pytest.mark.parametrize(("own", "used"), [(1.9, 1.0), (2.1, 2.1)])
def test_rivals_share_one_inflation_unless_theirs_is_twice_as_large(own: float, used: float) -> None:
    one = screen([hypothesis("best"), hypothesis("x"), hypothesis("late", "delay")])
    round_ = stub(screen=one, gains=np.array([100.0, 50.0, 50.0]), inflation=np.array([1.0, own, 5.0]), criteria=AS_SET)
    found = shared_inflation(round_)
    assert found[("x", "x")] == used
    assert found[("late", "late")] == 1.0, "what is judged by a full fit takes the common one"


@pytest.mark.parametrize(("cosine", "used"), [(0.88, 9.0), (0.92, 1.0)])
def test_rivals_of_nearly_one_signature_share_one_inflation_whatever_their_own(cosine: float, used: float) -> None:
    gram = np.eye(3)
    gram[0, 1] = gram[1, 0] = cosine
    one = screen([hypothesis("best"), hypothesis("x")], gram)
    round_ = stub(screen=one, gains=np.array([100.0, 99.0]), inflation=np.array([1.0, 9.0]), criteria=AS_SET)
    assert shared_inflation(round_)[("x", "x")] == used


@pytest.mark.parametrize(("cosine", "used"), [(0.88, 2.9), (0.92, 3.0)])
def test_rivals_of_one_signature_share_theirs_though_it_is_not_the_leaders(cosine: float, used: float) -> None:
    """A square and a cube of the angle of attack behind a leader that scatters a third as far: 617 and 614 gained, over 3.0 and
    2.9, the cube was named for chance."""
    gram = np.eye(3)
    gram[1, 2] = gram[2, 1] = cosine
    one = screen([hypothesis("best"), hypothesis("square"), hypothesis("cube")], gram)
    round_ = stub(
        screen=one, gains=np.array([500.0, 617.0, 595.0]), inflation=np.array([1.0, 3.0, 2.9]), criteria=AS_SET
    )
    found = shared_inflation(round_)
    assert (found[("square", "square")], found[("cube", "cube")]) == (3.0, used)


def test_inflation_divides_what_residuals_gain_and_not_what_priors_do() -> None:
    """A base without the delay moves a surface by 5 prior widths: 25 of a gain of 33, and all else is inflated fourfold."""
    assert deflated(33.0, 25.0, 4.0) == pytest.approx(25.0 + 8.0 / 4.0)
    believed = {"late": (0.0, 0.005), "a": (0.0, 1e-3)}
    problem = stub(free=("late", "a"), nuisance=lambda n: n == "late", prior=believed.get)
    before, after = stub(values={"late": 0.025, "a": 1.0}), stub(values={"late": 0.0, "a": 0.0})
    assert freed_by(problem, before, after) == pytest.approx(25.0), "what is believed of a derivative is not nuisance"


def test_the_price_of_an_estimate_is_its_distance_and_the_width_of_the_prior() -> None:
    assert price(3.0, 0.3, 3.0, 3.0) == pytest.approx(
        2.0 * np.log(4.0 / 3.0) + np.log(10.0)
    )  # Student's t, three degrees of freedom
    assert price(0.3, 0.3, 3.0, 3.0) == pytest.approx(
        0.5 * 0.1**2 * 4.0 / 3.0 + np.log(10.0), abs=1e-4
    )  # near none as a Gaussian
    assert price(30.0, 0.3, 3.0, 3.0) < np.log(10.0) + 8.0  # ten times the width is dear, not impossible
    assert price(0.0, 30.0, 3.0, 3.0) == 0.0
    assert price(3.0, np.inf, 3.0, 3.0) == 0.0


def assessed(
    value: float, forms: int = 1, stretches: Sequence[int] = (0,), states: Sequence[str] = ()
) -> FittedHypothesis:
    """stretches: the flight of each. states: of the hypothesis' own."""
    fitted = stub(values={"x": value}, cost=40.0, diverged=False, std=lambda: {"x": 0.03})
    problem = stub(model=BASE, criteria=AS_SET, free=(), records=[stub(flight=k) for k in stretches])
    tried = hypothesis("x", forms=forms)
    tried = replace(tried, form=replace(tried.form, states=tuple(Variable(n) for n in states)))
    return assess(problem, stub(cost=100.0, values={}), tried, fitted, 4.0, 1.0)


def test_evidence_is_the_gain_over_the_inflation_less_the_price_of_the_size() -> None:
    """Prior three wide (1.5 usual sizes of 2), bound 0.03 inflated twice."""
    found = assessed(3.0)
    assert found.gain == pytest.approx(120.0)
    assert found.score == pytest.approx(np.sqrt(120.0))
    assert found.size == 1.5
    assert found.evidence == pytest.approx(0.5 * 120.0 / 4.0 - 2.0 * np.log(4.0 / 3.0) - np.log(3.0 / 0.06))
    assert found.evidence - assessed(3.0, forms=2).evidence == pytest.approx(np.log(2.0))


@pytest.mark.parametrize(("states", "begun"), [((), 0), (("late",), 3), (("late", "later"), 6)])
def test_a_state_that_begins_anew_in_every_stretch_is_an_unknown_of_each(states: Sequence[str], begun: int) -> None:
    """Two flights in five stretches: the gain of 120 is one of 1 + 3 unknowns, and half of the three is noise."""
    found, whole = (
        assessed(3.0, stretches=(0, 0, 0, 1, 1), states=states),
        assessed(3.0, stretches=(0, 1), states=states),
    )
    assert whole.score == assessed(3.0).score
    assert found.score == pytest.approx(equivalent_z(120.0, 1 + begun))
    assert whole.evidence - found.evidence == pytest.approx(0.5 * begun)


@pytest.mark.parametrize(("value", "why"), [(9.9, ""), (10.0, "outside"), (-10.0, "outside")])
def test_an_estimate_at_a_physical_limit_is_none(value: float, why: str) -> None:
    assert why in assessed(value).why_not
    assert bool(assessed(value).why_not) is bool(why)


def test_the_least_lag_that_can_be_flown_is_possible() -> None:
    """A vane late by 17.5 ms gained most at the least lag of 15, which was called impossible: `time_skew` got its name."""
    lag = EffectParameter("beta_lag", "s", 0.07, 0.015, 0.8)
    assert impossible(lag, 0.015, 0.0) == ""
    assert "outside" in impossible(lag, 0.8, 0.0)


@pytest.mark.parametrize(("value", "possible"), [(0.027, False), (1e-4, False), (1.2e-3, True)])
def test_no_moment_of_inertia_is_four_times_what_is_stated(value: float, possible: bool) -> None:
    """A model aeroplane of 63 g had 46 times its own."""
    inertia = EffectParameter("Iyy", "kg m2", 9e-5, 3e-6, 30.0, none="Iyy")
    assert (impossible(inertia, value, 6e-4) == "") is possible


def test_an_estimate_at_a_limit_that_is_no_effect_has_shrunk_to_nothing() -> None:
    assert impossible(EffectParameter("x", "s", 2.0, 0.0, 10.0), 0.0, 0.0) == "x shrinks to nothing"


@pytest.mark.parametrize(("size", "called"), [(0.14, False), (0.16, True)])
def test_an_effect_of_a_seventh_of_its_usual_size_is_immaterial(size: float, called: bool) -> None:
    assert (not material(candidate(size=size), 0.05, {}, AS_SET).why_not) is called


@pytest.mark.parametrize(
    ("late", "std", "called"),
    [
        (0.0102, 0.0021, False),
        (0.0149, 0.0, False),
        (0.0151, 0.0, True),
        (0.0151, 0.001, False),
        (-0.0155, 0.001, True),
    ],
)
def test_a_surface_late_by_three_times_what_sampling_leaves_open_was_sampled_so(
    late: float, std: float, called: bool
) -> None:
    """A tenth of a sample is left open; a servo of 10.2 ms was named where surfaces had three times their usual noise."""
    found = candidate("late", "delay", estimates={"late": (late, std)})
    assert (not material(found, 0.05, {}, AS_SET).why_not) is called
    assert not material(candidate("play", "backlash", estimates={"play": (0.0, 0.1)}), 0.05, {}, AS_SET).why_not


@pytest.mark.parametrize(
    ("controls", "late", "called"),
    [
        (("delta_a", "delta_r"), 0.0046, True),
        (("delta_a", "delta_r"), 0.0044, False),
        (("delta_a",), 0.0149, False),
    ],
)
def test_samples_shift_all_surfaces_alike_and_one_beside_the_others_by_less(
    controls: tuple[str, ...], late: float, called: bool
) -> None:
    """Lags and delays of 10 ms of one surface at 20 Hz, clearly significant, were taken for sampling in 10 of 12 sets."""
    found = replace(candidate("late", "delay", estimates={"late": (late, 0.0)}), fit=fitted_with(*controls))
    assert (not material(found, 0.05, {}, AS_SET).why_not) is called


@pytest.mark.parametrize(("width", "called"), [(2.2, False), (2.3, True)])
def test_a_play_no_wider_than_the_noise_of_its_control_takes_that_off(width: float, called: bool) -> None:
    found = candidate("play", "backlash", estimates={"play": (width * 0.001, 0.0001)})
    assert (not material(found, 0.05, {"delta_a": 0.001}, AS_SET).why_not) is called
    late = candidate("late", "delay", estimates={"late": (0.02, 0.001)})
    assert not material(late, 0.05, {"delta_a": 1.0}, AS_SET).why_not


def test_the_six_best_are_compared_again_where_one_is_significant() -> None:
    many = [candidate(f"x{i}", score=2.2) for i in range(9)]
    assert list(worth_comparing([*many, candidate(score=4.1)], 4.0, AS_SET)) == many[:6]
    assert not worth_comparing([*many, candidate(score=3.9)], 4.0, AS_SET)
    assert not worth_comparing([], 4.0, AS_SET)


def test_a_fit_that_could_at_best_gain_half_of_what_a_name_needs_is_given_up() -> None:
    assert within_reach(100.0, gain=16.0) == 100.0 - 0.5 * (16.0 / 2.0)


@pytest.mark.parametrize(("behind", "names"), [(1.0, "bac"), (1.2, "abc")])
def test_a_number_that_the_base_holds_stands_before_a_term_that_is_as_probable(behind: float, names: str) -> None:
    """By one angle of attack a derivative that is off and its product with it leave the same flights."""
    held = candidate("b", evidence=candidate("a").evidence - behind)
    freeing = replace(held.hypothesis, form=replace(held.hypothesis.form, frees=("b",)))
    ranked = [candidate("a"), replace(held, hypothesis=freeing), candidate("c")]
    assert "".join(c.hypothesis.effect.name for c in held_first(ranked, AS_SET)) == names


def test_the_set_holds_nineteen_twentieths_of_the_weight() -> None:
    assert [n for n, _ in credible_set({"a": 0.94, "b": 0.05, "c": 0.01}, AS_SET)] == ["a", "b"]
    assert [n for n, _ in credible_set({"a": 0.96, "b": 0.04}, AS_SET)] == ["a"]


def test_a_refused_candidate_takes_its_weight_with_it() -> None:
    one, other = candidate("a", evidence=3.0), candidate("b", evidence=3.0)
    left = Choice((one, other), {"a": 0.5, "b": 0.5}, ()).without({("a", "a")})
    assert left.candidates == (other,)
    assert left.weights == {"b": 1.0}


def test_rivals_are_less_sure_where_something_is_left_without_a_name() -> None:
    """Drag of an elevator gains 261 where an accelerometer off the centre of gravity gains 270: 1 to 90, or 1 to 2 where what is
    left without a name is 2.5 times its threshold."""
    one, two = candidate("imu_z", evidence=134.5), candidate("CD_de2", evidence=130.0)
    choice = Choice((one, two), {"imu_z": 0.99, "CD_de2": 0.01}, ())
    assert choice.beside_rest(1.0) is choice.weights
    assert choice.beside_rest(6.25)["CD_de2"] == pytest.approx(1.0 / (1.0 + np.exp(4.5 / 6.25)))
    alone_ = Choice((), {"imu_z": 1.0}, ())
    assert alone_.beside_rest(6.25) == {"imu_z": 1.0}


@pytest.mark.parametrize(("score", "misfit"), [(3.99, 1.0), (4.01, (4.01 / 4.0) ** 2), (10.0, 6.25)])
def test_a_rest_that_matters_is_so_many_times_what_noise_leaves(score: float, misfit: float) -> None:
    assert misfit_of(Omnibus(score, 4.0, ())) == pytest.approx(misfit)


def test_projection_takes_out_what_the_base_can_absorb() -> None:
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((50, 4))
    projected = Projected.of(rows.T @ rows, 2, 1)
    left = rows[:, 2:] - rows[:, :2] @ np.linalg.lstsq(rows[:, :2], rows[:, 2:], rcond=None)[0]
    assert projected.B[0, 0] == pytest.approx(left[:, 0] @ left[:, 0])
    assert projected.scores()[0, 0] == pytest.approx(left[:, 0] @ left[:, 1] / np.linalg.norm(left[:, 0]))


# ------------------------------------------------------------------------------------------------ where a fit begins
@pytest.mark.parametrize(
    ("ends", "kept"),
    [
        # of both starts after their first steps: cost and play; of what is carried on: the same
        ({"near": ((12.0, 0.6), (3.0, 1.0)), "usual": ((10.0, 0.0), (10.0, 0.0))}, 3.0),
        ({"near": ((12.0, 0.6), (11.0, 0.4)), "usual": ((10.0, 0.0), (9.0, 0.0))}, 9.0),
        ({"near": ((12.0, 0.0), (3.0, 1.0)), "usual": ((10.0, 0.0), (9.0, 0.0))}, 9.0),
        ({"near": ((8.0, 0.6), (5.0, 0.8)), "usual": ((10.0, 1.0), (1.0, 1.0))}, 5.0),
    ],
    ids=[
        "nothing gives way to something better",
        "or stays where that is none",
        "no start that is at nothing too goes on",
        "something found ends the search",
    ],
)
def test_an_end_at_nothing_is_not_believed_while_another_start_goes_on(
    monkeypatch: pytest.MonkeyPatch, ends: dict[str, tuple[tuple[float, float], ...]], kept: float
) -> None:
    """A rudder with a degree of play, in six degrees of freedom: five steps from the usual size the fit had shrunk to no play at
    all, five from a third of it the way to the right one was half gone, and its cost the larger."""

    def fitted(which: str, turn: int) -> Any:
        cost, play = ends[which][turn]
        return stub(
            cost=cost,
            values={"play": play, "which": which},
            locals=[],
            converged=turn == 1,
            diverged=False,
            abandoned=False,
            model=None,
        )

    parameter = EffectParameter("play", "rad", 1.0, 0.0, 3.0)
    hypothesis = stub(form=stub(parameters=(parameter,), nonlinear=True))
    monkeypatch.setattr(
        confirm, "_first_steps", lambda p, b, h, start, _: (p, fitted("near" if start["play"] < 0.5 else "usual", 0))
    )
    monkeypatch.setattr(confirm, "fit", lambda trial, values, locals_, **_: fitted(str(values["which"]), 1))
    _, found = confirm.fit_hypothesis(stub(model=None, criteria=AS_SET), stub(cost=20.0), hypothesis, {"play": 0.0})
    assert found.cost == kept


@pytest.mark.parametrize(
    ("end", "kept"),
    [((30.0, 1.5), 3.0), ((20.5, 1.5), 20.5), ((30.0, 3.0), 30.0), ((30.0, 0.0), 30.0)],
    ids=["another valley", "as good as the base", "at its limit", "nothing"],
)
def test_a_fit_that_ends_above_the_base_it_holds_begins_nearer_to_no_effect(
    monkeypatch: pytest.MonkeyPatch, end: tuple[float, float], kept: float
) -> None:
    """A rudder with a degree of play: from four fifths of it and more another valley, from two thirds and less the right one."""

    costs = {1.0: 3.0, end[1]: end[0]}

    def there(play: float) -> Any:
        return stub(
            cost=costs[play],
            values={"play": play},
            locals=[],
            converged=True,
            diverged=False,
            abandoned=False,
            model=None,
        )

    def begun(problem: Any, base: Any, hypothesis: Any, start: Any, beyond: float) -> Any:
        return problem, there(1.0 if start["play"] < 0.2 else end[1])

    monkeypatch.setattr(confirm, "_first_steps", begun)
    monkeypatch.setattr(confirm, "fit", lambda trial, values, locals_, **_: there(values["play"]))
    hypothesis = stub(form=stub(parameters=(EffectParameter("play", "rad", 1.0, 0.0, 3.0),), nonlinear=True))
    _, found = confirm.fit_hypothesis(stub(model=None, criteria=AS_SET), stub(cost=20.0), hypothesis, {"play": 0.0})
    assert found.cost == kept


@pytest.mark.parametrize(("gain", "without", "share"), [(60.0, 20.0, 0.2), (40.0, -40.0, 1.0), (30.0, 30.0, 0.0)])
def test_a_fifth_of_what_the_noise_of_the_controls_gives_is_not_counted(
    gain: float, without: float, share: float
) -> None:
    assert own_share(gain, without, 0.0, AS_SET) == pytest.approx(share, abs=1e-12)


@pytest.mark.parametrize(
    ("gain", "without", "freed", "share"),
    [(27.0, 0.3, 26.8, 1.0), (93.1, 20.8, -8.8, 0.21), (180.0, -141.8, 33.9, 0.98)],
    ids=["a delay that the base followed in time", "a noisy elevator", "a lag"],
)
def test_what_the_base_need_not_move_in_time_is_an_effects_own(
    gain: float, without: float, freed: float, share: float
) -> None:
    """`elevator_delay` of half a sample beside `thrust_scale`: 26.8 of its 27 were a surface that the base had moved in time, and
    .39 of them were counted."""
    assert own_share(gain, without, freed, AS_SET) == pytest.approx(share, abs=0.015)
