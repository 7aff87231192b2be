"""The optimisation loop by itself, on a quadratic whose proposed steps fall short by steady factors."""

from dataclasses import dataclass

import numpy as np
import pytest

from estimation.estimators.gauss_newton import LoopOptions, SolverStep, Status, minimise

TRUE = np.array([3.0, -40.0, 0.02])
SCALE = np.array([1.0, 10.0, 0.01])
SHORT = np.array([0.9, 0.5, 0.3])  # of the step to the optimum, by unknown: as with a model that is not quite right


@dataclass
class Point:
    cost: float


class Quadratic:
    """Cost 1/2 |(u - true)/scale|^2; combine: whether the loop may combine steps."""

    def __init__(self, combine: bool) -> None:
        self.weight = 1.0 / SCALE if combine else None

    def evaluate(self, unknowns: np.ndarray, derivatives: bool) -> Point:
        return Point(0.5 * float(np.sum(((unknowns - TRUE) / SCALE) ** 2)))

    def step(self, unknowns: np.ndarray, point: Point, damping: float) -> SolverStep:
        away = TRUE - unknowns
        return SolverStep(SHORT * away, 0.5 * float(np.sum(SHORT * (away / SCALE) ** 2)), self.weight)

    def clip(self, unknowns: np.ndarray) -> np.ndarray:
        return unknowns


def test_combined_steps_reach_the_same_optimum_sooner() -> None:
    start = TRUE + SCALE * np.array([1.5, -2.0, 2.5])
    options = LoopOptions(tolerance=1e-12)
    plain, combined = minimise(Quadratic(False), start, options), minimise(Quadratic(True), start, options)
    assert plain.status is combined.status is Status.CONVERGED
    assert combined.unknowns == pytest.approx(TRUE, rel=1e-6)
    assert combined.iterations <= 6  # three directions: three steps to know them
    assert plain.iterations > 3 * combined.iterations


def test_far_away_steps_are_taken_as_they_are() -> None:
    start = TRUE + SCALE * np.array([150.0, -200.0, 250.0])
    first = minimise(Quadratic(True), start, LoopOptions(iterations=2))
    alone = minimise(Quadratic(False), start, LoopOptions(iterations=2))
    assert np.array_equal(first.unknowns, alone.unknowns)


class Exact(Quadratic):
    """Steps that fall short and yet give just what they promise, as those of a bent cost do where its errors change sign."""

    def step(self, unknowns: np.ndarray, point: Point, damping: float) -> SolverStep:
        step = super().step(unknowns, point, damping)
        return SolverStep(
            step.direction, point.cost - self.evaluate(unknowns + step.direction, False).cost, step.weight
        )


@pytest.mark.parametrize("away", [2.0, 8.0, 40.0])
def test_a_promise_kept_ends_the_search_only_where_steps_shrink_fast(away: float) -> None:
    """The slowest unknown leaves half of the cost with each step, the fastest a hundredth."""
    options = LoopOptions(tolerance=1e-3, kept=1.0)
    slow = minimise(Exact(False), TRUE + SCALE * np.array([0.0, 0.0, away]), options)
    assert slow.status is Status.CONVERGED
    assert slow.point.cost < 2e-3
    fast = minimise(Exact(False), TRUE + SCALE * np.array([away, 0.0, 0.0]), options)
    assert fast.iterations <= 3
