"""A set that is flown until a bound is reached: it may end it or fly it again, within hard limits, and never by old numbers."""

import math
from collections.abc import Mapping

import pytest
from pydantic import ValidationError

from daq.actuation.config import SequencerConfig, WantedBound
from daq.companion.process import Companion, IdentificationConfig
from daq.companion.wire import CompanionReply
from daq.contract.scan import Scan
from daq.contract.sequencing import Reason, State
from tests.unit.daq.sequencer_rig import USUAL, Rig, sequencer_config, short_manoeuvre, switch_plan

Known = Mapping[str, tuple[float, float]] | None
SET_S = 1.0


def flown(known: Known, seconds: float = 12.0, after_s: float = 0.0, **changes: object) -> Rig:
    """A rig after so long, whose identification tells `known` from after_s of running on."""
    config: SequencerConfig = sequencer_config(until="Cl_p 5 %", **changes)
    rig = Rig(switch_plan(*USUAL), config=config, manoeuvre=short_manoeuvre(SET_S))
    begun: list[float] = []

    def told() -> Known:
        running = rig.state is State.RUNNING
        if running and not begun:
            begun.append(rig.now * 1e-9)
        return known if running and rig.now * 1e-9 - begun[0] >= after_s else {}

    rig.actuation.known = told
    rig.run(seconds)
    return rig


def running_s(rig: Rig) -> float:
    return 0.02 * sum(f.state == State.RUNNING for f in rig.book.frames)


def test_a_set_ends_when_its_bound_is_reached() -> None:
    rig = flown({"Cl_p": (-0.5, 0.02)}, after_s=0.4, most_sets=5)
    assert rig.reason is Reason.REACHED
    assert running_s(rig) == pytest.approx(0.42, abs=0.06)
    assert any("wanted bound reached (Cl_p 5 % after 0.4 s)" in w for w in rig.book.words)
    assert rig.book.warnings == []
    assert State.RAMPING in [f.state for f in rig.book.frames]  # increments fade


def test_it_is_flown_again_while_the_bound_is_not_reached_and_no_more_than_allowed() -> None:
    rig = flown({"Cl_p": (-0.5, 0.026)}, most_sets=3)
    assert rig.reason is Reason.COMPLETE
    assert running_s(rig) == pytest.approx(3 * rig.plan.duration_s, abs=0.06)
    assert any("3 sets" in w and "Cl_p 5 % not reached" in w for w in rig.book.words)
    increments = [f.increments[1] for f in rig.book.frames if f.state == State.RUNNING]
    period = round(rig.plan.duration_s / 0.02)
    assert increments[period + 5] == pytest.approx(increments[5], abs=1e-3)
    assert max(map(abs, increments[2 * period :])) > math.radians(4.0)


def test_longest_s_holds_whatever_is_allowed_otherwise() -> None:
    rig = flown({}, most_sets=10, longest_s=2.5)
    assert running_s(rig) == pytest.approx(2 * rig.plan.duration_s, abs=0.06)


def test_without_news_a_set_is_flown_once() -> None:
    """Identification that has died says neither that a bound is reached nor that it is not."""
    rig = flown(None, most_sets=5)
    assert rig.reason is Reason.COMPLETE
    assert running_s(rig) == pytest.approx(rig.plan.duration_s, abs=0.06)


def test_limits_of_the_motion_hold_in_every_set() -> None:
    config: SequencerConfig = sequencer_config(until="Cl_p 5 %", most_sets=5)
    rig = Rig(switch_plan(*USUAL), config=config, manoeuvre=short_manoeuvre(SET_S))
    rig.actuation.known = dict

    def roll() -> None:
        rig.flying.bank_deg = 70.0 if running_s(rig) > 1.5 * rig.plan.duration_s else 0.0

    rig.run(6.0, roll)
    assert rig.reason is Reason.BANK


@pytest.mark.parametrize("text", ["Cl_p", "Cl_p 5", "5 %", "Cl_p 0 %", "Cl_p -5 %", "Cl_p 500 %", "Cl_p nan %"])
def test_a_bound_that_cannot_be_meant_is_named(text: str) -> None:
    with pytest.raises(ValidationError, match="is no bound to be reached"):
        sequencer_config(until=text)


def test_more_sets_without_a_bound_are_refused_and_off_is_the_default() -> None:
    with pytest.raises(ValidationError, match="most_sets is for a set that is flown until"):
        sequencer_config(most_sets=2)
    assert sequencer_config().wanted is None
    assert sequencer_config(until=" Cn_beta  2.5 % ").wanted == WantedBound("Cn_beta", 0.025)


@pytest.mark.parametrize("bound", [0.0, -0.02])
def test_no_bound_at_all_does_not_end_a_set(bound: float) -> None:
    assert WantedBound("Cl_p", 0.05).reached({"Cl_p": (-0.5, 0.02)})
    assert not WantedBound("Cl_p", 0.05).reached({"Cl_p": (-0.5, bound)})
    assert not WantedBound("Cl_p", 0.05).reached({"Cl_p": (0.0, 0.0)})


def test_old_answers_are_no_news() -> None:
    companion = Companion(IdentificationConfig(every_s=2.0), "cdfp", "", *[lambda *_: None] * 3)
    assert companion.known() is None  # not started
    companion._process = object()  # type: ignore[assignment]  # one that never says more
    assert companion.known() is None
    companion._answer = CompanionReply(10.0, {"Cl_p": (-0.5, 0.02)})
    for seconds, fresh in ((9.0, False), (11.0, True), (15.9, True), (16.1, False)):  # nor those of another clock
        companion._scan_time = Scan(1, round(seconds * 1e9)).time
        assert (companion.known() is not None) is fresh
