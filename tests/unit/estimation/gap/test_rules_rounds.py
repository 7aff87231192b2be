"""Rules of the rounds, each at its limit, on rounds and candidates made by hand: what becomes of earlier ones, when a round is
asked again."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimation.errors import GapError
from estimation.gap.answer.result import Rejected
from estimation.gap.criteria import AS_SET
from estimation.gap.search import bases
from estimation.gap.search import rounds as searching
from estimation.gap.search.bases import (
    factors_off,
    far_off,
    holds_an_effect,
    largest,
    many,
    moved_in_words,
    others_freed_in_words,
    stands_out,
    with_free_derivatives,
)
from estimation.gap.search.confirm import FittedHypothesis
from estimation.gap.search.rounds import better_rivals, idle, questioners, run_rounds
from estimation.gap.search.select import Choice
from estimation.gap.search.state import AcceptedEffect, Options
from estimation.gap.significance.calibration import Round
from estimation.models.base import Parameter
from tests.unit.estimation.gap.candidates_by_hand import ROUND, candidate, hypothesis, remainder, round_by_hand, stub
from tests.unit.estimation.gap.roll import ROLL

SETTING: Any = stub(options=Options())


# ------------------------------------------------------------------------------------------------ earlier effects again
@pytest.mark.parametrize(("gain", "needless"), [(15.0, True), (17.0, False), (-3.0, True)])
def test_an_effect_that_would_not_pass_beside_the_others_is_idle(gain: float, needless: bool) -> None:
    assert idle(gain, 4.0) is needless


def test_six_hypotheses_question_an_earlier_effect() -> None:
    assert questioners(np.arange(9.0), AS_SET) == [8, 7, 6, 5, 4, 3]


def rival(name: str, gain: float, scatter: float = 1.0, why_not: str = "") -> FittedHypothesis:
    """What gains so much, of which nulls scatter `scatter` times what theory says."""
    return candidate(name, gain=gain, score=float(np.sqrt(gain / scatter)), why_not=why_not)


def test_a_rival_must_beat_an_accepted_effect_clearly() -> None:
    better, best, bad = rival("a", 109.5), rival("b", 110.0), rival("c", 999.0, why_not="no")
    assert better_rivals([better, best, bad], 100.0, 1.0, 4.0, AS_SET) == [best, better]
    assert better_rivals([rival("x", 108.5)], 100.0, 1.0, 4.0, AS_SET) == []
    assert better_rivals([], 100.0, 1.0, 4.0, AS_SET) == []


def test_a_rival_does_not_replace_an_effect_that_gains_far_more_and_scatters_far_more() -> None:
    """Roll due to sideslip gained 164 000 beside what alpha changes of it, an airspeed 74 000; the first scattered 15 times as
    theory says, the second 1.3 times, and the second took the place (a PA-28 of JSBSim)."""
    assert better_rivals([rival("airspeed", 74.0, 1.3)], 164.0, 15.0, 4.0, AS_SET) == []
    as_good = rival("other", 124.0, 1.3)
    assert better_rivals([as_good], 164.0, 15.0, 4.0, AS_SET) == [as_good]


def test_a_rival_counts_as_much_as_its_nulls_scatter_and_has_to_be_significant() -> None:
    """An offset of the centre of gravity gained 1055 on flights of a light aircraft, and 100 times less by its nulls."""
    assert better_rivals([rival("lateral_cg", 1055.0, 100.0)], 0.0, 1.0, 4.0, AS_SET) == []  # 3.2 of 4
    loud, fair = rival("a", 400.0, 3.8), rival("b", 200.0, 1.5)
    assert better_rivals([loud, fair], 100.0, 1.0, 4.0, AS_SET) == [fair]
    assert better_rivals([loud], 100.0, 1.0, 4.0, AS_SET) == []
    assert better_rivals([rival("c", 15.0)], 0.0, 1.0, 4.0, AS_SET) == []


def test_a_rival_is_asked_what_any_effect_is_with_what_nulls_scatter_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """That is known of the last round, and of the earlier effect's own; the first that is confirmed takes the place. A bound is
    widened by what a small step scatters, a score by what is said of delays and plays. A rival of the same signature scatters as
    the earlier effect: beside `thrust_scale` nothing was left of `mass_error` to scatter, and it took the place at equal gain."""
    asked = [hypothesis(name, "linear") for name in ("own", "loud", "new", "other")]
    scatter = {"old": {asked[0].key: 2.0, asked[1].key: 3.0}, "last": {asked[1].key: 100.0}}
    given: dict[str, Any] = {}

    def round_of(threshold: float) -> Round:
        none: Any = None
        known = stub(hypotheses=asked[:2])
        return Round(none, known, np.zeros(2), np.array([5.0, threshold]), threshold, none)

    def confirmed(
        setting: Any, round_: Round, candidate: FittedHypothesis, nameless: float, nulls_of: Round
    ) -> tuple[str | None, str]:
        given.update(
            baseline=round_.baseline, inflation=list(round_.inflation), gains=list(round_.gains), nulls=nulls_of
        )
        return (None, "does not repeat") if candidate.hypothesis.label == "new" else ("child", "")

    def better(found: Any, gain: float, inflation: float, threshold: float, criteria: Any) -> list[FittedHypothesis]:
        given.update(found=found, gain=gain, scatter=inflation, threshold=threshold)
        return [elsewhere, rival("new", 999.0), rival("other", 998.0)]

    elsewhere = replace(rival("valley", 1100.0), fit=stub())  # the model without it fits as well from there
    monkeypatch.setattr(searching, "deeper_fit", lambda base, fit: fit if fit is elsewhere.fit else None)
    monkeypatch.setattr(searching, "hypotheses_for", lambda *args: [hypothesis("runs away", "linear"), *asked])
    monkeypatch.setattr(searching, "Tangent", lambda *args: None)
    tied = {0: [True, False, False, True]}  # `own` is the first that the screen has, the second that it was given
    monkeypatch.setattr(searching, "build_screen", lambda *args: stub(hypotheses=asked, tied=lambda h, _: tied[h]))
    monkeypatch.setattr(searching, "linear_gains", lambda *args: np.array([20.0, 1000.0, 30.0, 5.0]))
    monkeypatch.setattr(searching, "linear_guess", lambda *args: {})
    monkeypatch.setattr(
        searching, "individual_inflation", lambda round_: scatter["last" if round_.threshold == 4.5 else "old"]
    )
    monkeypatch.setattr(
        searching, "fit_hypothesis", lambda problem, fit, h, guess, beyond: given.update(beyond=beyond) or (None, h)
    )
    monkeypatch.setattr(searching, "assess", lambda problem, fit, h, found, inflation: (h.label, round(inflation, 9)))
    monkeypatch.setattr(searching, "material", lambda found, interval, noise, criteria: (*found, interval, noise))
    monkeypatch.setattr(searching, "better_rivals", better)
    monkeypatch.setattr(searching, "confirmed", confirmed)
    record = stub(inputs=("delta_a",), input_noise={"delta_a": 0.002}, interval=0.05)
    without = stub(problem=stub(records=[record]), criteria=AS_SET, clean=None, fit=stub(cost=1000.0))
    old = stub(candidate=rival("own", 200.0, 4.0), round_=round_of(9.0))
    last = round_of(4.5)
    found = searching._rival(stub(effects=(), prepared=stub(available=())), without, old, last, 100.0)
    assert found is not None
    assert given.pop("nulls") is last, "the screen without the earlier effect has none"
    assert (found[0].hypothesis.label, found[1]) == ("other", "child")
    assert (given.pop("gain"), given.pop("scatter")) == pytest.approx((100.0, 4.0))
    assert given.pop("beyond") == pytest.approx(1000.0 - 0.25 * 75.0), "what a rival has to gain"
    assert given == {
        "found": [(n, v, 0.05, {"delta_a": 0.002}) for n, v in (("new", 1.0), ("loud", 100.0), ("other", 4.0))],
        "threshold": 4.5,
        "baseline": without,
        "inflation": [5.0, 4.5, 1.0, 1.0],
        "gains": [20.0, 1000.0, 30.0, 5.0],
    }


def finding(name: str, cost: float = 50.0) -> AcceptedEffect:
    child: Any = stub(fit=stub(cost=cost), noise=None)
    return AcceptedEffect(ROUND, Choice((), {}, ()), candidate(name), stub(), child)


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
    monkeypatch.setattr(searching, "afresh_with", lambda *given: without)
    monkeypatch.setattr(searching, "_rival", lambda *given: None if rival is None else (candidate(rival), "child"))
    monkeypatch.setattr(searching, "fit_baseline", lambda *given: "fresh")
    setting = stub(prepared=None, scatter=None, child=lambda *given: "child")
    answer = searching.backward_check(setting, [finding("a"), finding("b")])
    if left is None:
        assert answer is None
        return
    assert answer is not None
    assert [f.candidate.hypothesis.label for f in answer[0]] == left
    assert answer[1][0].effect == "a"
    assert answer[1][0].why.startswith(why)
    if rival:  # by a lead of 30 in log evidence, which counts a thirtieth where so much is left without a name
        assert answer[0][-1].choice.weights["a"] < 1e-12
        assert answer[0][-1].choice.beside_rest(30.0)["a"] == pytest.approx(1.0 / (1.0 + np.e))


# ------------------------------------------------------------------------------------------------ enough nulls
@pytest.mark.parametrize(
    ("clear", "nameless", "best", "nulls", "asked"),
    [
        (True, 0.99, 2.5, "first", ["first"]),
        (False, 0.74, 0.74, "first", ["first"]),
        (False, 2.01, 0.0, "first", ["first"]),
        (False, 0.5, 2.01, "first", ["first"]),
        (False, 0.76, 0.0, "all", ["all"]),
        (False, 1.99, 0.0, "all", ["all"]),
        (False, 0.5, 0.76, "all", ["first", "all"]),
        (False, 0.5, 1.99, "all", ["first", "all"]),
    ],
)
def test_all_nulls_are_asked_where_the_first_leave_a_doubt(
    monkeypatch: pytest.MonkeyPatch, clear: bool, nameless: float, best: float, nulls: str, asked: list[str]
) -> None:
    """Scores in thresholds: of the strongest nameless signal and of the best candidate."""
    weighed: list[str] = []

    def choose(round_: Any) -> Choice:
        weighed.append(round_.nulls)
        return Choice((candidate("a", score=best * 4.0),), {}, ())

    every = round_by_hand(nulls="all")
    first = stub(threshold=4.0, nulls="first", has_enough_nulls=clear)
    first.with_enough_nulls = first if clear else every
    monkeypatch.setattr(searching, "choose", choose)
    monkeypatch.setattr(
        searching, "Remainder", lambda r: stub(of=r.nulls, omnibus=stub(score=6.0 * nameless, threshold=6.0))
    )
    round_, rest, choice = searching.weighed(first)
    assert (round_.nulls, rest.of) == (nulls, nulls)
    assert weighed == asked
    assert choice.best is not None


# ------------------------------------------------------------------------------------------------ rounds
def test_a_model_that_cannot_be_examined_is_withdrawn_and_what_was_found_before_it_stands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = iter([finding("a"), finding("b")])
    monkeypatch.setattr(searching, "Remainder", remainder)
    monkeypatch.setattr(searching, "choose", lambda *given: Choice((), {}, ()))
    monkeypatch.setattr(searching, "backward_check", lambda *given: None)
    monkeypatch.setattr(searching, "accept", lambda *given: (next(found), []))

    def screened(baseline: Any, number: int) -> Any:
        if number == 2:
            raise GapError("barely stable")
        return ROUND

    setting: Any = stub(first_screened=screened, options=Options(most=4), tell=lambda *given: None, prepared=None)
    left = run_rounds(setting, stub())
    assert [f.candidate.hypothesis.label for f in left.findings] == ["a"]
    assert [r.effect for r in left.rejected] == ["b"]
    assert "barely stable" in left.rejected[0].why
    assert len(left.rounds) == 2
    setting.first_screened = lambda baseline, number: screened(baseline, 2)
    with pytest.raises(GapError):
        run_rounds(setting, stub())


def test_rounds_go_on_until_nothing_is_accepted_or_enough_is(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [finding("a"), finding("b"), None]
    monkeypatch.setattr(searching, "Remainder", remainder)
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
        setting: Any = stub(
            first_screened=screened, options=Options(most=most), tell=lambda *given: None, prepared=None
        )
        return run_rounds(setting, stub())

    every = run(4)
    assert [f.candidate.hypothesis.label for f in every.findings] == ["a", "b"]
    assert seen == [0, 1, 2]
    assert len(every.rejected) == 3
    assert [f.candidate.hypothesis.label for f in run(1).findings] == ["a"]
    assert seen == [0, 1], "a last round examines what is left"


def test_effects_are_asked_again_until_all_of_them_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a false third name a `Cl_da` took the place of a `Cl_beta`, was joined by it again, and stayed."""
    a, b, c = finding("a"), finding("b"), finding("c")
    found = iter([a, b, None])
    revisions = iter([([b, c], []), ([c], []), None])
    monkeypatch.setattr(searching, "Remainder", remainder)
    monkeypatch.setattr(searching, "choose", lambda *given: Choice((), {}, ()))
    monkeypatch.setattr(searching, "accept", lambda *given: (next(found), []))
    monkeypatch.setattr(searching, "sharper_base", lambda *given: None)
    monkeypatch.setattr(searching, "backward_check", lambda *given: next(revisions))
    setting: Any = stub(
        first_screened=lambda *given: ROUND, options=Options(most=4), tell=lambda *given: None, prepared=None
    )
    assert [f.candidate.hypothesis.label for f in run_rounds(setting, stub()).findings] == ["c"]
    assert list(revisions) == [None], "one effect alone has none beside it"


