"""Maximum likelihood by output error: the main method.

`output_error(model, flights)` fits one flight, or several together, with the engine's exact sensitivities; each segment has its
own initial states, each flight its own values of `local` parameters. The result has both bounds and says which parameters the
data does not determine.
"""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.engine.simulate import Compile, Hold, Simulator
from estimation.errors import DataError, ModelError
from estimation.estimators.equation_error import start_values
from estimation.estimators.gauss_newton import AS_USUAL_LOOP, LoopOptions, P, SolverOutcome, Status, minimise
from estimation.estimators.input_path import in_own_terms, path_values, with_paths
from estimation.estimators.likelihood import LikelihoodPoint, Noise, OutputErrorProblem
from estimation.estimators.result import Estimate, FlightFit, Result, judge_status
from estimation.estimators.uncertainty import ParameterEffect, bounds_at_optimum, effects_of, judge_estimates
from estimation.models import load_model
from estimation.models.base import Model
from estimation.prepare.flight_data import (
    AS_USUAL,
    PIECES,
    FlightData,
    Preparation,
    cut_into_pieces,
    without_absent_outputs,
)
from estimation.prepare.pipeline import FlightsToFit, prepare_all
from estimation.signals.goodness_of_fit import channel_fits


@dataclass(frozen=True)
class OutputErrorOptions:
    """Options of a fit by output or filter error.

    noise: diagonal or full covariance R of the residuals. sigma: given standard deviation of every output [its unit], in place
    of R. free_states: names of the states whose initial values are estimated in each segment (default: those that the model
    does not hold); the others start as measured, or at their signal's `start`. improve_start: also try the equation-error
    solution as start. `compile_`: auto uses gcc where there is one. substeps: Runge-Kutta steps per sample. hold: inputs
    between samples, by default `engine.simulate.usual_hold`. preparation: of the inputs. loop: limits of the search. paths:
    estimate the paths of surfaces between samples where these are uncertain (`input_path`). Names that the model lacks raise
    ModelError when the fit begins.
    """

    noise: Noise = "diagonal"
    sigma: Mapping[str, float] | None = None
    free_states: tuple[str, ...] | None = None
    improve_start: bool = True
    compile_: Compile = "auto"
    substeps: int = 2
    hold: Hold | None = None
    preparation: Preparation = AS_USUAL
    loop: LoopOptions = AS_USUAL_LOOP
    paths: bool = True


STANDARD = OutputErrorOptions()
Fit = SolverOutcome[LikelihoodPoint]
NUMBERS_PER_UNKNOWN = 2  # that are compared: with fewer, the unknowns cannot be determined
HOPELESS = 0.2  # median r2 below which a fit is repeated on short pieces
GROWTH = 1e4  # of a disturbance over a segment: beyond it the end of the segment says nothing about its beginning
NEARBY = 1.0  # predicted reduction of the log likelihood below which all integration steps are used
MOVED = 1.5e-4  # log likelihood: an integration error that moves an estimate by about a hundredth of its bound
COARSE = 0.05  # of the noise: an integration error that matters
FINEST = 16  # substeps


def output_error(
    model: Model | str,
    flights: FlightsToFit,
    start: Mapping[str, float] | None = None,
    options: OutputErrorOptions = STANDARD,
) -> Result:
    """Fit `model` to one flight or to several together.

    start: start values by parameter name (default: the model's). Raises DataError or MissingColumnError for a flight
    that the model cannot use; a fit that fails is a Result whose status says so.
    """
    loaded = load_model(model).with_starts(start or {})
    loaded, data = without_absent_outputs(loaded, prepare_all(loaded, flights, options.preparation))
    full = with_paths(loaded, data) if options.paths else loaded
    problem = build_problem(full, data, options)
    numbers = int(sum(np.isfinite(s.z).sum() for f in data for s in f.segments))
    require_enough_data(problem, numbers, "measured values")
    outcome = find_optimum(problem, _starts(problem, options), options)
    if _hopeless(problem, outcome) or _unstable(problem, outcome):
        problem, outcome = _fit_by_pieces(full, data, options, problem, outcome)
    problem, outcome = _with_fine_steps(problem, outcome, options)
    return in_own_terms(fit_result(problem, outcome, "ml"), loaded)


