"""The joint fit and the eliminations of the gap workflow are those of the estimators, and do not depend on units."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.estimators.gauss_newton import LoopOptions, SolverStep, Status, minimise
from estimation.estimators.normal_equations import eliminated, solved
from estimation.gap.criteria import AS_SET
from estimation.gap.fit.fitting import fit
from estimation.gap.fit.problem import LikelihoodProblem, fine_grid
from estimation.gap.fit.whitener import Whitener
from estimation.gap.records.flight_records import FlightRecord, prepare_flights
from estimation.gap.significance.measure import rms_over_noise
from estimation.gap.significance.screen import Projected
from estimation.models.base import Model, Parameter, Signal
from estimation.models.load import load_model
from tests.studies import fourth_simulator as fourth
from tests.studies.gap_benchmark import SPEEDS

STEP, COUNT = 0.05, 80
ROLL = Model(
    name="roll",
    states=(Signal("p", "rad/s"),),
    inputs=(Signal("delta_a", "rad", control=True),),
    outputs=(Signal("p", "rad/s"),),
    parameters=(
        Parameter("L_p", start=-4.0),
        Parameter("L_a", start=30.0),
        Parameter("bias", local=True, prior_mean=0.0, prior_std=0.1),
    ),
    equations=("p_dot = L_p*p + L_a*delta_a", "p_measured = p + bias"),
)


def problem() -> LikelihoodProblem:
    """Two records of a roll mode of -6 1/s and 40 1/s2 per rad, without noise; their biases are 0.02 and -0.01."""
    time = STEP * np.arange(COUNT)
    u = 0.1 * np.sign(np.sin(2.0 * time))
    simulator = Simulator.build(ROLL, (), compile_="never", substeps=1, hold="linear")
    records = []
    for index, bias in enumerate((0.02, -0.01)):
        grid = fine_grid(Segment(0, time, u[:, None], np.zeros((COUNT, 1)), np.zeros(1))).segment
        z = simulator.run(grid, {"L_p": -6.0, "L_a": 40.0, "bias": bias}, np.array([0.3])).y[::2]
        records.append(FlightRecord(index, 0, time, {"delta_a": u}, z, np.zeros(1), {}))
    white = Whitener(np.tile(100.0 * np.eye(1, dtype=complex), (COUNT // 2 + 1, 1, 1)), COUNT)
    return LikelihoodProblem(ROLL, ROLL, tuple(records), (white, white), AS_SET)


def test_the_joint_fit_finds_shared_and_own_unknowns() -> None:
    found = fit(problem())
    assert found.converged
    assert not found.diverged
    assert [found.values[n] for n in ("L_p", "L_a")] == pytest.approx([-6.0, 40.0], rel=1e-3)
    assert [own.parameters["bias"] for own in found.locals] == pytest.approx([0.02, -0.01], abs=1e-3)
    assert [own.x0[0] for own in found.locals] == pytest.approx([0.3, 0.3], abs=2e-3)
    assert found.cost < 0.1


def test_what_is_held_stays_and_what_is_frozen_too() -> None:
    held = fit(problem(), held=["L_p"])
    assert held.values["L_p"] == -4.0
    assert held.values["L_a"] != 30.0
    frozen = fit(problem(), {"L_p": -6.0, "L_a": 40.0}, frozen=True)
    assert (frozen.values["L_p"], frozen.values["L_a"]) == (-6.0, 40.0)
    assert frozen.locals[0].parameters["bias"] == pytest.approx(0.02, abs=1e-3)
    assert frozen.hessian.shape == (0, 0)


def test_with_an_unknown_at_its_limit_the_others_are_at_their_best() -> None:
    """Damping may not be stronger than -4.5 (truth -6): the fit with it as an unknown is the one with it held there."""
    limited = problem()
    parameters = tuple(replace(p, lower=-4.5) if p.name == "L_p" else p for p in ROLL.parameters)
    model = replace(ROLL, parameters=parameters)
    limited = replace(limited, model=model, base=model)
    found, held = fit(limited), fit(limited, {"L_p": -4.5}, held=["L_p"])
    assert found.converged
    assert found.values["L_p"] == -4.5
    assert found.values["L_a"] == pytest.approx(held.values["L_a"], rel=1e-4)
    assert found.cost == pytest.approx(held.cost, abs=2e-3)
    assert found.cost > 10.0, "the limit is felt"


@pytest.mark.parametrize("path", ["curvature_delta_a", "edge_delta_a", "behind_edge_delta_a"])
def test_paths_between_samples_are_columns_of_the_same_run(path: str) -> None:
    """The derivative by an unknown of a control's path against a central difference of whole motions."""
    bound = problem()
    bound = replace(bound, records=tuple(replace(r, restless=frozenset({"delta_a"})) for r in bound.records))
    values = {**bound.starts(), "L_p": -6.0, "L_a": 40.0, path: 0.4}
    local = bound.starting_locals()[0]
    _, dy = bound.linearised(0, values, local) or (None, np.zeros(0))
    at = bound.free.index(path)
    ends = [bound.residual(0, {**values, path: 0.4 + h}, local) for h in (0.01, -0.01)]
    assert ends[0] is not None
    assert ends[1] is not None
    np.testing.assert_allclose(dy[:, :, at], (ends[1] - ends[0]) / 0.02, atol=1e-9)
    assert np.abs(dy[:, :, at]).max() > 1e-3


