"""From the state of the search to the answer, on searches made by hand: what is confirmed, which facts count, what is told."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from estimation.errors import GapError
from estimation.gap.answer.result import EffectStep, Gap, GapVerdict, Where
from estimation.gap.answer.words import conclude, describe_step, rest_of_inputs
from estimation.gap.criteria import AS_SET
from estimation.gap.decision import beside as beside_shape
from estimation.gap.decision import conclusion as concluding
from estimation.gap.decision.beside import without_doubted
from estimation.gap.decision.conclusion import facts_of, steps_in_words
from estimation.gap.decision.decide import Decision, with_names
from estimation.gap.decision.lineage import models
from estimation.gap.decision.steps import unknown_step
from estimation.gap.effects import catalogue
from estimation.gap.effects.base import EffectParameter
from estimation.gap.search import accept as accepting
from estimation.gap.search.accept import confirmed as confirm
from estimation.gap.search.state import AcceptedEffect, Options, SearchState
from estimation.gap.significance.measure import Repeatability, odd_flights
from estimation.gap.significance.omnibus import Omnibus, OmnibusSignal
from estimation.models.load import load_model

EFFECTS = {e.name: e for e in catalogue()}


def stub(**fields: Any) -> Any:
    """As much of a search as a rule looks at."""
    return SimpleNamespace(**fields)


# ------------------------------------------------------------------------------------------------ confirmation
def asked(
    patch: pytest.MonkeyPatch,
    score: float = 5.0,
    gain: float = 100.0,
    cross: float | None = 1.0,
    held: float | None = 1.0,
    timing: bool = False,
    linear: float | None = None,
    bounds: float = 5.0,
    gaps: tuple[float, float] | None = (2.0, 1.9),
    highest: float = 1.6,
    confirmed: float | None = 0.0,
) -> tuple[Any, str]:
    """A linear candidate beside a nameless term that gains 100, threshold 4; its estimate so many bounds from none at 1, which
    the nulls scatter four times as far. highest: the largest held-out gap of nulls; confirmed: by the
    likelihood of the held-out flights."""
    likelihood = None if held is None else stub(gain=held, confirmed=lambda *given: confirmed)
    patch.setattr(accepting, "held_out_likelihood", lambda *given: likelihood)
    patch.setattr(accepting, "held_out_gaps", lambda *given: gaps)
    patch.setattr(accepting, "by_timing", lambda *given: timing)
    patch.setattr(accepting, "flight_gains", lambda *given: [50.0, 50.0])
    parameter = EffectParameter("x", "s", 2.0, -10.0, 10.0, none=1.0)
    hypothesis = stub(
        form=stub(nonlinear=False, slows_control=False, parameters=(parameter,)), label="x", key=("x", "x")
    )
    child = stub(fit=stub(values={"x": 1.0 - bounds}, std=lambda: {"x": 0.5}))
    round_ = stub(
        criteria=AS_SET,
        threshold=4.0,
        baseline=stub(problem=stub(model=None)),
        inflation=np.array([4.0]),
        screen=stub(hypotheses=[hypothesis], cross_gain=lambda h: cross),
        standardised=lambda: np.array([score if linear is None else linear]),
    )
    setting = stub(child=lambda *given: child, prepared=None, floors=lambda *given: stub(highest=highest))
    return confirm(setting, round_, stub(score=score, gain=gain, hypothesis=hypothesis), 100.0)


@pytest.mark.parametrize(
    ("known", "why"),
    [
        ({}, ""),
        ({"gain": 60.0}, "explains only 60%"),
        ({"cross": -1.0}, "does not hold on the training flights"),
        ({"cross": -1.0, "score": 7.0}, ""),
        ({"held": -4.0, "score": 4.1, "confirmed": None}, ""),  # inflated six times: 0.7 of the 0.8 above the threshold
        ({"held": -8.0, "score": 4.1, "confirmed": None}, "does not hold on the held-out flights"),
        ({"held": -1.0, "linear": 4.0}, "does not hold on the held-out flights"),  # the full fit alone
        ({"held": -18.0, "score": 7.0}, ""),  # a gain of 100 at a score of 7: inflated twice, held out too
        ({"held": -19.0, "score": 7.0}, "does not hold on the held-out flights"),
        ({"held": -35.0, "timing": True}, ""),  # inflated four times
        ({"held": -37.0, "timing": True}, "does not hold on the held-out flights"),
        ({"held": None, "gaps": None}, ""),
        ({"held": -1.0}, ""),  # the gap shrinks and stands above those of nulls
        ({"held": -1.0, "highest": 2.1}, "closes nothing"),  # nulls have such a gap too
        ({"held": -1.0, "highest": 2.1, "confirmed": None}, ""),  # and the likelihood can tell nothing
        ({"held": 1.0, "highest": 2.1}, ""),
        ({"gaps": (1.340, 1.341), "held": 17.0}, ""),  # inflated four times, still more than chance gives there
        ({"gaps": (1.340, 1.341), "held": 15.0}, "closes nothing"),
        ({"gaps": (1.340, 1.341), "held": 17.0, "highest": 1.3405}, "closes nothing"),
        ({"gaps": (1.455, 1.478), "held": 8.0, "score": 7.0}, ""),
        ({"gaps": (1.455, 1.478), "held": 7.0, "score": 7.0}, "closes nothing"),
        ({"gaps": (1.455, 1.478), "timing": True}, ""),
        # a right tilt of an inertial unit, score 8: the likelihood predicted 1.4 and gained 0.4
        ({"gaps": (1.305, 1.315), "held": 0.4, "score": 7.0, "confirmed": None}, ""),
        ({"gaps": (1.305, 1.315), "held": -0.4, "score": 7.0, "confirmed": None}, "closes nothing"),
        ({"gaps": (1.305, 1.315), "held": 0.4, "score": 5.9, "confirmed": None}, "closes nothing"),
        ({"gaps": (1.605, 1.615), "held": 0.4, "score": 7.0, "confirmed": None}, "closes nothing"),
        # a lag of an aileron in gusts: its likelihood gained 166 where it predicted 94, while the gap grew
        ({"gaps": (4.0, 4.7), "held": 166.0, "confirmed": 0.93}, ""),
        ({"gaps": (4.0, 4.7), "held": 166.0, "confirmed": 0.69}, "closes nothing"),
        ({"gaps": (4.0, 4.9), "held": 166.0, "confirmed": 0.93}, "closes nothing"),  # beyond three times the highest
        (
            {"gaps": (684.0, 1638.0), "score": 7.0, "held": 100.0, "confirmed": 1.0},
            "closes nothing",
        ),  # an inertia of a model aeroplane, 46 times what it is
        ({"bounds": 3.05}, ""),
        ({"bounds": 2.95}, "x = -1.95 +- 1 cannot be told from no effect"),  # the states it begins anew gained the rest
    ],
)
def test_what_is_refused_says_why(monkeypatch: pytest.MonkeyPatch, known: dict[str, Any], why: str) -> None:
    child, said = asked(monkeypatch, **known)
    assert said.startswith(why)
    assert (child is not None) is (why == "")


# ------------------------------------------------------------------------------------------------ facts and words
def step(effect: str, score: float = 20.0) -> EffectStep:
    return EffectStep(
        effect=effect, title=effect, form=effect, confidence=1.0, members=(), separate_by="", estimates={}, units={},
        score=score, threshold=4.0, where=Where("Cn", ("r",), (), "everywhere"), gap=Gap(3.0, 1.2, 1.0),
        holdout=Gap(2.8, 1.1, 1.0), migrated={},
    )  # fmt: skip


def test_the_form_of_an_effect_is_told_where_it_is_one_of_several() -> None:
    drag = replace(step("CD_beta2"), title="drag of sideslip", estimates={"CD_abs_beta": (0.17, 0.002)})
    assert describe_step(replace(drag, form="in proportion")).startswith(
        "drag of sideslip (CD_beta2, in proportion: CD_abs_beta = 0.17 +- 0.002), score 20.0"
    )
    assert describe_step(drag).startswith("drag of sideslip (CD_beta2: CD_abs_beta")
    assert describe_step(replace(drag, form="CD_abs_beta")).startswith("drag of sideslip (CD_beta2: CD_abs_beta")


def test_the_bound_of_a_time_has_what_sampling_leaves_open_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lag of 40 ms in records of 20 Hz was 31 +- 2: how a surface moves between two samples is not known that well."""
    known = {"elevator_lag": (0.031, 0.002), "k": (1.0, 0.1)}
    monkeypatch.setattr(concluding, "estimates_of", lambda *_: known)
    after = stub(criteria=AS_SET, problem=stub(records=[stub(interval=0.05)]))
    late = replace(step("elevator_lag"), units={"elevator_lag": "s", "k": "1"})
    told = concluding.with_final_estimates(late, stub(round_=None, candidate=None), after)
    assert told.estimates["elevator_lag"] == (0.031, pytest.approx(np.hypot(0.002, 0.005)))
    assert told.estimates["k"] == (1.0, 0.1)
    assert "Of that bound 5 ms is what sampling leaves open" in describe_step(told)
    plain = concluding.with_final_estimates(replace(late, units={}), stub(round_=None, candidate=None), after)
    assert plain.estimates == known
    assert "sampling" not in describe_step(plain)