def find_optimum(problem: OutputErrorProblem, start: Array, options: OutputErrorOptions) -> Fit:
    """The optimum from `start`: first with half the integration steps, near it with all of them."""
    steps = problem.simulator.substeps
    if steps < 2 or problem.size == 0:
        return minimise(problem, start, options.loop)
    rough = copy(problem)
    rough.simulator = replace(problem.simulator, substeps=steps // 2)
    near = minimise(rough, start, replace(options.loop, tolerance=max(options.loop.tolerance, NEARBY)))
    if near.status is not Status.CONVERGED:
        return minimise(problem, start, options.loop)
    end = minimise(problem, near.unknowns, options.loop)
    return replace(end, iterations=near.iterations + end.iterations, evaluations=near.evaluations + end.evaluations)


def require_enough_data(problem: OutputErrorProblem, numbers: int, kind: str) -> None:
    """DataError where there are too few numbers of a kind for the unknowns."""
    if numbers < NUMBERS_PER_UNKNOWN * problem.size:
        names = ", ".join(f.name for f in problem.flights)
        raise DataError(
            f"{names}: {numbers} {kind} for {problem.size} unknowns of model {problem.model.name}; "
            "that cannot be settled: fly longer, or fix parameters"
        )


def _hopeless(problem: OutputErrorProblem, outcome: Fit) -> bool:
    """Whether a fit failed or explains the motion no better than its mean."""
    if outcome.status is not Status.CONVERGED:
        return True
    point = outcome.point
    z = np.concatenate([s.z for f in problem.flights for s in f.segments])
    r = np.concatenate([r for flight in point.residuals for r in flight])
    with np.errstate(invalid="ignore"):
        r2 = 1.0 - np.nanmean(r**2, axis=0) / np.maximum(np.nanvar(z, axis=0), 1e-300)
    return bool(np.nanmedian(r2) < HOPELESS)


def _unstable(problem: OutputErrorProblem, outcome: Fit) -> bool:
    """Whether sensitivities to the initial state, estimated or held, grow by more than GROWTH within some segment."""
    point = outcome.point
    states = len(problem.free) + np.arange(problem.nx)
    for motions in point.motions:
        for motion in motions:
            if motion.dy is None or not states.size or len(motion.dy) < 2:
                continue
            size = np.abs(motion.dy[:, :, states]).max(axis=(1, 2))
            quarter = max(1, len(size) // 4)
            if size[-quarter:].max() > GROWTH * max(float(size[:quarter].min()), 1e-300):
                return True
    return False


def _fit_by_pieces(
    model: Model, data: list[FlightData], options: OutputErrorOptions, problem: OutputErrorProblem, outcome: Fit
) -> tuple[OutputErrorProblem, Fit]:
    """A fit on short pieces with their own initial states, then one of whole segments from there; the better of the two.

    An unstable aircraft cannot be simulated for long from any state, but short pieces can, and give good estimates. Where they do
    not either, the outcome is the given one.
    """
    for seconds in PIECES:
        pieces = [cut_into_pieces(d, seconds) for d in data]
        if all(len(p.segments) == len(d.segments) for p, d in zip(pieces, data, strict=True)):
            continue
        short = build_problem(model, pieces, options)
        if any(len(s) * problem.ny < 3 * problem.nx for f in pieces for s in f.segments):
            break
        piecewise = minimise(short, _starts(short, options), options.loop)
        if piecewise.status is not Status.CONVERGED or _hopeless(short, piecewise):
            continue
        uncut = minimise(problem, problem.pack(short.values(piecewise.unknowns, 0)), options.loop)
        uncut_preferred = not _hopeless(problem, uncut) and uncut.point.cost <= outcome.point.cost
        if uncut_preferred and _unstable(problem, uncut):  # by Akaike's criterion, because pieces have more unknowns
            uncut_preferred = uncut.point.cost + problem.size <= piecewise.point.cost + short.size
        if uncut_preferred:
            return problem, uncut
        return short, replace(piecewise, status=Status.CUT)
    return problem, outcome


def _with_fine_steps(
    problem: OutputErrorProblem, outcome: Fit, options: OutputErrorOptions
) -> tuple[OutputErrorProblem, Fit]:
    """Refit with finer integration steps while twice as many change the outputs by more than COARSE of the noise, or would move
    the estimates by more than about a hundredth of their bounds."""
    while outcome.status in (Status.CONVERGED, Status.CUT) and problem.simulator.substeps < FINEST:
        point = outcome.point
        finer = replace(problem.simulator, substeps=2 * problem.simulator.substeps)
        largest = 0.0
        residuals: list[list[Array]] = []
        for i, flight in enumerate(problem.flights):
            values = problem.values(outcome.unknowns, i)
            residuals.append([])
            for j, segment in enumerate(flight.segments):
                motion = finer.run(segment, values, problem.initial_state(outcome.unknowns, i, j))
                integration_error = (motion.y - point.motions[i][j].y) / np.sqrt(np.diag(point.R))
                largest = max(largest, float(np.sqrt(np.mean(integration_error**2, axis=0)).max()))
                residuals[-1].append(segment.z - motion.y)
        refined = LikelihoodPoint(point.cost, residuals, point.motions, point.R)
        step = problem.step(outcome.unknowns, refined, 0.0)
        if largest < COARSE and step.decrement < MOVED:
            break
        options = replace(options, substeps=finer.substeps)
        problem = build_problem(problem.model, problem.flights, options)
        status = outcome.status
        outcome = minimise(problem, outcome.unknowns + step.direction, options.loop)
        if status is Status.CUT and outcome.status is Status.CONVERGED:
            outcome = replace(outcome, status=Status.CUT)
    return problem, outcome


def build_problem(model: Model, data: list[FlightData], options: OutputErrorOptions) -> OutputErrorProblem:
    """The likelihood of prepared flights."""
    simulator = Simulator.build(model, compile_=options.compile_, substeps=options.substeps, hold=options.hold)
    free_states = free_states_of(model, options)
    sigma = None
    if options.sigma is not None:
        if without_sigma := [n for n in model.output_names if n not in options.sigma]:
            raise ModelError(
                f"model {model.name}: sigma: none given for output {without_sigma[0]!r}; every output needs one"
            )
        sigma = np.array([options.sigma[n] for n in model.output_names])
    return OutputErrorProblem(model, data, simulator, noise=options.noise, sigma=sigma, free_states=free_states)


def free_states_of(model: Model, options: OutputErrorOptions) -> NDArray[np.bool_] | None:
    """(nx,) which initial states the options free; None where the model decides. ModelError for a name that is no state."""
    if options.free_states is None:
        return None
    if unknown := [n for n in options.free_states if n not in model.state_names]:
        raise ModelError(
            f"model {model.name}: free_states: no state {unknown[0]!r}; it has {', '.join(model.state_names)}"
        )
    return np.array([n in options.free_states for n in model.state_names])


def reopen_fit(
    model: Model | str, flights: FlightsToFit, result: Result, options: OutputErrorOptions = STANDARD
) -> tuple[OutputErrorProblem, Fit]:
    """The problem of an earlier fit and its optimum, in the same pieces. DataError for flights other than those of the fit."""
    loaded = load_model(model).with_starts(result.fitted_model.starts())
    loaded, data = without_absent_outputs(loaded, prepare_all(loaded, flights, options.preparation))
    if len(data) != len(result.flights):
        raise DataError(f"{len(data)} flights given for a fit of {len(result.flights)}: give those that were fitted")
    loaded = with_paths(loaded, data).with_starts(path_values(result)) if options.paths else loaded
    problem = build_problem(loaded, in_pieces_of(data, result), options)
    start = problem.pack(loaded.starts(), [list(f.initial_states) for f in result.flights])
    return _with_fine_steps(problem, minimise(problem, start, options.loop), options)


def in_pieces_of(data: list[FlightData], result: Result) -> list[FlightData]:
    """Prepared flights in the segments of a result. DataError where they have none like them."""
    segment_counts = [len(f.initial_states) for f in result.flights]
    for pieces in (data, *([cut_into_pieces(d, seconds) for d in data] for seconds in PIECES)):
        if [len(p.segments) for p in pieces] == segment_counts:
            return pieces
    raise DataError(f"{data[0].name}: not in the segments of the fit: give the flights that were fitted")


def _starts(problem: OutputErrorProblem, options: OutputErrorOptions) -> Array:
    """The better of the given start and the equation-error solution."""
    from_model = problem.pack(problem.model.starts())
    if not options.improve_start:
        return from_model
    regression_values = start_values(problem.simulator, problem.flights)
    if regression_values is None:
        return from_model
    from_regression = problem.clip(problem.pack(regression_values))
    return min(from_model, from_regression, key=lambda unknowns: problem.evaluate(unknowns, False).cost)


def fit_result(problem: OutputErrorProblem, outcome: Fit, method: str) -> Result:
    """The result of an optimisation: estimates with bounds and verdicts, histories, fit."""
    model, unknowns = problem.model, outcome.unknowns
    point = outcome.point
    if outcome.status is Status.DIVERGED:
        return failed_result(problem, outcome, method)
    problem.segment_blocks(point)
    spread = bounds_at_optimum(problem, unknowns, point)
    effects = effects_of(problem, point)
    shared_names = tuple(problem.free[i] for i in problem.shared)
    estimated, pairs = judge_estimates(
        model,
        shared_names,
        unknowns[: len(shared_names)],
        spread.covariance,
        spread.coloured,
        spread.undetermined,
        problem.flights,
        effects,
    )
    flights = tuple(
        _flight_fit(problem, unknowns, point, i, (spread.local_covariance[i], spread.local_coloured[i]), effects)
        for i in range(len(problem.flights))
    )
    if len(problem.local):
        estimated |= mean_of_locals(flights, tuple(problem.free[i] for i in problem.local))
    ordered = {n: estimated[n] for n in problem.free if n in estimated}
    status, text = judge_status(outcome.status, ordered)
    return Result(
        model, method, status, text, outcome.iterations, outcome.evaluations, point.cost, point.R, shared_names, ordered,
        spread.covariance, spread.coloured, pairs, flights, problem.simulator.kernel.label,
    )  # fmt: skip


def failed_result(problem: OutputErrorProblem, outcome: SolverOutcome[P], method: str) -> Result:
    """The result of a fit that found no usable simulation."""
    names = tuple(problem.free[i] for i in problem.shared)
    no_covariance = np.full((len(names), len(names)), np.nan)
    reason = "no usable simulation was found"
    estimated = {
        n: Estimate(n, float("nan"), float("inf"), float("inf"), False, reason, problem.model.parameter(n).unit)
        for n in problem.free
    }
    flights = []
    for f in problem.flights:
        blank, still = (np.full((f.samples, n), np.nan) for n in (problem.ny, problem.nx))
        time, measured = f.histories(problem.ny)
        x0 = tuple(s.x0 for s in f.segments)
        flights.append(FlightFit(f.name, f.samples, time, measured, blank, blank, still, x0, {}, {}, f.notes))
    return Result(
        problem.model, method, outcome.status, outcome.status.value, outcome.iterations, outcome.evaluations,
        float("inf"), np.eye(problem.ny) * np.nan, names, estimated, no_covariance, no_covariance, (), tuple(flights),
        problem.simulator.kernel.label,
    )  # fmt: skip


def _flight_fit(
    problem: OutputErrorProblem,
    unknowns: Array,
    point: LikelihoodPoint,
    index: int,
    covariances: tuple[Array, Array],
    effects: Mapping[str, ParameterEffect],
) -> FlightFit:
    """One flight at the optimum. covariances: of its local parameters, Cramer-Rao and corrected."""
    flight = problem.flights[index]
    time, measured = flight.histories(problem.ny)
    outputs, states = np.full_like(measured, np.nan), np.full((flight.samples, problem.nx), np.nan)
    for segment, motion in zip(flight.segments, point.motions[index], strict=True):
        outputs[segment.rows], states[segment.rows] = motion.y, motion.x
    names = tuple(problem.free[i] for i in problem.local)
    values = problem.parameters(unknowns, index)[problem.local]
    blind = np.zeros(len(names), bool)
    local, _ = judge_estimates(problem.model, names, values, *covariances, blind, [flight], effects)
    initial_states = tuple(problem.initial_state(unknowns, index, j) for j in range(len(flight.segments)))
    fit = channel_fits(problem.model.output_names, measured, outputs)
    return FlightFit(
        flight.name,
        flight.samples,
        time,
        measured,
        outputs,
        measured - outputs,
        states,
        initial_states,
        local,
        fit,
        flight.notes,
    )


def mean_of_locals(flights: tuple[FlightFit, ...], names: tuple[str, ...]) -> dict[str, Estimate]:
    """One estimate for each local parameter: the mean over flights and the bound of that mean; not identifiable where no flight
    can identify its own."""
    result = {}
    for name in names:
        members = [f.local[name] for f in flights]
        count = len(members)
        std = float(np.sqrt(sum(e.std**2 for e in members))) / count
        coloured = float(np.sqrt(sum(e.std_coloured**2 for e in members))) / count
        mean = float(np.mean([e.estimate for e in members]))
        identifiable = any(e.identifiable for e in members)
        reason = "" if identifiable else f"each flight's own: {members[0].why}"
        result[name] = replace(
            members[0], estimate=mean, std=std, std_coloured=coloured, identifiable=identifiable, why=reason
        )
    return result
