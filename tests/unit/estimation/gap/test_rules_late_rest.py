"""Names beside a coefficient that follows late: what stands out, which names are still needed, and the whole answer."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimation.gap.answer.result import GapVerdict
from estimation.gap.answer.shape import EventReport, Happened, LaggedTerm
from estimation.gap.criteria import AS_SET
from estimation.gap.decision.beside import (
    SIZE,
    TIME,
    LateRest,
    beside_memory,
    hypothesis_of,
    significant_beside,
    stands_out,
)
from estimation.gap.decision.conclusion import _outweighs
from estimation.gap.decision.decide import Decision
from estimation.gap.effects import catalogue
from estimation.gap.search.state import Options
from estimation.gap.workflow import run_gap
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth

MEMORY = LaggedTerm("Cn", "p_hat", 0.5, 400.0, 15.0, 7.0)


def _flown(scale: float, reach: float) -> Any:
    return SimpleNamespace(scale={"Cn": scale}, reach=lambda name: reach)


def test_a_memory_beside_names_stands_out_at_twice_its_threshold() -> None:
    limit = AS_SET.far_above * MEMORY.threshold
    assert not stands_out(replace(MEMORY, score=0.99 * limit), AS_SET)
    assert stands_out(replace(MEMORY, score=1.01 * limit), AS_SET)
    assert AS_SET.far_above == 2.0


def test_what_a_strong_lag_leaves_at_one_instant_is_no_event() -> None:
    burst = Happened([EventReport("burst", "", "f2", 12.0, 13.0, ((0.1, 0.01),), "rad/s2", 8.0, 6.0)])
    assert _outweighs(MEMORY, burst)
    assert not _outweighs(replace(MEMORY, score=1.3 * MEMORY.threshold), burst)
    assert not _outweighs(None, burst)


def test_a_name_is_needed_beside_a_memory_where_it_would_have_been_named() -> None:
    finding: Any = SimpleNamespace(
        candidate=SimpleNamespace(gain=200.0, score=10.0), round_=SimpleNamespace(threshold=4.0)
    )  # inflated twice: a gain of 32 is a score of 4
    assert not significant_beside(31.0, finding)
    assert significant_beside(33.0, finding)


def test_a_lag_adds_how_far_its_follower_is_behind() -> None:
    hypothesis, start = hypothesis_of(MEMORY, _flown(2e-3, 0.1))
    lag = hypothesis.form
    assert start == {SIZE: 0.0, TIME: 0.5}
    assert lag.terms == {"Cn": (f"{SIZE}*(nameless_follower - p_hat)",)}
    assert lag.lines == ("nameless_follower_dot = (p_hat - nameless_follower)/nameless_time",)
    assert lag.parameters[0].typical == pytest.approx(0.02)
    assert lag.parameters[1].lower < 0.25
    assert lag.parameters[1].upper > 1.0
    assert lag.obstacle(load_model("lateral", "cdfp")) is None


def test_names_that_a_memory_explains_are_withdrawn_from_the_first_on() -> None:
    told = beside_memory(Decision(GapVerdict.UNKNOWN, 3, ()), ["Cn_da", "Cn_betadot", "Ixz_error"], LateRest(MEMORY, 1))
    assert told.kept == 1
    assert [n for n, _ in told.withdrawn] == ["Cn_betadot", "Ixz_error"]
    assert "Cn follows p_hat some 0.5 s late" in told.withdrawn[0][1]
    assert beside_memory(Decision(GapVerdict.UNKNOWN, 1, ()), ["Cn_da"], LateRest(MEMORY, 1)).withdrawn == ()


NEAR = ("Cn_da", "Cn_betadot", "Ixz_error", "prop_gyroscopic", "gyro_misalignment", "rudder_lag", "gust")


@pytest.mark.parametrize("seed", [40180, 40280])
def test_two_names_that_imitate_a_memory_are_withdrawn(seed: int) -> None:
    """Yaw that follows roll rate 0.4 s late; yaw by the rate of sideslip and a product of inertia close some of it."""
    hidden = truth.Hidden("Cn", lambda s: 0.03 * s["p_hat"], 0.4)
    asked = [truth.Request(seed + i, v, hidden=hidden, duration=25.0) for i, v in enumerate((14.5, 16.5, 19.0))]
    flights = [
        Flight.build(f"f{i}", c["time"], {k: v for k, v in c.items() if k != "time"})
        for i, c in enumerate(truth.fly(asked))
    ]
    effects = [e for e in catalogue() if e.name in NEAR]
    result = run_gap(load_model("lateral", "cdfp"), flights[:2], flights[2:], effects, Options(seed=1, nulls=40))
    assert result.verdict is GapVerdict.UNKNOWN
    assert [s.effect for s in result.steps] == ["unknown"]
    shape = result.steps[0].shape
    assert isinstance(shape, LaggedTerm)
    assert (shape.line, shape.variable) == ("Cn", "p_hat")
    assert 0.25 <= shape.time <= 0.65
    assert any("not needed where Cn follows p_hat" in r.why for r in result.rejected)
    assert np.isfinite(result.steps[0].score)
