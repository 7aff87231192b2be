"""Joint fit of one model to many records, residuals weighted by the whitener: generalised output error.

Shared parameters plus, per record, initial states (and local parameters such as instrument biases): the normal matrix
has arrow structure and is reduced record by record (Schur complement), so cost is linear in the number of flights.
The optimiser and the elimination are those of the estimators (`estimation.estimators`); here is what they are given.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.estimators.gauss_newton import LoopOptions, SolverStep, Status, minimise
from estimation.estimators.normal_equations import FlightBlocks, pseudo_inverse, step_within
from estimation.gap.criteria import Criteria
from estimation.gap.likelihood.between_samples import MidSampleGrid, fine_grid
from estimation.gap.likelihood.whitening import Whitener
from estimation.gap.records.flight_records import FlightRecord, started
from estimation.models.base import Model, ParameterRole
from estimation.models.dependence import asked_for

LARGEST = 1e9  # sensitivity beyond which the motion counts as running away: its square still fits beside 1 in a double
ITERATIONS = 25  # a fit that takes more has not come to rest and is gone on with by the caller
ENOUGH = 1e-3  # of the log-likelihood: steps below a twentieth of a standard deviation
KEPT = 1.0  # of the log-likelihood: a step so short that was as good as its promise is the last
FLAT = 1e-6  # of the cost: a smaller decrease is rounding of sums over 10^4 residuals and of the integration


@dataclass(frozen=True)
class Local:
    """Values of one record's own unknowns: initial states (nx,), then local parameters."""

    x0: Array
    parameters: Mapping[str, float]


def carried(local: Local, old: Model, new: Model) -> Local:
    """A record's own unknowns carried over to a model with more or fewer states."""
    return Local(started(new, dict(zip(old.state_names, local.x0, strict=True))), local.parameters)


@dataclass(frozen=True)
class ModelFit:
    """A fitted model.

    values: shared parameters, held ones included. locals: per record. residuals: per record (N, ny), measured minus
    model, NaN where not measured. cost: half the whitened sum of squares with priors. hessian: (n, n) of the shared
    free parameters, everything local eliminated. converged, diverged: how it ended.
    """

    model: Model
    free: tuple[str, ...]
    values: Mapping[str, float]
    locals: tuple[Local, ...]
    residuals: tuple[Array, ...]
    cost: float
    hessian: Array
    converged: bool
    diverged: bool

    def std(self) -> dict[str, float]:
        """Cramer-Rao bounds of the shared parameters under the whitened likelihood."""
        inverse = pseudo_inverse(self.hessian)[0]
        return {n: float(np.sqrt(max(inverse[i, i], 0.0))) for i, n in enumerate(self.free)}