def test_an_unknown_under_its_floor_says_that_its_course_stands_out() -> None:
    """A log of a firmware: a gap of 88.8 under a floor of 234, and an unknown."""
    assert "(a gap of 88.8, 234 with nothing hidden): its course stands out" in describe_step(
        replace(step("unknown"), gap=Gap(88.8, 88.8, 234.0))
    )
    assert "its course" not in describe_step(replace(step("unknown"), gap=Gap(2.0, 2.0, 1.0)))


def test_a_held_out_gap_that_was_never_above_its_floor_is_told_to_say_nothing() -> None:
    """A right `Cm_de3` closed "0 %" of a held-out gap of 1.258 over a floor of 1.254."""
    unseen = Gap(1.258, 1.258, 1.254, highest=1.31, enough=0.7)
    assert "did not show it in their gap (1.26, up to 1.31 with nothing hidden)" in describe_step(
        replace(step("Cm_de3"), holdout=unseen)
    )
    assert "did not show it" not in describe_step(
        replace(step("Cm_de3"), holdout=Gap(1.4, 1.39, 1.254, highest=1.31, enough=0.7))
    )
    assert "(a gap of 1.29, up to 1.31 with nothing hidden): its course stands out" in describe_step(
        replace(step("Cm_de3"), gap=Gap(1.29, 1.28, 1.254, highest=1.31, enough=0.7))
    )
    # one that vanished there needs no excuse
    assert "did not show it" not in describe_step(
        replace(step("Cm_de3"), holdout=Gap(1.30, 1.25, 1.254, highest=1.31, enough=0.7))
    )


