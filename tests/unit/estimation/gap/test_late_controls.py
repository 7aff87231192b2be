"""A control that is far later than usual: the base takes it for the aircraft's own slowness, and must be fitted anew with it."""

import numpy as np
import pytest

from estimation.gap.criteria import AS_SET
from estimation.gap.effects import catalogue
from estimation.gap.fit.baseline import Baseline, fit_baseline
from estimation.gap.fit.noise import channel_noise
from estimation.gap.records.candidate_model import with_dormant, with_nuisance
from estimation.gap.records.flight_records import prepare_flights, sample_interval
from estimation.gap.search import accept as accepting
from estimation.gap.search.confirm import fit_from_afar, fit_hypothesis, strayed
from estimation.gap.significance import measured_again
from estimation.gap.significance.screen import Hypothesis, hypotheses_for
from estimation.models.dependence import force_states
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth
from tests.unit.estimation.gap.candidates_by_hand import ROUND, candidate, stub

LATERAL = load_model("lateral", "cdfp")


def fitted(hidden: dict[str, float]) -> tuple[Baseline, dict[str, Hypothesis]]:
    """The base fitted to two flights with `hidden` (times the usual size), and the late controls that can be asked for."""
    requests = [truth.Request(71 + i, speed, hidden, gust=0.0, duration=20.0) for i, speed in enumerate((15.0, 18.0))]
    flights = [
        Flight.build(f"f{i}", c["time"], {k: v for k, v in c.items() if k != "time"})
        for i, c in enumerate(truth.fly(requests))
    ]
    effects = [e for e in catalogue(model=LATERAL) if e.name in ("aileron_lag", "rudder_delay")]
    prepared = prepare_flights(LATERAL, effects, flights, (), AS_SET)
    scatter = channel_noise(prepared.records)
    noise = dict(zip(LATERAL.output_names, scatter, strict=True))
    clean = with_nuisance(LATERAL, noise, sample_interval(prepared.records), AS_SET)
    working = with_dormant(clean, effects, prepared.available, force_states(LATERAL))
    baseline = fit_baseline(working, clean, prepared, scatter)
    return baseline, {h.effect.name: h for h in hypotheses_for(clean, effects, prepared.available)}


def test_a_servo_far_slower_than_usual_is_found_where_the_base_took_it_for_roll_damping() -> None:
    baseline, asked = fitted({"aileron_lag": 12.0})
    slow, late = asked["aileron_lag"], asked["rudder_delay"]
    assert abs(baseline.fit.values["Cl_p"]) < 0.2, "a third of what the aircraft has"
    afar = fit_from_afar(baseline.problem, baseline.fit, slow)
    assert afar is not None
    _, found = fit_hypothesis(baseline.problem, baseline.fit, slow, {}, afar=afar)
    assert found.values["aileron_lag"] == pytest.approx(0.6, abs=0.03), "the slowest that is asked for, of .72"
    assert found.values["Cl_p"] < -0.3
    assert found.cost < baseline.fit.cost - 100.0
    assert fit_from_afar(baseline.problem, baseline.fit, late) is None, (
        "a rudder so late is no way to follow these flights"
    )


def test_a_servo_eight_times_slower_than_usual_is_found_from_the_base() -> None:
    baseline, asked = fitted({"aileron_lag": 8.0})
    _, found = fit_hypothesis(baseline.problem, baseline.fit, asked["aileron_lag"], {})
    assert found.values["aileron_lag"] == pytest.approx(0.48, abs=0.03)
    assert found.cost < baseline.fit.cost - 100.0


def test_no_late_control_is_followed_where_none_is() -> None:
    baseline, asked = fitted({})
    assert all(fit_from_afar(baseline.problem, baseline.fit, h) is None for h in asked.values())


def test_flights_made_anew_that_ran_away_say_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A base that took a servo of half a second for slow rolling grew by a third a second: flights made of it had two hundred
    times the energy, on which any steadier hypothesis gained, and the servo was refused for it."""
    nothing = np.zeros((1, 1))
    remade = [measured_again.SimulatedRecord(nothing, nothing, energy) for energy in (10.5, 12.0, 11.4, *[2000.0] * 13)]
    monkeypatch.setattr(measured_again.NullFlyer, "build", lambda *_: None)
    monkeypatch.setattr(measured_again.MeasuredAgain, "_flown", lambda *_: (nothing, nothing))
    monkeypatch.setattr(measured_again.MeasuredAgain, "_simulated", lambda *_: remade)
    problem = stub(records=(None,), whiteners=(stub(energy=lambda residual: 10.0),))
    again = measured_again.MeasuredAgain(
        stub(problem=problem, fit=stub(residuals=(None,)), noise=None, criteria=AS_SET), 1
    )
    assert [remade.energy for (remade,) in again.sets] == [10.5, 11.4]


@pytest.mark.parametrize(("kind", "bound"), [("delay", 0.2), ("linear", 3.0)])
def test_the_bound_of_a_late_control_is_that_of_what_it_is_weighed_against(
    monkeypatch: pytest.MonkeyPatch, kind: str, bound: float
) -> None:
    """About a base that grows a small step of a delay scatters nine hundred times: it is itself known as its rivals are."""
    found = candidate("late", kind)
    name = found.hypothesis.form.parameters[0].name
    monkeypatch.setattr(accepting, "inflation_by_hypothesis", lambda _: {found.hypothesis.key: 900.0})
    monkeypatch.setattr(accepting, "individual_inflation", lambda _: {found.hypothesis.key: 4.0})
    child = stub(fit=stub(values={name: 0.5}, std=lambda: {name: 0.1}))
    assert accepting.estimates_of(ROUND, found, child)[name] == (0.5, pytest.approx(bound))


@pytest.mark.parametrize(
    ("found", "controls", "lost"),
    [
        ({}, {"delta_a"}, False),
        ({"Cl_da": -0.04}, {"delta_a"}, True),  # of -0.0963
        ({"Cl_da": -0.05}, {"delta_a"}, False),
        ({"Cl_da": -0.04}, {"delta_r"}, False),
        ({"CY_dr": 0.1, "Cl_dr": -0.01}, {"delta_r"}, False),  # a yawing moment is left
        ({"CY_dr": 0.1, "Cl_dr": -0.01, "Cn_dr": 0.002}, {"delta_r"}, True),
        ({"Cl_p": -0.2}, {"delta_a"}, True),
        ({"Cl_p": -0.2}, {"delta_r"}, True),  # which rolls the aircraft too
    ],
)
def test_a_base_has_lost_a_control_of_which_it_finds_less_than_half(
    found: dict[str, float], controls: set[str], lost: bool
) -> None:
    """Half a second behind the record nothing correlates with it any more, and all derivatives of its coefficient are open."""
    starts = LATERAL.starts()
    problem = stub(
        model=LATERAL, base=LATERAL, parameters=LATERAL.free_names, nuisance=lambda name: False, criteria=AS_SET
    )
    fit = stub(values={**starts, **found}, std=lambda: dict.fromkeys(starts, 0.0))
    assert strayed(problem, fit, controls) is lost
