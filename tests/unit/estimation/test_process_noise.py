"""Filter error in its published form: the Riccati gain against closed forms, estimates against truth in gusts and without."""

from collections.abc import Mapping

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from estimation.engine.compiled import CompiledKernel
from estimation.engine.kernel import SensitivityColumns
from estimation.engine.simulate import Simulator
from estimation.estimators.filter_error import GainLaw, filter_error, gain_law, process_noise_error
from estimation.estimators.output_error import output_error
from estimation.estimators.result import Result
from estimation.models import load_model
from estimation.prepare.pipeline import prepare_all
from estimation.structure.candidates import structure_candidates, with_candidates
from groundstation.flight import Flight
from tests.unit.estimation.truth import DEG, NOISE, STRONG, TRUE, Case, fly

LATERAL = load_model("lateral", "cdfp")


def test_gain_of_one_state_is_the_closed_form() -> None:
    """x' = a x + w, y = x + v: P = phi^2 P r/(P + r) + q, K = P/(P + r)."""
    a, dt, r = -0.8, 0.05, 0.02
    for size in (0.1, 1.0, 4.0):
        law = gain_law(np.array([[a]]), np.array([[1.0]]), dt, np.array([r]), np.array([r]), (0,))
        phi2, q, R = np.exp(2 * a * dt), (size * r) ** 2, r**2
        b = R * (1.0 - phi2) - q
        P = 0.5 * (-b + np.sqrt(b**2 + 4.0 * q * R))
        assert law.gain(np.array([size]))[0, 0] == pytest.approx(P / (P + R), rel=1e-8)


def law() -> GainLaw:
    A = np.array([[-0.6, 0.09, -1.0, 0.6], [-20.0, -9.0, 2.0, 0.0], [9.0, 0.4, -1.2, 0.0], [0.0, 1.0, 0.09, 0.0]])
    C = np.vstack([np.eye(4), [-8.0, -0.1, 0.2, 0.0]])
    return gain_law(
        A, C, 0.05, np.array([0.004, 0.007, 0.005, 0.005, 0.05]), np.array([0.004, 0.007, 0.005]), (0, 1, 2)
    )


def test_gain_is_a_fixed_point_of_the_riccati_recursion_and_the_filter_is_stable() -> None:
    made, size = law(), np.array([0.5, 1.5, 0.2])
    K = made.gain(size)
    R, Q = np.diag(made.noise**2), np.diag([*(made.unit * size) ** 2, 0.0])
    P = Q.copy()
    for _ in range(3000):
        gain = P @ made.C.T @ np.linalg.inv(made.C @ P @ made.C.T + R)
        P = made.transition @ (P - gain @ made.C @ P) @ made.transition.T + Q
    np.testing.assert_allclose(K, gain, rtol=1e-5, atol=1e-8)
    assert np.abs(np.linalg.eigvals(made.transition @ (np.eye(4) - K @ made.C))).max() < 1.0


def test_slopes_of_the_gain_and_no_noise_no_gain() -> None:
    made, size = law(), np.array([0.5, 1.5, 0.2])
    for i, slope in enumerate(made.slopes(size)):
        step = 1e-3 * np.eye(3)[i]
        np.testing.assert_allclose(slope, (made.gain(size + step) - made.gain(size - step)) / 2e-3, atol=1e-5)
    assert np.abs(made.gain(np.zeros(3))).max() < 1e-3  # the spiral is all but marginal
    assert np.isfinite(made.slopes(np.zeros(3))).all()


def test_a_gain_laid_out_by_columns_is_the_same_gain() -> None:
    flights, _ = fly(Case(noise=NOISE, seconds=6.0), np.random.default_rng(3))
    data = prepare_all(LATERAL, flights[0])[0]
    simulator = Simulator.build(LATERAL)
    if not isinstance(simulator.kernel, CompiledKernel):
        pytest.skip("no C compiler")
    gain = np.random.default_rng(1).normal(0, 0.02, (4, 5))
    segment, values = data.segments[0], LATERAL.starts()
    runs = [simulator.run(segment, values, segment.x0, gain=g) for g in (gain, np.asfortranarray(gain))]
    np.testing.assert_array_equal(runs[0].y, runs[1].y)
    assert isinstance(simulator.columns(), SensitivityColumns)