def test_effects_that_drop_each_other_in_turn_end_the_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of two drops the other: without an end the search went round in circles."""
    turn = iter("abababab")
    monkeypatch.setattr(searching, "Remainder", remainder)
    monkeypatch.setattr(searching, "choose", lambda *given: Choice((), {}, ()))
    monkeypatch.setattr(searching, "accept", lambda *given: (finding(next(turn)), []))
    monkeypatch.setattr(searching, "backward_check", lambda setting, findings: ([findings[-1]], []))
    numbers: list[int] = []

    def screened(baseline: Any, number: int) -> Any:
        numbers.append(number)
        return ROUND

    setting: Any = stub(first_screened=screened, options=Options(most=4), tell=lambda *given: None, prepared=None)
    state = run_rounds(setting, stub())
    assert [f.candidate.hypothesis.label for f in state.findings] == ["a"]
    assert numbers == [0, 1, 2, 3], "the last round examines what is left"


def test_a_round_is_asked_again_about_a_better_base(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a significant candidate leads its base to is not gained by it; two better valleys a round, and no more."""
    leads, score, seen = {"first": "second", "second": "third", "third": "fourth"}, 10.0, []

    def choose(*given: Any) -> Choice:
        return Choice((candidate("a", score=score),), {}, (Rejected("z", "weak"),))

    def base(name: str) -> Any:
        return stub(name=name, model=None, clean=None, noise=None)

    def screened(baseline: Any, number: int) -> Any:
        seen.append((baseline.name, number))
        return round_by_hand(baseline=baseline)

    monkeypatch.setattr(searching, "Remainder", remainder)
    monkeypatch.setattr(searching, "choose", choose)
    monkeypatch.setattr(searching, "deeper_fit", lambda baseline, fit: leads.get(baseline.name))
    monkeypatch.setattr(searching, "fit_baseline", lambda model, clean, prepared, scatter, found, noise: base(found))
    monkeypatch.setattr(searching, "accept", lambda *given: (None, []))
    monkeypatch.setattr(searching, "sharper_base", lambda *given: None)
    setting: Any = stub(
        first_screened=screened, options=Options(), tell=lambda *given: None, prepared=None, scatter=None
    )
    state = run_rounds(setting, base("first"))
    assert seen == [("first", 0), ("second", 0), ("third", 0)]
    assert [r.baseline.name for r in state.rounds] == ["third"]
    assert len(state.rejected) == 1, "what was said of a base that gave way is forgotten with it"
    seen.clear()
    score = 3.0  # of a threshold of 4
    run_rounds(setting, base("first"))
    assert seen == [("first", 0)]