def test_a_control_that_rests_has_no_unknown_edges() -> None:
    bound = problem()
    assert list(bound.paths) == ["curvature_delta_a"]
    restless = replace(bound, records=tuple(replace(r, restless=frozenset({"delta_a"})) for r in bound.records))
    assert restless.prior("edge_delta_a") == (0.0, AS_SET.surface_freedom)
    assert restless.limits("edge_delta_a") == (-0.8, 0.8)
    assert restless.nuisance("edge_delta_a")


def test_a_control_that_never_rests_on_one_flight_has_edges_on_all() -> None:
    """Random steps of an elevator rested for a little longer on one of three flights: its edges had no unknown, 8.2 of 5.2."""
    kind = fourth.Kind(axes="longitudinal", course="random steps")
    flights = fourth.fly(4301, kind, SPEEDS[:3])
    records = prepare_flights(load_model("longitudinal", "cdfp"), (), flights, (), AS_SET).records
    assert [bool(r.filtered) for r in records] == [True, True, False]
    assert all(r.restless == {"delta_e"} for r in records)


def test_an_edge_is_the_steepest_interval_of_a_step() -> None:
    """A servo that starts on a sample: 0.76 of a step in the first interval, then 0.18."""
    u = np.zeros(40)
    u[11:] = 1.0 - np.exp(-np.arange(1, 30) / 0.7)
    u[31:] -= 1.0 - np.exp(-np.arange(1, 10) / 0.7)
    u += 1e-3 * np.cos(np.arange(40.0))
    segment = Segment(0, 0.05 * np.arange(40), u[:, None], np.zeros((40, 1)), np.zeros(1))
    edges = fine_grid(segment).edges(0, 0, AS_SET)
    assert np.flatnonzero(edges).tolist() == [21, 61]
    np.testing.assert_allclose(edges[[21, 61]], np.diff(u)[[10, 30]])
    behind = fine_grid(segment).edges(0, 1, AS_SET)
    assert np.flatnonzero(behind).tolist() == [23, 63]
    np.testing.assert_allclose(behind[[23, 63]], np.diff(u)[[10, 30]])


def test_a_small_change_of_an_input_is_followed_to_the_outputs() -> None:
    bound = problem()
    values, local = {**bound.starts(), "L_p": -6.0, "L_a": 40.0}, bound.starting_locals()[0]
    du = np.random.default_rng(8).normal(size=(COUNT, 1, 3))
    changes = bound.disturbed(0, values, local, du)
    segment = bound.coarse[0]
    simulator = Simulator.build(ROLL, (), compile_="never", substeps=1, hold="linear")
    assert changes is not None
    for k in range(3):
        alone = replace(fine_grid(segment).segment, u=np.zeros((2 * COUNT - 1, 1)))
        alone.u[::2], alone.u[1::2] = du[:, :, k], 0.5 * (du[1:, :, k] + du[:-1, :, k])
        np.testing.assert_allclose(changes[:, :, k], simulator.run(alone, values, np.zeros(1)).y[::2], atol=1e-9)
    assert bound.disturbed(0, {**values, "L_p": 4000.0}, local, du) is None


