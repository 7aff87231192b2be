"""How far a surface strays between two samples: responses, marginalisation and the estimate of the freedom."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator
from scipy.linalg import expm

from estimation.engine.simulate import Segment, Simulator
from estimation.gap.criteria import AS_SET
from estimation.gap.fit.linear_motion import Linear, linear_motion
from estimation.gap.fit.noise import NoiseModel, Shapes, shapes_of, whitener
from estimation.gap.fit.problem import fine_grid, middles
from estimation.gap.fit.surface_steps import (
    SurfaceSteps,
    displaced,
    find_surface_steps,
    freedom_of,
    jumping_outputs,
    loosened,
)
from estimation.gap.records.flight_records import prepare_flights, quick_length
from estimation.models.base import InputTransform, Parameter, Signal
from groundstation.flight import Flight
from tests.unit.estimation.gap.roll import ROLL

DT = 0.05
N = 200


def _segment() -> Segment:
    time = np.arange(N, dtype=np.float64) * DT
    u = 0.1 * ((time > 2.0) & (time < 3.0)) - 0.1 * ((time > 6.0) & (time < 6.6))
    return Segment(0, time, u[:, None], np.full((N, 1), 10.0), np.zeros(1))  # a motion in which kinks are small


def _linear() -> tuple[Linear, Shapes, Segment]:
    segment = _segment()
    simulator = Simulator.build(ROLL, (), compile_="never", substeps=1, hold="linear")
    linear = linear_motion(ROLL, simulator, segment, ROLL.starts())
    return linear, shapes_of(ROLL, linear, N, AS_SET), segment


def test_the_linear_motion_is_the_model_s() -> None:
    linear, _, _ = _linear()
    assert linear.A[0, 0] == pytest.approx(-6.0, rel=1e-6)
    assert linear.B[0, 0] == pytest.approx(40.0, rel=1e-6)
    assert linear.C[0, 0] == pytest.approx(1.0, rel=1e-6)


def test_the_steps_are_found_and_their_response_is_that_of_the_moved_middle() -> None:
    linear, _, segment = _linear()
    steps = find_surface_steps(ROLL, linear, segment, AS_SET)
    assert sorted(steps.at) == [40, 59, 120, 131]
    simulator = Simulator.build(ROLL, (), compile_="never", substeps=4, hold="linear")
    grid = fine_grid(segment).segment
    which = int(np.flatnonzero(steps.at == 59)[0])
    moved = grid.u.copy()
    moved[2 * 59 + 1, 0] += steps.step[which]
    still = simulator.run(grid, ROLL.starts(), np.zeros(1)).y
    other = simulator.run(Segment(0, grid.time, moved, grid.z, grid.x0), ROLL.starts(), np.zeros(1)).y
    np.testing.assert_allclose(steps.response[:, :, which], (other - still)[::2], atol=2e-4)


def test_loosening_equals_the_full_covariance() -> None:
    linear, shapes, segment = _linear()
    steps = find_surface_steps(ROLL, linear, segment, AS_SET)
    plain = whitener(NoiseModel(np.array([1e-4]), {}), shapes)
    loose = loosened(plain, steps, {"delta_a": 0.3})
    residual = np.random.default_rng(0).normal(0, 0.01, (N, 1)) + 0.4 * steps.response[:, :, 1]
    E = (steps.response * 0.3).reshape(N, -1)
    covariance = 1e-4 * np.eye(N) + E @ E.T
    expected = residual[:, 0] @ np.linalg.solve(covariance, residual[:, 0])
    assert np.sum(loose.rows(residual) ** 2) == pytest.approx(expected, rel=1e-6)
    assert np.sum(loose.series(residual) ** 2) == pytest.approx(expected, rel=1e-6)
    assert loose.energy(residual) == pytest.approx(expected, rel=1e-6)
    columns = np.random.default_rng(1).normal(0, 0.01, (N, 1, 4))
    np.testing.assert_allclose(loose.gram(columns), loose.rows(columns).T @ loose.rows(columns), rtol=1e-9, atol=1e-9)


def test_steps_that_move_nothing_loosen_nothing() -> None:
    linear, shapes, segment = _linear()
    steps = find_surface_steps(ROLL, linear, segment, AS_SET)
    still = SurfaceSteps(steps.name, steps.at, steps.step, 1e-9 * steps.response, AS_SET)
    plain = whitener(NoiseModel(np.array([1e-4]), {}), shapes)
    residual = np.random.default_rng(0).normal(0, 0.01, (N, 1))
    np.testing.assert_array_equal(loosened(plain, still, {"delta_a": 0.3}).series(residual), plain.series(residual))


def test_the_freedom_is_estimated_from_the_flights() -> None:
    linear, shapes, segment = _linear()
    one = find_surface_steps(ROLL, linear, segment, AS_SET)
    many = SurfaceSteps(one.name * 12, np.tile(one.at, 12), np.tile(one.step, 12), one.response, AS_SET)
    plain = whitener(NoiseModel(np.array([1e-6]), {}), shapes)
    rng, told, freedom = np.random.default_rng(1), [], {"delta_a": 0.2}
    moves = 0.35 * rng.standard_normal((12, len(one.name)))
    for _ in range(5):
        told = [displaced(plain, one, freedom, one.response @ m + 1e-3 * rng.standard_normal((N, 1))) for m in moves]
        freedom = freedom_of([one] * 12, told)
    assert len(many.name) == 48
    assert freedom["delta_a"] == pytest.approx(np.sqrt(np.mean(moves**2)), rel=0.1)


FEELING = replace(
    ROLL,
    outputs=(*ROLL.outputs, Signal("ay", "m/s2")),
    parameters=(*ROLL.parameters, Parameter("Y_a", start=5.0)),
    equations=("p_dot = L_p*p + 0.1*L_a*delta_a", "ay = Y_a*delta_a + 0.1*p"),
)


def _feeling() -> tuple[Linear, Shapes, Segment]:
    segment = replace(_segment(), z=np.ones((N, 2)))
    simulator = Simulator.build(FEELING, (), compile_="never", substeps=1, hold="linear")
    linear = linear_motion(FEELING, simulator, segment, FEELING.starts())
    return linear, shapes_of(FEELING, linear, N, AS_SET), segment


def test_an_output_that_shows_the_control_at_once_may_be_off_next_to_its_jumps_only() -> None:
    assert jumping_outputs(ROLL) == ()
    assert jumping_outputs(FEELING) == ("ay",)
    linear, _, segment = _feeling()
    steps = find_surface_steps(FEELING, linear, segment, AS_SET)
    own = [m for m, name in enumerate(steps.name) if name == "ay"]
    assert sorted(steps.at[own]) == [40, 41, 59, 60, 120, 121, 131, 132]
    np.testing.assert_allclose(steps.step[own], 5.0 * 0.1 + DT * 0.1 * 4.0 * 0.1, rtol=1e-6)  # jump and kink
    for m in own:
        seen = np.zeros((N, 2))
        seen[steps.at[m], 1] = steps.step[m]
        np.testing.assert_array_equal(steps.response[:, :, m], seen)
    assert [name for name in steps.name if name != "ay"] == ["delta_a"] * 4


def test_a_rate_may_be_off_next_to_its_kinks() -> None:
    linear, _, segment = _linear()
    steps = find_surface_steps(ROLL, replace(linear, scale=np.ones(1)), segment, AS_SET)
    own = [m for m, name in enumerate(steps.name) if name == "p"]
    assert sorted(steps.at[own]) == [40, 41, 59, 60, 120, 121, 131, 132]
    np.testing.assert_allclose(steps.step[own], DT * 40.0 * 0.1, rtol=1e-6)
    assert "p" not in find_surface_steps(ROLL, linear, segment, AS_SET).name


@pytest.mark.parametrize("off", [0.02, 0.2])
def test_how_far_jumps_are_off_is_estimated_from_the_flights(off: float) -> None:
    """By repeated estimates, as the baseline does it; surfaces stay where they are."""
    linear, shapes, segment = _feeling()
    one = find_surface_steps(FEELING, linear, segment, AS_SET)
    own = np.array([name == "ay" for name in one.name])
    level = np.array([1e-3, 2e-3])
    plain = whitener(NoiseModel(level**2, {}), shapes)
    rng, freedom = np.random.default_rng(2), {"delta_a": 0.1, "ay": 0.1}
    flights = []
    for _ in range(20):
        moved = one.response @ np.where(own, off * rng.standard_normal(own.size), 0.1 * rng.standard_normal(own.size))
        flights.append(moved + level * rng.standard_normal((N, 2)))
    for _ in range(12):
        told = [displaced(plain, one, freedom, flight) for flight in flights]
        freedom = freedom_of([one] * len(flights), told)
    assert freedom["ay"] == pytest.approx(off, rel=0.2)
    assert freedom["delta_a"] == pytest.approx(0.1, rel=0.2)


def test_a_motion_that_runs_away_has_no_endless_response() -> None:
    wild = Linear(np.array([[400.0]]), np.array([[1.0]]), np.eye(1), np.zeros((1, 1)), ("delta_a",), DT, np.ones(1))
    assert expm(wild.A * DT)[0, 0] > 1e8
    assert np.isfinite(find_surface_steps(ROLL, wild, _segment(), AS_SET).response).all()


def test_a_noisier_flight_is_marked_and_a_quieter_one_left_as_usual() -> None:
    rng = np.random.default_rng(3)
    time, still = np.arange(400, dtype=np.float64) * DT, np.zeros(400)
    flights = [
        Flight.build(f"f{i}", time, {"delta_a": still, "p": level * rng.standard_normal(400)})
        for i, level in enumerate((0.01, 0.01, 0.03, 0.002))
    ]
    prepared = prepare_flights(ROLL, (), flights[:3], flights[3:], AS_SET)
    marks = [r.louder for r in prepared.records]
    assert marks[0] is None
    assert marks[1] is None
    assert marks[2] is not None
    assert marks[2][0] == pytest.approx(9.0, rel=0.3)
    assert marks[3] is None


@pytest.mark.parametrize(
    ("count", "kept"), [(601, 600), (600, 600), (199, 199), (211, 210), (719, 719), (1201, 1200), (5, 5)]
)
def test_a_record_loses_at_most_one_sample_in_two_hundred_to_be_quick(count: int, kept: int) -> None:
    """719 is prime, and so much of 716, 717 and 718 is that it stays whole; 199 may not lose one."""
    assert quick_length(count) == kept


def test_inputs_run_through_the_middles_of_a_monotone_cubic() -> None:
    rng = np.random.default_rng(4)
    time, u = np.cumsum(rng.uniform(0.03, 0.07, 60)), rng.standard_normal((60, 5))
    u[20:30, 1], u[:, 2] = 0.4, np.round(u[:, 2])
    expected = PchipInterpolator(time, u, axis=0)(0.5 * (time[1:] + time[:-1]))
    np.testing.assert_allclose(middles(time, u), expected, atol=1e-12)
    np.testing.assert_array_equal(middles(time[:2], u[:2]), 0.5 * (u[:1] + u[1:2]))


def test_a_grid_with_other_inputs_is_the_grid_of_those_inputs() -> None:
    rng = np.random.default_rng(5)
    time, u = 0.05 * np.arange(30), rng.standard_normal((30, 3))
    first = fine_grid(Segment(0, time, u, np.zeros((30, 1)), np.zeros(1)))
    other = u.copy()
    other[:, 1] = rng.standard_normal(30)
    expected = fine_grid(replace(first.segment, time=time, u=other, z=np.zeros((30, 1))))
    found = first.with_inputs(other)
    np.testing.assert_array_equal(found.segment.u, expected.segment.u)
    np.testing.assert_array_equal(found.rounding, expected.rounding)


def test_motion_by_middles_is_the_motion_on_straight_lines_between_them() -> None:
    """Both on inputs that a timing offset moves, so that sensitivities go through the inputs too."""
    _, _, segment = _linear()
    timed = ROLL.plus(parameters=[Parameter("late", "s")], transforms=[InputTransform("delay", "delta_a", ("late",))])
    fine, values = fine_grid(segment).segment, {**ROLL.starts(), "late": 0.012}
    for model in (timed, replace(timed, transforms=(), output_delays={"p": "late"})):
        simulator = Simulator.build(model, substeps=1, hold="linear")
        every = simulator.run(fine, values, np.array([0.3]), sensitivities=True)
        found = simulator.run_by_middles(fine, values, np.array([0.3]), sensitivities=True)
        assert every.dy is not None
        assert found.dy is not None
        assert found.finite
        np.testing.assert_allclose(found.y, every.y[::2], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found.dy, every.dy[::2], rtol=1e-9, atol=1e-9)