def test_no_share_is_told_of_a_gap_that_was_never_above_its_floor() -> None:
    """ArduPlane's own log: 11.4 before and 11.6 after a right `Cn_da`, under a floor of 12.2, was "0 %" of training flights."""
    under = Gap(11.38, 11.58, 12.16)
    assert (under.share, Gap(11.85, 11.27, 12.16).share, Gap(3.0, 1.2, 1.0).share) == ("-", "-", "94%")
    assert "(a gap of 11.4, 12.2 with nothing hidden): its course stands out" in describe_step(
        replace(step("Cn_da"), gap=under)
    )
    assert "did not show it" in describe_step(replace(step("Cn_da"), holdout=Gap(11.38, 11.27, 12.16, 14.0, 0.7)))


def search(*names: str) -> Any:
    findings = [stub(candidate=stub(hypothesis=stub(effect=EFFECTS[n], form=EFFECTS[n].forms[0]))) for n in names]
    hypotheses = [stub(effect=EFFECTS[n]) for n in ("Cn_da", "Cn_da", "beta_lag", "beta_bias")]
    leading = (
        OmnibusSignal("time", "beta", "burst", 9.0, span=(3.0, 4.0)),
        OmnibusSignal("term", "r_dot", "p|p|", 8.0),
        OmnibusSignal("activity", "p", "quiet", 3.0),
    )
    return stub(
        findings=findings, rounds=[stub(screen=stub(hypotheses=hypotheses))], omnibus=Omnibus(9.0, 5.0, leading)
    )


