"""Output error in the frequency domain: the fit, its bounds and what is told of it.

V. Klein and E. A. Morelli, Aircraft System Identification, 2nd ed., chapter 7. A first fit takes noise as white over the
band, the next ones with the spectrum that the residuals show. `std` is the Cramer-Rao bound of the last; `std_coloured`
(`bounds`) counts the cross-spectra of the residuals, what the fit took away of them, and imperfect inputs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator
from estimation.errors import DataError
from estimation.estimators.equation_error import simulated_fits, start_values
from estimation.estimators.frequency_domain.bounds import Bounds, bounds, noise_shapes
from estimation.estimators.frequency_domain.problem import FrequencyPoint, FrequencyProblem
from estimation.estimators.frequency_domain.transformed import NYQUIST, Band
from estimation.estimators.gauss_newton import AS_USUAL_LOOP, SolverOutcome, Status, minimise
from estimation.estimators.output_error import failed, mean_of_locals
from estimation.estimators.result import FlightFit, Result
from estimation.estimators.uncertainty import estimates
from estimation.models import load_model
from estimation.models.base import Model
from estimation.prepare.flight_data import FlightData, without_absent_outputs
from estimation.prepare.pipeline import prepare_all
from groundstation.flight import Flight
from groundstation.flight.notes import Note, NoteKind

NAME = "ml-frequency"
LOW = 0.1  # Hz; below, gusts and drifts are larger than what manoeuvres of a few seconds leave
HIGH = 3.0  # Hz; above, noise is larger than motion, and 20 Hz samples no longer say how a surface moved between them
PER_PERIOD = 4.0  # samples of a period of the highest frequency
FEWEST_BINS = 4  # frequencies of a stretch worth having


@dataclass(frozen=True)
class FrequencyOptions:
    """band: frequencies compared [Hz], by default LOW to HIGH or what the samples allow. drift: a slow drift of every
    output in every stretch is estimated too. rounds: fits with the spectrum of the residuals after the first, white one."""

    band: tuple[float, float] | None = None
    drift: bool = True
    rounds: int = 1


AS_USUAL = FrequencyOptions()
Fit = SolverOutcome[FrequencyPoint]


def frequency_output_error(
    model: Model | str,
    flights: Flight | FlightData | Sequence[Flight | FlightData],
    options: FrequencyOptions = AS_USUAL,
) -> Result:
    """Fit `model`, linearised about each stretch, to the transforms of one flight or of several together.

    Raises DataError or MissingColumnError for a flight that cannot feed the model; a fit that fails is a Result that says so.
    """
    chosen = load_model(model)
    chosen, data = without_absent_outputs(chosen, prepare_all(chosen, flights))
    band = _band(data, options)
    data = [_long_enough(d, band) for d in data]
    simulator = Simulator.build(chosen)
    problem = FrequencyProblem(data, simulator, band, drift=options.drift)
    _enough(problem)
    starts = [chosen.starts(), start_values(simulator, data) or chosen.starts()]
    begun = [problem.clip(problem.begin(s)) for s in starts]
    first = min(begun, key=lambda u: problem.evaluate(u, False).cost)
    outcome = minimise(problem, first, AS_USUAL_LOOP)
    for _ in range(options.rounds if outcome.status.usable else 0):
        problem = problem.shaped(noise_shapes(problem, outcome.point))
        outcome = minimise(problem, outcome.unknowns, AS_USUAL_LOOP)
    return _described(problem, outcome)


def _band(data: Sequence[FlightData], options: FrequencyOptions) -> Band:
    step = max(float(np.median(np.diff(s.time))) for d in data for s in d.segments)
    low, high = options.band or (LOW, min(HIGH, 1.0 / (PER_PERIOD * step)))
    if not 0.0 < low < high <= NYQUIST / step:
        raise DataError(
            f"band {low:g} to {high:g} Hz: give two frequencies in order, the higher at most {NYQUIST / step:.3g} Hz for samples "
            f"{step:.3g} s apart"
        )
    return Band(low, high)


def _long_enough(flight: FlightData, band: Band) -> FlightData:
    """The flight without the segments that hold hardly any frequency of the band, which is said. DataError where none is left."""

    def bins(seconds: float) -> int:
        return int(band.high * seconds) - max(1, int(np.ceil(band.low * seconds))) + 1

    kept = tuple(s for s in flight.segments if bins(float(s.time[-1] - s.time[0])) >= FEWEST_BINS)
    if not kept:
        raise DataError(
            f"{flight.name}: no stretch is long enough for method ml-frequency: {FEWEST_BINS / band.high:.2g} s "
            "without a gap are "
            "needed; take method ml"
        )
    if len(kept) == len(flight.segments):
        return flight
    text = f"{len(flight.segments) - len(kept)} stretches too short to be transformed: left out by ml-frequency"
    return replace(flight, segments=kept, notes=(*flight.notes, Note(NoteKind.LEFT_OUT, text)))


def _enough(problem: FrequencyProblem) -> None:
    numbers = round(2.0 * float(problem.counts().sum()))
    if numbers < 2 * problem.size:
        names = ", ".join(f.name for f in problem.flights)
        raise DataError(
            f"{names}: {numbers} numbers in the band for {problem.size} unknowns of model {problem.model.name}; "
            "that cannot be settled: "
            "fly longer, or fix parameters"
        )


# ---------------------------------------------------------------------------------------------------------- result


def _described(problem: FrequencyProblem, outcome: Fit) -> Result:
    model, unknowns, point = problem.model, outcome.unknowns, outcome.point
    names = tuple(problem.free[i] for i in problem.shared)
    if outcome.status is Status.DIVERGED:
        return failed(problem, outcome, NAME)
    problem.segment_blocks(point)
    spread = bounds(problem, unknowns, point)
    found, pairs = estimates(
        model, names, unknowns[: len(names)], spread.covariance, spread.coloured, spread.blind, problem.flights
    )
    flights, R = _flights(problem, unknowns, spread)
    if len(problem.local):
        found |= mean_of_locals(flights, tuple(problem.free[i] for i in problem.local))
    ordered = {n: found[n] for n in problem.free if n in found}
    unclear = [n for n, e in ordered.items() if not e.identifiable]
    status = Status.NOT_IDENTIFIABLE if outcome.status is Status.CONVERGED and unclear else outcome.status
    text = status.value + (f": {', '.join(unclear)}" if status is Status.NOT_IDENTIFIABLE else "")
    return Result(
        model, NAME, status, f"{text}; {_compared(problem)}", outcome.iterations, outcome.evaluations, point.cost, R, names,
        ordered, spread.covariance, spread.coloured, pairs, flights, problem.simulator.kernel.label,
    )  # fmt: skip


def _compared(problem: FrequencyProblem) -> str:
    bins = sum(s.omega.size - 1 for flight in problem.stretches for s in flight)
    return f"{bins} frequencies from {problem.band.low:.2g} to {problem.band.high:.2g} Hz"


def _flights(problem: FrequencyProblem, unknowns: Array, spread: Bounds) -> tuple[tuple[FlightFit, ...], Array]:
    """Each flight simulated in time at the estimates, from its measured initial states; and the (ny, ny) variances."""
    values = [problem.values(unknowns, i) for i in range(len(problem.flights))]
    fits, R = simulated_fits(problem.model, problem.flights, values)
    names = tuple(problem.free[i] for i in problem.local)
    seen = np.zeros(len(names), bool)
    result = []
    for i, (fit, flight) in enumerate(zip(fits, problem.flights, strict=True)):
        at = problem.parameters(unknowns, i)[problem.local]
        local, _ = estimates(problem.model, names, at, *spread.local[i], seen, [flight])
        result.append(replace(fit, local=local))
    return tuple(result), R
