"""Neural Gauss-Newton estimates of a flight, or of several together: `ngn` as published, and `ngn-improved`.

Published form: S. Das, R. A. Kuttieri, M. Sinha and R. Jategaonkar, Journal of Guidance, Control and Dynamics 33(1),
2010, and The Aeronautical Journal (2018), pp 889-912. A network learns the motion one step ahead from motion and
measured coefficients; then it is frozen, the coefficients come from the aerodynamic model, and Gauss-Newton finds the
parameters with which it predicts best. No equation of motion is solved.

Improved form: coefficients are means over an interval, a linear path bypasses the hidden layer, and the normal equations are
formed with instruments (`samples`), so that neither derivatives of rates nor noise in the regressors make the parameters too
small. Estimates are means over an ensemble of networks.

The Cramer-Rao bound of a frozen network takes the network and its inputs for exact, and is far too small. The corrected bound is
from a block bootstrap (networks trained again on resampled blocks) and the spread of the ensemble.

The histories of the result are those of the model simulated with the estimates, as in every other method: one-step predictions
of a network follow any flight and say nothing about the parameters. Their errors are in `extra`.
"""

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.aircraft import Aircraft
from estimation.errors import EstimationError
from estimation.estimators.equation_error import simulated_fits
from estimation.estimators.gauss_newton import Status
from estimation.estimators.neural_gauss_newton.axes import Axis, axis_for, unsupported_model
from estimation.estimators.neural_gauss_newton.formulation import FlightUnknowns, TrainingRows
from estimation.estimators.neural_gauss_newton.network import one_thread, usable_device
from estimation.estimators.neural_gauss_newton.samples import INTERVAL_S
from estimation.estimators.neural_gauss_newton.solve import NeuralProblem, NeuralSolution, solve_problems
from estimation.estimators.neural_gauss_newton.training import NgnOptions, default_options
from estimation.estimators.output_error import mean_of_locals
from estimation.estimators.refits import PERCENTILES
from estimation.estimators.regression_error import BOUNDS_LEAVE_OUT
from estimation.estimators.result import Bootstrap, Estimate, FlightFit, Result, Spread, judge_status
from estimation.estimators.uncertainty import judge_estimates
from estimation.models import load_model
from estimation.models.base import Model
from estimation.prepare.columns import with_derived
from estimation.prepare.flight_data import FlightData, without_absent_outputs
from estimation.prepare.pipeline import prepare_all
from groundstation.flight import Array, Flight
from groundstation.flight.findings import Finding


def ngn_result(
    model: Model,
    flights: Sequence[Flight],
    problem: NeuralProblem,
    solution: NeuralSolution,
    settings: dict[str, object],
    bootstrap: bool,
) -> Result:
    """The result of a problem: estimates with bounds and verdicts, simulated histories, and the training record in `extra`.

    bootstrap: include its replicates.
    """
    rows, unknowns = problem.rows, problem.unknowns
    model, data = without_absent_outputs(model, prepare_all(model, flights))
    shared = [i for i, f in enumerate(unknowns.owner) if f < 0]
    names = tuple(unknowns.names[i] for i in shared)
    pick = np.ix_(shared, shared)
    parameters, pairs = _estimates(model, names, solution, np.array(shared, int), data)
    fitted, R = _fitted_flights(model, data, unknowns, solution, rows.notes)
    means = mean_of_locals(fitted, tuple(fitted[0].local))
    parameters |= {n: replace(e, identifiable=True, why="") for n, e in means.items()}
    ordered = {n: parameters[n] for n in model.free_names if n in parameters}
    status, text = _status(solution, ordered)
    text = text if problem.options.improved else f"{text}; {BOUNDS_LEAVE_OUT}"
    cost = float(np.mean([0.5 * rows.u.shape[0] * np.log(f.R).sum() for f in solution.fits]))
    return Result(
        model, "ngn-improved" if problem.options.improved else "ngn", status, text, max(f.iterations for f in solution.fits),
        sum(f.iterations for f in solution.fits), cost, R, names, ordered, solution.bound[pick], solution.spread[pick],
        pairs, fitted, "torch", {**settings, **_record(rows, unknowns, solution)},
        bootstrap=_bootstrap(names, solution, np.array(shared, int)) if bootstrap else None,
    )  # fmt: skip