@dataclass(frozen=True)
class LikelihoodProblem:
    """A model bound to records and their whiteners. base: the model the records were prepared for.

    Shared unknowns are the model's free parameters and one `curvature_<control>` for each control: how a surface moved
    between two samples, from a straight line (-1) over a monotone cubic (0) to rounder than that.
    """

    model: Model
    base: Model
    records: tuple[FlightRecord, ...]
    whiteners: tuple[Whitener, ...]
    criteria: Criteria

    @cached_property
    def coarse(self) -> tuple[Segment, ...]:
        """The records as this model needs them, at the samples."""
        return tuple(r.segment(self.model, self.base) for r in self.records)

    @cached_property
    def grids(self) -> tuple[MidSampleGrid, ...]:
        """The same with one more instant in the middle of each interval."""
        return tuple(fine_grid(s) for s in self.coarse)

    @cached_property
    def local_names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.model.parameters if p.local and not p.fixed)

    @cached_property
    def curvatures(self) -> dict[str, int]:
        """Curvature unknown -> column of the input it belongs to."""
        return {f"curvature_{s.name}": i for i, s in enumerate(self.model.inputs) if s.control}

    @cached_property
    def asked(self) -> frozenset[str]:
        """Names that the equations ask for with the dormant terms at rest."""
        dormant = (p for p in self.model.parameters if p.role is ParameterRole.DORMANT and p.fixed)
        return asked_for(self.model, {p.name for p in dormant if p.start == 0.0})

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Free shared parameters of the model itself."""
        return tuple(n for n in self.model.free_names if n not in self.local_names)

    @property
    def free(self) -> tuple[str, ...]:
        """All shared unknowns, in the order of the columns."""
        return (*self.parameters, *self.curvatures)

    @cached_property
    def simulator(self) -> Simulator:
        return Simulator.build(self.model, (*self.parameters, *self.local_names), substeps=1, hold="linear")

    @cached_property
    def alone(self) -> Simulator:
        """The same without derivatives by any parameter."""
        return Simulator.build(self.model, (), substeps=1, hold="linear")

    def starts(self) -> dict[str, float]:
        """Start values of everything shared, held parameters included."""
        return {**self.model.starts(), **dict.fromkeys(self.curvatures, 0.0)}

    def starting_locals(self) -> tuple[Local, ...]:
        starts = self.model.starts()
        return tuple(Local(s.x0, {n: starts[n] for n in self.local_names}) for s in self.coarse)

    def residual(self, index: int, values: Mapping[str, float], local: Local) -> Array | None:
        """(N, ny) measured minus model of one record; None where the motion leaves the finite numbers."""
        modelled = self.modelled(index, values, local)
        return None if modelled is None else self.coarse[index].z - modelled

    def modelled(
        self, index: int, values: Mapping[str, float], local: Local, inputs: Array | None = None
    ) -> Array | None:
        """(N, ny) outputs of the model on one record; None where the motion leaves the finite numbers.

        inputs: (N, nu) other inputs than the record's own.
        """
        grid = self.grids[index] if inputs is None else self.grids[index].with_inputs(inputs)
        shared = {**values, **local.parameters}
        motion = self.simulator.run_by_middles(self.driven(grid, values), shared, local.x0)
        return motion.y if motion.finite else None

    def linearised(self, index: int, values: Mapping[str, float], local: Local) -> tuple[Array, Array] | None:
        """(residual (N, ny), sensitivities (N, ny, shared unknowns + local parameters + initial states)) of one record."""
        grid, shared = self.grids[index], {**values, **local.parameters}
        asked = [j for j, i in enumerate(self.curvatures.values()) if self.model.input_names[i] in self.asked]
        paths = np.zeros((*grid.rounding.shape, len(asked)))
        for k, j in enumerate(asked):
            column = list(self.curvatures.values())[j]
            paths[:, column, k] = grid.rounding[:, column]
        segment = self.driven(grid, values)
        motion = self.simulator.run_by_middles(segment, shared, local.x0, sensitivities=True, moved=paths)
        if not motion.finite or motion.dy is None or not max(motion.dy.max(), -motion.dy.min()) < LARGEST:
            return None
        residual = self.coarse[index].z - motion.y
        n, m, own = len(self.parameters), len(self.curvatures), motion.dy.shape[2] - len(asked)
        dy = np.zeros((*residual.shape, own + m))
        dy[:, :, :n], dy[:, :, n + m :] = motion.dy[:, :, :n], motion.dy[:, :, n:own]
        dy[:, :, [n + j for j in asked]] = motion.dy[:, :, own:]
        dy[~np.isfinite(residual)] = 0.0
        return residual, dy

    def disturbed(self, index: int, values: Mapping[str, float], local: Local, du: Array) -> Array | None:
        """(N, ny, k) change of the outputs of one record by small changes (N, nu, k) of its inputs, straight between samples.

        None where the motion leaves the finite numbers."""
        fine = np.empty((2 * len(du) - 1, *du.shape[1:]))
        fine[::2], fine[1::2] = du, 0.5 * (du[1:] + du[:-1])
        motion = self.alone.run_by_middles(
            self.driven(self.grids[index], values),
            {**values, **local.parameters},
            local.x0,
            sensitivities=True,
            moved=fine,
        )
        return motion.dy[:, :, -du.shape[2] :] if motion.finite and motion.dy is not None else None

    def driven(self, grid: MidSampleGrid, values: Mapping[str, float]) -> Segment:
        """A grid's inputs with the paths of the controls between samples as `values` say."""
        u = grid.segment.u
        shifts = [(i, values[name]) for name, i in self.curvatures.items() if values.get(name, 0.0) != 0.0]
        if shifts:
            u = u.copy()
            for i, kappa in shifts:
                u[:, i] += kappa * grid.rounding[:, i]
        return replace(grid.segment, u=u)

    def prior(self, name: str) -> tuple[float, float] | None:
        """(mean, standard deviation) of what is believed of an unknown, or None."""
        if name in self.curvatures:
            return 0.0, self.criteria.curvature_spread
        p = self.model.parameter(name)
        return None if p.prior_mean is None or p.prior_std is None else (p.prior_mean, p.prior_std)

    def nuisance(self, name: str) -> bool:
        """Whether a shared unknown is only carried along: no effect may be named for it."""
        return name in self.curvatures or self.model.parameter(name).role is ParameterRole.NUISANCE

    def limits(self, name: str) -> tuple[float, float]:
        if name in self.curvatures:
            return -self.criteria.curvature_limit, self.criteria.curvature_limit
        p = self.model.parameter(name)
        return p.lower, p.upper


