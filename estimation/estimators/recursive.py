"""The recursive estimator of `daq.identification` over a flight's file: the numbers that were, or would have been, seen live.

Measured columns go in as they are, scan by scan; nothing is smoothed and nothing is taken from the future.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daq.identification.airframe import COLUMNS, DERIVATIVES, SIGNALS, Airframe, Belief, Sample
from daq.identification.live import GAP, LiveDerivative, LiveEstimates, LiveEstimator
from daq.identification.solve import RegressionSolution
from estimation.aircraft import Aircraft
from estimation.errors import EstimationError
from estimation.estimators.equation_error import simulated_fits
from estimation.estimators.gauss_newton import Status
from estimation.estimators.result import Estimate, EstimateHistory, FlightFit, Result, correlation_matrix
from estimation.estimators.uncertainty import LISTED
from estimation.models.base import Model, Parameter
from estimation.prepare.columns import with_derived
from estimation.prepare.flight_data import FOR_REGRESSION, FlightData, without_absent_outputs
from estimation.prepare.pipeline import prepare_all
from groundstation.flight import GAP_FACTOR, Array, Flight

EVERY = 0.5  # s between two entries of the history
DOUBTED = 0.5  # of a believed value: its standard deviation where the aircraft file states none


@dataclass(frozen=True)
class _RecursiveRun:
    """What came of feeding flights one after the other. ends: stretch of the estimator at which each flight ends."""

    estimator: LiveEstimator
    ends: tuple[int, ...]
    history: EstimateHistory


def estimate_recursively(model: Model, flights: Sequence[Flight], aircraft: Aircraft) -> Result:
    """Estimates with bounds after the last scan, and how they came about.

    model: one with the derivatives of `lateral`. Several flights are taken one after the other, as one aircraft; the history
    is that of a single flight. Raises EstimationError for another model, parameters that are held or an airframe that cannot
    be, MissingColumnError for a flight without the measured motion.
    """
    airframe = airframe_of(model, aircraft)
    for flight in flights:
        flight.require([s for s in SIGNALS if s != "rho"], "method live")
    compared_model, data = without_absent_outputs(model, prepare_all(model, flights, FOR_REGRESSION))
    run = _fed(airframe, [with_derived(f, ["rho"]) for f in flights])
    return _result(compared_model, data, run)


def unsupported_by_live(model: Model) -> str:
    """Why a model cannot be taken, empty where it can."""
    if set(model.parameter_names) != set(DERIVATIVES):
        return f"method live knows the derivatives of model lateral only, not those of {model.name}; take method ml"
    fixed = [p.name for p in model.parameters if p.fixed]
    return f"method live holds no parameter ({', '.join(fixed)}): free it, or take method ml" if fixed else ""


def airframe_of(model: Model, aircraft: Aircraft) -> Airframe:
    """The airframe and what is believed of it, as a model and its aircraft have it."""
    if objection := unsupported_by_live(model):
        raise EstimationError(objection)
    lag = None if aircraft.servos is None else aircraft.servos.lag
    c = model.constants
    try:
        return Airframe(
            c["b"],
            c["S"],
            c["m"],
            c["Ixx"],
            c["Iyy"],
            c["Izz"],
            c["Ixz"],
            {p.name: _belief(p) for p in model.parameters},
            lag,
        )
    except KeyError as error:
        raise EstimationError(
            f"model {model.name} has no constant {error}, and method live cannot do without"
        ) from error
    except ValueError as error:
        raise EstimationError(f"model {model.name}: {error}") from error


def _belief(p: Parameter) -> Belief:
    value = p.start if p.reference is None else p.reference
    return Belief(value, p.reference_std if p.reference_std is not None else DOUBTED * abs(value))


def samples_of(flight: Flight, part: slice) -> Iterator[Sample]:
    """Scans of a stretch of a flight, in order. A column that is missing reads NaN."""
    columns = [flight.time[part], *(flight[n][part] for n in SIGNALS)]
    for row in np.stack(columns, axis=1).tolist():
        yield Sample(*row)


def _fed(airframe: Airframe, flights: Sequence[Flight]) -> _RecursiveRun:
    estimator, ends, snapshots = LiveEstimator(airframe), [], list[LiveEstimates]()
    for flight in flights:
        due = -math.inf
        for part in flight.segments:
            if not _leads_over(flight, part.start):
                estimator.restart()
            for sample in samples_of(flight, part):
                estimator.add(sample)
                if sample.time >= due and len(flights) == 1:
                    due = sample.time + EVERY - 1e-6
                    snapshots.append(replace(estimator.estimates(), time=sample.time))
        if len(flights) == 1:
            snapshots.append(replace(estimator.estimates(), time=float(flight.time[-1])))
        ends.append(estimator.stretches + 1)
    return _RecursiveRun(estimator, tuple(ends), _history(snapshots))


def _leads_over(flight: Flight, row: int) -> bool:
    """Whether a segment begins only because some scans are missing, fewer than make the estimator begin anew by itself."""
    if row == 0:
        return False
    step = float(flight.time[row] - flight.time[row - 1])
    return GAP_FACTOR * flight.sample_interval < step <= GAP


def _history(snapshots: Sequence[LiveEstimates]) -> EstimateHistory:
    def series(name: str, field: str) -> Array:
        derivatives = (e.derivatives[name] for e in snapshots)
        return np.array([getattr(d, field) if d.told else np.nan for d in derivatives])

    return EstimateHistory(
        np.array([e.time for e in snapshots]),
        {n: series(n, "estimate") for n in DERIVATIVES},
        {n: series(n, "std") for n in DERIVATIVES},
    )


def _result(model: Model, data: list[FlightData], run: _RecursiveRun) -> Result:
    final = run.estimator.estimates()
    names = tuple(n for n in model.parameter_names if not model.parameter(n).local)
    shared = {n: _estimate(model.parameter(n), final.derivatives[n]) for n in names}
    local = list(_locals(model, run))
    values = [{n: e.estimate for n, e in (shared | flight_local).items()} for flight_local in local]
    fits, R = simulated_fits(model, data, values)
    flights: tuple[FlightFit, ...] = tuple(
        replace(f, local=flight_local) for f, flight_local in zip(fits, local, strict=True)
    )
    honest, white = (_matrix(names, run.estimator.solutions(), kind) for kind in ("covariance", "white"))
    status, text = _status(final, shared)
    return Result(
        model, "live", status, text, final.rows, final.rows, math.nan, R, names, shared, white, honest,
        _pairs(names, honest), flights, "daq.identification", history=run.history if len(data) == 1 else None,
    )  # fmt: skip


def _locals(model: Model, run: _RecursiveRun) -> Iterator[dict[str, Estimate]]:
    """Each flight's own constants, where the model says that they are."""
    begin = 0
    for end in run.ends:
        derivatives = run.estimator.estimates(slice(begin, end)).derivatives
        yield {p.name: _estimate(p, derivatives[p.name]) for p in model.parameters if p.local}
        begin = end


def _estimate(p: Parameter, d: LiveDerivative) -> Estimate:
    """The start value stands where there is no number at all."""
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


def _matrix(names: tuple[str, ...], solutions: Mapping[str, RegressionSolution | None], kind: str) -> Array:
    """(n, n) covariance in the order of the names; zero where there is none, constants by themselves."""
    result = np.zeros((len(names), len(names)))
    for coefficient, solution in solutions.items():
        if solution is not None:
            index = [names.index(f"{coefficient}_{COLUMNS[c]}") for c in solution.columns]
            result[np.ix_(index, index)] = getattr(solution, kind)
    return result


def _pairs(names: tuple[str, ...], covariance: Array) -> tuple[tuple[str, str, float], ...]:
    rho = correlation_matrix(covariance)
    pairs = [
        (names[i], names[j], round(float(rho[i, j]), 4))
        for i in range(len(names))
        for j in range(i)
        if abs(rho[i, j]) >= LISTED
    ]
    return tuple(sorted(pairs, key=lambda p: -abs(p[2])))
