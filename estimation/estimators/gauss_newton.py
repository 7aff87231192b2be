"""The optimisation loop of all likelihood fits: Gauss-Newton with step halving, Levenberg-Marquardt where that stalls.

Near the optimum steps shrink by a constant factor, because the model is not exact or R relaxes. There several steps are combined
into one (Anderson mixing; Walker and Ni, SIAM J. Numer. Anal. 49, 2011). The fixed point is the same.

A problem evaluates its cost (a negative log likelihood) and proposes steps; the loop limits, accepts and damps them, and
handles costs that are not finite. Failure is a status, not an exception.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Status(Enum):
    """How an estimation ended; the value is the sentence for a person."""

    CONVERGED = "converged"
    STALLED = "stopped early: the fit cannot be improved along any direction the derivatives offer; do not trust it"
    LIMIT = "stopped at the limit of iterations before the estimates settled; do not trust it"
    DIVERGED = "no usable simulation was found from any starting point: check signs, units and the chosen model"
    NOT_IDENTIFIABLE = "converged, but some parameters cannot be told from this data"
    CUT = "converged on short pieces: the motion is unstable, so the flight was cut and each piece has its own initial state"

    @property
    def usable(self) -> bool:
        return self in (Status.CONVERGED, Status.NOT_IDENTIFIABLE, Status.CUT)


class EvaluatedPoint(Protocol):
    """The evaluation of a problem at some unknowns; `cost` is inf where the simulation is not finite."""

    @property
    def cost(self) -> float: ...


P = TypeVar("P", bound=EvaluatedPoint)
Trial = TypeVar("Trial")


@dataclass(frozen=True, slots=True)
class SolverStep:
    """A proposed change of the unknowns; decrement: the cost reduction it predicts, in log-likelihood units.

    weight: scale of each unknown (square root of the information's diagonal), or None where steps are not to be
    combined.
    """

    direction: Array
    decrement: float
    weight: Array | None = None


class SolverProblem(Protocol[P]):
    """A problem that the loop can solve."""

    def evaluate(self, unknowns: Array, derivatives: bool) -> P:
        """Cost, and derivatives if asked for."""
        ...

    def step(self, unknowns: Array, point: P, damping: float) -> SolverStep:
        """Gauss-Newton step from a point evaluated with derivatives; damping as in Marquardt's scaled diagonal."""
        ...

    def clip(self, unknowns: Array) -> Array:
        """The nearest unknowns within their limits."""
        ...


@dataclass(frozen=True)
class LoopOptions:
    """When the loop ends; all costs and reductions in log-likelihood units.

    tolerance: predicted reduction below which the estimates have settled (1e-7: steps below 5e-4 of a bound). relative: the same
    as a fraction of the cost; the larger counts. gain: also end after a step that lowered the cost by less than the tolerance.
    kept: also end after a step that predicted a reduction below this and achieved it to within half the tolerance, if the next
    predicted reduction, extrapolated from the last two, is below the tolerance. beyond: end as LIMIT if not even PREDICTED_LEFT
    times the predicted reduction would reach this cost. flat: predicted reduction, in tolerances, that counts as rounding where
    no step lowers the cost. iterations, halvings (of one step), first_damping, most_damping (Marquardt): limits."""

    iterations: int = 60
    tolerance: float = 1e-7
    halvings: int = 8
    first_damping: float = 1e-3
    most_damping: float = 1e8
    near: float = 10.0  # predicted reduction below which steps are combined
    memory: int = 4  # steps that are combined
    relative: float = 0.0
    gain: bool = False
    kept: float = 0.0
    beyond: float = math.inf
    flat: float = 1e3

    def settled(self, cost: float) -> float:
        """The reduction that is negligible at a cost."""
        return max(self.tolerance, self.relative * max(cost, 1.0))


PREDICTED_LEFT = 3.0  # times the predicted reduction of a step: the most that it and all later steps may achieve
DAMPING_FACTOR = 10.0  # by which damping rises after a step that fails, and falls after one that succeeds
AS_USUAL_LOOP = LoopOptions()


@dataclass(frozen=True)
class SolverOutcome(Generic[P]):
    """The result of the loop. point: evaluated at `unknowns`, with derivatives; history: costs."""

    status: Status
    unknowns: Array
    point: P
    iterations: int
    evaluations: int
    history: tuple[float, ...]


def minimise(problem: SolverProblem[P], start: Array, options: LoopOptions = AS_USUAL_LOOP) -> SolverOutcome[P]:
    """Lower the cost from `start` until the predicted reduction is negligible."""
    unknowns = problem.clip(start)
    point = problem.evaluate(unknowns, True)
    count = 1
    history = [point.cost]

    def outcome(status: Status, iterations: int) -> SolverOutcome[P]:
        return SolverOutcome(status, unknowns, point, iterations, count, tuple(history))

    if not math.isfinite(point.cost):
        return outcome(Status.DIVERGED, 0)
    damping = 0.0
    previous_predicted = math.inf
    memory = _StepMemory(options.memory)
    for iteration in range(1, options.iterations + 1):
        step = problem.step(unknowns, point, damping)
        if step.decrement < options.settled(point.cost):
            return outcome(Status.CONVERGED, iteration - 1)
        if point.cost - PREDICTED_LEFT * step.decrement > options.beyond:
            return outcome(Status.LIMIT, iteration - 1)
        combined = memory.combined(unknowns, step) if damping == 0.0 and step.decrement < options.near else None
        next_unknowns, moved_point, evaluations = _search(problem, unknowns, point, step, combined, options)
        count += evaluations
        if next_unknowns is None or moved_point is None:
            if step.decrement < options.flat * options.tolerance:  # the cost is flat to rounding here
                return outcome(Status.CONVERGED, iteration - 1)
            damping = max(DAMPING_FACTOR * damping, options.first_damping)
            if damping > options.most_damping:
                return outcome(Status.STALLED, iteration)
            continue
        damping = damping / DAMPING_FACTOR if damping > options.first_damping else 0.0
        achieved, predicted = point.cost - moved_point.cost, step.decrement
        unknowns, point = next_unknowns, moved_point
        history.append(point.cost)
        negligible = options.settled(point.cost)
        if options.gain and achieved < negligible:
            return outcome(Status.CONVERGED, iteration)
        as_predicted = predicted < options.kept and abs(achieved - predicted) < 0.5 * negligible
        if as_predicted and predicted * predicted < negligible * previous_predicted:
            return outcome(Status.CONVERGED, iteration)
        previous_predicted = predicted
    return outcome(Status.LIMIT, options.iterations)


class _StepMemory:
    """The last unknowns and the steps proposed at them."""

    def __init__(self, memory: int) -> None:
        self.memory = memory
        self.points: list[Array] = []
        self.directions: list[Array] = []

    def combined(self, unknowns: Array, step: SolverStep) -> Array | None:
        """The step to where the proposed steps, taken as linear in the unknowns, vanish; None at the first step."""
        if step.weight is None:
            return None
        self.points = [*self.points[-self.memory :], unknowns]
        self.directions = [*self.directions[-self.memory :], step.direction]
        if len(self.points) < 2:
            return None
        change = np.diff(np.array(self.points), axis=0).T
        step_change = np.diff(np.array(self.directions), axis=0).T
        share = np.linalg.lstsq(step_change * step.weight[:, None], step.direction * step.weight, rcond=1e-8)[0]
        return np.asarray(step.direction - (change + step_change) @ share)


def halve_until(
    evaluate: Callable[[float], Trial], acceptable: Callable[[Trial], bool], halvings: int
) -> tuple[float, Trial] | None:
    """The largest of the fractions 1, 1/2, 1/4 ... of a step that leads to an acceptable point, and that point; None without
    one."""
    for fraction in (0.5**k for k in range(halvings)):
        point = evaluate(fraction)
        if acceptable(point):
            return fraction, point
    return None


def _search(
    problem: SolverProblem[P], unknowns: Array, point: P, step: SolverStep, combined: Array | None, options: LoopOptions
) -> tuple[Array | None, P | None, int]:
    """Unknowns and point, with derivatives, of the first of the combined and the halved steps that lowers the cost, and the
    number of evaluations; None and None where no step does."""
    count = 0

    def lowers_cost(trial: P) -> bool:
        return math.isfinite(trial.cost) and trial.cost < point.cost

    def evaluate(fraction: float) -> P:
        nonlocal count
        trial_unknowns = problem.clip(unknowns + fraction * step.direction)
        trial = problem.evaluate(trial_unknowns, fraction == 1.0)
        count += 1
        if fraction < 1.0 and lowers_cost(trial):  # the loop needs derivatives where it continues
            trial = problem.evaluate(trial_unknowns, True)
            count += 1
        return trial

    if combined is not None and np.all(np.isfinite(combined)):
        trial_unknowns = problem.clip(unknowns + combined)
        trial = problem.evaluate(trial_unknowns, True)
        count += 1
        if lowers_cost(trial):
            return trial_unknowns, trial, count
    accepted = halve_until(evaluate, lowers_cost, options.halvings)
    if accepted is None:
        return None, None, count
    return problem.clip(unknowns + accepted[0] * step.direction), accepted[1], count