def prior_terms(problem: LikelihoodProblem, names: Sequence[str], values: Mapping[str, float]) -> tuple[Array, Array]:
    """(weights (n,), weighted distances (n,)) of the Gaussian priors of the named parameters."""
    weight, distance = np.zeros(len(names)), np.zeros(len(names))
    for i, name in enumerate(names):
        believed = problem.prior(name)
        if believed is not None:
            weight[i] = 1.0 / believed[1] ** 2
            distance[i] = weight[i] * (believed[0] - values[name])
    return weight, distance


def prior_cost(problem: LikelihoodProblem, names: Sequence[str], values: Mapping[str, float]) -> float:
    weight, distance = prior_terms(problem, names, values)
    return 0.5 * float(np.sum(distance[weight > 0] ** 2 / weight[weight > 0]))


@dataclass(frozen=True)
class WhitenedPoint:
    """Values at which the whitened cost was computed; residuals: per record, none where the motion leaves the finite numbers;
    products: per record, where the derivatives were worked out with it."""

    cost: float
    residuals: tuple[Array, ...] = ()
    products: tuple["LinearisedRecord", ...] = ()


@dataclass(frozen=True)
class LinearisedRecord:
    """One record linearised. residual: (N, ny); gram: inner products of the white columns of shared unknowns, of its own and of
    the residual."""

    residual: Array
    gram: Array


@dataclass
class ProblemUnknowns:
    """The problem as the optimiser sees it: one vector of the first n shared unknowns, then every record's own.

    values: everything shared, where it starts. held: indices of shared unknowns that stay. hessian: of the last step. begun:
    whether a point has been evaluated.
    """

    problem: LikelihoodProblem
    values: Mapping[str, float]
    n: int
    held: Sequence[int]
    hessian: Array
    runaway: bool = False
    begun: bool = False

    @cached_property
    def limits(self) -> Array:
        """(2, n) lower and upper of the shared unknowns."""
        return np.array([self.problem.limits(n) for n in self.problem.free[: self.n]]).reshape(-1, 2).T

    def packed(self, locals_: Sequence[Local]) -> Array:
        own = [[*(local.parameters[n] for n in self.problem.local_names), *local.x0] for local in locals_]
        return np.concatenate([[self.values[n] for n in self.problem.free[: self.n]], *own])

    def unpacked(self, unknowns: Array) -> tuple[dict[str, float], tuple[Local, ...]]:
        """Shared values by name, and every record's own."""
        names, count = self.problem.local_names, len(self.problem.local_names)
        shared = zip(self.problem.free[: self.n], unknowns[: self.n].tolist(), strict=True)
        own = unknowns[self.n :].reshape(len(self.problem.records), -1)
        locals_ = tuple(Local(row[count:].copy(), dict(zip(names, row[:count].tolist(), strict=True))) for row in own)
        return {**self.values, **dict(shared)}, locals_

    def clip(self, unknowns: Array) -> Array:
        return np.concatenate([np.clip(unknowns[: self.n], *self.limits), unknowns[self.n :]])

    def evaluate(self, unknowns: Array, derivatives: bool) -> WhitenedPoint:
        """Cost and residuals. Derivatives cost more and wait until a step is wanted, but for the first point, from which one is:
        the same run of the motion gives both."""
        first, self.begun = not self.begun, True
        values, locals_ = self.unpacked(unknowns)
        if first and derivatives:
            made = [linearised_in(self.problem, i, values, local, self.n) for i, local in enumerate(locals_)]
            known = tuple(m for m in made if m is not None)
            if len(known) == len(made):
                energies = [float(m.gram[-1, -1]) for m in known]
                return WhitenedPoint(self.cost(values, locals_, energies), tuple(m.residual for m in known), known)
        problem, residuals = self.problem, []
        for i, local in enumerate(locals_):
            residual = problem.residual(i, values, local)
            if residual is None:
                return WhitenedPoint(np.inf)
            residuals.append(residual)
        energies = [w.energy(r) for w, r in zip(problem.whiteners, residuals, strict=True)]
        return WhitenedPoint(self.cost(values, locals_, energies), tuple(residuals))

    def cost(self, values: Mapping[str, float], locals_: Sequence[Local], energies: Sequence[float]) -> float:
        """Half the whitened sums of squares of the records, with the priors."""
        problem = self.problem
        own = sum(prior_cost(problem, problem.local_names, local.parameters) for local in locals_)
        return prior_cost(problem, problem.free, values) + own + 0.5 * sum(energies)

    def step(self, unknowns: Array, point: WhitenedPoint, damping: float) -> SolverStep:
        """Gauss-Newton step; none, and `runaway` set, where a sensitivity leaves the finite numbers."""
        problem, n = self.problem, self.n
        values, locals_ = self.unpacked(unknowns)
        weight, distance = prior_terms(problem, problem.free[:n], values)
        H, g, decrement, blocks = np.diag(weight), distance, 0.0, []
        for i, local in enumerate(locals_):
            products = point.products[i] if point.products else linearised_in(problem, i, values, local, n)
            if products is None:
                self.runaway = True
                return SolverStep(np.zeros_like(unknowns), 0.0)
            block = record_blocks(problem, products, local, n)
            information, gradient = block.reduced()
            H, g = H + information, g + gradient
            decrement += 0.5 * float(block.gl @ block.ll_inverse @ block.gl)
            blocks.append(block)
        self.hessian = H
        low, high = self.limits - unknowns[:n]
        low[list(self.held)] = high[list(self.held)] = 0.0
        shared = step_within(H, g, low, high)
        own = [block.local(shared) for block in blocks]
        return SolverStep(np.concatenate([shared, *own]), decrement + float(shared @ g - 0.5 * shared @ H @ shared))