def errors(result: Result, truth: Mapping[str, float]) -> np.ndarray:
    """Error over corrected bound of the well-excited derivatives."""
    found = result.parameters
    return np.array([(found[n].estimate - truth[n]) / found[n].std_coloured for n in STRONG])


@pytest.fixture(scope="module")
def rough() -> list[Flight]:
    return fly(Case(noise=NOISE, gust=0.6), np.random.default_rng(11), 3)[0]


@pytest.fixture(scope="module")
def calm() -> list[Flight]:
    return fly(Case(noise=NOISE), np.random.default_rng(12), 2)[0]


def test_in_gusts_it_finds_them_and_the_truth(rough: list[Flight]) -> None:
    for flight in rough:
        result = process_noise_error(LATERAL, flight)
        assert result.converged
        assert np.abs(errors(result, TRUE)).max() < 4.0
        # 0.6 m/s at 16.5 m/s, correlated over 0.8 s: as white noise of the rate of beta that is sqrt(2/0.8) of it by the root of
        # a second; found within a factor of two
        gathered = 0.6 / 16.5 * np.sqrt(2.0 / 0.8)
        assert 0.5 < result.extra["process_noise"]["beta"] / gathered < 2.0


def test_in_calm_air_it_is_output_error(calm: list[Flight]) -> None:
    for flight in calm:
        by_noise, by_output = process_noise_error(LATERAL, flight), output_error(LATERAL, flight)
        assert by_noise.converged
        for n in STRONG:
            a, b = by_noise.parameters[n], by_output.parameters[n]
            assert abs(a.estimate - b.estimate) < 1.5 * b.std_coloured
            assert a.std_coloured < 2.0 * b.std_coloured
        assert by_noise.extra["process_noise"]["beta"] < 0.5 * DEG


def test_a_vane_that_shows_late_does_not_steer_the_filter(calm: list[Flight]) -> None:
    """In calm air both filters are output error, whose estimates are right; steered by the lagging vane they had Cn_r
    and Cn_beta three bounds off it."""
    made = calm[0]
    late = CubicSpline(made.time, made["beta"])(np.maximum(made.time - 0.07, 0.0))
    flight = made.with_columns(beta=late)
    lag = [c for c in structure_candidates(LATERAL) if c.name == "delay_beta"]
    model = with_candidates(LATERAL, lag)
    by_output = output_error(model, flight)
    assert by_output.parameters["delay_beta"].estimate == pytest.approx(0.07, abs=0.01)
    for method in (filter_error, process_noise_error):
        filtered = method(model, flight)
        assert filtered.converged
        assert not any(row.get("beta") for row in filtered.extra["gain"].values())
        for n in STRONG:
            a, b = filtered.parameters[n], by_output.parameters[n]
            assert abs(a.estimate - b.estimate) < 1.5 * b.std_coloured, (method, n)


def test_a_free_gain_that_finds_nothing_gives_way(calm: list[Flight], monkeypatch: pytest.MonkeyPatch) -> None:
    from estimation.estimators import filter_error as module
    from estimation.estimators.gauss_newton import LoopOptions

    monkeypatch.setattr(module, "LOOP", LoopOptions(iterations=1, tolerance=1e-12))  # as if it never settled
    settle = iter(
        [module.LOOP, LoopOptions(iterations=150, tolerance=1e-3), LoopOptions(iterations=150, tolerance=1e-3)]
    )
    minimise = module.minimise
    monkeypatch.setattr(module, "minimise", lambda problem, start, options: minimise(problem, start, next(settle)))
    result = filter_error(LATERAL, calm[0])
    assert (result.method, result.converged) == ("fem", True)
    assert set(result.extra) >= {"gain", "process_noise"}