def test_facts_know_whose_instrument_a_name_blames_and_how_many_effects_were_asked() -> None:
    facts = facts_of(search("Cn_da", "beta_lag"), [step("Cn_da"), step("beta_lag", 7.0)], True, [EFFECTS["Cn_da"]])
    assert [(n.effect, n.score, n.instruments) for n in facts.named] == [
        ("Cn_da", 20.0, frozenset()),
        ("beta_lag", 7.0, frozenset({"beta"})),
    ]
    assert (facts.rest, facts.rest_threshold, facts.rest_place) == (9.0, 5.0, "beta")
    assert (facts.covered, facts.blind) == (True, 1)
    assert facts.asked == 2, "beta_bias is carried by derivatives and asked of no flight"


def test_an_answer_tells_the_names_that_stand_and_then_the_rest() -> None:
    named = [step("Cn_da"), step("beta_lag")]
    check, gap = stub(origin="sensor"), Gap(1.4, 1.4, 1.0)
    steps = steps_in_words(Decision(GapVerdict.UNKNOWN, 1, ()), named, search("Cn_da", "beta_lag").omnibus, check, gap)
    assert [s.effect for s in steps] == ["Cn_da", "unknown"]
    assert [s.where.origin for s in steps] == ["sensor", ""]
    assert all(s.text for s in steps)
    assert steps[1].gap == Gap(1.4, 1.4, 1.0)
    assert [
        s.effect for s in steps_in_words(Decision(GapVerdict.GAP_CLOSED, 2, ()), named, search().omnibus, check, gap)
    ] == [
        "Cn_da",
        "beta_lag",
    ]
    assert steps_in_words(Decision(GapVerdict.NO_GAP, 0, ()), [], search().omnibus, check, gap) == ()


def test_the_rest_is_placed_by_the_signals_above_the_threshold() -> None:
    found = unknown_step(search().omnibus, Gap(1.4, 1.4, 1.0))
    assert found.where == Where("beta", ("beta", "r_dot"), ((3.0, 4.0),), "beta: burst; r_dot: like p|p|")
    assert (found.score, found.threshold) == (9.0, 5.0)


def test_the_child_has_the_effects_that_stand_at_their_fitted_values() -> None:
    base = load_model("lateral", "cdfp")
    form = EFFECTS["Cn_da"].forms[0]
    first: Any = stub(fit=stub(values={"Cl_p": -0.5}))
    kept: Any = stub(
        candidate=stub(hypothesis=stub(effect=EFFECTS["Cn_da"], form=form)),
        child=stub(fit=stub(values={"Cl_p": -0.4, "Cn_da": -0.01})),
    )
    before, after = models(base, first, [kept])
    assert before.parameter("Cl_p").start == -0.5
    assert after.name == "lateral+Cn_da"
    assert (after.parameter("Cl_p").start, after.parameter("Cn_da").start) == (-0.4, -0.01)
    assert models(base, first, [])[1] == before
    assert np.isfinite(after.parameter("Cn_da").lower)


