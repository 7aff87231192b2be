"""The one optimisation loop: Gauss-Newton with step halving, Levenberg-Marquardt where that stalls.

Near the optimum, where steps shrink by a steady factor because the model is not quite right or R relaxes, several are
combined into one (Anderson mixing; Walker and Ni, SIAM J. Numer. Anal. 49, 2011): the fixed point is the same.

A problem evaluates its cost (a negative log likelihood) and proposes steps; limits, acceptance, damping and the
non-finite checks live here. The outcome is a named state with a sentence, never an exception.
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
    """A place at which a problem has been evaluated; `cost` is inf where the simulation left the finite numbers."""

    @property
    def cost(self) -> float: ...


P = TypeVar("P", bound=EvaluatedPoint)
Place = TypeVar("Place")


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
    """What the loop needs of a problem."""

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
    """tolerance: predicted reduction [log likelihood] below which the estimates have settled (1e-7: steps below
    5e-4 of a bound). relative: the same as a share of the cost, where that is more. gain: a step that lowered the cost by
    less than the tolerance ends the search too. kept: so does one that promised less than this and gave it to within
    half the tolerance, where the next, smaller in the ratio in which this one was smaller than the last, would promise less
    than the tolerance (a promise kept alone says little, but it is all that a first step can tell). beyond: cost which a
    search has to come near to be worth going on with. flat: tolerances a step that lowers nothing may still promise at
    rounding."""

    iterations: int = 60
    tolerance: float = 1e-7
    halvings: int = 8
    first_damping: float = 1e-3
    most_damping: float = 1e8
    near: float = 10.0  # predicted reduction from which steps are combined
    memory: int = 4  # steps combined
    relative: float = 0.0
    gain: bool = False
    kept: float = 0.0
    beyond: float = math.inf
    flat: float = 1e3

    def settled(self, cost: float) -> float:
        """Reduction at that cost that is not worth a step."""
        return max(self.tolerance, self.relative * max(cost, 1.0))


HOPED = 3.0  # times what a step promises that it and those after it may give
AS_USUAL_LOOP = LoopOptions()


@dataclass(frozen=True)
class SolverOutcome(Generic[P]):
    """Where the loop ended. point: evaluated there, with derivatives."""

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
    if not math.isfinite(point.cost):
        return SolverOutcome(Status.DIVERGED, unknowns, point, 0, count, tuple(history))
    damping = 0.0
    last = math.inf
    history_of_steps = _Past(options.memory)
    for iteration in range(1, options.iterations + 1):
        step = problem.step(unknowns, point, damping)
        if step.decrement < options.settled(point.cost):
            return SolverOutcome(Status.CONVERGED, unknowns, point, iteration - 1, count, tuple(history))
        if point.cost - HOPED * step.decrement > options.beyond:
            return SolverOutcome(Status.LIMIT, unknowns, point, iteration - 1, count, tuple(history))
        combined = (
            history_of_steps.combined(unknowns, step) if damping == 0.0 and step.decrement < options.near else None
        )
        next_unknowns, moved_point, evaluations = _search(problem, unknowns, point, step, combined, options)
        count += evaluations
        if next_unknowns is None or moved_point is None:
            if step.decrement < options.flat * options.tolerance:  # the cost is flat to rounding here
                return SolverOutcome(Status.CONVERGED, unknowns, point, iteration - 1, count, tuple(history))
            damping = max(10.0 * damping, options.first_damping)
            if damping > options.most_damping:
                return SolverOutcome(Status.STALLED, unknowns, point, iteration, count, tuple(history))
            continue
        damping = damping / 10.0 if damping > options.first_damping else 0.0
        gained, promised = point.cost - moved_point.cost, step.decrement
        unknowns, point = next_unknowns, moved_point
        history.append(point.cost)
        if options.gain and gained < options.settled(point.cost):
            return SolverOutcome(Status.CONVERGED, unknowns, point, iteration, count, tuple(history))
        negligible = options.settled(point.cost)
        if (
            promised < options.kept
            and abs(gained - promised) < 0.5 * negligible
            and promised * promised < negligible * last
        ):
            return SolverOutcome(Status.CONVERGED, unknowns, point, iteration, count, tuple(history))
        last = promised
    return SolverOutcome(Status.LIMIT, unknowns, point, options.iterations, count, tuple(history))


class _Past:
    """The last places and the steps proposed there."""

    def __init__(self, memory: int) -> None:
        self.memory = memory
        self.places: list[Array] = []
        self.directions: list[Array] = []

    def combined(self, unknowns: Array, step: SolverStep) -> Array | None:
        """The step to where a straight-line law through the last steps would vanish; None while there is only one."""
        if step.weight is None:
            return None
        self.places = [*self.places[-self.memory :], unknowns]
        self.directions = [*self.directions[-self.memory :], step.direction]
        if len(self.places) < 2:
            return None
        change = np.diff(np.array(self.places), axis=0).T
        turn = np.diff(np.array(self.directions), axis=0).T
        share = np.linalg.lstsq(turn * step.weight[:, None], step.direction * step.weight, rcond=1e-8)[0]
        return np.asarray(step.direction - (change + turn) @ share)


def halve_until(
    evaluate: Callable[[float], Place], acceptable: Callable[[Place], bool], halvings: int
) -> tuple[float, Place] | None:
    """The largest of a whole step, its half, its quarter ... that leads to an acceptable place, and that place."""
    for fraction in (0.5**k for k in range(halvings)):
        place = evaluate(fraction)
        if acceptable(place):
            return fraction, place
    return None


def _search(
    problem: SolverProblem[P], unknowns: Array, point: P, step: SolverStep, combined: Array | None, options: LoopOptions
) -> tuple[Array | None, P | None, int]:
    """First of the combined and the halved steps that lowers the cost, evaluated with derivatives."""
    count = 0

    def lower(place: P) -> bool:
        return math.isfinite(place.cost) and place.cost < point.cost

    def evaluate(fraction: float) -> P:
        nonlocal count
        trial = problem.clip(unknowns + fraction * step.direction)
        place = problem.evaluate(trial, fraction == 1.0)
        count += 1
        if fraction < 1.0 and lower(place):  # a place without derivatives is none to go on from
            place = problem.evaluate(trial, True)
            count += 1
        return place

    if combined is not None and np.all(np.isfinite(combined)):
        trial = problem.clip(unknowns + combined)
        place = problem.evaluate(trial, True)
        count += 1
        if lower(place):
            return trial, place, count
    lowered = halve_until(evaluate, lower, options.halvings)
    if lowered is None:
        return None, None, count
    return problem.clip(unknowns + lowered[0] * step.direction), lowered[1], count
