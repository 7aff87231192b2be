"""How many nulls a round flies: the first of them, and all of them where these leave a doubt."""

from typing import Any, cast

import numpy as np
import pytest

from estimation.gap.decision import conclusion as concluding
from estimation.gap.decision.conclusion import NOT_SEARCHED
from estimation.gap.effects import catalogue
from estimation.gap.search import state as searched
from estimation.gap.search.state import Options, SearchState
from estimation.gap.significance.calibration import CLEAR, FIRST_NULLS, Round
from estimation.gap.workflow import _Run
from estimation.models.load import load_model
from tests.studies import fourth_simulator as fourth
from tests.unit.estimation.gap.candidates_by_hand import stub

MOST = FIRST_NULLS + 10
ASKED = ("Cn_da", "Cl_beta3")


def first_round(size: float, nulls: int) -> tuple[Round, list[str]]:
    """The first round about flights with a `Cn_da` of so many usual sizes, and what was said meanwhile."""
    model, said = load_model("lateral", "cdfp"), list[str]()
    flown = fourth.fly(80330, fourth.Kind(axes="lateral", hidden=(("Cn_da", size),)), (14.5, 16.5))
    effects = [e for e in catalogue(model=model) if e.name in ASKED]
    run = _Run.of(model, flown, (), (), effects, Options(nulls=nulls), lambda what, share: said.append(what))
    setting, baseline = run.set_up(model)
    return setting.first_screened(baseline, 0), said


@pytest.fixture(scope="module")
def nothing() -> tuple[Round, list[str]]:
    return first_round(0.0, MOST)


def test_the_first_nulls_are_flown_first_and_all_where_they_are_needed(nothing: tuple[Round, list[str]]) -> None:
    first, said = nothing
    assert len(first.null_residuals) == FIRST_NULLS
    assert said[-1] == f"round 1: null {FIRST_NULLS} of {MOST}"
    every = first.with_enough_nulls
    assert len(every.null_residuals) == MOST
    assert said[-1] == f"round 1: null {MOST} of {MOST}"
    assert every.with_enough_nulls is every
    assert every.threshold == pytest.approx(first.threshold, rel=0.1)
    assert every.standardised().max() < CLEAR * every.threshold


def test_the_first_nulls_suffice_where_something_stands_clearly_out() -> None:
    round_, said = first_round(1.0, MOST)
    assert round_.with_enough_nulls is round_
    assert said[-1] == f"round 1: null {FIRST_NULLS} of {MOST}"
    best = int(np.argmax(round_.standardised()))
    assert round_.screen.hypotheses[best].effect.name == "Cn_da"
    assert round_.standardised()[best] > CLEAR * round_.threshold


def test_a_nameless_shape_or_event_is_asked_again_with_all_nulls(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first nulls had let no name come near its threshold; they have not shown that a shape is none either."""
    every: Any = stub(nulls="all", has_enough_nulls=True)
    first: Any = stub(nulls="first", has_enough_nulls=False, with_enough_nulls=every)
    left: Any = "rest of first"
    monkeypatch.setattr(searched, "examine", lambda round_: f"rest of {round_.nulls}")
    search = SearchState((), (first,), left, ())
    asked: list[str] = []

    def unnamed(state: Any) -> None:
        asked.append(state.search.rounds[-1].nulls)
        state.event = "event" if asked == ["first"] or found else None

    def decided(setting: Any, search: SearchState) -> Any:
        decision = stub(doubted=False, kept=0)
        empty = {"event": None, "shapes": NOT_SEARCHED, "findings": (), "named": (), "model": None}
        return stub(setting=setting, search=search, decision=decision, **empty)

    monkeypatch.setattr(concluding, "_decided", decided)
    monkeypatch.setattr(concluding, "without_doubted", lambda *given: None)
    monkeypatch.setattr(concluding, "_search_unnamed", unnamed)
    monkeypatch.setattr(concluding, "names_beside", lambda *given: None)
    monkeypatch.setattr(concluding, "_answer", lambda state, check, rejected: state)
    for found in (True, False):
        asked.clear()
        answer: Any = concluding.concluded(*cast(Any, (stub(steered=False), search, None)))
        assert asked == ["first", "all"]
        assert answer.event == ("event" if found else None)
        assert answer.search.omnibus == "rest of all"


def test_the_first_nulls_of_many_are_those_of_few(nothing: tuple[Round, list[str]]) -> None:
    """So an answer with more of them differs by its thresholds alone."""
    few, _ = first_round(0.0, 8)
    for of_few, of_many in zip(few.null_residuals, nothing[0].null_residuals, strict=False):
        np.testing.assert_array_equal(np.stack(of_few), np.stack(of_many))
    assert few.threshold == pytest.approx(nothing[0].threshold, rel=0.4)
