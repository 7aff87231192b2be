"""Rules of the search, each at its limit, on rounds and candidates made by hand: which are fitted, weighed and accepted."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.gap.answer.result import Rejected
from estimation.gap.criteria import AS_SET
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.errors import GapError
from estimation.gap.search import accept as accepting
from estimation.gap.search import backward_check as checking
from estimation.gap.search import confirm
from estimation.gap.search import rounds as searching
from estimation.gap.search.accept import accept, by_timing, doubtful, explains, follows, holds, is_strong, repeats
from estimation.gap.search.backward_check import better_rivals, idle, questioners
from estimation.gap.search.confirm import Candidate, assess, deflated, freed_by, impossible, leading, price
from estimation.gap.search.rounds import run_rounds
from estimation.gap.search.search_state import Finding, Options
from estimation.gap.search.select import Choice, comparable, credible_set, material, promise, worth_comparing
from estimation.gap.tests_of_fit.calibration import Round
from estimation.gap.tests_of_fit.hypotheses import Column, Hypothesis
from estimation.gap.tests_of_fit.omnibus import Omnibus, Signal
from estimation.gap.tests_of_fit.screen import Projected, Reduced, Screen, equivalent_z
from estimation.gap.verdict.steps import misfit_of
from estimation.models.base import InputTransform, Model, Parameter
from estimation.models.base import Signal as Variable

BASE = Model("none", (Variable("p"),), (), (Variable("p"),), (Parameter("a"),), ("p_dot = a*p",))


def stub(**fields: Any) -> Any:
    """As much of a round, problem or setting as a rule looks at."""
    return SimpleNamespace(**fields)


def hypothesis(name: str, kind: str = "linear", forms: int = 1) -> Hypothesis:
    """One unknown of usual size 2, between -10 and 10; kind: linear, delay or backlash."""
    parameter = EffectParameter(name, "s", 2.0, -10.0, 10.0)
    transforms = () if kind == "linear" else (InputTransform(kind, "delta_a", (name,)),)
    made = tuple(Form(f"{name}{i or ''}", (parameter,), transforms=transforms) for i in range(forms))
    effect = Effect(name, name, Group.ACTUATOR, "", "", "", "", {}, "fly it", made)
    return Hypothesis(effect, made[0])


def candidate(name: str = "x", kind: str = "linear", **known: Any) -> Candidate:
    given: dict[str, Any] = {
        "gain": 100.0,
        "score": 10.0,
        "evidence": 50.0,
        "estimates": {},
        "size": 1.0,
        "why_not": "",
    }
    return Candidate(hypothesis(name, kind), stub(values={}, residuals=(), diverged=False), **(given | known))


def screen(hypotheses: Sequence[Hypothesis], gram: Array | None = None, flights: tuple[int, ...] = (0,)) -> Screen:
    """Every hypothesis with one column of unit length; the last column of `gram` is the residual."""
    k = len(hypotheses)
    columns = tuple(Column(h, x.form.parameters[0]) for h, x in enumerate(hypotheses))
    whole = np.eye(k + 1) if gram is None else gram
    return Screen((), tuple(hypotheses), columns, (Reduced(whole),) * len(flights), np.zeros_like(whole), flights)


# ------------------------------------------------------------------------------------------------ which are fitted in full
def test_the_ten_best_get_a_full_fit() -> None:
    delays = [hypothesis(f"d{i}", "delay") for i in range(15)]
    assert leading(screen(delays), 100.0 - np.arange(15.0), AS_SET) == list(range(10))


def test_four_get_one_however_weak_and_others_where_they_gain_a_share_of_the_best() -> None:
    linear = screen([hypothesis(f"x{i}") for i in range(9)])
    weak = np.array([100.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    assert leading(linear, weak, AS_SET) == [0, 1, 2, 3]
    near = np.array([100.0, 99.0, 98.0, 97.0, 17.0, 16.0, 14.0, 13.0, 12.0])
    assert leading(linear, near, AS_SET) == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize(("cosine", "fitted"), [(0.88, False), (0.92, True)])
def test_what_is_tied_to_the_best_is_fitted_too(cosine: float, fitted: bool) -> None:
    gram = np.eye(13)
    gram[0, 11] = gram[11, 0] = cosine
    chosen = leading(screen([hypothesis(f"x{i}") for i in range(12)], gram), 100.0 - np.arange(12.0), AS_SET)
    assert (11 in chosen) is fitted


def test_a_play_is_always_fitted() -> None:
    hypotheses = [*(hypothesis(f"x{i}") for i in range(12)), hypothesis("play", "backlash")]
    assert 12 in leading(screen(hypotheses), np.array([*(100.0 - np.arange(12.0)), 0.0]), AS_SET)


def test_a_lag_of_the_air_is_always_fitted() -> None:
    """Not one of an instrument, which a small step tells."""
    wake = Variable("beta_wake", "rad", start="beta")
    parameter = EffectParameter("tau", "s", 0.1, 0.01, 0.6)
    air = Form("air", (parameter,), terms={"Cl": ("Cl_beta*(beta_wake - beta)",)}, states=(wake,))
    shown = Form("shown", (parameter,), outputs={"beta": "beta_wake"}, states=(wake,))
    effects = [Effect(f.label, "", Group.UNSTEADY, "", "", "", "", {}, "", (f,)) for f in (air, shown)]
    hypotheses = [*(hypothesis(f"x{i}") for i in range(12)), *(Hypothesis(e, e.forms[0]) for e in effects)]
    chosen = leading(screen(hypotheses), np.array([*(100.0 - np.arange(12.0)), 0.0, 0.0]), AS_SET)
    assert (12 in chosen, 13 in chosen) == (True, False)


def test_nonlinear_hypotheses_promise_either_sign_and_are_not_held_against_their_scatter() -> None:
    gram = np.eye(3)
    gram[:2, 2] = gram[2, :2] = -6.0
    one = screen([hypothesis("x"), hypothesis("late", "delay")], gram)
    baseline = stub(
        problem=stub(free=("timing_x", "a"), nuisance=lambda n: n != "a", prior=lambda n: (0.0, 0.005)), fit=stub()
    )
    baseline.fit.values = {"timing_x": 0.0, "a": 1.0}
    round_ = stub(screen=one, gains=np.zeros(2), inflation=np.array([1.0, 9.0]), baseline=baseline)
    assert promise(round_) == pytest.approx([0.0, 36.0 / 5.0])
    baseline.fit.values["timing_x"] = 0.025
    assert promise(round_) == pytest.approx([0.0, 25.0]), (
        "the base had moved it in time by five widths of what is believed"
    )


# ------------------------------------------------------------------------------------------------ how they are weighed
@pytest.mark.parametrize(("own", "used"), [(1.9, 1.0), (2.1, 2.1)])
def test_rivals_share_one_inflation_unless_theirs_is_twice_as_large(own: float, used: float) -> None:
    one = screen([hypothesis("best"), hypothesis("x"), hypothesis("late", "delay")])
    round_ = stub(screen=one, gains=np.array([100.0, 50.0, 50.0]), inflation=np.array([1.0, own, 5.0]), criteria=AS_SET)
    found = comparable(round_)
    assert found[("x", "x")] == used
    assert found[("late", "late")] == 1.0, "what is judged by a full fit takes the common one"


@pytest.mark.parametrize(("cosine", "used"), [(0.88, 9.0), (0.92, 1.0)])
def test_rivals_of_nearly_one_signature_share_one_inflation_whatever_their_own(cosine: float, used: float) -> None:
    gram = np.eye(3)
    gram[0, 1] = gram[1, 0] = cosine
    one = screen([hypothesis("best"), hypothesis("x")], gram)
    round_ = stub(screen=one, gains=np.array([100.0, 99.0]), inflation=np.array([1.0, 9.0]), criteria=AS_SET)
    assert comparable(round_)[("x", "x")] == used


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


def assessed(value: float, forms: int = 1, stretches: Sequence[int] = (0,), states: Sequence[str] = ()) -> Candidate:
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


def test_an_estimate_at_a_limit_that_is_no_effect_has_shrunk_to_nothing() -> None:
    assert impossible(EffectParameter("x", "s", 2.0, 0.0, 10.0), 0.0, 0.0) == "x shrinks to nothing"


@pytest.mark.parametrize(("size", "called"), [(0.14, False), (0.16, True)])
def test_an_effect_of_a_seventh_of_its_usual_size_is_immaterial(size: float, called: bool) -> None:
    assert (not material(candidate(size=size), 0.05, {}, AS_SET).why_not) is called


@pytest.mark.parametrize(("late", "called"), [(0.18, False), (0.22, True)])
def test_a_surface_late_by_a_fifth_of_a_sample_was_sampled_so(late: float, called: bool) -> None:
    found = candidate("late", "delay", estimates={"late": (late * 0.05, 0.001)})
    assert (not material(found, 0.05, {}, AS_SET).why_not) is called
    assert not material(candidate("play", "backlash", estimates={"play": (0.0, 0.1)}), 0.05, {}, AS_SET).why_not


@pytest.mark.parametrize(("width", "called"), [(2.2, False), (2.3, True)])
def test_a_play_no_wider_than_the_noise_of_its_control_takes_that_off(width: float, called: bool) -> None:
    found = candidate("play", "backlash", estimates={"play": (width * 0.001, 0.0001)})
    assert (not material(found, 0.05, {"delta_a": 0.001}, AS_SET).why_not) is called
    late = candidate("late", "delay", estimates={"late": (0.02, 0.001)})
    assert not material(late, 0.05, {"delta_a": 1.0}, AS_SET).why_not


def test_the_six_best_are_compared_again_where_the_best_is_promising() -> None:
    many = [candidate(f"x{i}", score=2.2) for i in range(9)]
    assert list(worth_comparing(many, AS_SET)) == many[:6]
    assert not worth_comparing([candidate(score=1.8), *many], AS_SET)
    assert not worth_comparing([], AS_SET)


def test_the_set_holds_nineteen_twentieths_of_the_weight() -> None:
    assert [n for n, _ in credible_set({"a": 0.94, "b": 0.05, "c": 0.01}, AS_SET)] == ["a", "b"]
    assert [n for n, _ in credible_set({"a": 0.96, "b": 0.04}, AS_SET)] == ["a"]


def test_a_refused_candidate_takes_its_weight_with_it() -> None:
    one, other = candidate("a", evidence=3.0), candidate("b", evidence=3.0)
    left = Choice((one, other), {"a": 0.5, "b": 0.5}, ()).without({("a", "a")})
    assert left.candidates == (other,)
    assert left.weights == {"b": 1.0}


# ------------------------------------------------------------------------------------------------ when one is accepted
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
    assert repeats(cross, strong, timing, gains) is repeated


@pytest.mark.parametrize(
    ("held", "spare", "stands"),
    [
        (None, 0.0, True),
        (0.1, 0.0, True),
        (-0.1, 0.0, False),
        (-2.0, 2.5, True),
        (-3.0, 2.5, False),
        (-8.0, np.inf, True),
        (-10.0, np.inf, False),
    ],
)
def test_chance_may_take_on_held_out_flights_what_there_is_to_spare(
    held: float | None, spare: float, stands: bool
) -> None:
    assert holds(held, spare, AS_SET) is stands


@pytest.mark.parametrize(("freed", "followed"), [(45.0, False), (55.0, True)])
def test_the_base_had_followed_where_timing_frees_half_of_the_gain(freed: float, followed: bool) -> None:
    assert follows(freed, 100.0, AS_SET) is followed


@pytest.mark.parametrize(("moved", "followed"), [(0.04, False), (0.06, True)])
def test_timing_is_freed_of_its_prior(moved: float, followed: bool) -> None:
    """A tenth of a second wide; 0.06 s costs 0.18 of the log-likelihood: 0.36 of a gain of 0.5 in twice of it."""
    problem = stub(free=("timing_delta_a",), prior=lambda name: (0.0, 0.1))
    baseline = stub(problem=problem, fit=stub(values={"timing_delta_a": moved}))
    found = candidate(gain=0.5)
    found.fit.values["timing_delta_a"] = 0.0
    assert by_timing(stub(baseline=baseline, criteria=AS_SET), found) is followed


ROUND = stub(threshold=4.0, baseline="base", criteria=AS_SET)
REST = Omnibus(9.0, 5.0, (Signal("term", "r", "beta", 9.0, gain=80.0), Signal("time", "r", "burst", 8.0, gain=1e9)))


def test_the_first_candidate_that_is_confirmed_becomes_the_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, float]] = []

    def confirmed(setting: Any, round_: Any, one: Candidate, nameless: float) -> tuple[Any, str]:
        asked.append((one.hypothesis.label, nameless))
        return ("child", "") if one.hypothesis.label == "b" else (None, "no")

    monkeypatch.setattr(accepting, "confirmed", confirmed)
    rivals = tuple(candidate(n, evidence=50.0) for n in ("a", "b", "c"))
    finding, said = accept(stub(), ROUND, Choice(rivals, {}, ()), REST)
    assert asked == [("a", 80.0), ("b", 80.0)], "a nameless term is the strongest term, not a burst"
    assert finding is not None
    assert (finding.candidate, finding.child) == (rivals[1], "child")
    assert finding.choice.weights == pytest.approx({"b": 0.5, "c": 0.5})
    assert said == [Rejected("a", "no")]


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
    assert accept(stub(), ROUND, Choice(rivals, {}, ()), REST) == (None, [])


@pytest.mark.parametrize(("shape", "nameless"), [(30.0, 80.0), (900.0, 900.0)])
def test_a_name_is_held_against_a_shape_without_one(
    monkeypatch: pytest.MonkeyPatch, shape: float, nameless: float
) -> None:
    asked: list[float] = []

    def confirmed(setting: Any, round_: Any, one: Candidate, nameless: float) -> tuple[Any, str]:
        asked.append(nameless)
        return None, "no"

    monkeypatch.setattr(accepting, "confirmed", confirmed)
    accept(stub(), ROUND, Choice((candidate(evidence=50.0),), {}, ()), REST, lambda: shape)
    assert asked == [nameless]
    accept(stub(), ROUND, Choice((candidate(score=3.9),), {}, ()), REST, lambda: pytest.fail("asked for nothing"))


def test_a_model_that_cannot_be_examined_is_withdrawn_and_what_was_found_before_it_stands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = iter([finding("a"), finding("b")])
    monkeypatch.setattr(searching, "examine", lambda round_: REST)
    monkeypatch.setattr(searching, "choose", lambda *given: Choice((), {}, ()))
    monkeypatch.setattr(searching, "backward_check", lambda *given: None)
    monkeypatch.setattr(searching, "accept", lambda *given: (next(found), []))

    def screened(baseline: Any, number: int) -> Any:
        if number == 2:
            raise GapError("barely stable")
        return ROUND

    setting: Any = stub(screened=screened, options=Options(most=4), tell=lambda *given: None, prepared=None)
    left = run_rounds(setting, stub())
    assert [f.candidate.hypothesis.label for f in left.findings] == ["a"]
    assert [r.effect for r in left.rejected] == ["b"]
    assert "barely stable" in left.rejected[0].why
    assert len(left.rounds) == 2
    setting.screened = lambda baseline, number: screened(baseline, 2)
    with pytest.raises(GapError):
        run_rounds(setting, stub())


# ------------------------------------------------------------------------------------------------ earlier effects again
@pytest.mark.parametrize(("gain", "needless"), [(15.0, True), (17.0, False), (-3.0, True)])
def test_an_effect_that_would_not_pass_beside_the_others_is_idle(gain: float, needless: bool) -> None:
    assert idle(gain, 4.0) is needless


def test_six_hypotheses_question_an_earlier_effect() -> None:
    assert questioners(np.arange(9.0), AS_SET) == [8, 7, 6, 5, 4, 3]


def rival(name: str, gain: float, scatter: float = 1.0, why_not: str = "") -> Candidate:
    """What gains so much, of which nulls scatter `scatter` times what theory says."""
    return candidate(name, gain=gain, score=float(np.sqrt(gain / scatter)), why_not=why_not)


def test_a_rival_must_beat_an_accepted_effect_clearly() -> None:
    better, best, bad = rival("a", 108.5), rival("b", 109.0), rival("c", 999.0, why_not="no")
    assert better_rivals([better, best, bad], 100.0, 4.0, AS_SET) == [best, better]
    assert better_rivals([rival("x", 107.0)], 100.0, 4.0, AS_SET) == []
    assert better_rivals([], 100.0, 4.0, AS_SET) == []


def test_a_rival_counts_as_much_as_its_nulls_scatter_and_has_to_be_significant() -> None:
    """An offset of the centre of gravity gained 1055 on flights of a light aircraft, and 100 times less by its nulls."""
    assert better_rivals([rival("lateral_cg", 1055.0, 100.0)], 0.0, 4.0, AS_SET) == []  # 3.2 of 4
    loud, fair = rival("a", 400.0, 3.8), rival("b", 200.0, 1.5)
    assert better_rivals([loud, fair], 100.0, 4.0, AS_SET) == [fair]
    assert better_rivals([loud], 100.0, 4.0, AS_SET) == []
    assert better_rivals([rival("c", 15.0)], 0.0, 4.0, AS_SET) == []


def test_a_rival_is_asked_what_any_effect_is_with_what_nulls_scatter_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """That is known of the last round, and of the earlier effect's own; the first that is confirmed takes the place. A bound is
    widened by what a small step scatters, a score by what is said of delays and plays."""
    asked = [hypothesis(name, "linear") for name in ("own", "loud", "new", "other")]
    scatter = {"old": {asked[0].key: 2.0, asked[1].key: 3.0}, "last": {asked[1].key: 100.0}}
    given: dict[str, Any] = {}

    def round_of(threshold: float) -> Round:
        none: Any = None
        known = stub(hypotheses=asked[:2])
        return Round(none, known, np.zeros(2), np.zeros((0, 2)), np.array([5.0, threshold]), threshold, none)

    def confirmed(setting: Any, round_: Round, candidate: Candidate, nameless: float) -> tuple[str | None, str]:
        given.update(baseline=round_.baseline, inflation=list(round_.inflation), gains=list(round_.gains))
        return (None, "does not repeat") if candidate.hypothesis.label == "new" else ("child", "")

    def better(found: Any, gain: float, threshold: float, criteria: Any) -> list[Candidate]:
        given.update(found=found, gain=gain, threshold=threshold)
        return [elsewhere, rival("new", 999.0), rival("other", 998.0)]

    elsewhere = replace(rival("valley", 1100.0), fit=stub())  # the model without it fits as well from there
    monkeypatch.setattr(checking, "deeper", lambda base, fit: fit if fit is elsewhere.fit else None)
    monkeypatch.setattr(checking, "hypotheses_for", lambda *args: asked)
    monkeypatch.setattr(checking, "Tangent", lambda *args: None)
    monkeypatch.setattr(checking, "build_screen", lambda *args: stub(hypotheses=asked))
    monkeypatch.setattr(checking, "linear_gains", lambda *args: np.array([20.0, 1000.0, 30.0, 5.0]))
    monkeypatch.setattr(checking, "linear_guess", lambda *args: {})
    monkeypatch.setattr(checking, "alone", lambda round_: scatter["last" if round_.threshold == 4.5 else "old"])
    monkeypatch.setattr(checking, "fit_hypothesis", lambda problem, fit, h, guess: (None, h))
    monkeypatch.setattr(checking, "assess", lambda problem, fit, h, found, inflation: (h.label, inflation))
    monkeypatch.setattr(checking, "material", lambda found, interval, noise, criteria: (*found, interval, noise))
    monkeypatch.setattr(checking, "better_rivals", better)
    monkeypatch.setattr(checking, "confirmed", confirmed)
    records = [stub(inputs=("delta_a",), input_noise={"delta_a": 0.002})]
    problem = stub(coarse=[stub(time=np.array([0.0, 0.05, 0.1]))], records=records)
    without = stub(problem=problem, criteria=AS_SET, clean=None, fit=None)
    old = stub(candidate=rival("own", 200.0, 4.0), round_=round_of(9.0))
    found = checking._rival(stub(effects=(), prepared=stub(available=())), without, old, round_of(4.5), 100.0)
    assert found is not None
    assert (found[0].hypothesis.label, found[1]) == ("other", "child")
    assert given.pop("gain") == pytest.approx(25.0)
    assert given == {
        "found": [(n, v, 0.05, {"delta_a": 0.002}) for n, v in (("new", 1.0), ("loud", 100.0), ("other", 1.0))],
        "threshold": 4.5,
        "baseline": without,
        "inflation": [5.0, 4.5, 1.0, 1.0],
        "gains": [20.0, 1000.0, 30.0, 5.0],
    }


def finding(name: str, cost: float = 50.0) -> Finding:
    child: Any = stub(fit=stub(cost=cost), noise=None)
    return Finding(ROUND, Choice((), {}, ()), candidate(name), stub(), child)


@pytest.mark.parametrize(
    ("cost", "rival", "left", "why"),
    [
        (57.0, None, ["b"], "no longer needed"),
        (70.0, "c", ["b", "c"], "c explains the same better"),
        (70.0, None, None, ""),
    ],
)
def test_an_earlier_effect_is_dropped_exchanged_or_stands(
    monkeypatch: pytest.MonkeyPatch, cost: float, rival: str | None, left: list[str] | None, why: str
) -> None:
    """Threshold 4, so a gain of 2 (57 - 50) = 14 is too little and 40 enough."""
    without = stub(fit=stub(cost=cost, values={}, locals=()), noise=None, model=None, clean=None)
    monkeypatch.setattr(checking, "afresh_with", lambda *given: without)
    monkeypatch.setattr(checking, "_rival", lambda *given: None if rival is None else (candidate(rival), "child"))
    monkeypatch.setattr(checking, "fit_baseline", lambda *given: "fresh")
    setting = stub(prepared=None, scatter=None, child=lambda *given: "child")
    answer = checking.backward_check(setting, [finding("a"), finding("b")])
    if left is None:
        assert answer is None
        return
    assert answer is not None
    assert [f.candidate.hypothesis.label for f in answer[0]] == left
    assert answer[1][0].effect == "a"
    assert answer[1][0].why.startswith(why)


def test_rivals_are_less_sure_where_something_is_left_without_a_name() -> None:
    """Drag of an elevator gains 261 where an accelerometer off the centre of gravity gains 270: 1 to 90, or 1 to 2 where what is
    left without a name is 2.5 times its threshold."""
    one, two = candidate("imu_z", evidence=134.5), candidate("CD_de2", evidence=130.0)
    choice = Choice((one, two), {"imu_z": 0.99, "CD_de2": 0.01}, ())
    assert choice.beside_rest(1.0) is choice.weights
    assert choice.beside_rest(6.25)["CD_de2"] == pytest.approx(1.0 / (1.0 + np.exp(4.5 / 6.25)))
    alone_ = Choice((), {"imu_z": 1.0}, ())
    assert alone_.beside_rest(6.25) == {"imu_z": 1.0}


@pytest.mark.parametrize(("score", "misfit"), [(5.19, 1.0), (5.21, (5.21 / 4.0) ** 2), (10.0, 6.25)])
def test_a_rest_that_matters_is_so_many_times_what_noise_leaves(score: float, misfit: float) -> None:
    assert misfit_of(Omnibus(score, 4.0, ()), AS_SET) == pytest.approx(misfit)


# ------------------------------------------------------------------------------------------------ rounds
def test_rounds_go_on_until_nothing_is_accepted_or_enough_is(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [finding("a"), finding("b"), None]
    monkeypatch.setattr(searching, "examine", lambda round_: REST)
    monkeypatch.setattr(searching, "choose", lambda *given: Choice((), {}, (Rejected("z", "weak"),)))
    monkeypatch.setattr(searching, "backward_check", lambda *given: None)
    seen: list[int] = []

    def screened(baseline: Any, number: int) -> Any:
        seen.append(number)
        return ROUND

    def run(most: int) -> Any:
        seen.clear()
        answers = iter(found)
        monkeypatch.setattr(searching, "accept", lambda *given: (next(answers), []))
        setting: Any = stub(screened=screened, options=Options(most=most), tell=lambda *given: None, prepared=None)
        return run_rounds(setting, stub())

    every = run(4)
    assert [f.candidate.hypothesis.label for f in every.findings] == ["a", "b"]
    assert seen == [0, 1, 2]
    assert len(every.rejected) == 3
    assert [f.candidate.hypothesis.label for f in run(1).findings] == ["a"]
    assert seen == [0, 1], "a last round examines what is left"


def test_a_round_is_asked_again_about_a_better_base(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a significant candidate leads its base to is not gained by it; two better valleys a round, and no more."""
    leads, score, seen = {"first": "second", "second": "third", "third": "fourth"}, 10.0, []

    def choose(*given: Any) -> Choice:
        return Choice((candidate("a", score=score),), {}, (Rejected("z", "weak"),))

    def base(name: str) -> Any:
        return stub(name=name, model=None, clean=None, noise=None)

    def screened(baseline: Any, number: int) -> Any:
        seen.append((baseline.name, number))
        return stub(threshold=4.0, baseline=baseline)

    monkeypatch.setattr(searching, "examine", lambda round_: REST)
    monkeypatch.setattr(searching, "choose", choose)
    monkeypatch.setattr(searching, "deeper", lambda baseline, fit: leads.get(baseline.name))
    monkeypatch.setattr(searching, "fit_baseline", lambda model, clean, prepared, scatter, found, noise: base(found))
    monkeypatch.setattr(searching, "accept", lambda *given: (None, []))
    setting: Any = stub(screened=screened, options=Options(), tell=lambda *given: None, prepared=None, scatter=None)
    state = run_rounds(setting, base("first"))
    assert seen == [("first", 0), ("second", 0), ("third", 0)]
    assert [r.baseline.name for r in state.rounds] == ["third"]
    assert len(state.rejected) == 1, "what was said of a base that gave way is forgotten with it"
    seen.clear()
    score = 3.0  # of a threshold of 4
    run_rounds(setting, base("first"))
    assert seen == [("first", 0)]


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
            cost=cost, values={"play": play, "which": which}, locals=[], converged=turn == 1, diverged=False, model=None
        )

    parameter = EffectParameter("play", "rad", 1.0, 0.0, 3.0)
    hypothesis = stub(form=stub(parameters=(parameter,), nonlinear=True))
    monkeypatch.setattr(
        confirm, "_begun", lambda p, b, h, start, _: (p, fitted("near" if start["play"] < 0.5 else "usual", 0))
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

    def begun(problem: Any, base: Any, hypothesis: Any, start: Any, beyond: float) -> Any:
        cost, play = (3.0, 1.0) if start["play"] < 0.2 else end
        values = {"play": play}
        return problem, stub(cost=cost, values=values, locals=[], converged=True, diverged=False, model=None)

    monkeypatch.setattr(confirm, "_begun", begun)
    hypothesis = stub(form=stub(parameters=(EffectParameter("play", "rad", 1.0, 0.0, 3.0),), nonlinear=True))
    _, found = confirm.fit_hypothesis(stub(model=None, criteria=AS_SET), stub(cost=20.0), hypothesis, {"play": 0.0})
    assert found.cost == kept