def test_what_is_left_beside_a_shape_is_said_where_it_matters_and_where_it_can_be_examined(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def left(score: float) -> Any:
        return Omnibus(score, 4.0, (OmnibusSignal("term", "q_dot", "alpha", score),))

    before, about = left(20.0), stub(criteria=AS_SET)
    for score, said in (
        (1.05 * 4.0, "q_dot: like alpha"),
        (0.95 * 4.0, ""),
    ):
        monkeypatch.setattr(concluding, "examine", lambda round_, score=score: left(score))
        rest, words = concluding.still_left(about, before)
        assert (rest.score, words) == (score, said)

    def runs_away(round_: Any) -> Any:
        raise GapError("runs away")

    monkeypatch.setattr(concluding, "examine", runs_away)
    assert concluding.still_left(about, before) == (before, "")


def test_a_name_that_stands_beside_a_shape_is_withdrawn_no_longer() -> None:
    withdrawn = (("rudder_lag", "closes only 26% of the gap"), ("CY_beta3", "a smooth function explains more"))
    decision = with_names(Decision(GapVerdict.UNKNOWN, 0, withdrawn), ["rudder_lag"])
    assert (decision.kept, decision.withdrawn) == (1, withdrawn[1:])


@pytest.mark.parametrize(
    ("others", "found", "replaced"),
    [((), None, True), ((), ("Cn_da",), True), (("Cn_da",), ("Cn_da", "beta_lag"), True), (("Cn_da",), None, False),
     (("Cn_da",), ("beta_lag",), False)],
    ids=["alone", "another comes with it", "the other stands beside it", "no name does", "another one does"],
)  # fmt: skip
def test_a_shape_takes_the_place_of_a_doubted_name_beside_which_the_others_stand(
    monkeypatch: pytest.MonkeyPatch, others: tuple[str, ...], found: tuple[str, ...] | None, replaced: bool
) -> None:
    def finding(name: str, doubted: bool = False) -> Any:
        candidate = stub(hypothesis=stub(effect=stub(name=name)))
        return stub(candidate=candidate, doubted=doubted, round_=stub(baseline=f"before {name}"))

    shape = stub(measured=stub(closed=0.99), fitted=stub(increment=stub(place=stub(words="CY by beta"))))
    monkeypatch.setattr(beside_shape, "search_shape", lambda *given: stub(shape=shape))
    beside: Any = None if found is None else stub(findings=tuple(finding(n) for n in found))
    monkeypatch.setattr(beside_shape, "names_beside", lambda *given: beside)
    kept = [finding("beta_scale"), finding("CY_beta3", doubted=True), *(finding(n) for n in others)]
    named: Any = [stub(holdout=stub(closed=0.95)) for _ in kept]
    setting: Any = stub(options=stub(criteria=AS_SET))
    answer = without_doubted(setting, stub(), kept, named, Decision(GapVerdict.GAP_CLOSED, len(kept), ()))
    assert (answer is not None) is replaced
    if answer is not None:
        decision, before = answer[:2]
        assert (decision.kept, before, str(answer[2])) == (1, tuple(kept[:1]), "before CY_beta3")
        assert [effect for effect, _ in decision.withdrawn] == ["CY_beta3"]
    assert without_doubted(setting, stub(), kept[:1], named, Decision(GapVerdict.GAP_CLOSED, 1, ())) is None


# ------------------------------------------------------------------------------------------------ a name in place of a shape
@pytest.mark.parametrize(("stand", "asked"), [([0, 0], 2), ([0, 2, 2], 3), ([0, 1, 2, 2], 4)])
def test_names_in_place_of_a_shape_are_concluded_from_as_long_as_more_of_them_stand(
    monkeypatch: pytest.MonkeyPatch, stand: list[int], asked: int
) -> None:
    """A clipped gyro: two names stood in place of a shape, were withdrawn beside what was left, and were found again without
    end."""
    states = iter(stand)
    decided: list[Any] = []

    def state(setting: Any, search: Any) -> Any:
        decision = stub(kept=next(states), doubted=False)
        decided.append(stub(setting=setting, search=search, decision=decision, findings=(), named=(), event=None))
        vars(decided[-1]).update(model=None, shapes=concluding.NOT_SEARCHED)
        return decided[-1]

    monkeypatch.setattr(concluding, "_decided", state)
    monkeypatch.setattr(concluding, "without_doubted", lambda *given: None)
    monkeypatch.setattr(concluding, "_search_unnamed", lambda *given: None)
    monkeypatch.setattr(concluding, "names_beside", lambda *given: "names")
    monkeypatch.setattr(concluding, "in_its_place", lambda *given: "further rounds")
    monkeypatch.setattr(concluding, "_add_names", lambda *given: None)
    monkeypatch.setattr(concluding, "rejected_hypotheses", lambda *given: ())
    monkeypatch.setattr(concluding, "_answer", lambda state, check, rejected: state)
    answer = concluding.concluded(*cast(Any, (stub(steered=False), "rounds", None)))
    assert len(decided) == asked
    assert answer is decided[-2], "the last that had more names"


@pytest.mark.parametrize(("room", "named", "taken"), [(4, True, True), (4, False, False), (3, True, False)])
def test_rounds_about_the_names_that_stood_beside_a_shape_may_name_what_it_stood_for(
    monkeypatch: pytest.MonkeyPatch, room: int, named: bool, taken: bool
) -> None:
    asked: list[Any] = []

    def rounds(setting: Any, baseline: Any) -> SearchState:
        asked.append((setting.working, setting.options.most, baseline))
        return SearchState(("Cm_beta2",) if named else (), ("last",), "left", ("turned down",))  # type: ignore[arg-type]

    monkeypatch.setattr(beside_shape, "run_rounds", rounds)
    asked_afresh: list[Any] = []

    def afresh(setting: Any, findings: Any, child: Any) -> str:
        asked_afresh.append((setting.working, len(findings), child))
        return "with two"

    monkeypatch.setattr(beside_shape, "afresh_with", afresh)
    round_: Any = stub(baseline="base")
    one: Any = stub(model="one", clean="one")
    kept: Any = AcceptedEffect(round_, stub(), stub(), "base", one)  # type: ignore[arg-type]
    found: Any = [
        AcceptedEffect(round_, stub(), stub(), "shape", child, doubted=True)
        for child in ("shape and two", "shape and three")
    ]  # type: ignore[arg-type]
    standing: Any = stub(model="all three", clean="to read")
    search = SearchState((kept,), ("first",), "rest", ("no",))  # type: ignore[arg-type]
    beside: Any = stub(baseline=standing, findings=tuple(found), rejected=("not beside",))
    setting: Any = _Setting("model", "clean", Options(most=room), lambda what, share: None)
    more = beside_shape.in_its_place(setting, search, [kept], beside)
    assert (more is not None) is taken
    assert asked == ([("all three", 1, standing)] if room == 4 else [])
    if more is not None:
        assert more.findings[0] is kept
        # every name is held against the model without the shape
        assert [f.child for f in more.findings[1:3]] == ["with two", standing]
        assert [f.parent for f in more.findings[1:3]] == [one, "with two"]
        assert not any(f.doubted for f in more.findings[1:3])
        assert asked_afresh == [("one", 1, "shape and two")]
        assert more.findings[3:] == ("Cm_beta2",)
        assert (more.rounds, more.omnibus) == (("first", "last"), "left")
        assert more.rejected == ("no", "not beside", "turned down")
    alone: Any = stub(baseline=standing, findings=(found[1],), rejected=())
    more = beside_shape.in_its_place(setting, search, [kept], alone)
    if more is not None:
        assert (more.findings[1].parent, more.findings[1].child) == (one, standing)


@dataclass(frozen=True)
class _Setting:
    """As much of a setting as is replaced."""

    working: Any
    clean: Any
    options: Options
    tell: Any


def test_a_rest_that_times_of_commands_may_have_made_accuses_nothing() -> None:
    words = rest_of_inputs({"delta_a": 0.04, "delta_r": 0.04}, "what is left in p_dot", 43.5, 4.12)
    assert "delta_a and delta_r are known by commands that the log has every 40 ms" in words
    alone = conclude(GapVerdict.CANNOT_TELL, (), {}, (), (), True, inputs=words)
    assert alone.startswith("No effect found: delta_a and delta_r are known")
    assert "hardly excite" not in alone
    assert f"Beside this, {words}" in conclude(GapVerdict.GAP_CLOSED, (), {}, (), (), True, inputs=words)


@pytest.mark.parametrize(
    ("odd", "begins", "ends"),
    [
        (
            ["a"],
            "No effect found",
            "a does not repeat the other training flights even with this model: look at that flight",
        ),
        (
            ["a", "b"],
            "No effect found",
            "a and b do not repeat the other training flights even with this model: look at those",
        ),
        (["a", "b", "c"], "No training flight repeats the others", "No effect found"),
    ],
)
def test_flights_of_which_none_repeats_the_others_are_told_before_anything(
    odd: list[str], begins: str, ends: str
) -> None:
    """Five stretches of a jet at Mach 0.49 to 0.88: a shape led the answer, and four flights of four were odd."""
    text = conclude(GapVerdict.NO_GAP, (), {}, (), (), True, odd, flights=3)
    assert text.startswith(begins)
    assert ends in text


def test_of_two_flights_that_do_not_repeat_each_other_neither_is_the_odd_one() -> None:
    """A damper on in one of two Dutch rolls: the other was told to be looked at."""
    a, b, c = (Repeatability(n, chi, 10.0, 20.0) for n, chi in (("a", 15.0), ("b", 30.0), ("c", 12.0)))
    assert odd_flights((a, b)) == ["a", "b"]
    assert odd_flights((a, b, c)) == ["b"]
    assert odd_flights((a, c)) == []
