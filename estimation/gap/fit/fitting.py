"""The joint fit of one model to many records with whitened residuals: generalised output error.

Unknowns are the shared parameters and, per record, initial states and local parameters such as instrument biases. The normal
matrix has arrow structure and is reduced record by record (Schur complement), so that the work is linear in the number of
flights. Optimiser and elimination are those of the estimators (`estimation.estimators`); this file states the problem for them.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimation.engine.kernel import Array
from estimation.estimators.gauss_newton import LoopOptions, SolverStep, Status, minimise
from estimation.estimators.normal_equations import FlightBlocks, step_within
from estimation.gap.fit.problem import LikelihoodProblem, Local, ModelFit, prior_cost, prior_terms

ITERATIONS = 25  # at most; a caller may go on with a fit that has not converged by then
ENOUGH = 1e-3  # of the log-likelihood: steps below a twentieth of a standard deviation
LAST_GAIN = 1.0  # of the log-likelihood: a step that predicts less, and gains what it predicted, is the last
FLAT = 1e-6  # of the cost: a smaller decrease is rounding of sums over 10^4 residuals and of the integration


@dataclass(frozen=True)
class WhitenedPoint:
    """The whitened cost at some values. residuals: per record (N, ny), empty where the motion runs away; grams: per record, as of
    `linearised_in`, where the derivatives were computed with it."""

    cost: float
    residuals: tuple[Array, ...] = ()
    grams: tuple[Array, ...] = ()


@dataclass
class ProblemUnknowns:
    """The problem as the optimiser sees it: one vector of the first n shared unknowns, then the local unknowns of every record.

    values: start of everything shared. held: indices of shared unknowns that stay fixed. hessian: (n, n) at the last step.
    runaway: whether a linearised motion ran away. evaluated: whether a point has been evaluated.
    """

    problem: LikelihoodProblem
    values: Mapping[str, float]
    n: int
    held: Sequence[int]
    hessian: Array
    runaway: bool = False
    evaluated: bool = False

    @cached_property
    def limits(self) -> Array:
        """(2, n) lower and upper limits of the shared unknowns."""
        return np.array([self.problem.limits(n) for n in self.problem.free[: self.n]]).reshape(-1, 2).T

    def packed(self, locals_: Sequence[Local]) -> Array:
        """The vector of unknowns: shared ones at their start, then `locals_`."""
        local_rows = [[*(local.parameters[n] for n in self.problem.local_names), *local.x0] for local in locals_]
        return np.concatenate([[self.values[n] for n in self.problem.free[: self.n]], *local_rows])

    def unpacked(self, unknowns: Array) -> tuple[dict[str, float], tuple[Local, ...]]:
        """Shared values by name, and the local unknowns of every record."""
        names, count = self.problem.local_names, len(self.problem.local_names)
        shared = zip(self.problem.free[: self.n], unknowns[: self.n].tolist(), strict=True)
        local_rows = unknowns[self.n :].reshape(len(self.problem.records), -1)
        locals_ = tuple(
            Local(row[count:].copy(), dict(zip(names, row[:count].tolist(), strict=True))) for row in local_rows
        )
        return {**self.values, **dict(shared)}, locals_

    def clip(self, unknowns: Array) -> Array:
        return np.concatenate([np.clip(unknowns[: self.n], *self.limits), unknowns[self.n :]])

    def evaluate(self, unknowns: Array, derivatives: bool) -> WhitenedPoint:
        """Cost and residuals. Derivatives are left to `step`, since they cost more and not every point is stepped from; only at
        the first point, which always is, one simulation gives both."""
        first, self.evaluated = not self.evaluated, True
        problem, (values, locals_) = self.problem, self.unpacked(unknowns)
        if first and derivatives:
            linearised = [linearised_in(problem, i, values, local, self.n) for i, local in enumerate(locals_)]
            finite = [m for m in linearised if m is not None]
            if len(finite) == len(linearised):
                residuals, grams = zip(*finite, strict=True)
                return WhitenedPoint(self.cost(values, locals_, [float(g[-1, -1]) for g in grams]), residuals, grams)
        residuals = tuple(problem.residual(i, values, local) for i, local in enumerate(locals_))
        if any(r is None for r in residuals):
            return WhitenedPoint(np.inf)
        energies = [w.energy(r) for w, r in zip(problem.whiteners, residuals, strict=True)]
        return WhitenedPoint(self.cost(values, locals_, energies), residuals)

    def cost(self, values: Mapping[str, float], locals_: Sequence[Local], energies: Sequence[float]) -> float:
        """Half the whitened sums of squares (energies) of the records, plus the costs of the priors."""
        problem = self.problem
        local_cost = sum(prior_cost(problem, problem.local_names, local.parameters) for local in locals_)
        return prior_cost(problem, problem.free, values) + local_cost + 0.5 * sum(energies)

    def step(self, unknowns: Array, point: WhitenedPoint, damping: float) -> SolverStep:
        """Gauss-Newton step within the limits, and the decrease it predicts; zero, and `runaway` set, where a sensitivity runs
        away."""
        problem, n = self.problem, self.n
        values, locals_ = self.unpacked(unknowns)
        weight, distance = prior_terms(problem, problem.free[:n], values)
        H, g, decrement, blocks = np.diag(weight), distance, 0.0, []
        for i, local in enumerate(locals_):
            known = (point.residuals[i], point.grams[i]) if point.grams else None
            linearised = known or linearised_in(problem, i, values, local, n)
            if linearised is None:
                self.runaway = True
                return SolverStep(np.zeros_like(unknowns), 0.0)
            block = record_blocks(problem, linearised[1], local, n)
            information, gradient = block.reduced()
            H, g = H + information, g + gradient
            decrement += 0.5 * float(block.gl @ block.ll_inverse @ block.gl)
            blocks.append(block)
        self.hessian = H
        low, high = self.limits - unknowns[:n]
        low[list(self.held)] = high[list(self.held)] = 0.0
        shared = step_within(H, g, low, high)
        local_steps = [block.local(shared) for block in blocks]
        return SolverStep(
            np.concatenate([shared, *local_steps]), decrement + float(shared @ g - 0.5 * shared @ H @ shared)
        )


def cost_at(problem: LikelihoodProblem, values: Mapping[str, float]) -> float:
    """Whitened cost at shared `values` (by default the model's start values), every record from its measured initial state;
    infinite where the motion runs away."""
    view = ProblemUnknowns(problem, {**problem.starts(), **values}, 0, (), np.zeros((0, 0)))
    return view.evaluate(view.packed(problem.starting_locals()), False).cost


def linearised_in(
    problem: LikelihoodProblem, index: int, values: Mapping[str, float], local: Local, n: int
) -> tuple[Array, Array] | None:
    """(residual (N, ny), gram) of one record, linearised; None where the motion runs away. gram: inner products of the white
    columns [first n shared unknowns | its local unknowns | residual]."""
    linear = problem.linearised(index, values, local)
    if linear is None:
        return None
    residual, dy = linear
    return residual, problem.whiteners[index].gram(dy[:, :, :n], dy[:, :, len(problem.free) :], residual)


def record_blocks(problem: LikelihoodProblem, gram: Array, local: Local, n: int) -> FlightBlocks:
    """Information of one record about the first n shared unknowns and its local ones, with the priors of the latter. gram: as of
    `linearised_in`."""
    information, gradient, m = gram[:-1, :-1].copy(), gram[:-1, -1].copy(), len(gram) - 1
    weight, distance = local_prior(problem, local, m - n)
    information[n:, n:] += np.diag(weight)
    gradient[n:] += distance
    return FlightBlocks.split(information, gradient, np.arange(n), np.arange(n, m))


def local_prior(problem: LikelihoodProblem, local: Local, count: int) -> tuple[Array, Array]:
    """(weights, weighted distances) of the priors of a record's `count` local unknowns; zero for initial states."""
    w, d = prior_terms(problem, problem.local_names, local.parameters)
    return np.pad(w, (0, count - w.size)), np.pad(d, (0, count - d.size))


def fit(
    problem: LikelihoodProblem,
    start: Mapping[str, float] | None = None,
    locals_: Sequence[Local] | None = None,
    iterations: int = ITERATIONS,
    frozen: bool = False,
    enough: float = ENOUGH,
    held: Collection[str] = (),
    beyond: float = np.inf,
) -> ModelFit:
    """Minimise the whitened cost from `start` (by default the model's values) and `locals_` (by default as measured).

    frozen: hold all shared unknowns and fit only the local ones. enough: iterations end where a step predicts a smaller decrease
    of the cost. held: shared unknowns that stay at `start`. beyond: the fit is abandoned where its steps predict that it will not
    come below this cost.
    """
    n = 0 if frozen else len(problem.free)
    names = problem.free[:n]
    values = {**problem.starts(), **(start or {})}
    view = ProblemUnknowns(problem, values, n, [i for i, name in enumerate(names) if name in held], np.zeros((n, n)))
    start_unknowns = view.packed(locals_ if locals_ is not None else problem.starting_locals())
    options = LoopOptions(
        iterations,
        enough,
        most_damping=0.0,
        near=0.0,
        relative=FLAT,
        gain=True,
        kept=LAST_GAIN,
        beyond=beyond,
        flat=0.0,
    )  # whitened residuals are nearly linear near the optimum: halving suffices, damping and combined steps gain nothing
    outcome = minimise(view, start_unknowns, options)
    point = outcome.point
    shared_values, local_values = view.unpacked(outcome.unknowns)
    converged = outcome.status is Status.CONVERGED and not view.runaway
    diverged = outcome.status is Status.DIVERGED or view.runaway
    return ModelFit(
        problem.model,
        names,
        shared_values,
        local_values,
        point.residuals,
        point.cost,
        view.hessian,
        converged,
        diverged,
        abandoned=outcome.status is Status.LIMIT and outcome.iterations < iterations,
    )
