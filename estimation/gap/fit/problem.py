"""A model bound to records and their whiteners: residuals, sensitivities, priors and limits for a fit.

Between two samples inputs follow a monotone cubic, of which the simulation uses the value half-way: servos round the steps of
surfaces, and straight lines between samples bias the control and damping derivatives by some 2 % at 20 Hz.

Steps of a sequence that a computer flies all begin at the same time after a sample. What the cubic lacks half-way is then the
same share of every step. With a few steps that passes for the scatter that is allowed for; where a control never rests it adds
up, and the share is an unknown (`edge_<control>`). So is that in the interval behind it (`behind_edge_<control>`), where a servo
that answers the motion has already turned back.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.estimators.normal_equations import pseudo_inverse
from estimation.gap.criteria import Criteria
from estimation.gap.fit.whitener import Whitener
from estimation.gap.records.flight_records import FlightRecord, starting_state
from estimation.gap.records.sampling import smallest_step
from estimation.models.base import Model, ParameterRole
from estimation.models.dependence import names_used
from estimation.signals.curves import half_way, inner_slopes

WIDTHS = 4.0  # prior widths to which the path of a surface between samples may go
# unknown of the edges of a control -> intervals behind the steepest one
EDGES: Mapping[str, int] = {"edge_{}": 0, "behind_edge_{}": 1}
LONGEST_STEP = 0.03  # s, of the integration: with it a vane that lags by 12 ms is stable (2.78 of its time constants)
LARGEST = 1e9  # sensitivity beyond which the motion counts as running away: its square still fits beside 1 in a double


def integration_steps(interval: float) -> int:
    """Steps of the integration within an interval [s]."""
    return max(1, math.ceil(interval / LONGEST_STEP))


@dataclass(frozen=True)
class MidSampleGrid:
    """A segment with samples half-way added. rounding: (2N - 1, nu) distance of its inputs there from a straight line."""

    segment: Segment
    rounding: Array

    def with_inputs(self, u: Array) -> "MidSampleGrid":
        """The same with other inputs (N, nu) at the samples; only columns that differ are computed."""
        changed = np.flatnonzero((u != self.segment.u[::2]).any(axis=0))
        values, rounding = self.segment.u.copy(), self.rounding.copy()
        values[:, changed], rounding[:, changed] = _with_middles(self.segment.time[::2], u[:, changed])
        return MidSampleGrid(replace(self.segment, u=values), rounding)

    def edges(self, column: int, behind: int, criteria: Criteria) -> Array:
        """(2N - 1,) half-way in the steepest interval of every edge of an input, or so many intervals `behind` it, the change
        over the steepest one, else zero."""
        change = np.diff(self.segment.u[::2, column])
        size = np.pad(np.abs(change), 1)
        steepest = (size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:])
        edge = steepest & (size[1:-1] > smallest_step(change, criteria))
        result, changes = np.zeros(len(self.rounding)), np.where(edge, change, 0.0)
        result[1 + 2 * behind :: 2] = changes[: changes.size - behind]
        return result


def fine_grid(segment: Segment) -> MidSampleGrid:
    """Time and inputs with one more sample in the middle of each interval."""
    values, rounding = _with_middles(segment.time, segment.u)
    z = np.full((len(values), segment.z.shape[1]), np.nan)
    return MidSampleGrid(replace(segment, time=_on_lines(segment.time), u=values, z=z), rounding)


def _on_lines(values: Array) -> Array:
    """(2N - 1, ...) values (N, ...) with one more on a straight line between each two."""
    fine = np.empty((2 * len(values) - 1, *values.shape[1:]))
    fine[::2], fine[1::2] = values, 0.5 * (values[1:] + values[:-1])
    return fine


def _with_middles(time: Array, u: Array) -> tuple[Array, Array]:
    """(2N - 1, columns) inputs u (N, columns) with their values half-way between samples, and the distance of these from straight
    lines."""
    values, rounding, mid_values = _on_lines(u), np.zeros((2 * len(u) - 1, u.shape[1])), middles(time, u)
    rounding[1::2], values[1::2] = mid_values - values[1::2], mid_values
    return values, rounding


def middles(time: Array, u: Array) -> Array:
    """(N - 1, columns) values half-way between samples (N, columns), on the monotone cubic of Fritsch and Butland (1984) with the
    three-point end slopes of Moler (Numerical Computing with MATLAB, 2004, section 3.6)."""
    step = np.diff(time)[:, None]
    if len(u) < 3:
        return np.asarray(0.5 * (u[1:] + u[:-1]))
    chord = np.diff(u, axis=0) / step
    slope = np.empty_like(u)
    slope[1:-1] = inner_slopes(chord, step)
    slope[0] = _end_slope(step[0], step[1], chord[0], chord[1])
    slope[-1] = _end_slope(step[-1], step[-2], chord[-1], chord[-2])
    return half_way(u, slope, step)


def _end_slope(h0: Array, h1: Array, m0: Array, m1: Array) -> Array:
    """Slope at an end from the two chord slopes m next to it over steps h: of the sign of the first, at most three times it."""
    slope = ((2.0 * h0 + h1) * m0 - h0 * m1) / (h0 + h1)
    limited = np.where(np.sign(slope) == np.sign(m0), slope, 0.0)
    steepest = 3.0 * m0  # of a cubic that is monotone there (Fritsch and Carlson 1980)
    return np.where((np.sign(m0) != np.sign(m1)) & (np.abs(slope) > np.abs(steepest)), steepest, limited)


@dataclass(frozen=True)
class Local:
    """Values of the local unknowns of one record: initial states (nx,) and local parameters by name."""

    x0: Array
    parameters: Mapping[str, float]


def carried_local(local: Local, old: Model, new: Model) -> Local:
    """A record's local unknowns for a model with more or fewer states than `old`."""
    return Local(starting_state(new, dict(zip(old.state_names, local.x0, strict=True))), local.parameters)


