"""Neural Gauss-Newton: exact derivatives, the truth within the stated figures, flights with holes, same seed same bits."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from estimation.aircraft import load_aircraft
from estimation.errors import DataError, EstimationError
from estimation.estimators.gauss_newton import Status
from estimation.estimators.neural_gauss_newton import NgnOptions, estimate_campaign, estimate_ngn, training
from estimation.estimators.neural_gauss_newton.axes import LateralAxis, LongitudinalAxis
from estimation.estimators.neural_gauss_newton.formulation import FlightUnknowns
from estimation.estimators.neural_gauss_newton.network import (
    NetworkShape,
    forward,
    initial_weights,
    input_slopes,
    usable_device,
    weight_normal_equations,
)
from estimation.estimators.neural_gauss_newton.samples import training_stretches, window_mean
from estimation.estimators.neural_gauss_newton.solve import NeuralProblem
from estimation.estimators.neural_gauss_newton.training import (
    Job,
    TrainingOptions,
    default_options,
    mean_square,
    train_jobs,
)
from estimation.models import load_model
from estimation.models.base import joint_model
from firmware_sim.physics.aerodynamics import true_derivatives
from firmware_sim.runs.direct import direct_flights
from firmware_sim.world.scenario import load_scenario
from groundstation.flight import Flight, MissingColumnError, read_flight
from tests.support.paths import ROOT
from tests.unit.estimation.truth import IXX, IXZ, IYY, IZZ, NOISE, STRONG, TRUE, Case, fly

AIRCRAFT = load_aircraft("cdfp")
SHORT = NgnOptions(improved=True, instruments=True, ensemble=1, bootstraps=3)


def errors(result, names=STRONG):
    return {n: abs(result.parameters[n].estimate / TRUE[n] - 1) for n in names}


def with_heading(flight):
    """The flight with a psi that its rates have made."""
    rate = (flight["q"] * np.sin(flight["phi"]) + flight["r"] * np.cos(flight["phi"])) / np.cos(flight["theta"])
    psi = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(flight.time))])
    return flight.with_columns(psi=psi)


def network(shape, nets=1):
    w = initial_weights(shape, torch.Generator().manual_seed(3), nets)
    return w + 0.1 * torch.randn(w.shape, generator=torch.Generator().manual_seed(4), dtype=torch.float64)


@pytest.mark.parametrize("skip", [False, True])
def test_normal_equations_are_those_of_autograd(skip):
    shape = NetworkShape(5, 4, 3, skip)
    generator = torch.Generator().manual_seed(1)
    w = network(shape, 2)
    u, z = (torch.randn(7, n, generator=generator, dtype=torch.float64) for n in (5, 3))
    weight = torch.randint(0, 3, (2, 7), generator=generator).double()
    matrices, rights = weight_normal_equations(shape, w, u, z, weight)
    for k in range(2):
        J = torch.func.jacrev(lambda v: forward(shape, v, u))(w[k])
        torch.testing.assert_close(matrices[k], torch.einsum("m,mop,moq->pq", weight[k], J, J))
        residual = z - forward(shape, w[k], u)
        torch.testing.assert_close(rights[k], torch.einsum("m,mop,mo->p", weight[k], J, residual))


@pytest.mark.parametrize("skip", [False, True])
def test_slopes_by_the_inputs_are_differences(skip):
    shape = NetworkShape(5, 4, 3, skip)
    w = network(shape)[0]
    u = torch.randn(7, 5, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    out, slopes = input_slopes(shape, w, u)
    torch.testing.assert_close(out, forward(shape, w, u))
    step = 1e-6
    for j in range(5):
        du = torch.zeros(5, dtype=torch.float64)
        du[j] = step
        difference = (forward(shape, w, u + du) - forward(shape, w, u - du)) / (2 * step)
        torch.testing.assert_close(slopes[:, :, j], difference, atol=1e-8, rtol=1e-6)


def test_an_ensemble_is_its_members():
    shape = NetworkShape(5, 4, 3, True)
    w = network(shape, 3)
    u = torch.randn(7, 5, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    torch.testing.assert_close(forward(shape, w, u), torch.stack([forward(shape, v, u) for v in w]))


def smooth_map(count):
    """A job whose rows follow a smooth map, the last fifth of it not to be seen."""
    generator = torch.Generator().manual_seed(count)
    u = torch.randn(count, 2, generator=generator, dtype=torch.float64)
    z = torch.stack([torch.tanh(u[:, 0] - 0.5 * u[:, 1]), 0.3 * u[:, 1]], dim=1)
    shape = NetworkShape(2, 5, 2, True)
    seen = (torch.arange(count) % 5 != 0).double()
    return Job(shape, u, z, seen, initial_weights(shape, generator)[0])


def test_training_learns_a_smooth_map():
    job = smooth_map(200)
    [(w, iterations)] = train_jobs([job], TrainingOptions(iterations=40))
    assert mean_square(job.shape, w, job.u, job.z, 1 - job.weight) < 1e-2 * float(job.z.var())
    assert iterations > 0


def test_side_by_side_is_as_alone(monkeypatch):
    """Whatever the company and the size of the batches: rows of other lengths, rows that are shared, one more shape."""
    jobs = [smooth_map(200), smooth_map(120), smooth_map(160)]
    jobs.append(replace(jobs[0], start=1.1 * jobs[0].start))
    jobs.append(
        replace(
            jobs[1], shape=NetworkShape(2, 3, 2), start=initial_weights(NetworkShape(2, 3, 2), torch.Generator())[0]
        )
    )
    options = TrainingOptions(iterations=6)
    alone = [train_jobs([j], options)[0] for j in jobs]
    for rows in (40_000, 420):
        monkeypatch.setitem(training.LARGEST_BATCH_ROWS, "cpu", rows)
        for (w, n), (same, m) in zip(train_jobs(jobs, options), alone, strict=True):
            torch.testing.assert_close(w, same, rtol=1e-7, atol=1e-8)
            assert n == m


def test_longitudinal_slopes_are_the_derivatives_of_its_coefficients():
    axis = LongitudinalAxis(AIRCRAFT)
    rng = np.random.default_rng(0)
    s = {c: 0.1 * rng.standard_normal(4) for c in axis.columns} | {"V": np.full(4, 16.0)}
    theta = rng.standard_normal(10)
    _, slopes = axis.aerodynamic(s, theta)
    for j in range(10):
        d = np.zeros(10)
        d[j] = 1e-6
        difference = (axis.aerodynamic(s, theta + d)[0] - axis.aerodynamic(s, theta - d)[0]) / 2e-6
        np.testing.assert_allclose(slopes[:, :, j], difference, atol=1e-8)


def test_interval_moments_are_exact_for_constant_angular_acceleration():
    """With q = 0 and straight rates, the mean moments over an interval follow in closed form."""
    t = np.arange(60) * 0.05
    p_dot, r_dot = 0.3, -0.2
    columns = {c: np.zeros(60) for c in LateralAxis(AIRCRAFT).columns}
    columns |= {"p": p_dot * t, "r": r_dot * t, "V": np.full(60, 16.0), "rho": np.full(60, 1.2)}
    axis = LateralAxis(AIRCRAFT)
    only = training_stretches(axis, Flight.build("f", t, columns), "interval", axis.motion)[0]
    scale = 0.5 * 1.2 * 16.0**2 * AIRCRAFT.area * AIRCRAFT.span
    np.testing.assert_allclose(only.u[:, -2], (IXX * p_dot - IXZ * r_dot) / scale, rtol=1e-9)
    np.testing.assert_allclose(only.u[:, -1], (IZZ * r_dot - IXZ * p_dot) / scale, rtol=1e-9)
    assert AIRCRAFT.Iyy == IYY


def test_window_mean_is_exact_for_a_cubic():
    t = np.arange(10.0)
    exact = ((t[4:] ** 4 - t[:-4] ** 4) / 4 - (t[4:] ** 2 - t[:-4] ** 2)) / 4
    np.testing.assert_allclose(window_mean(t**3 - 2 * t, 4), exact, rtol=1e-9)


def test_published_form_is_near_the_truth_and_low_in_roll():
    options = replace(default_options(False), bootstraps=0)
    flights, _ = fly(Case(noise=NOISE), np.random.default_rng(11), 2)
    each = [estimate_ngn(AIRCRAFT, f, options=options) for f in flights]
    assert all(r.method == "ngn" for r in each)
    for name in STRONG:
        mean = np.mean([r.parameters[name].estimate for r in each]) / TRUE[name] - 1
        assert abs(mean) < 0.15, name
        if name in ("Cl_beta", "Cl_p", "Cl_da"):
            assert mean < 0.0, name  # a derivative of 20 Hz rates is too small


@pytest.fixture(scope="module")
def improved(made_flights):
    return [estimate_ngn(AIRCRAFT, f, options=SHORT) for f in made_flights[:3]]


def test_improved_form_is_within_five_percent_on_average(improved):
    for name in STRONG:
        mean = np.mean([r.parameters[name].estimate for r in improved])
        assert abs(mean / TRUE[name] - 1) < 0.06, name
    assert all(r.method == "ngn-improved" and r.converged for r in improved)


def pitching(seeds):
    flown = direct_flights([load_scenario("longitudinal")] * len(seeds), seeds)
    return [Flight.build(f"f{i}", c.pop("time"), c) for i, c in enumerate(flown)]


def assert_near_the_truth(flights, improved, allowed):
    truth, model = true_derivatives(AIRCRAFT, {}), load_model("longitudinal", AIRCRAFT)
    options = replace(default_options(improved, "longitudinal"), bootstraps=0)
    each = [estimate_ngn(AIRCRAFT, f, model=model, options=options) for f in flights]
    assert all(r.converged for r in each)
    for name in ("CL_alpha", "CD_0", "CD_k", "Cm_alpha", "Cm_q", "Cm_de"):
        mean = np.mean([r.parameters[name].estimate for r in each])
        assert abs(mean / truth[name] - 1) < allowed, name


@pytest.fixture(scope="module")
def two_pitching():
    return pitching([1, 2])


@pytest.mark.parametrize(("improved", "allowed"), [(False, 0.2), (True, 0.08)])
def test_longitudinal_forms_find_lift_drag_and_pitch(two_pitching, improved, allowed):
    assert_near_the_truth(two_pitching, improved, allowed)


@pytest.mark.study
@pytest.mark.parametrize(("improved", "allowed"), [(False, 0.2), (True, 0.08)])
def test_longitudinal_forms_over_more_flights(improved, allowed):
    assert_near_the_truth(pitching([1, 2, 3, 4, 5]), improved, allowed)


@pytest.fixture(scope="module")
def ordinary():
    return read_flight(ROOT / "recordings/foreign/ordinary_0.csv")


def published_longitudinal(flight, factor):
    """The published form with beliefs of which all are `factor` times those of the aircraft."""
    beliefs = {n: replace(d, value=factor * d.value) for n, d in AIRCRAFT.derivatives.items()}
    believed = replace(AIRCRAFT, derivatives=beliefs)
    return estimate_ngn(believed, flight, model=load_model("longitudinal", believed), bootstraps=0)


@pytest.fixture(scope="module")
def rightly_believed(ordinary):
    return published_longitudinal(ordinary, 1.0)


@pytest.mark.parametrize("factor", [-1.0, 0.1, 30.0])
def test_beliefs_of_another_aircraft_do_not_change_the_estimates(ordinary, rightly_believed, factor):
    right, found = rightly_believed, published_longitudinal(ordinary, factor)
    assert found.status.usable
    for name, value in right.values.items():
        assert found.values[name] == pytest.approx(value, abs=1e-3 * right.std[name])


def test_density_is_derived_where_other_methods_derive_it(ordinary):
    temperature = np.full(len(ordinary), 281.0)
    static = ordinary["rho"] * 287.05287 * temperature  # ideal gas, dry air
    columns = {n: v for n, v in ordinary.columns.items() if n not in ("rho", "altitude")}
    without = Flight.build("no_density", ordinary.time, {**columns, "p_static": static, "temperature": temperature})
    right, found = (estimate_ngn(AIRCRAFT, f, improved=True, bootstraps=0) for f in (ordinary, without))
    for name in STRONG:
        assert found.values[name] == pytest.approx(right.values[name], abs=0.05 * right.std[name])


def test_an_end_where_the_network_predicts_nothing_is_not_called_converged(ordinary, monkeypatch):
    monkeypatch.setattr(NeuralProblem, "regression", property(lambda self: self.unknowns.start))
    assert published_longitudinal(ordinary, 30.0).status is Status.STALLED


def test_honest_spread_is_wider_than_the_bound_of_a_frozen_network():
    """Light gusts colour the residuals; the bound takes them for white."""
    flight = fly(Case(noise=NOISE, gust=0.15), np.random.default_rng(7), 1)[0][0]
    result = estimate_ngn(AIRCRAFT, flight, options=SHORT, bootstraps=24)
    ratio = [result.parameters[n].std_coloured / result.parameters[n].std for n in STRONG]
    assert np.median(ratio) > 1.2
    assert set(result.extra["bootstrap_spread"]) == set(TRUE)
    assert {"hidden", "smoothing", "seed", "record"} <= set(result.extra)
    assert result.bootstrap is not None
    assert len(result.bootstrap.estimates) == 24
    for name, spread in result.bootstrap.parameters.items():
        assert spread.interval[0] < result.parameters[name].estimate < spread.interval[1], name


def test_same_seed_gives_the_same_bits_and_threads_are_left_alone(made_flights, improved):
    before = torch.get_num_threads()
    first, second = improved[0], estimate_ngn(AIRCRAFT, made_flights[0], options=SHORT)
    assert {n: e.estimate for n, e in first.parameters.items()} == {n: e.estimate for n, e in second.parameters.items()}
    assert first.std_coloured == second.std_coloured
    other = estimate_ngn(AIRCRAFT, made_flights[0], options=SHORT, seed=1)
    assert other.std_coloured != first.std_coloured
    assert torch.get_num_threads() == before


def test_joint_estimate_has_constants_for_each_flight(made_flights):
    flights = made_flights[:2]
    result = estimate_ngn(AIRCRAFT, flights, model=joint_model(load_model("lateral", AIRCRAFT)), options=SHORT)
    assert max(errors(result, ("Cl_beta", "Cl_p", "Cl_da", "Cn_beta", "CY_beta")).values()) < 0.06
    assert "Cl_0" not in result.names
    assert all("Cl_0" in f.local for f in result.flights)


def test_gap_and_dropouts_are_never_crossed(made_flights):
    whole = made_flights[0]
    keep = (whole.time < 9.0) | (whole.time > 10.5)
    holed = whole.part(keep)
    beta = holed["beta"].copy()
    beta[100:106] = np.nan
    flight = Flight.build("holed", holed.time, {**holed.columns, "beta": beta})
    axis = LateralAxis(AIRCRAFT)
    steps = {
        round(float(flight.time[s.first[-1] + 1] - flight.time[s.first[0]]), 3) > 0
        for s in training_stretches(axis, flight, "point", ("beta", "phi", "p", "r"))
    }
    found = training_stretches(axis, flight, "point", ("beta", "phi", "p", "r"))
    assert steps == {True}
    assert len(found) == 3
    assert all(np.max(np.diff(flight.time[s.first])) < 0.06 for s in found)
    assert max(errors(estimate_ngn(AIRCRAFT, flight, options=SHORT), ("Cl_beta", "Cl_p", "Cl_da")).values()) < 0.08


@pytest.mark.parametrize("missing", [601, 200])
def test_missing_heading_is_done_without_and_said(made_flights, missing):
    whole = with_heading(made_flights[0])
    holed = whole.with_columns(psi=np.where(np.arange(len(whole)) < missing, np.nan, whole["psi"]))
    result = estimate_ngn(AIRCRAFT, holed, options=SHORT)
    assert "psi" not in result.extra["inputs"]
    assert result.extra["rows"] > 590
    assert any("psi is not measured" in n.text for n in result.flights[0].notes)
    assert max(errors(result, ("Cl_beta", "Cl_p", "Cl_da")).values()) < 0.06


def test_what_was_not_used_is_said(made_flights):
    flight = made_flights[0]
    beta = np.where(np.arange(len(flight)) > 400, np.nan, flight["beta"])
    result = estimate_ngn(AIRCRAFT, flight.with_columns(beta=beta), options=SHORT)
    assert any("the networks saw 401 of 601 samples" in n.text for n in result.flights[0].notes)


def test_what_cannot_be_used_is_said(made_flights):
    flight = made_flights[0]
    without = Flight.build("f", flight.time, {k: v for k, v in flight.columns.items() if k != "delta_a"})
    with pytest.raises(MissingColumnError, match="delta_a"):
        estimate_ngn(AIRCRAFT, without)
    broken = flight.with_columns(beta=np.where(np.arange(len(flight)) % 10 == 0, np.nan, flight["beta"]))
    with pytest.raises(DataError, match="no stretch of 20 samples"):
        estimate_ngn(AIRCRAFT, broken)
    with pytest.raises(EstimationError, match="formulation"):
        estimate_ngn(AIRCRAFT, flight, model=load_model("six-dof", AIRCRAFT))


def test_fixed_parameter_stays(made_flights):
    model = load_model("lateral", AIRCRAFT).fixed(CY_p=-0.05)
    result = estimate_ngn(AIRCRAFT, made_flights[0], model=model, options=NgnOptions(ensemble=1, bootstraps=0))
    assert "CY_p" not in result.parameters
    assert FlightUnknowns.build(model, LateralAxis(AIRCRAFT), 1).base[0, 2] == -0.05


def test_campaign_gives_what_flights_give_one_by_one(made_flights):
    flights = [with_heading(made_flights[0].part(slice(0, 300))), made_flights[1].part(slice(0, 240))]
    for result, flight in zip(estimate_campaign(AIRCRAFT, flights, options=SHORT), flights, strict=True):
        alone = estimate_ngn(AIRCRAFT, flight, options=SHORT)
        for name, found in result.parameters.items():
            np.testing.assert_allclose(found.estimate, alone.parameters[name].estimate, rtol=1e-5, atol=1e-7)
            np.testing.assert_allclose(found.std_coloured, alone.parameters[name].std_coloured, rtol=1e-3)


def test_a_device_that_is_not_there_is_said():
    assert usable_device("auto") in ("cpu", "cuda")
    with pytest.raises(EstimationError, match="unknown"):
        usable_device("abacus")
