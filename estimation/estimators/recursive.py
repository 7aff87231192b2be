"""The recursive estimator of `daq.identification` over a recorded flight: the numbers of live identification.

It gets measured columns scan by scan; nothing is smoothed and no later scan is used.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.identification.airframe import PITCH_SIGNALS, SIGNALS, Airframe, Belief, Sample
from daq.identification.estimates import LiveDerivative, LiveEstimates
from daq.identification.live import GAP, JointEstimator
from daq.identification.regression import LATERAL, PlaneRegression
from daq.identification.solve import RegressionSolution
from estimation.aircraft import Aircraft
from estimation.errors import EstimationError
from estimation.estimators.equation_error import simulated_fits
from estimation.estimators.gauss_newton import Status
from estimation.estimators.linear_terms import OPTIONAL, LinearTerms, linear_terms
from estimation.estimators.result import Estimate, EstimateHistory, FlightFit, Result, correlation_matrix
from estimation.estimators.uncertainty import correlated_pairs
from estimation.models.base import Model, Parameter
from estimation.prepare.columns import with_derived
from estimation.prepare.flight_data import FOR_REGRESSION, FlightData, without_absent_outputs
from estimation.prepare.measured_cg import cg_history
from estimation.prepare.measured_mass import mass_history
from estimation.prepare.pipeline import prepare_all
from groundstation.flight import GAP_FACTOR, Array, Flight

HISTORY_INTERVAL = 0.5  # s between two entries of the history
USUAL_DOUBT = 0.5  # of a believed value: its standard deviation where the aircraft file states none


@dataclass(frozen=True)
class _RecursiveRun:
    """The estimator after all flights. ends: for each flight, one past its last stretch in the estimator."""

    estimator: JointEstimator
    ends: tuple[int, ...]
    history: EstimateHistory


def estimate_recursively(model: Model, flights: Sequence[Flight], aircraft: Aircraft) -> Result:
    """Estimates with bounds after the last scan, and their history where there is one flight.

    model: linear in its parameters, as `linear_terms` requires. Several flights follow each other, of one aircraft. Raises
    EstimationError for another model, fixed parameters, an impossible airframe or one without believed derivatives,
    MissingColumnError for a flight without the measured motion.
    """
    airframe, terms = airframe_of(model, aircraft), linear_terms(model)
    if not any(b.value for b in airframe.beliefs.values()):
        raise EstimationError(
            f"method live needs a rough value of each derivative to begin with, and nothing is believed of {aircraft.name}: state"
            " [derivatives] in its file, or take method ls or ml"
        )
    for flight in flights:
        flight.require(list(terms.signals), "method live")
    compared_model, data = without_absent_outputs(model, prepare_all(model, flights, FOR_REGRESSION))
    run = _run(airframe, terms, [with_derived(f, ["rho"]) for f in flights])
    return _result(compared_model, data, run, terms)


def unsupported_by_live(model: Model) -> str:
    """Why a model cannot be used, empty where it can."""
    try:
        linear_terms(model)
    except EstimationError as error:
        return str(error)
    return ""


def airframe_of(model: Model, aircraft: Aircraft) -> Airframe:
    """Geometry, mass and beliefs of a model and its aircraft. EstimationError where the model lacks a constant, or one is
    impossible."""
    terms, c = linear_terms(model), model.constants
    lag = None if aircraft.servos is None else aircraft.servos.lag
    beliefs = {terms.names[p.name]: _belief(p) for p in model.parameters}
    pitching = any(r.name == "longitudinal" for r in terms.regressions)
    try:
        b, S, m, Ixx, Iyy, Izz, Ixz = (c[n] for n in ("b", "S", "m", "Ixx", "Iyy", "Izz", "Ixz"))
        return Airframe(b, S, m, Ixx, Iyy, Izz, Ixz, beliefs, lag, c["c"] if pitching else math.nan)
    except KeyError as error:
        raise EstimationError(
            f"model {model.name} has no constant {error}, and method live cannot do without"
        ) from error
    except ValueError as error:
        raise EstimationError(f"model {model.name}: {error}") from error


def _belief(p: Parameter) -> Belief:
    value = p.start if p.reference is None else p.reference
    return Belief(value, p.reference_std if p.reference_std is not None else USUAL_DOUBT * abs(value))


def values_of(model: Model) -> tuple[dict[str, float], dict[str, float]]:
    """Values of a model's parameters, and the standard deviations of its priors and of beliefs that were not replaced by
    estimates."""
    values = {p.name: p.start for p in model.parameters}
    stds = {p.name: s for p in model.parameters if (s := _stated_std(p)) is not None}
    return values, stds


def _stated_std(p: Parameter) -> float | None:
    if p.prior_std is not None:
        return p.prior_std
    return p.reference_std if p.reference_std and p.start == p.reference else None


def samples_of(
    flight: Flight, part: slice, regressions: Sequence[PlaneRegression] = (LATERAL,), airframe: Airframe | None = None
) -> Iterator[Sample]:
    """Scans of a stretch of a flight, in order. For the pitching plane alone, a lateral column that is not measured reads zero.
    airframe: its mass and CG limit the flight's measured ones; None: these are not used. Raises DataError as `mass_history` and
    `cg_history`."""
    names = [*SIGNALS, *(PITCH_SIGNALS if regressions != (LATERAL,) else ())]
    lateral = any(r.name == "lateral" for r in regressions)
    absent = () if lateral else [n for n in (*OPTIONAL, "delta_a", "delta_r") if not flight.measured(n)]
    size = flight.time[part].size
    columns = [flight.time[part], *(np.zeros(size) if n in absent else flight[n][part] for n in names)]
    loading = np.full((size, 2), math.nan)
    if airframe is not None:
        loading = np.stack([mass_history(flight, airframe.mass), cg_history(flight, airframe.span)], axis=1)[part]
    for row, (mass, cg_x) in zip(np.stack(columns, axis=1).tolist(), loading.tolist(), strict=True):
        yield Sample(*row)._replace(mass=mass, cg_x=cg_x)


def _run(airframe: Airframe, terms: LinearTerms, flights: Sequence[Flight]) -> _RecursiveRun:
    """Feed all scans of the flights, one flight after the other, to one estimator."""
    estimator, ends, entries = JointEstimator(airframe, terms.regressions), [], list[LiveEstimates]()
    for flight in flights:
        due = -math.inf
        for part in flight.segments:
            if not _continues(flight, part.start):
                estimator.restart()
            for sample in samples_of(flight, part, terms.regressions, airframe):
                estimator.add(sample)
                if sample.time >= due and len(flights) == 1:
                    due = sample.time + HISTORY_INTERVAL - 1e-6  # 1e-6: rounding of the times
                    entries.append(replace(estimator.estimates(), time=sample.time))
        if len(flights) == 1:
            entries.append(replace(estimator.estimates(), time=float(flight.time[-1])))
        ends.append(estimator.stretches + 1)
    return _RecursiveRun(estimator, tuple(ends), _history(entries, terms.names))


def _continues(flight: Flight, row: int) -> bool:
    """Whether a segment begins after a gap that is too short to restart the estimator."""
    if row == 0:
        return False
    step = float(flight.time[row] - flight.time[row - 1])
    return GAP_FACTOR * flight.sample_interval < step <= GAP


def _history(entries: Sequence[LiveEstimates], names: Mapping[str, str]) -> EstimateHistory:
    def series(name: str, field: str) -> Array:
        derivatives = (e.derivatives[name] for e in entries)
        return np.array([getattr(d, field) if d.told else np.nan for d in derivatives])

    return EstimateHistory(
        np.array([e.time for e in entries]),
        {parameter: series(name, "estimate") for parameter, name in names.items()},
        {parameter: series(name, "std") for parameter, name in names.items()},
    )


def _result(model: Model, data: list[FlightData], run: _RecursiveRun, terms: LinearTerms) -> Result:
    """The result of a run, with flights simulated at its estimates."""
    final = run.estimator.estimates()
    names = tuple(n for n in model.parameter_names if not model.parameter(n).local)
    estimates = {n: _estimate(model.parameter(n), final.derivatives[terms.names[n]]) for n in names}
    constants_by_flight = list(_locals(model, run, terms))
    values = [
        {n: e.estimate for n, e in (estimates | flight_constants).items()} for flight_constants in constants_by_flight
    ]
    fits, R = simulated_fits(model, data, values)
    flights: tuple[FlightFit, ...] = tuple(
        replace(f, local=flight_constants) for f, flight_constants in zip(fits, constants_by_flight, strict=True)
    )
    corrected, white = (
        _matrix([terms.names[n] for n in names], run.estimator.solutions(), kind) for kind in ("covariance", "white")
    )
    status, text = _status(final, estimates)
    return Result(
        model, "live", status, text, final.rows, final.rows, math.nan, R, names, estimates, white, corrected,
        correlated_pairs(names, correlation_matrix(corrected)), flights, "daq.identification",
        history=run.history if len(data) == 1 else None,
    )  # fmt: skip


def _locals(model: Model, run: _RecursiveRun, terms: LinearTerms) -> Iterator[dict[str, Estimate]]:
    """The local parameters of each flight."""
    begin = 0
    for end in run.ends:
        derivatives = run.estimator.estimates(slice(begin, end)).derivatives
        yield {p.name: _estimate(p, derivatives[terms.names[p.name]]) for p in model.parameters if p.local}
        begin = end


def _estimate(p: Parameter, d: LiveDerivative) -> Estimate:
    """The estimate of a parameter; its start value where there is no finite estimate."""
    value, bound, white = (d.estimate, d.std, d.white) if math.isfinite(d.std) else (p.start, math.inf, math.inf)
    return Estimate(
        p.name, value, min(white, bound), bound, d.told, d.why, p.unit, p.reference, p.reference_source, p.local
    )


def _status(final: LiveEstimates, parameters: Mapping[str, Estimate]) -> tuple[Status, str]:
    blind = [n for n, e in parameters.items() if not e.identifiable]
    text = f"solved from {final.rows} intervals, {final.span:.1f} s"
    if blind:
        text += f"; cannot be told from this data: {', '.join(blind)}"
    if final.still:
        text += f"; not moved: {', '.join(final.still)}"
    return (Status.NOT_IDENTIFIABLE if blind else Status.CONVERGED), text


def _matrix(names: Sequence[str], solutions: Mapping[str, RegressionSolution | None], kind: str) -> Array:
    """(n, n) covariance in the order of the names, zero between different regressions. kind: attribute of the solutions."""
    result = np.zeros((len(names), len(names)))
    for solution in solutions.values():
        if solution is not None:
            indices = [names.index(n) for n in solution.names]
            result[np.ix_(indices, indices)] = getattr(solution, kind)
    return result