@pytest.mark.parametrize(("likelier", "held"), [(90.0, False), (110.0, True)])
def test_noise_holds_an_effect_where_flights_are_clearly_likelier_with_it(likelier: float, held: bool) -> None:
    assert holds_an_effect(likelier, AS_SET) is held


def test_a_round_is_asked_once_more_with_noise_that_holds_no_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    sharp, first, seen = stub(name="sharp"), stub(name="first"), []

    def screened(baseline: Any, number: int) -> Any:
        seen.append((baseline.name, number))
        return round_by_hand(baseline=baseline)

    monkeypatch.setattr(searching, "Remainder", remainder)
    monkeypatch.setattr(searching, "choose", lambda *given: Choice((), {}, ()))
    monkeypatch.setattr(searching, "accept", lambda *given: (None, []))
    monkeypatch.setattr(searching, "sharper_base", lambda *given: sharp)
    setting: Any = stub(
        first_screened=screened, options=Options(), tell=lambda *given: None, prepared=None, scatter=None
    )
    state = run_rounds(setting, first)
    assert seen == [("first", 0), ("sharp", 0)]
    assert [r.baseline.name for r in state.rounds] == ["sharp"]


# ------------------------------------------------------------------------------------------------ a base that is off
@pytest.mark.parametrize(("gains", "off"), [((9.0, 25.0, 7.9), "b"), ((7.0, 7.9, 0.0), None), ((), None)])
def test_a_derivative_is_off_that_gains_clearly(gains: tuple[float, ...], off: str | None) -> None:
    hypotheses = [stub(form=stub(frees=(n,))) for n in "abc"[: len(gains)]]
    screen = stub(hypotheses=hypotheses, span=lambda h: [h], projected=lambda: stub(gain=lambda span: gains[span[0]]))
    assert largest(screen, AS_SET) == off


