"""Joint fit of one model to many records, residuals weighted by the whitener: generalised output error.

Shared parameters plus, per record, initial states (and local parameters such as instrument biases): the normal matrix
has arrow structure and is reduced record by record (Schur complement), so cost is linear in the number of flights.
Gauss-Newton with step halving. The reduced system of each record is kept: the screen and the nulls need nothing else.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.gap.bench import Record
from estimation.gap.whitening import Whitener
from estimation.models.base import Model

LARGEST = 1e9  # sensitivity beyond which the motion counts as running away
EDGE_STEP = 0.25
EDGE_SPREAD = 1.5  # prior standard deviation of an edge parameter
HALVINGS = 8
FLAT = 1e-4  # of the cost: a smaller predicted decrease ends the iterations


@dataclass(frozen=True)
class Local:
    """Values of one record's own unknowns: initial states (nx,), then local parameters."""

    x0: Array
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Fit:
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
    iterations: int
    converged: bool
    diverged: bool

    def std(self) -> dict[str, float]:
        """Cramer-Rao bounds of the shared parameters under the whitened likelihood."""
        inverse = np.linalg.pinv(self.hessian, hermitian=True)
        return {n: float(np.sqrt(max(inverse[i, i], 0.0))) for i, n in enumerate(self.free)}


@dataclass(frozen=True)
class Problem:
    """A model bound to records and their whiteners. base: the model the records were prepared for.

    Shared unknowns are the model's free parameters and one `edge_<control>` for each control: how a surface moved
    between two samples, from a straight line (-1) over a monotone cubic (0) to rounder than that.
    """

    model: Model
    base: Model
    records: tuple[Record, ...]
    whiteners: tuple[Whitener, ...]
    work: float = 0.0  # how much simulation is coming: decides whether compiling repays

    @cached_property
    def coarse(self) -> tuple[Segment, ...]:
        """The records as this model needs them, at the samples."""
        return tuple(r.segment(self.model, self.base) for r in self.records)

    @cached_property
    def grids(self) -> "tuple[Grid, ...]":
        """The same with one more instant in the middle of each interval."""
        return tuple(fine_grid(s) for s in self.coarse)

    @cached_property
    def local_names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.model.parameters if p.local and not p.fixed)

    @cached_property
    def edges(self) -> dict[str, int]:
        """Edge parameter -> column of the input it belongs to."""
        return {f"edge_{s.name}": i for i, s in enumerate(self.model.inputs) if s.control}

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Free shared parameters of the model itself."""
        return tuple(n for n in self.model.free_names if n not in self.local_names)

    @property
    def free(self) -> tuple[str, ...]:
        """All shared unknowns, in the order of the columns."""
        return (*self.parameters, *self.edges)

    @cached_property
    def simulator(self) -> Simulator:
        return Simulator.build(
            self.model, (*self.parameters, *self.local_names), substeps=1, work=self.work, hold="linear"
        )

    def starts(self) -> dict[str, float]:
        """Start values of everything shared, held parameters included."""
        return {**self.model.starts(), **dict.fromkeys(self.edges, 0.0)}

    def starting_locals(self) -> tuple[Local, ...]:
        starts = self.model.starts()
        return tuple(Local(s.x0, {n: starts[n] for n in self.local_names}) for s in self.coarse)

    def residual(
        self, index: int, values: Mapping[str, float], local: Local, inputs: Array | None = None
    ) -> Array | None:
        """(N, ny) measured minus model of one record; None where the motion leaves the finite numbers.

        inputs: (N, nu) other inputs than the record's own.
        """
        grid = self.grids[index] if inputs is None else fine_grid(replace(self.coarse[index], u=inputs))
        motion = self.simulator.run(self.driven(grid, values), {**values, **local.parameters}, local.x0)
        return self.coarse[index].z - motion.y[::2] if motion.finite else None

    def linearised(self, index: int, values: Mapping[str, float], local: Local) -> tuple[Array, Array] | None:
        """(residual (N, ny), sensitivities (N, ny, shared unknowns + local parameters + initial states)) of one record."""
        segment = self.driven(self.grids[index], values)
        motion = self.simulator.run(segment, {**values, **local.parameters}, local.x0, sensitivities=True)
        if not motion.finite or motion.dy is None or not np.abs(motion.dy).max() < LARGEST:
            return None
        residual = self.coarse[index].z - motion.y[::2]
        n = len(self.parameters)
        columns = [motion.dy[::2, :, :n]]
        for name in self.edges:
            moved = self.residual(index, {**values, name: values[name] + EDGE_STEP}, local)
            if moved is None:
                return None
            columns.append(np.nan_to_num((residual - moved) / EDGE_STEP)[:, :, None])
        dy = np.concatenate([*columns, motion.dy[::2, :, n:]], axis=2)
        dy[~np.isfinite(residual)] = 0.0
        return residual, dy

    def driven(self, grid: "Grid", values: Mapping[str, float]) -> Segment:
        """A grid's inputs with the edges of the controls rounded as `values` say."""
        u = grid.segment.u
        shifts = [(i, values[name]) for name, i in self.edges.items() if values.get(name, 0.0) != 0.0]
        if shifts:
            u = u.copy()
            for i, kappa in shifts:
                u[:, i] += kappa * grid.rounding[:, i]
        return replace(grid.segment, u=u)

    def prior(self, name: str) -> tuple[float, float] | None:
        """(mean, standard deviation) of what is believed of an unknown, or None."""
        if name in self.edges:
            return 0.0, EDGE_SPREAD
        p = self.model.parameter(name)
        return None if p.prior_mean is None or p.prior_std is None else (p.prior_mean, p.prior_std)

    def limits(self, name: str) -> tuple[float, float]:
        if name in self.edges:
            return -6.0, 6.0
        p = self.model.parameter(name)
        return p.lower, p.upper