@dataclass(frozen=True)
class ModelFit:
    """A fitted model.

    values: shared parameters, held ones included. locals: per record. residuals: per record (N, ny), measured minus
    model, NaN where not measured. cost: half the whitened sum of squares with priors. hessian: (n, n) of the shared
    free parameters, everything local eliminated. converged, diverged: how the fit ended; abandoned: its steps predicted that it
    would not reach the cost that it had to.
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
    abandoned: bool = False

    def std(self) -> dict[str, float]:
        """Cramer-Rao bounds of the shared parameters under the whitened likelihood."""
        inverse = pseudo_inverse(self.hessian)[0]
        return {n: float(np.sqrt(max(inverse[i, i], 0.0))) for i, n in enumerate(self.free)}


@dataclass(frozen=True)
class LikelihoodProblem:
    """A model bound to records and their whiteners. base: the model the records were prepared for.

    Shared unknowns are the model's free parameters and one `curvature_<control>` for each control: how its surface moves between
    two samples, on a straight line (-1), a monotone cubic (0) or a rounder curve (above 0). A control that never rests also has
    `edge_<control>` and `behind_edge_<control>`: by which share of a step its surface is off half-way in it, and in the interval
    behind it.
    """

    model: Model
    base: Model
    records: tuple[FlightRecord, ...]
    whiteners: tuple[Whitener, ...]
    criteria: Criteria

    @cached_property
    def coarse(self) -> tuple[Segment, ...]:
        """The records with this model's inputs and states, at the samples."""
        return tuple(r.segment(self.model, self.base) for r in self.records)

    @cached_property
    def grids(self) -> tuple[MidSampleGrid, ...]:
        """The same with one more instant half-way in each interval."""
        return tuple(fine_grid(s) for s in self.coarse)

    @cached_property
    def local_names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.model.parameters if p.local and not p.fixed)

    @cached_property
    def paths(self) -> dict[str, tuple[int, int | None]]:
        """Unknown of a path between samples -> column of the input it belongs to, and of an edge the intervals behind the
        steepest one; None of a curvature."""
        controls = {s.name: i for i, s in enumerate(self.model.inputs) if s.control}
        restless = frozenset[str]().union(*(r.restless for r in self.records))
        curvatures = {f"curvature_{n}": (i, None) for n, i in controls.items()}
        edges = {
            kind.format(n): (i, behind) for kind, behind in EDGES.items() for n, i in controls.items() if n in restless
        }
        return {**curvatures, **edges}

    def _path(self, grid: MidSampleGrid, name: str) -> Array:
        """(2N - 1,) change of an input by one unit of the unknown `name` of its path."""
        column, behind = self.paths[name]
        return grid.rounding[:, column] if behind is None else grid.edges(column, behind, self.criteria)

    @cached_property
    def used_names(self) -> frozenset[str]:
        """Names that the equations use while the dormant terms are zero."""
        dormant = (p for p in self.model.parameters if p.role is ParameterRole.DORMANT and p.fixed)
        return names_used(self.model, {p.name for p in dormant if p.start == 0.0})

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Free shared parameters of the model itself."""
        return tuple(n for n in self.model.free_names if n not in self.local_names)

    @property
    def free(self) -> tuple[str, ...]:
        """All shared unknowns, in the order of the columns."""
        return (*self.parameters, *self.paths)

    @cached_property
    def simulator(self) -> Simulator:
        names = (*self.parameters, *self.local_names)
        return Simulator.build(self.model, names, substeps=self.substeps, hold="linear")

    @cached_property
    def parameterless_simulator(self) -> Simulator:
        """The simulator without derivatives by any parameter."""
        return Simulator.build(self.model, (), substeps=self.substeps, hold="linear")

    @cached_property
    def substeps(self) -> int:
        """Integration steps between two instants of `grids`."""
        return integration_steps(0.5 * max(r.interval for r in self.records))

    def starts(self) -> dict[str, float]:
        """Start values of everything shared, held parameters included."""
        return {**self.model.starts(), **dict.fromkeys(self.paths, 0.0)}

    def starting_locals(self) -> tuple[Local, ...]:
        starts = self.model.starts()
        return tuple(Local(s.x0, {n: starts[n] for n in self.local_names}) for s in self.coarse)

    def residual(self, index: int, values: Mapping[str, float], local: Local) -> Array | None:
        """(N, ny) measured minus model of one record; None where the motion does not stay finite."""
        modelled = self.modelled(index, values, local)
        return None if modelled is None else self.coarse[index].z - modelled

    def modelled(
        self, index: int, values: Mapping[str, float], local: Local, inputs: Array | None = None
    ) -> Array | None:
        """(N, ny) outputs of the model on one record; None where the motion does not stay finite.

        inputs: (N, nu) inputs in place of the measured ones.
        """
        grid = self.grids[index] if inputs is None else self.grids[index].with_inputs(inputs)
        shared = {**values, **local.parameters}
        motion = self.simulator.run_by_middles(self.driven(grid, values), shared, local.x0)
        return motion.y if motion.finite else None

    def fitted_outputs(self, index: int, model_fit: ModelFit) -> Array:
        """(N, ny) outputs of a fitted model on one record, also where none was measured; all zero where its motion runs away."""
        modelled = self.modelled(index, model_fit.values, model_fit.locals[index])
        return np.zeros_like(self.coarse[index].z) if modelled is None else modelled

    def linearised(self, index: int, values: Mapping[str, float], local: Local) -> tuple[Array, Array] | None:
        """(residual (N, ny), sensitivities (N, ny, shared unknowns + local parameters + initial states)) of one record.

        None where the motion or a sensitivity runs away."""
        grid, shared = self.grids[index], {**values, **local.parameters}
        names, columns = list(self.paths), [column for column, _ in self.paths.values()]
        active = [j for j, column in enumerate(columns) if self.model.input_names[column] in self.used_names]
        paths = np.zeros((*grid.rounding.shape, len(active)))
        for k, j in enumerate(active):
            paths[:, columns[j], k] = self._path(grid, names[j])
        segment = self.driven(grid, values)
        motion = self.simulator.run_by_middles(segment, shared, local.x0, sensitivities=True, moved=paths)
        if not motion.finite or motion.dy is None or not max(motion.dy.max(), -motion.dy.min()) < LARGEST:
            return None
        residual = self.coarse[index].z - motion.y
        n, m, split = len(self.parameters), len(self.paths), motion.dy.shape[2] - len(active)
        dy = np.zeros((*residual.shape, split + m))
        dy[:, :, :n], dy[:, :, n + m :] = motion.dy[:, :, :n], motion.dy[:, :, n:split]
        dy[:, :, [n + j for j in active]] = motion.dy[:, :, split:]
        dy[~np.isfinite(residual)] = 0.0
        return residual, dy

    def by_dormant(self, index: int, fit: ModelFit, names: Sequence[str]) -> Array:
        """(N, ny, names) derivatives of the outputs of one record by dormant parameters about a fit; zero where not measured.

        Not finite where a derivative, or the motion itself, runs away."""
        simulator = Simulator.build(self.model, tuple(names), substeps=self.substeps, hold="linear")
        local, segment = fit.locals[index], self.driven(self.grids[index], fit.values)
        shared = {**self.model.starts(), **fit.values, **local.parameters}
        motion = simulator.run_by_middles(segment, shared, local.x0, sensitivities=True)
        if motion.dy is None or not motion.finite:
            return np.full((*self.coarse[index].z.shape, len(names)), np.inf)
        by_names = motion.dy[:, :, : len(names)].copy()
        by_names[~np.isfinite(self.coarse[index].z)] = 0.0
        return by_names

    def disturbed(self, index: int, values: Mapping[str, float], local: Local, du: Array) -> Array | None:
        """(N, ny, k) changes of the outputs of one record by k small changes (N, nu, k) of its inputs, linear between samples.

        None where the motion does not stay finite."""
        driven, shared = self.driven(self.grids[index], values), {**values, **local.parameters}
        motion = self.parameterless_simulator.run_by_middles(
            driven, shared, local.x0, sensitivities=True, moved=_on_lines(du)
        )
        return motion.dy[:, :, -du.shape[2] :] if motion.finite and motion.dy is not None else None

    def driven(self, grid: MidSampleGrid, values: Mapping[str, float]) -> Segment:
        """A grid's segment with the controls between samples moved by the path unknowns in `values`."""
        moved = [name for name in self.paths if values.get(name, 0.0) != 0.0]
        u = grid.segment.u.copy() if moved else grid.segment.u
        for name in moved:
            u[:, self.paths[name][0]] += values[name] * self._path(grid, name)
        return replace(grid.segment, u=u)

    def prior(self, name: str) -> tuple[float, float] | None:
        """(mean, standard deviation) of an unknown's Gaussian prior, or None where it has none."""
        if name in self.paths:
            is_curvature = self.paths[name][1] is None
            return 0.0, self.criteria.curvature_spread if is_curvature else self.criteria.surface_freedom
        p = self.model.parameter(name)
        return None if p.prior_mean is None or p.prior_std is None else (p.prior_mean, p.prior_std)

    def nuisance(self, name: str) -> bool:
        """Whether a shared unknown is a nuisance parameter (timing, curvature ...), for which no effect may be named."""
        return name in self.paths or self.model.parameter(name).role is ParameterRole.NUISANCE

    def limits(self, name: str) -> tuple[float, float]:
        if name in self.paths and (prior := self.prior(name)):
            return -WIDTHS * prior[1], WIDTHS * prior[1]
        p = self.model.parameter(name)
        return p.lower, p.upper