@pytest.mark.parametrize(("off", "enough"), [("ab", False), ("abc", True)])
def test_a_base_is_off_in_many_derivatives_where_three_gain_one_beside_the_other(off: str, enough: bool) -> None:
    assert many(list(off), AS_SET) is enough


def test_a_number_is_off_by_more_than_three_bounds_and_a_factor_as_it_is() -> None:
    """Of a base with all numbers off by 10 % two freed derivatives and three factors fitted the flights: four got names."""
    values, std = {"Cl_p": -0.464, "Cl_r": 0.13, "k_Cl": 1.09, "k_Cn": 0.98}, {"Cl_p": 0.02, "Cl_r": 0.011}
    found: Any = stub(values=values, std=lambda: {**std, "k_Cl": 0.02, "k_Cn": 0.01})
    assert far_off(["Cl_p", "Cl_r"], {"Cl_p": -0.4, "Cl_r": 0.1}, found, AS_SET) == ["Cl_p"]
    assert factors_off(found, AS_SET) == ["k_Cl"]


@pytest.mark.parametrize(
    ("after", "costs", "stands"),
    [
        (-0.448, (7235.0, 5609.0, 5212.0), True),  # Cl_p of a SITL file times 1.4, by logs with servo outputs at 25 Hz
        (-0.174, (6101.0, 6076.0, 6050.0), False),  # the right file: half of what all gain
        (-0.516, (7235.0, 5609.0, 5212.0), True),
        (-0.519, (7235.0, 5609.0, 5212.0), False),  # a number as far off as usual stays so, whatever it gains
        (-0.448, (7235.0, 5900.0, 5212.0), False),
        (-0.448, (7235.0, 7235.0, 7235.0), False),
    ],
)
def test_one_wrong_number_stands_out_of_many_that_surfaces_bend(
    after: float, costs: tuple[float, float, float], stands: bool
) -> None:
    """By the times of recorded commands three more derivatives looked off by a quarter and more, and all were refitted."""
    assert stands_out(-0.609, after, costs, AS_SET) is stands