def _status(solution: NeuralSolution, parameters: dict[str, Estimate]) -> tuple[Status, str]:
    if not np.all(np.isfinite(solution.theta)):
        return Status.DIVERGED, Status.DIVERGED.value
    # a network that predicts no better than the mean gets coefficients unlike those it was trained on
    if any(float(np.log(f.R).mean()) >= 0.0 for f in solution.fits):
        return Status.STALLED, Status.STALLED.value
    if not all(f.converged for f in solution.fits):
        return Status.LIMIT, Status.LIMIT.value
    return judge_status(Status.CONVERGED, parameters)


def _estimates(
    model: Model, names: tuple[str, ...], solution: NeuralSolution, index: NDArray[np.int64], data: list[FlightData]
) -> tuple[dict[str, Estimate], tuple[tuple[str, str, float], ...]]:
    pick = np.ix_(index, index)
    blind = np.diag(solution.bound)[index] <= 0.0
    return judge_estimates(
        model, names, solution.theta[index], solution.bound[pick], solution.spread[pick], blind, data
    )


def _fitted_flights(
    model: Model,
    data: list[FlightData],
    unknowns: FlightUnknowns,
    solution: NeuralSolution,
    notes: tuple[Finding, ...],
) -> tuple[tuple[FlightFit, ...], Array]:
    """Each flight simulated with its estimates, and with its local ones; and R (ny, ny) of the residuals, diagonal."""
    values = [
        {
            n: float(v)
            for n, v, owner in zip(unknowns.names, solution.theta, unknowns.owner, strict=True)
            if owner in (-1, index)
        }
        for index in range(len(data))
    ]
    fits, R = simulated_fits(model, data, values)
    flights = []
    for index, (flight, fit) in enumerate(zip(data, fits, strict=True)):
        local_index = np.array([i for i, owner in enumerate(unknowns.owner) if owner == index], int)
        names = tuple(unknowns.names[i] for i in local_index)
        local = _estimates(model, names, solution, local_index, [flight])[0] if local_index.size else {}
        flights.append(replace(fit, local=local, notes=(*fit.notes, *notes)))
    return tuple(flights), R


def _bootstrap(names: tuple[str, ...], solution: NeuralSolution, index: NDArray[np.int64]) -> Bootstrap | None:
    """The replicates about the estimate; None for fewer than two. index: of the names among the unknowns."""
    deviations = solution.bootstrap[:, index]
    if len(deviations) < 2:
        return None
    replicates = solution.theta[index] + deviations
    low, high = np.percentile(replicates, PERCENTILES, axis=0)
    std, bias = replicates.std(axis=0, ddof=1), deviations.mean(axis=0)
    spreads = {n: Spread(float(std[i]), float(bias[i]), (float(low[i]), float(high[i]))) for i, n in enumerate(names)}
    return Bootstrap(names, replicates, spreads, 0)


def _record(rows: TrainingRows, unknowns: FlightUnknowns, solution: NeuralSolution) -> dict[str, Any]:
    """Errors of training, and the parts of the spread."""

    def spread(values: Array) -> dict[str, float]:
        if len(values) < 2:
            return {}
        return dict(zip(unknowns.names, np.std(values, axis=0, ddof=1).tolist(), strict=True))

    outputs = [*rows.motion, *rows.axis.accelerations]
    rms = np.sqrt(np.mean([f.R for f in solution.fits], axis=0))
    return {
        "record": [
            {"training_error": t.training_error, "validation_error": t.validation_error, "iterations": t.iterations}
            for t in solution.trained
        ],
        "prediction_rms_standardised": dict(zip(outputs, rms.tolist(), strict=True)),
        "ensemble_spread": spread(solution.members),
        "bootstrap_spread": spread(solution.bootstrap),
    }