def changes_by(trial: LikelihoodProblem, base_fit: ModelFit, values: Mapping[str, float]) -> tuple[Array, ...] | None:
    """Per record (N, ny): outputs of a trial model with shared `values` minus those of a fitted base, with the unknowns that the
    base has of each record; zero where nothing was measured. None where the motion runs away."""
    changes = []
    for i, (local, before) in enumerate(zip(base_fit.locals, base_fit.residuals, strict=True)):
        residual = trial.residual(i, values, carried_local(local, base_fit.model, trial.model))
        if residual is None:
            return None
        changes.append(np.nan_to_num(before - residual))
    return tuple(changes)


def prior_terms(problem: LikelihoodProblem, names: Sequence[str], values: Mapping[str, float]) -> tuple[Array, Array]:
    """(weights (n,), weighted distances from the mean (n,)) of the priors of the named parameters; zero where one has none."""
    weight, distance = np.zeros(len(names)), np.zeros(len(names))
    for i, name in enumerate(names):
        prior = problem.prior(name)
        if prior is not None:
            weight[i] = 1.0 / prior[1] ** 2
            distance[i] = weight[i] * (prior[0] - values[name])
    return weight, distance


def prior_cost(problem: LikelihoodProblem, names: Sequence[str], values: Mapping[str, float]) -> float:
    weight, distance = prior_terms(problem, names, values)
    return 0.5 * float(np.sum(distance[weight > 0] ** 2 / weight[weight > 0]))


def freed_by(problem: LikelihoodProblem, base_fit: ModelFit, model_fit: ModelFit) -> float:
    """The part of a fit's gain over `base_fit` (twice a log-likelihood) that comes from the priors of nuisance parameters: with
    an effect in the model, surfaces need not be shifted in time as far."""
    names = [n for n in problem.free if problem.nuisance(n)]
    return 2.0 * (prior_cost(problem, names, base_fit.values) - prior_cost(problem, names, model_fit.values))