def test_free_derivatives_stand_for_the_factor_on_their_coefficient() -> None:
    base = ROLL.plus(parameters=[Parameter("k_Cl", start=1.0), Parameter("Cl_p", start=-0.4, fixed=True)])
    base = replace(base, equations=("Cl_sim = 0.1*p + 0.2*delta_a", "Cl = k_Cl*Cl_sim + Cl_p*p", *base.equations))
    free = with_free_derivatives(base, ["Cl_p"])
    assert "Cl_p" in free.free_names
    assert "k_Cl" not in free.free_names
    assert free.definitions["Cl"].endswith("off_Cl_delta_a*0.2*delta_a"), (
        "what has no parameter may be off as the others are"
    )
    assert (free.parameter("off_Cl_delta_a").prior_std, "off_Cl_p" in free.parameter_names) == (0.1, False)
    drag = base.plus(parameters=[Parameter("k_CD", start=1.0)])
    drag = replace(drag, equations=("CD_sim = 0.3*p", "CD = k_CD*CD_sim", *base.equations))
    free = with_free_derivatives(drag, ["Cl_p"])
    assert "k_CD" in free.free_names
    assert free.definitions["CD"].endswith("off_CD_p*0.3*p"), "none of what it has has a parameter"
    moved = stub(fit=stub(values={"Cl_p": -0.44, "L_p": -6.1}, std=lambda: {"Cl_p": 0.01, "L_p": 0.2}), criteria=AS_SET)
    words = moved_in_words(["Cl_p", "L_p"], {"Cl_p": -0.4, "L_p": -6.0}, moved)
    assert "all 2 were refitted first: Cl_p from -0.4 to -0.44 +- 0.01." in words
    biased = moved_in_words(["Cl_p"], {"Cl_p": -0.4}, moved, biased=True)
    assert "look off, as errors in the times of commands bias them" in biased
    assert others_freed_in_words(["Cl_p", "L_p"]).startswith("The 2 other derivatives of the base were free beside it")


@pytest.mark.parametrize(
    ("gains", "surprise", "noise"),
    [((60.0, 300.0, 90.0), 700.0, "noise of b"), ((60.0, 300.0, 90.0), 950.0, None), ((40.0, 49.0, 9.0), 700.0, None)],
)
def test_the_noise_is_that_of_the_hypothesis_with_which_flights_are_likeliest(
    monkeypatch: pytest.MonkeyPatch, gains: tuple[float, ...], surprise: float, noise: str | None
) -> None:
    surprises = {"base": 1000.0, "a": 930.0, "b": surprise, "c": 999.0}
    monkeypatch.setattr(bases, "_deviance", lambda base, fit: (surprises[fit], f"noise of {fit}"))
    monkeypatch.setattr(bases, "with_noise", lambda base, noise: noise)
    round_ = stub(baseline=stub(criteria=AS_SET, fit="base"))
    choice = stub(candidates=[stub(gain=g, fit=f) for g, f in zip(gains, "abc", strict=True)])
    assert bases.sharper_base(round_, choice) == noise