def test_a_motion_that_runs_away_has_diverged() -> None:
    wild = fit(problem(), {"L_p": 4000.0})
    assert wild.diverged
    assert not wild.converged
    assert wild.cost == np.inf


def test_bounds_are_those_of_the_whole_problem_without_elimination() -> None:
    """Cramer-Rao bounds of the reduced Hessian against the inverse of the information about everything at once."""
    bound, found = problem(), fit(problem())
    blocks = []
    for i in range(2):
        residual, dy = bound.linearised(i, found.values, found.locals[i]) or (np.zeros(0), np.zeros(0))
        assert residual.size
        rows = bound.whiteners[i].rows(dy)
        own = np.zeros((rows.shape[0], 4))
        own[:, 2 * i : 2 * i + 2] = rows[:, 3:]
        blocks.append(np.concatenate([rows[:, :3], own], axis=1))
    J = np.concatenate(blocks)
    prior = np.diag([0.0, 0.0, 1 / 1.5**2, 100.0, 0.0, 100.0, 0.0])
    expected = np.sqrt(np.diag(np.linalg.inv(J.T @ J + prior)))[:3]
    assert [found.std()[n] for n in bound.free] == pytest.approx(list(expected), rel=1e-2)


# ------------------------------------------------------------------------------------------------ elimination
def columns(rows: int = 200) -> Array:
    return np.random.default_rng(0).standard_normal((rows, 5))


def test_elimination_is_least_squares() -> None:
    X = columns()
    left = X[:, 2:] - X[:, :2] @ np.linalg.lstsq(X[:, :2], X[:, 2:], rcond=None)[0]
    np.testing.assert_allclose(eliminated(X.T @ X, 2), left.T @ left, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        solved(X[:, :2].T @ X[:, :2], X[:, :2].T @ X[:, 4]), np.linalg.lstsq(X[:, :2], X[:, 4], rcond=None)[0]
    )
    assert eliminated(X.T @ X, 0) == pytest.approx(X.T @ X)


@pytest.mark.parametrize("unit", [1e-7, 1.0, 1e7])
def test_what_the_base_absorbs_does_not_depend_on_the_unit_of_a_parameter(unit: float) -> None:
    """A tolerance on raw eigenvalues drops a parameter whose unit makes its sensitivity small; it absorbs all the same."""
    X = columns()
    X[:, 2] += X[:, 0]  # a hypothesis that looks like the first parameter
    X[:, 0] *= unit
    absorbed = Projected.of(X.T @ X, 2, 2)
    X[:, 0] /= unit
    expected = Projected.of(X.T @ X, 2, 2)
    np.testing.assert_allclose(absorbed.B, expected.B, rtol=1e-6)
    np.testing.assert_allclose(absorbed.scores(), expected.scores(), rtol=1e-6)


def test_a_direction_the_data_does_not_see_is_left_alone() -> None:
    X = columns()
    X[:, 1] = X[:, 0]
    both = solved(X[:, :2].T @ X[:, :2], X[:, :2].T @ X[:, 4])
    assert both[0] == pytest.approx(both[1])
    assert 2 * both[0] == pytest.approx(float(np.linalg.lstsq(X[:, :1], X[:, 4], rcond=None)[0][0]))


# ------------------------------------------------------------------------------------------------ the loop's options
@dataclass(frozen=True)
class At:
    cost: float


class Bowl:
    """cost + x^2/2, whose steps are told to go a share of the way."""

    def __init__(self, cost: float, share: float = 1.0, uphill: bool = False) -> None:
        self.floor, self.share, self.sign = cost, share, -1.0 if uphill else 1.0

    def evaluate(self, unknowns: Array, derivatives: bool) -> At:
        return At(self.floor + 0.5 * float(unknowns[0]) ** 2)

    def step(self, unknowns: Array, point: At, damping: float) -> SolverStep:
        return SolverStep(-self.sign * self.share * unknowns, 0.5 * float(unknowns[0]) ** 2)

    def clip(self, unknowns: Array) -> Array:
        return unknowns