@dataclass(frozen=True)
class Grid:
    """A segment with mid-interval samples, and how far its inputs there lie from a straight line, (2N - 1, nu)."""

    segment: Segment
    rounding: Array


def fine_grid(segment: Segment) -> Grid:
    """Time and inputs with one more sample in the middle of each interval.

    Inputs pass through the middle by a monotone cubic (PCHIP), not by a straight line: surfaces driven by servos round
    their edges, and straight lines bias the control and damping derivatives by some 2 % at 20 Hz.
    """
    time, u = segment.time, segment.u
    middle = 0.5 * (time[1:] + time[:-1])
    fine = np.empty(2 * time.size - 1)
    fine[::2], fine[1::2] = time, middle
    values, rounding = np.empty((fine.size, u.shape[1])), np.zeros((fine.size, u.shape[1]))
    values[::2] = u
    if u.shape[1]:
        values[1::2] = PchipInterpolator(time, u, axis=0)(middle)
        rounding[1::2] = values[1::2] - 0.5 * (u[1:] + u[:-1])
    z = np.full((fine.size, segment.z.shape[1]), np.nan)
    return Grid(replace(segment, time=fine, u=np.ascontiguousarray(values), z=z), rounding)


def prior_terms(problem: Problem, names: Sequence[str], values: Mapping[str, float]) -> tuple[Array, Array]:
    """(weights (n,), weighted distances (n,)) of the Gaussian priors of the named parameters."""
    weight, distance = np.zeros(len(names)), np.zeros(len(names))
    for i, name in enumerate(names):
        believed = problem.prior(name)
        if believed is not None:
            weight[i] = 1.0 / believed[1] ** 2
            distance[i] = weight[i] * (believed[0] - values[name])
    return weight, distance


def prior_cost(problem: Problem, names: Sequence[str], values: Mapping[str, float]) -> float:
    weight, distance = prior_terms(problem, names, values)
    return 0.5 * float(np.sum(distance[weight > 0] ** 2 / weight[weight > 0]))


def _cost(problem: Problem, values: Mapping[str, float], locals_: Sequence[Local]) -> tuple[float, list[Array]] | None:
    total, residuals = prior_cost(problem, problem.free, values), []
    for i, local in enumerate(locals_):
        residual = problem.residual(i, values, local)
        if residual is None:
            return None
        residuals.append(residual)
        total += 0.5 * float(np.sum(problem.whiteners[i].rows(residual) ** 2))
        total += prior_cost(problem, problem.local_names, local.parameters)
    return total, residuals