def estimate_ngn(
    aircraft: Aircraft,
    flights: Flight | Sequence[Flight],
    *,
    model: Model | None = None,
    improved: bool = False,
    options: NgnOptions | None = None,
    device: str | None = None,
    bootstraps: int | None = None,
    seed: int | None = None,
) -> Result:
    """Estimates over one flight or several together.

    model: a built-in lateral or longitudinal one (default: lateral), with any parameters fixed or local. options: replace
    `improved` where given (default: `default_options`); device (cpu, cuda or auto), bootstraps and seed replace those of the
    options. Where bootstraps is given, the result has its `bootstrap`.
    Raises EstimationError for another model, MissingColumnError and DataError for a flight that cannot be used.
    """
    flight_list = [flights] if isinstance(flights, Flight) else list(flights)
    return _estimate(aircraft, [flight_list], model, improved, options, device, bootstraps, seed)[0]


def estimate_campaign(
    aircraft: Aircraft,
    flights: Sequence[Flight],
    *,
    model: Model | None = None,
    improved: bool = False,
    options: NgnOptions | None = None,
    device: str | None = None,
    bootstraps: int | None = None,
    seed: int | None = None,
) -> list[Result]:
    """`estimate_ngn` of each flight by itself, with the networks of all flights trained side by side.

    Results equal those of one flight after the other, within rounding.
    """
    return _estimate(aircraft, [[f] for f in flights], model, improved, options, device, bootstraps, seed)


def _estimate(
    aircraft: Aircraft,
    sets: Sequence[Sequence[Flight]],
    model: Model | None,
    improved: bool,
    options: NgnOptions | None,
    device: str | None,
    bootstraps: int | None,
    seed: int | None,
) -> list[Result]:
    """A result for each set of flights; arguments as of `estimate_ngn`."""
    ngn_model = load_model("lateral", aircraft) if model is None else model
    axis = axis_for(ngn_model.name, aircraft)
    if axis is None:
        raise EstimationError(unsupported_model(ngn_model.name))
    base = options or default_options(improved, axis.name)
    chosen = replace(
        base,
        device=usable_device(base.device if device is None else device),
        bootstraps=base.bootstraps if bootstraps is None else bootstraps,
        seed=base.seed if seed is None else seed,
    )
    with one_thread():
        problems = [_problem(axis, ngn_model, flights, chosen) for flights in sets]
        solutions = solve_problems(problems, chosen)
    return [
        ngn_result(ngn_model, flights, p, s, _settings(p.rows, chosen), bootstraps is not None)
        for flights, p, s in zip(sets, problems, solutions, strict=True)
    ]


def _problem(axis: Axis, model: Model, flights: Sequence[Flight], options: NgnOptions) -> NeuralProblem:
    unknowns = FlightUnknowns.build(model, axis, len(flights))
    complete = [with_derived(f, axis.columns) for f in flights]
    rows = TrainingRows.build(axis, complete, "interval" if options.improved else "point")
    return NeuralProblem(rows, unknowns, options)


def _settings(rows: TrainingRows, options: NgnOptions) -> dict[str, object]:
    """What is needed to repeat the estimation."""
    smoothing = (
        f"means over {INTERVAL_S:g} s" if options.improved else "piecewise polynomials, derivatives of cubic splines"
    )
    return {
        "form": "interval" if options.improved else "point",
        "inputs": [*rows.motion, *rows.axis.coefficients],
        "outputs": [*rows.motion, *rows.axis.accelerations],
        "hidden": options.hidden,
        "smoothing": smoothing,
        "training": asdict(options.training),
        "seed": options.seed,
        "instruments": options.instruments,
        "ensemble": options.ensemble,
        "bootstraps": options.bootstraps,
        "rows": int(rows.u.shape[0]),
        "device": options.device,
    }