def cost_at(problem: LikelihoodProblem, values: Mapping[str, float]) -> float:
    """Whitened cost at shared `values` (the model's own where not given), every record from its measured initial state; infinite
    where the motion runs away."""
    view = ProblemUnknowns(problem, {**problem.starts(), **values}, 0, (), np.zeros((0, 0)))
    return view.evaluate(view.packed(problem.starting_locals()), False).cost


def linearised_in(
    problem: LikelihoodProblem, index: int, values: Mapping[str, float], local: Local, n: int
) -> LinearisedRecord | None:
    """One record linearised in the first n shared unknowns and its own; None where the motion runs away."""
    found = problem.linearised(index, values, local)
    if found is None:
        return None
    residual, dy = found
    columns = np.concatenate([dy[:, :, :n], dy[:, :, len(problem.free) :], residual[:, :, None]], axis=2)
    return LinearisedRecord(residual, problem.whiteners[index].gram(columns))


def record_blocks(problem: LikelihoodProblem, products: LinearisedRecord, local: Local, n: int) -> FlightBlocks:
    """Information of one record about the first n shared unknowns and its own."""
    gram = products.gram
    information, gradient, m = gram[:-1, :-1].copy(), gram[:-1, -1].copy(), len(gram) - 1
    weight, distance = local_prior(problem, local, m - n)
    information[n:, n:] += np.diag(weight)
    gradient[n:] += distance
    return FlightBlocks.split(information, gradient, np.arange(n), np.arange(n, m))


def local_prior(problem: LikelihoodProblem, local: Local, count: int) -> tuple[Array, Array]:
    """(weights, weighted distances) of the priors of a record's own `count` unknowns; initial states have none."""
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
    """Minimise the whitened cost from `start`. frozen: hold the shared parameters and fit only what is local.
    enough: of the cost; iterations end where a step promises less. held: shared parameters that stay where they are.
    beyond: a fit whose steps promise nothing near this cost is left where it is."""
    n = 0 if frozen else len(problem.free)
    names = problem.free[:n]
    values = {**problem.starts(), **(start or {})}
    view = ProblemUnknowns(problem, values, n, [i for i, name in enumerate(names) if name in held], np.zeros((n, n)))
    begin = view.packed(locals_ if locals_ is not None else problem.starting_locals())
    options = LoopOptions(
        iterations,
        enough,
        most_damping=0.0,
        near=0.0,
        relative=FLAT,
        gain=True,
        kept=KEPT,
        beyond=beyond,
        flat=0.0,
    )  # whitened residuals are nearly linear near the optimum: halving does, damping and combined steps repay nothing
    outcome = minimise(view, begin, options)
    point = outcome.point
    done, own = view.unpacked(outcome.unknowns)
    converged = outcome.status is Status.CONVERGED and not view.runaway
    diverged = outcome.status is Status.DIVERGED or view.runaway
    return ModelFit(problem.model, names, done, own, point.residuals, point.cost, view.hessian, converged, diverged)
