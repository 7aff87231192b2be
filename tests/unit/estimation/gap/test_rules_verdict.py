"""Rules of the verdict, each at its limit: the decision table, names beside a rest, tables, places."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimation.gap.answer.result import Gap, GapVerdict
from estimation.gap.criteria import AS_SET
from estimation.gap.decision.decide import TABLE, Named, VerdictFacts, closed_by, decide, only_steered, outweighs
from estimation.gap.decision.location import binned, channels_that_gain, regime, spans_of, windows
from estimation.gap.decision.steps import (
    detectable_sizes,
    followers,
    migrated,
    nominal_threshold,
    ties_of,
    undetectable,
    worth_in_words,
)
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.significance.screen import Hypothesis, HypothesisColumn, Screen


def stub(**fields: Any) -> Any:
    """As much of a round or baseline as a rule looks at."""
    return SimpleNamespace(**fields)


def gap(closed: float) -> Gap:
    """From an excess of 3 (before 2, floor 1) down to what is left of it."""
    return Gap(2.0, float(np.sqrt(1.0 + 3.0 * (1.0 - closed))), 1.0)


def named(
    effect: str = "Cn_da", score: float = 20.0, closed: float = 0.95, held: float | None = None, *places: str
) -> Named:
    return Named(effect, score, gap(closed), None if held is None else gap(held), frozenset(places))


QUIET = VerdictFacts(named=(), rest=3.0, rest_threshold=5.0, rest_place="r", covered=True, blind=0, asked=50)


def verdict(facts: VerdictFacts) -> GapVerdict:
    return decide(facts, AS_SET).verdict


# ------------------------------------------------------------------------------------------------ the table
def test_every_combination_of_facts_has_exactly_one_verdict() -> None:
    for number in range(16):
        found = [bool(number >> bit & 1) for bit in range(4)]
        fitting = [row for row in TABLE if all(w is None or w == f for w, f in zip(row[:-1], found, strict=True))]
        assert len(fitting) == 1
    assert {row[-1] for row in TABLE} == set(GapVerdict)


def test_nothing_found_and_nothing_left_is_no_gap() -> None:
    assert verdict(QUIET) is GapVerdict.NO_GAP


@pytest.mark.parametrize(("blind", "word"), [(7, GapVerdict.NO_GAP), (8, GapVerdict.CANNOT_TELL)])
def test_flights_that_hide_one_effect_in_seven_cannot_tell(blind: int, word: GapVerdict) -> None:
    assert verdict(replace(QUIET, blind=blind)) is word
    assert verdict(replace(QUIET, blind=blind, named=(named(),))) is GapVerdict.GAP_CLOSED, "what they show they show"


def test_where_every_control_only_follows_the_motion_no_rest_counts_and_names_do() -> None:
    loud = replace(QUIET, rest=60.0)
    assert verdict(loud) is GapVerdict.UNKNOWN
    assert verdict(only_steered(loud)) is GapVerdict.CANNOT_TELL
    assert verdict(only_steered(replace(loud, named=(named(),)))) is GapVerdict.GAP_CLOSED


def test_a_rest_that_errors_of_the_inputs_may_have_left_is_no_effect_and_names_fall_beside_it_all_the_same() -> None:
    loud = replace(QUIET, rest=60.0)
    assert decide(loud, AS_SET, commanded=True).verdict is GapVerdict.CANNOT_TELL
    assert decide(QUIET, AS_SET, commanded=True).verdict is GapVerdict.NO_GAP
    certain = replace(loud, named=(named(),), rest=7.0)
    assert decide(certain, AS_SET, commanded=True).kept == decide(certain, AS_SET).kept
    assert decide(certain, AS_SET, commanded=True).verdict is not GapVerdict.UNKNOWN


def test_where_commands_are_recorded_a_name_of_a_gap_that_nothing_hidden_leaves_is_withdrawn_with_all_after_it() -> (
    None
):
    """A `Cn_r` 1.4 times too large in a SITL file was an `imu_lever_arm`: a gap of 6.00 of 6.00, held out 5.94 of up to 8.23."""
    gap, held = Gap(5.999, 5.485, 6.0, 6.3, 0.7), Gap(5.94, 5.74, 6.2, 8.23, 0.7)
    lever = replace(named(), effect="imu_lever_arm", gap=gap, held=held)
    facts = replace(QUIET, named=(lever, replace(named(), effect="time_skew")))
    assert decide(facts, AS_SET).kept == 2
    told = decide(facts, AS_SET, commanded=True)
    assert (told.verdict, told.kept, told.doubted) == (GapVerdict.CANNOT_TELL, 0, True)
    assert [effect for effect, _ in told.withdrawn] == ["imu_lever_arm", "time_skew"]
    seen = decide(replace(facts, named=facts.named[::-1]), AS_SET, commanded=True)
    assert (seen.verdict, seen.kept) == (GapVerdict.GAP_CLOSED, 1)


@pytest.mark.parametrize(("rest", "word"), [(4.9, GapVerdict.NO_GAP), (5.1, GapVerdict.UNKNOWN)])
def test_a_rest_above_its_threshold_is_an_unknown_effect(rest: float, word: GapVerdict) -> None:
    assert verdict(replace(QUIET, rest=rest)) is word


@pytest.mark.parametrize(("rest", "word"), [(7.4, GapVerdict.GAP_CLOSED), (7.6, GapVerdict.UNKNOWN)])
def test_beside_names_that_close_the_gap_a_rest_is_restless_scatter_unless_it_is_strong(
    rest: float, word: GapVerdict
) -> None:
    facts = replace(QUIET, rest=rest, named=(named(score=50.0),))
    assert verdict(facts) is word
    assert verdict(replace(facts, covered=False)) is GapVerdict.UNKNOWN
    assert verdict(replace(facts, named=())) is GapVerdict.UNKNOWN


def test_a_rest_in_the_very_instrument_that_a_name_blames_is_no_restless_scatter() -> None:
    """A vane that sticks, named as one that is late and ahead, which leaves 1.4 thresholds in that vane."""
    two = (named("alpha_lag", 19.4, 0.36, None, "alpha"), named("alpha_position", 16.7, 0.30, None, "alpha"))
    decision = decide(replace(QUIET, rest=7.2, rest_place="alpha", named=two), AS_SET)
    assert (decision.verdict, decision.kept) == (GapVerdict.UNKNOWN, 0)
    assert verdict(replace(QUIET, rest=7.2, rest_place="q", named=two)) is not GapVerdict.UNKNOWN
    strong = replace(QUIET, rest=7.2, rest_place="alpha", named=(named("alpha_lag", 40.0, 0.9, None, "alpha"),))
    assert decide(strong, AS_SET).kept == 1


@pytest.mark.parametrize(("closed", "word"), [(0.68, GapVerdict.GAP_REDUCED), (0.72, GapVerdict.GAP_CLOSED)])
def test_a_gap_is_closed_where_seven_tenths_of_it_are_gone(closed: float, word: GapVerdict) -> None:
    assert verdict(replace(QUIET, named=(named(closed=closed),))) is word


def test_the_held_out_gap_decides_where_there_is_one() -> None:
    assert verdict(replace(QUIET, named=(named(closed=0.99, held=0.5),))) is GapVerdict.GAP_REDUCED
    assert verdict(replace(QUIET, named=(named(closed=0.5, held=0.9),))) is GapVerdict.GAP_CLOSED


def test_names_close_together_what_lay_before_the_first_and_after_the_last() -> None:
    first, last = Named("a", 9.0, Gap(3.0, 2.0, 1.0), None), Named("b", 9.0, Gap(2.0, 1.0, 1.0), None)
    assert closed_by([first]) == pytest.approx(1.0 - 3.0 / 8.0)
    assert closed_by([first, last]) == 1.0
    held = [replace(first, held=Gap(3.0, 2.5, 1.0)), replace(last, held=Gap(2.5, 2.0, 1.0))]
    assert closed_by(held) == pytest.approx(1.0 - 3.0 / 8.0)


def test_held_out_flights_that_showed_nothing_do_not_decide_unless_they_get_worse() -> None:
    """`thrust_scale` and `elevator_delay`, both right: a held-out gap of 1.40, up to 1.80 with nothing hidden: `gap_reduced`."""
    name = named(closed=0.95)
    unseen = Gap(1.40, 1.38, 1.30, highest=1.80, enough=0.7)
    assert verdict(replace(QUIET, named=(replace(name, held=unseen),))) is GapVerdict.GAP_CLOSED
    assert (unseen.share, unseen.to_json()["closed"]) == ("-", 1.0)
    larger = Gap(1.20, 1.25, 1.30, highest=1.80, enough=0.7)
    assert verdict(replace(QUIET, named=(replace(name, held=larger),))) is GapVerdict.GAP_REDUCED
    assert (larger.share, larger.to_json()["closed"]) == ("-", 0.0)
    seen = Gap(1.90, 1.80, 1.30, highest=1.80, enough=0.7)
    assert verdict(replace(QUIET, named=(replace(name, held=seen),))) is GapVerdict.GAP_REDUCED


def test_names_of_a_gap_that_nothing_hidden_leaves_close_it_where_all_that_is_left_is_such_a_gap() -> None:
    """A right `elevator_lag` of score 13: 1.326 before and 1.305 after, 1.235 and up to 1.38 with nothing hidden."""
    unseen = Gap(1.326, 1.305, 1.235, highest=1.38, enough=0.7)
    name = replace(named(), gap=unseen, held=Gap(1.167, 1.153, 1.234, highest=1.41, enough=0.7))
    assert unseen.share == "-"
    assert verdict(replace(QUIET, named=(name,))) is GapVerdict.GAP_CLOSED
    assert verdict(replace(QUIET, named=(replace(name, held=None),))) is GapVerdict.GAP_CLOSED
    stands_above = replace(name, gap=Gap(1.5, 1.4, 1.235, highest=1.38, enough=0.7))
    assert verdict(replace(QUIET, named=(stands_above,))) is GapVerdict.GAP_REDUCED


# ------------------------------------------------------------------------------------------------ names beside a rest
LOUD = replace(QUIET, rest=10.0, covered=False)


@pytest.mark.parametrize(("score", "kept"), [(17.0, 0), (18.0, 1)])
def test_a_name_that_closes_little_stands_from_three_quarters_of_the_significance_on(score: float, kept: int) -> None:
    """300 is three quarters of 300 + 10^2."""
    found = decide(replace(LOUD, named=(named(score=score, closed=0.3),)), AS_SET)
    assert (found.verdict, found.kept) == (GapVerdict.UNKNOWN, kept)
    assert found.withdrawn == (() if kept else (("Cn_da", "closes only 30% of the gap"),))


def test_a_name_that_closes_the_gap_stands_beside_any_rest() -> None:
    for closed, held in ((0.8, None), (0.3, 0.8)):
        assert decide(replace(LOUD, named=(named(score=5.0, closed=closed, held=held),)), AS_SET).kept == 1
    assert decide(replace(LOUD, named=(named(score=5.0, closed=0.3, held=0.3),)), AS_SET).kept == 0


def test_only_the_last_name_is_asked_what_it_closes() -> None:
    facts = replace(LOUD, named=(named("a", 5.0, 0.1), named("b", 5.0, 0.1)))
    found = decide(facts, AS_SET)
    assert (found.kept, [effect for effect, _ in found.withdrawn]) == (1, ["b"])


def test_last_names_with_which_the_gap_grows_do_not_stand_where_no_flight_is_held_out() -> None:
    """They are significant, so that something without a name is left."""
    grown = Gap(6.744, 6.906, 6.16, highest=6.8)
    last = replace(named("CL_alpha2", 16.6), gap=grown)
    found = decide(replace(QUIET, named=(named(), last, last)), AS_SET)
    assert (found.verdict, found.kept, len(found.withdrawn)) == (GapVerdict.UNKNOWN, 1, 2)
    assert found.withdrawn[0][1].startswith("closes nothing")
    for stands in (
        replace(last, held=gap(0.5)),
        replace(last, gap=replace(grown, highest=7.0)),
        replace(last, gap=replace(grown, after=6.7)),
    ):
        assert decide(replace(QUIET, named=(named(), stands)), AS_SET).kept == 2
    assert decide(replace(QUIET, named=(last, named())), AS_SET).kept == 2, "the last one is fitted with it"


def kept(names: Sequence[tuple[str, float]], place: str, rest: float) -> tuple[int, list[str]]:
    """Names that close the gap, and blame the vane where they are called beta_..."""
    made = tuple(named(n, s, 0.9, None, *(["beta"] if n.startswith("beta_") else [])) for n, s in names)
    found = decide(replace(LOUD, named=made, rest=rest, rest_place=place), AS_SET)
    assert found.verdict is GapVerdict.UNKNOWN
    return found.kept, [effect for effect, _ in found.withdrawn]


@pytest.mark.parametrize(("score", "stands"), [(29.0, 0), (31.0, 1)])
def test_a_name_for_the_very_instrument_needs_nine_tenths(score: float, stands: int) -> None:
    """30^2 is nine tenths of 30^2 + 10^2."""
    assert kept([("beta_lag", score)], "beta", 10.0)[0] == stands


def test_a_name_for_an_instrument_goes_with_all_that_were_found_on_top_of_it() -> None:
    sticking = [("beta_lag", 25.0), ("beta_scale", 14.0)]
    assert kept(sticking, "beta", 13.2) == (0, ["beta_lag", "beta_scale"])
    assert kept([("Cn_da", 19.0), *sticking], "beta", 13.2) == (1, ["beta_lag", "beta_scale"])
    assert kept([("beta_lag", 20.0)], "p", 40.0) == (1, [])
    assert kept([("Cn_da", 19.0)], "r", 40.0) == (1, [])


def test_a_certain_effect_outweighs_a_small_nameless_rest() -> None:
    assert outweighs(17.3, 6.0, AS_SET.named_share)
    assert not outweighs(17.3, 12.0, AS_SET.named_share)
    assert not outweighs(5.0, 50.0, AS_SET.named_share)


# ------------------------------------------------------------------------------------------------ tables
def asked(gram: np.ndarray, tied_to: tuple[str, ...] = ()) -> Any:  # type: ignore[type-arg]
    """A round of hypotheses a, b, ... of usual size 2; the last column of `gram` is the residual."""
    columns, hypotheses = [], []
    for h in range(len(gram) - 1):
        parameter = EffectParameter("abc"[h], "1", 2.0, -9.0, 9.0)
        form = Form("abc"[h], (parameter,))
        effect = Effect("abc"[h], "", Group.SENSOR, "", "", "", "", {}, "", (form,), tied_to=tied_to)
        columns.append(HypothesisColumn(h, parameter))
        hypotheses.append(Hypothesis(effect, form))
    screen = Screen((), tuple(hypotheses), tuple(columns), (gram,), np.zeros_like(gram), (0,))
    return stub(screen=screen, inflation=np.ones(len(hypotheses)), threshold=4.0, criteria=AS_SET)


@pytest.mark.parametrize(("power", "hidden"), [(0.95, True), (1.05, False)])
def test_an_effect_is_hidden_that_twice_its_usual_size_would_not_have_shown(power: float, hidden: bool) -> None:
    """A score of 4 at two usual sizes of 2: one per unit."""
    gram = np.diag([power**2, 1.0])
    assert bool(undetectable(asked(gram))) is hidden
    assert not undetectable(asked(gram, tied_to=("CY_0",))), "what no flight shows is said elsewhere"


def test_an_effect_that_could_not_be_asked_is_one_that_was_not_seen() -> None:
    seen = asked(np.diag([4.0, 1.0]))
    assert undetectable(seen) == []
    (a,) = seen.screen.hypotheses
    other = replace(a, effect=replace(a.effect, name="other"))
    tied = replace(a, effect=replace(a.effect, name="tied", tied_to=("CY_0",)))
    seen.screen = replace(seen.screen, runaway=(a, other, tied))
    assert [e.name for e in undetectable(seen)] == ["other"], "another form of `a` was asked"


def test_the_smallest_size_seen_gives_the_threshold() -> None:
    assert detectable_sizes(asked(np.diag([4.0, 1.0]))) == pytest.approx({"a": 2.0})


@pytest.mark.parametrize(("cosine", "tied"), [(0.88, False), (0.92, True)])
def test_signatures_are_tied_from_a_cosine_of_nine_tenths_on(cosine: float, tied: bool) -> None:
    gram = np.eye(3)
    gram[0, 1] = gram[1, 0] = -cosine
    found = ties_of(asked(gram))
    assert bool(found) is tied
    assert all((t.first, t.second) == ("a", "b") and t.cosine == pytest.approx(cosine) for t in found)


def test_the_nominal_threshold_is_that_of_a_normal_law() -> None:
    assert nominal_threshold(1, AS_SET) == pytest.approx(2.24140, abs=1e-5)
    assert nominal_threshold(50, AS_SET) == pytest.approx(3.48076, abs=1e-5)


# ------------------------------------------------------------------------------------------------ steps
@pytest.mark.parametrize(("bounds", "found"), [(2.8, False), (3.2, True)])
def test_a_derivative_that_moves_by_three_bounds_had_absorbed_the_effect(bounds: float, found: bool) -> None:
    def baseline(value: float) -> Any:
        values = {"Cn_p": value, "timing_x": 100.0 * value, "form_w1": 100.0 * value}
        fit = stub(free=tuple(values), values=values, std=lambda: dict.fromkeys(values, 0.1))
        problem = stub(nuisance=lambda n: n == "timing_x")
        read, model = stub(parameter_names=("Cn_p", "timing_x")), stub(parameter=lambda n: stub(reference=0.5))
        return stub(fit=fit, criteria=AS_SET, problem=problem, model=model, clean=read)

    moved = migrated(baseline(1.0), baseline(1.0 + 0.1 * bounds))
    assert list(moved) == (["Cn_p"] if found else [])
    assert all(m.bounds == pytest.approx(bounds) and m.prior == 0.5 for m in moved.values())


def test_surfaces_followed_that_moved_by_two_fifths_of_the_largest_shift() -> None:
    moved = {"delta_a": -0.06, "delta_r": 0.026, "delta_e": 0.022}
    assert followers(moved, AS_SET) == {"delta_a": -0.06, "delta_r": 0.026}
    assert followers({}, AS_SET) == {}


@pytest.mark.parametrize(
    ("worth", "beyond"),
    [({"p": 1.9}, False), ({"p": 2.1}, True), ({"r": 2.1}, True), ({"beta": 0.95}, False), ({"beta": 1.05}, True),
     ({"phi": 1.9}, False), ({"phi": 2.1}, True), ({"ay": 99.0}, False)],
)  # fmt: skip
def test_what_stays_within_simulator_tolerances_is_real_but_immaterial(worth: dict[str, float], beyond: bool) -> None:
    assert worth_in_words(worth).startswith("matters" if beyond else "real but within")


def test_worth_is_said_beside_its_tolerance() -> None:
    text = worth_in_words({"beta": 1.5, "p": 0.5})
    assert text == "matters: p 0.5 against 2 deg/s, beta 1.5 against 1 deg (beyond it)"


# ------------------------------------------------------------------------------------------------ where it lives
def test_channels_that_gain_a_seventh_of_the_best_show_the_effect() -> None:
    assert channels_that_gain(np.array([14.0, 100.0, 16.0, -5.0]), AS_SET) == [1, 2]


def test_stretches_that_gain_a_seventh_of_the_best_show_the_effect() -> None:
    """Boxes of 2 s at 20 Hz: smoothing over a second leaves their height and their half-height ends."""
    time = 0.05 * np.arange(400)
    gain = np.zeros(400)
    gain[40:80], gain[160:200], gain[280:320] = 0.16, 1.0, 0.14
    found = spans_of(time, gain, AS_SET)
    assert [round(a) for a, _ in found] == [8, 2]


def test_a_stretch_is_smoothed_over_a_second_and_half_of_it_long() -> None:
    """A spike of one sample becomes a second of flight."""
    gain = np.zeros(400)
    gain[200] = 1.0
    ((begin, end),) = spans_of(0.05 * np.arange(400), gain, AS_SET)
    assert end - begin == pytest.approx(0.95)


def where(gain_at: float, share: float = 1.0) -> str:
    """Of a roll rate that grows evenly from 0 to 1 while the gain is made beyond `gain_at` of its distance from the middle."""
    p = np.linspace(-1.0, 1.0, 2001)
    gain = np.where(np.abs(p) > gain_at, share, 1.0)
    return regime({"p": np.radians(p)}, gain, AS_SET)


def test_a_regime_holds_the_three_tenths_of_largest_values_and_more_than_its_share_of_the_gain() -> None:
    assert where(0.7, 100.0) == "|p| > 0.7 deg/s"
    # a share of gain g over a share of time 0.3: 1.45 and 1.55 times
    assert where(0.7, 1.45 * 0.7 / (1 - 1.45 * 0.3)) == "everywhere"
    assert where(0.7, 1.55 * 0.7 / (1 - 1.55 * 0.3)) == "|p| > 0.7 deg/s"


@pytest.mark.parametrize(("share", "told"), [(0.05, True), (0.25, True), (0.4, False)])
def test_a_signal_of_two_values_has_a_regime_where_one_of_them_is_rare(share: float, told: bool) -> None:
    """A switch that is on for so much of the time; of one that is on for long no value is larger than its large ones."""
    on = np.arange(2000) < 2000 * share
    assert (regime({"x": on.astype(float)}, on.astype(float), AS_SET) != "everywhere") is told


def test_the_map_over_the_regime_has_six_equal_bins() -> None:
    rows = binned(np.arange(600.0), np.repeat(np.arange(1.0, 7.0) ** 2, 100))
    assert len(rows) == 6
    assert rows[0]["gap"] == pytest.approx(1.0)
    assert rows[-1]["gap"] == pytest.approx(6.0)


def test_the_map_over_time_has_windows_of_two_seconds() -> None:
    time = 0.05 * np.arange(200)
    found = windows(time, np.full((200, 2), 4.0))
    assert [w[0] for w in found] == pytest.approx([0.0, 2.0, 4.0, 6.0, 8.0])
    assert found[-1][1] == pytest.approx(9.95)
    assert all(w[2] == 2.0 for w in found)