def fit(
    problem: Problem,
    start: Mapping[str, float] | None = None,
    locals_: Sequence[Local] | None = None,
    iterations: int = 25,
    frozen: bool = False,
    enough: float = 1e-3,
    held: Collection[str] = (),
) -> Fit:
    """Minimise the whitened cost from `start`. frozen: hold the shared parameters and fit only what is local.
    enough: of the cost; iterations end where a step promises less. held: shared parameters that stay where they are."""
    model = problem.model
    values = {**problem.starts(), **(start or {})}
    here = list(locals_ if locals_ is not None else problem.starting_locals())
    n = 0 if frozen else len(problem.free)
    names = problem.free[:n]
    now = _cost(problem, values, here)
    if now is None:
        return Fit(model, names, values, tuple(here), (), np.inf, np.zeros((n, n)), 0, False, True)
    cost, residuals = now
    hessian = np.zeros((n, n))
    converged = False
    for iteration in range(iterations):
        step = _step(problem, values, here, n, [i for i, name in enumerate(names) if name in held])
        if step is None:
            return Fit(model, names, values, tuple(here), tuple(residuals), cost, hessian, iteration, False, True)
        d_shared, d_local, hessian, decrease = step
        if decrease < FLAT * 0.01 * max(cost, 1.0) or decrease < enough:
            converged = True
            break
        part = 1.0
        for _ in range(HALVINGS):
            trial_values = _limited(problem, names, values, part * d_shared)
            trial_local = [_moved(problem, loc, part * d) for loc, d in zip(here, d_local, strict=True)]
            trial = _cost(problem, trial_values, trial_local)
            if trial is not None and trial[0] < cost:
                break
            part *= 0.5
        else:
            break
        gained = cost - trial[0]
        values, here, (cost, residuals) = trial_values, trial_local, trial
        if gained < max(FLAT * 0.01 * max(cost, 1.0), enough):
            converged = True
            break
    return Fit(model, names, values, tuple(here), tuple(residuals), cost, hessian, iteration + 1, converged, False)


def _limited(problem: Problem, names: Sequence[str], values: Mapping[str, float], step: Array) -> dict[str, float]:
    moved = dict(values)
    for name, d in zip(names, step, strict=True):
        lower, upper = problem.limits(name)
        moved[name] = float(np.clip(values[name] + d, lower, upper))
    return moved


def _moved(problem: Problem, local: Local, step: Array) -> Local:
    nb = len(problem.local_names)
    parameters = {n: local.parameters[n] + float(d) for n, d in zip(problem.local_names, step[:nb], strict=True)}
    return Local(local.x0 + step[nb:], parameters)


def _step(
    problem: Problem, values: Mapping[str, float], locals_: Sequence[Local], n: int, held: Sequence[int] = ()
) -> tuple[Array, list[Array], Array, float] | None:
    """Gauss-Newton step: shared, per record, reduced Hessian, predicted decrease of the cost. held: shared ones with no step."""
    shared = len(problem.free)
    weight, distance = prior_terms(problem, problem.free[:n], values)
    H, g = np.diag(weight), distance.copy()
    kept = []
    gain = 0.0
    for i, local in enumerate(locals_):
        found = problem.linearised(i, values, local)
        if found is None:
            return None
        residual, dy = found
        rows = problem.whiteners[i].rows(np.concatenate([dy, residual[:, :, None]], axis=2))
        Jt, Jl, r = rows[:, :n], rows[:, shared:-1], rows[:, -1]
        w_local, d_local = _local_prior(problem, local, Jl.shape[1])
        Hll = Jl.T @ Jl + np.diag(w_local)
        gl = Jl.T @ r + d_local
        Htl = Jt.T @ Jl
        inverse = np.linalg.pinv(Hll, hermitian=True)
        H += Jt.T @ Jt - Htl @ inverse @ Htl.T
        g += Jt.T @ r - Htl @ inverse @ gl
        kept.append((inverse, Htl, gl))
        gain += 0.5 * float(gl @ inverse @ gl)
    d_shared = _solve(H, g, held)
    gain += 0.5 * float(d_shared @ g)
    d_locals = [inverse @ (gl - Htl.T @ d_shared) for inverse, Htl, gl in kept]
    return d_shared, d_locals, H, gain


def _solve(H: Array, g: Array, held: Sequence[int] = ()) -> Array:
    """H^-1 g with unit scaling; directions the data say nothing about are left alone, as are those of `held`."""
    if g.size == 0:
        return g
    if len(held):
        free = np.setdiff1d(np.arange(g.size), held)
        step = np.zeros_like(g)
        step[free] = _solve(H[np.ix_(free, free)], g[free])
        return step
    diagonal = np.diag(H)
    scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-24 * max(float(diagonal.max()), 1e-200)))
    values, vectors = np.linalg.eigh(H * scale[:, None] * scale[None, :])
    keep = values > 1e-10 * values.max()
    return scale * (vectors[:, keep] @ ((vectors[:, keep].T @ (scale * g)) / values[keep]))


def _local_prior(problem: Problem, local: Local, count: int) -> tuple[Array, Array]:
    weight, distance = np.zeros(count), np.zeros(count)
    w, d = prior_terms(problem, problem.local_names, local.parameters)
    weight[: w.size], distance[: d.size] = w, d
    return weight, distance
