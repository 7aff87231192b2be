"""Events in time: scores of several unknowns, the limit from nulls, and what is taken out of a rolling aircraft's flights."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lti
from scipy.stats import chi2, norm

from estimation.engine.kernel import Array
from estimation.gap.answer.result import Gap, GapVerdict
from estimation.gap.answer.shape import EventReport, Happened
from estimation.gap.answer.words import describe_events
from estimation.gap.criteria import AS_SET
from estimation.gap.decision.decide import Decision, as_unknown
from estimation.gap.decision.unnamed import event_report, event_step
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.fitting import fit
from estimation.gap.fit.noise import NoiseModel
from estimation.gap.fit.problem import LikelihoodProblem
from estimation.gap.fit.whitener import Whitener
from estimation.gap.records.candidate_model import DISTURBANCE
from estimation.gap.records.flight_records import FlightRecord
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.tangent import Tangent
from estimation.gap.significance.transients import equivalent, find_transients, possible_events, standing_out
from estimation.models.base import Model, Parameter, Signal
from tests.unit.estimation.gap.roll import ROLL

NOISE = 0.02
TIME = np.arange(0.0, 20.0, 0.05)
MOVED = 0.05 * np.sin(2.0 * TIME) + 0.02 * np.sin(5.0 * TIME)  # rad, of the one control


def test_several_unknowns_count_as_one_that_is_as_improbable() -> None:
    gains = np.array([[16.0, 1.0, 1.0], [25.0, 3.0, 3.0], [60.0, 8.0, 4.0], [60.0, 4.0, 8.0]])
    found, largest = standing_out(gains, np.array([1, 3, 3, 3]), ["a", "b", "c", "c"])
    assert found[0] == pytest.approx(4.0)
    assert found[1] == pytest.approx(norm.isf(chi2.sf(25.0, 3) / 2))
    assert found[2:] == pytest.approx([norm.isf(chi2.sf(30.0, 3) / 2)] * 2), (
        "twice as scattered on nulls as theory says"
    )
    nulls = [
        norm.isf(chi2.sf([1.0, 3.0, 4.0, 2.0], [1, 3, 3, 3]) / 2),
        norm.isf(chi2.sf([1.0, 3.0, 2.0, 4.0], [1, 3, 3, 3]) / 2),
    ]
    assert largest == pytest.approx(np.max(nulls, axis=1))
    assert np.isfinite(equivalent(np.array([1e6]), np.array([2]))).all()


def round_about(model: Model, inputs: dict[str, Array], shown: Sequence[Array], rng: np.random.Generator) -> Round:
    """A round about fitted flights with the same inputs; shown: what the one instrument would show of each without its noise."""
    records = tuple(
        FlightRecord(i, 0, TIME, inputs, (z + NOISE * rng.standard_normal(TIME.size))[:, None], np.zeros(1), {})
        for i, z in enumerate(shown)
    )
    white = Whitener(np.full((TIME.size // 2 + 1, 1, 1), 1.0 / NOISE, complex), TIME.size)
    problem = LikelihoodProblem(model, model, records, (white,) * len(records), AS_SET)
    flights: Any = None
    baseline = Baseline(problem, fit(problem), NoiseModel(np.array([NOISE**2]), {}), np.array([NOISE]), model, flights)
    nulls = tuple(tuple(NOISE * rng.standard_normal((TIME.size, 1)) for _ in records) for _ in range(60))
    screen: Any = None
    return Round(baseline, screen, np.zeros(0), np.zeros(0), 4.0, Tangent(problem, baseline.fit, nulls))


def rolled(added: Sequence[Array], seed: int = 5) -> Round:
    """A round about flights of an aircraft that only rolls; added: what its gyro shows beside the motion, per flight."""
    roll = lti([40.0], [1.0, 6.0]).output(MOVED, TIME)[1]
    return round_about(ROLL, {"delta_a": MOVED}, [roll + more for more in added], np.random.default_rng(seed))


NOTHING = np.zeros(TIME.size)


def test_nothing_happens_on_flights_with_nothing_but_noise() -> None:
    round_ = rolled([NOTHING, NOTHING])
    found = find_transients(round_)
    assert found.events == ()
    assert found.cleared is round_


def test_a_step_of_a_gyro_is_found_in_its_flight_at_its_time_and_taken_out() -> None:
    found = find_transients(rolled([NOTHING, 0.03 * (TIME > 12.0)]))
    (slip,) = found.events
    assert (slip.event.kind, slip.event.channel, slip.event.record) == ("slip", "p", 1)
    assert slip.event.start == pytest.approx(12.0, abs=0.5)
    assert slip.sizes[0][0] == pytest.approx(0.03, abs=4.0 * slip.sizes[0][1])
    assert slip.score > slip.threshold
    assert found.cleared is not None
    left = np.concatenate([r[:, 0] for r in found.cleared.baseline.fit.residuals])
    assert np.std(left) == pytest.approx(NOISE, rel=0.08)
    assert found.cleared.baseline.fit.values["L_p"] == pytest.approx(-6.0, rel=0.03)


def sunk(gusts: Sequence[Array], doors: Sequence[str], seed: int = 6) -> Round:
    """A round about flights of an aircraft that only sinks: alpha follows a control and what its door lets in; gusts: by which
    the air turns the flow in each flight [rad]."""
    model = replace(
        ROLL,
        states=(Signal("alpha", "rad"),),
        outputs=(Signal("alpha", "rad"),),
        inputs=(*ROLL.inputs, *(Signal(d, "rad/s") for d in doors)),
        parameters=(Parameter("Z_a", start=-4.0), Parameter("Z_e", start=10.0)),
        equations=("alpha_dot = Z_a*alpha + Z_e*delta_a" + "".join(f" + {d}" for d in doors),),
    )
    still, airy = lti([10.0], [1.0, 4.0]), lti([1.0, 0.0], [1.0, 4.0])
    shown = [still.output(MOVED, TIME)[1] + airy.output(g, TIME)[1] for g in gusts]
    return round_about(model, {"delta_a": MOVED} | dict.fromkeys(doors, NOTHING), shown, np.random.default_rng(seed))


def test_a_gust_that_comes_and_goes_is_found_as_one_of_the_air() -> None:
    """Half a sine of 3 s in the angle of the flow: its rate is half a cosine, which takes back what it gives."""
    gust = np.where((TIME > 8.0) & (TIME < 11.0), 0.2 * np.sin(np.pi * (TIME - 8.0) / 3.0), 0.0)
    round_ = sunk([NOTHING, gust], [DISTURBANCE.format("alpha")])
    found = find_transients(round_)
    (burst,) = found.events
    assert (burst.event.kind, burst.event.air, burst.event.record) == ("burst", "alpha", 1)
    assert (burst.event.start, burst.event.end) == pytest.approx((8.0, 11.0), abs=0.5)
    assert burst.sizes[0][0] == pytest.approx(0.2 * np.pi / 3.0, abs=4.0 * burst.sizes[0][1])
    told = event_report(burst, round_.baseline.model, "f1")
    assert told.sizes[0][0] == pytest.approx(0.2, abs=4.0 * told.sizes[0][1])
    assert "a gust changes alpha on f1 from 8.0 to 11.0 s by up to 0.2" in describe_events(Happened([told]))
    assert (told.to_json()["air"], told.to_json()["unit"]) == ("alpha", "rad")
    events = possible_events(moving(round_)[0]).events
    assert {e.air for e in events if e.kind == "burst"} == {"", "alpha"}
    turning = possible_events(moving(sunk([NOTHING], [DISTURBANCE.format("q")]))[0])
    assert {e.air for e in turning.events} == {""}, "the air turns the flow and not the body"


def moving(round_: Round) -> tuple[LikelihoodProblem, Any]:
    return round_.baseline.problem, round_.baseline.fit


def test_a_drift_is_one_thing_on_all_flights_with_a_size_on_each() -> None:
    share = TIME / TIME[-1]
    (drift,) = find_transients(rolled([0.04 * share, -0.05 * share])).events
    assert (drift.event.kind, drift.event.channel, drift.event.record) == ("drift", "p", -1)
    for (size, bound), true in zip(drift.sizes, (0.04, -0.05), strict=True):
        assert size == pytest.approx(true, abs=4.0 * bound)
        assert bound < 0.01


def test_an_event_is_told_with_its_time_and_blames_no_term_of_the_model() -> None:
    slip = EventReport("slip", "beta", "f2", 18.2, 30.0, ((0.026, 0.001),), "rad", 23.0, 5.8)
    burst = EventReport("burst", "", "f1", 14.0, 15.0, ((0.1, 0.01),) * 3, "1/s", 9.0, 5.8)
    step = event_step(Happened([slip, burst]), Gap(2.0, 2.0, 1.0))
    form = step.to_json()["form"]
    assert (form["kind"], form["start"], form["end"], form["flight"]) == ("event", 18.2, 30.0, "f2")
    assert [e["what"] for e in form["events"]] == ["slip", "burst"]
    text = describe_events(Happened([slip, burst]))
    assert "beta jumps on f2 at 18.2 s by 0.026 +- 0.001 rad" in text
    assert "disturbed on f1 from 14.0 to 15.0 s" in text
    assert "no model term is wrong" in text


def test_a_shape_reduces_the_gap_and_an_event_stays_unknown() -> None:
    decision = Decision(GapVerdict.NO_GAP, 1, (("a", "b"),))
    assert as_unknown(decision) == replace(decision, verdict=GapVerdict.UNKNOWN)