@dataclass
class Counted:
    """A bowl that counts how often it is asked for a step."""

    bowl: Bowl
    asked: int = 0

    def evaluate(self, unknowns: Array, derivatives: bool) -> At:
        return self.bowl.evaluate(unknowns, derivatives)

    def step(self, unknowns: Array, point: At, damping: float) -> SolverStep:
        self.asked += 1
        return self.bowl.step(unknowns, point, damping)

    def clip(self, unknowns: Array) -> Array:
        return unknowns

    def steps(self, start: Array, options: LoopOptions) -> int:
        assert minimise(self, start, options).status is Status.CONVERGED
        return self.asked


ENDS = LoopOptions(25, 1e-3, most_damping=0.0, near=0.0, relative=1e-6, gain=True, flat=0.0)


def test_a_promise_below_a_share_of_the_cost_ends_the_search() -> None:
    small = np.array([0.1])  # promises 0.005
    assert minimise(Bowl(1e5), small, ENDS).iterations == 0
    assert minimise(Bowl(1e3), small, ENDS).iterations == 1


def test_a_gain_below_the_tolerance_ends_the_search_too() -> None:
    """A tenth of a thousandth of the way: it promises 0.5 and gains 1e-4."""
    slow = Bowl(0.0, share=1e-4)
    assert minimise(slow, np.array([1.0]), ENDS).iterations == 1
    assert minimise(slow, np.array([1.0]), replace(ENDS, gain=False)).status is Status.LIMIT


def test_a_short_step_that_kept_its_promise_is_the_last() -> None:
    """Whole steps arrive, so the first gives what it promised; steps that go half the way gain three quarters of it."""
    kept = replace(ENDS, kept=1.0)
    near, far = np.array([1.0]), np.array([2.0])  # promise 0.5 and 2
    assert Counted(Bowl(0.0)).steps(near, kept) == 1
    assert Counted(Bowl(0.0)).steps(far, kept) == 2
    assert Counted(Bowl(0.0)).steps(near, ENDS) == 2
    assert Counted(Bowl(0.0, share=0.5)).steps(near, kept) == 5, (
        "wrong by a quarter until that is less than the tolerance"
    )


def test_a_search_that_comes_nowhere_near_is_given_up() -> None:
    start = np.array([2.0])  # promises 2, may give 6
    away = minimise(Bowl(100.0), start, replace(ENDS, beyond=95.9))
    assert (away.status, away.iterations, away.point.cost) == (Status.LIMIT, 0, 102.0)
    assert minimise(Bowl(100.0), start, replace(ENDS, beyond=96.1)).status is Status.CONVERGED


def test_without_damping_a_search_that_finds_nothing_better_has_stalled() -> None:
    assert minimise(Bowl(0.0, uphill=True), np.array([0.1]), ENDS).status is Status.STALLED
    assert minimise(Bowl(0.0, uphill=True), np.array([0.1]), replace(ENDS, flat=1e3)).status is Status.CONVERGED


# ------------------------------------------------------------------------------------------------ the size of the gap
def test_the_gap_is_what_own_unknowns_cannot_take_in_units_of_the_noise() -> None:
    """Initial state and bias of every record fitted once more with plain weights (and the bias' prior), shared ones held."""
    bound = problem()
    found = fit(bound, {"L_p": -6.0, "L_a": 40.0}, frozen=True)
    rng, scatter = np.random.default_rng(3), np.array([0.02])
    residuals = tuple(0.05 * rng.standard_normal((COUNT, 1)) + 0.3 for _ in range(2))
    left = 0.0
    for i, residual in enumerate(residuals):
        _, dy = bound.linearised(i, found.values, found.locals[i]) or (residual, residual)
        J = np.vstack([dy[:, 0, 3:] / scatter, [[1.0 / 0.1, 0.0]]])
        r = np.append(residual[:, 0] / scatter, 0.0)
        left += float(np.sum((r - J @ np.linalg.lstsq(J, r, rcond=None)[0])[:-1] ** 2))
    expected = np.sqrt(left / (2 * COUNT))
    assert rms_over_noise(bound, replace(found, residuals=residuals), scatter) == pytest.approx(expected, rel=1e-6)
