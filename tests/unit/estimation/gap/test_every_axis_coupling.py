"""Models of all axes: what couples the planes is found in the equation in which it lives, beside all effects of both planes."""

import numpy as np
import pytest

from estimation.gap.criteria import AS_SET
from estimation.gap.effects import catalogue
from estimation.gap.fit.baseline import Baseline, fit_afresh, fit_baseline
from estimation.gap.fit.noise import channel_noise
from estimation.gap.records.candidate_model import with_dormant, with_nuisance
from estimation.gap.records.flight_records import FlightRecords, prepare_flights, sample_interval
from estimation.gap.search.confirm import fit_hypothesis
from estimation.gap.significance.nulls import InputErrors, NullFlyer, input_errors
from estimation.gap.significance.screen import Screen, build_screen, hypotheses_for, linear_gains, linear_guess
from estimation.gap.significance.tangent import Tangent
from estimation.models.dependence import force_states
from estimation.models.load import load_model
from groundstation.flight import Flight
from tests.studies import second_truth as truth

ALL_AXES = load_model("six-dof", "cdfp")


@pytest.fixture(scope="module")
def screened() -> tuple[FlightRecords, Baseline, Screen]:
    """Two flights of all axes in calm air that pitch by sideslip, twice as much as usual, fitted without knowing of it."""
    requests = [
        truth.Request(90 + i, speed, {"Cm_beta2": 2.0}, gust=0.0, manoeuvres="all", duration=20.0)
        for i, speed in enumerate((15.0, 18.0))
    ]
    flights = [
        Flight.build(f"f{i}", c["time"], {k: v for k, v in c.items() if k != "time"})
        for i, c in enumerate(truth.fly(requests))
    ]
    effects = catalogue(model=ALL_AXES)
    prepared = prepare_flights(ALL_AXES, effects, flights, (), AS_SET)
    scatter = channel_noise(prepared.records)
    noise = dict(zip(ALL_AXES.output_names, scatter, strict=True))
    clean = with_nuisance(ALL_AXES, noise, sample_interval(prepared.records), AS_SET)
    working = with_dormant(clean, effects, prepared.available, force_states(ALL_AXES))
    baseline = fit_baseline(working, clean, prepared, scatter)
    # forms without states of their own: each of the others needs equations of its own, which says nothing here
    asked = [h for h in hypotheses_for(clean, effects, prepared.available) if not h.form.states]
    return prepared, baseline, build_screen(Tangent(baseline.problem, baseline.fit), asked)


def test_a_coupling_stands_out_of_the_effects_of_both_planes(screened: tuple[FlightRecords, Baseline, Screen]) -> None:
    _, baseline, screen = screened
    names = [h.effect.name for h in screen.hypotheses]
    assert {"Cn_da", "beta_scale", "alpha_scale", "thrust_z", "Cl_alpha_p", "prop_gyroscopic"} <= set(names)
    gains = linear_gains(screen, baseline.problem)
    order = np.argsort(-gains)
    first = [names[k] for k in order[:3]]
    assert "Cm_beta2" in first, [(names[k], float(gains[k])) for k in order[:8]]
    lateral_only = {e.name for e in catalogue()}
    assert not lateral_only & set(first)  # they live in pitching; which of them it is the full fits of a run part
    assert gains[names.index("Cm_beta2")] > 0.8 * gains[order[0]]
    for lateral in ("Cn_da", "Cl_beta3", "CY_da", "beta_scale"):
        assert gains[names.index(lateral)] < 0.25 * gains[order[0]]
    chosen = screen.hypotheses[names.index("Cm_beta2")]
    guess = linear_guess(screen, baseline.problem, names.index("Cm_beta2"))
    _, fitted = fit_hypothesis(baseline.problem, baseline.fit, chosen, guess)
    assert fitted.values["Cm_beta2"] == pytest.approx(2 * truth.pitch.CROSS["Cm_beta2"], rel=0.15)
    assert fitted.cost < baseline.fit.cost - 20.0


def test_a_moment_of_inertia_shows_where_the_model_rolls_and_yaws() -> None:
    assert next(e for e in catalogue(model=load_model("longitudinal", "cdfp")) if e.name == "Iyy_error").tied_to
    assert not next(e for e in catalogue(model=ALL_AXES) if e.name == "Iyy_error").tied_to


def test_gusts_enter_every_rate_on_which_forces_and_moments_act() -> None:
    assert set(force_states(ALL_AXES)) == {"V", "alpha", "beta", "p", "q", "r"}


def test_a_model_fitted_afresh_ends_where_the_baseline_is(screened: tuple[FlightRecords, Baseline, Screen]) -> None:
    """Whether an effect is still needed is told by two costs: what is only nuisance must be free in both."""
    _, baseline, _ = screened
    again = fit_afresh(baseline, baseline.problem.model, baseline.clean)
    assert again is not None
    assert again.fit.cost == pytest.approx(baseline.fit.cost, abs=0.02)
    nuisances = [n for n in baseline.problem.free if baseline.problem.nuisance(n)]
    assert any(again.fit.values[n] != baseline.problem.model.starts().get(n) for n in nuisances)


def test_nulls_draw_what_courses_of_errors_in_the_inputs_do_to_the_model(
    screened: tuple[FlightRecords, Baseline, Screen],
) -> None:
    prepared, baseline, _ = screened
    problem, found = baseline.problem, baseline.fit
    errors = [input_errors(r, baseline.clean, np.random.default_rng(i)) for i, r in enumerate(prepared.records)]
    modelled = NullFlyer.build(problem, found, baseline.noise, errors).modelled[1]
    assert modelled is not None
    assert len(modelled.changes) == errors[1].count > 10
    own, names, coarse = found.locals[1], problem.model.input_names, problem.coarse[1]
    np.testing.assert_allclose(modelled.outputs, coarse.z - found.residuals[1], atol=1e-12)
    for number in (0, 5):
        course = errors[1].course(names, number)
        assert set(np.flatnonzero(np.any(course != 0.0, axis=0))) == {names.index(n) for n in errors[1].bank}
        opposite = problem.modelled(1, found.values, own, inputs=coarse.u - course)
        assert opposite is not None
        wrong = opposite - (modelled.outputs - modelled.changes[number])
        assert np.all(np.std(wrong, axis=0) < 0.1 * np.std(modelled.changes[number], axis=0))
    rng = np.random.default_rng(3)
    drawn = [modelled.draw(rng) - modelled.outputs for _ in range(400)]
    assert len({d.tobytes() for d in drawn}) == 2 * errors[1].count
    exact = NullFlyer.build(problem, found, baseline.noise, [InputErrors({})] * 2).modelled[1]
    assert exact is not None
    np.testing.assert_array_equal(exact.draw(rng), modelled.outputs)
