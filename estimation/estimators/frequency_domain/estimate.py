"""Output error in the frequency domain: the fit, its bounds and its result.

V. Klein and E. A. Morelli, Aircraft System Identification, 2nd ed., chapter 7. The first fit takes noise as white over the band,
the next ones use the spectrum of the residuals. `std` is the Cramer-Rao bound of the last fit. `std_coloured` is from
M^-1 B M^-1 with M the information and B the covariance of the score. B is a sum over frequencies of slopes times the spectra and
cross-spectra of the residuals, smoothed over neighbouring frequencies and raised by what the fit absorbed, plus the effect of
input errors (`estimation.estimators.input_error`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator
from estimation.errors import DataError
from estimation.estimators.equation_error import simulated_fits, start_values
from estimation.estimators.frequency_domain.problem import FrequencyPoint, FrequencyProblem, SegmentRows
from estimation.estimators.frequency_domain.transformed import NYQUIST, Band
from estimation.estimators.gauss_newton import AS_USUAL_LOOP, SolverOutcome, Status, minimise
from estimation.estimators.input_error import disturbed_outputs
from estimation.estimators.normal_equations import FlightBlocks, pseudo_inverse
from estimation.estimators.output_error import failed_result, mean_of_locals, require_enough_data
from estimation.estimators.result import FlightFit, Result, judge_status
from estimation.estimators.uncertainty import TIED, free_covariance, judge_estimates, reduction, with_shared
from estimation.models import load_model
from estimation.models.base import Model
from estimation.models.dependence import require_states
from estimation.prepare.flight_data import FlightData, without_absent_outputs
from estimation.prepare.pipeline import FlightsToFit, prepare_all
from estimation.signals.curves import Complex
from groundstation.flight.findings import Finding, FindingKind

NAME = "ml-frequency"
LOW = 0.1  # Hz; below, gusts and drifts are larger than the effect of manoeuvres of a few seconds
HIGH = 3.0  # Hz; above, noise is larger than motion, and 20 Hz samples do not show how a surface moved between them
PER_PERIOD = 4.0  # samples in a period of the highest frequency
FEWEST_BINS = 4  # frequencies of a stretch that is used
SMOOTHED = 4  # bins to either side over which the spectra of residuals are averaged
LEAST_REMAINING = 0.25  # of the noise power after a fit: a spectrum is raised at most fourfold
LEAST = 0.05  # of an output's mean noise, at every frequency


@dataclass(frozen=True)
class Bounds:
    """(shared, shared) covariances, Cramer-Rao and corrected, and both of each flight's local parameters; blind: (shared,) which
    the data does not see."""

    covariance: Array
    coloured: Array
    local: list[tuple[Array, Array]]
    blind: NDArray[np.bool_]


@dataclass(frozen=True)
class SpectralScore:
    """Parts of the score of one flight about the free parameters, nuisances projected out. independent: (n, n) covariance of
    those that are independent from flight to flight; common: (n, errors) due to timing errors that all flights of an aircraft
    share."""

    independent: Array
    common: Array


def frequency_bounds(problem: FrequencyProblem, unknowns: Array, point: FrequencyPoint) -> Bounds:
    """Both bounds at an optimum."""
    blocks = [problem.flight_blocks(unknowns, point, i) for i in range(len(problem.flights))]
    covariance, unseen = pseudo_inverse(problem.shared_information(unknowns, blocks)[0])
    blind = np.any(np.abs(unseen) > TIED, axis=1)
    scores = [
        _score(problem, unknowns, point, i, free_covariance(problem, covariance, b)) for i, b in enumerate(blocks)
    ]
    middle = np.diag(problem.prior_weight[problem.shared])
    reduced = [reduction(problem, block) for block in blocks]
    middle += sum(r @ s.independent @ r.T for r, s in zip(reduced, scores, strict=True))
    common = np.sum([r @ s.common for r, s in zip(reduced, scores, strict=True)], axis=0)
    coloured = covariance @ (middle + common @ common.T) @ covariance
    return Bounds(covariance, coloured, _local(problem, blocks, scores, covariance, coloured), blind)


def _local(
    problem: FrequencyProblem,
    blocks: list[FlightBlocks],
    scores: list[SpectralScore],
    covariance: Array,
    coloured: Array,
) -> list[tuple[Array, Array]]:
    """Both covariances of each flight's local parameters."""
    covariances = []
    for block, score in zip(blocks, scores, strict=True):
        total = score.independent + score.common @ score.common.T
        given_shared = block.ll_inverse @ total[np.ix_(problem.local, problem.local)] @ block.ll_inverse
        covariances.append(
            (with_shared(block, block.ll_inverse, covariance), with_shared(block, given_shared, coloured))
        )
    return covariances


def _score(
    problem: FrequencyProblem, unknowns: Array, point: FrequencyPoint, index: int, covariance: Array
) -> SpectralScore:
    """Parts of the score of one flight: noise as residuals show it, and input errors (`estimators.input_error`) of the prior
    size. covariance: (n, n) of the parameters of this flight."""
    n = len(problem.free)
    total, columns = np.zeros((n, n)), []
    responses = disturbed_outputs(problem, unknowns, index)
    for j, (stretch, segment) in enumerate(zip(problem.stretches[index], problem.flights[index].segments, strict=True)):
        rows = problem.rows(point, index, j)
        inverse = point.blocks[index][j].xx_inverse
        J = rows.by_parameter - rows.nuisance @ (inverse @ (rows.nuisance.T @ rows.by_parameter))
        shape = (stretch.omega.size, problem.ny)
        spectra = _smoothed(_complex(rows.residual, shape), _leverage(J, rows, covariance, inverse, shape))
        slopes = _complex(J, (stretch.omega.size, problem.ny, n))
        total += np.real(np.einsum("kon,kop,kpm->nm", slopes.conj(), spectra, slopes))
        changes = stretch.transformed(segment.time, responses[j].values)
        columns.append(J.T @ problem.in_noise(changes, point, index, j))
    noise, edges, common = np.split(
        np.sum(columns, axis=0), [responses[0].noise, responses[0].noise + responses[0].edges], axis=1
    )
    for draws in (noise, edges):
        total += draws @ draws.T / max(draws.shape[1], 1)
    return SpectralScore(total, common)


def _leverage(J: Array, rows: SegmentRows, covariance: Array, nuisance_inverse: Array, shape: tuple[int, int]) -> Array:
    """(bins, ny) share of each residual that the fit absorbs. J: nuisances projected out; covariance: (n, n) of the
    parameters."""
    leverage = np.einsum("rn,nm,rm->r", J, covariance, J)
    leverage += np.einsum("rk,kl,rl->r", rows.nuisance, nuisance_inverse, rows.nuisance)
    of_parts = _complex(leverage, shape)  # of real and imaginary parts
    return np.asarray(0.5 * of_parts.real + 0.5 * of_parts.imag)


def _complex(values: Array, shape: tuple[int, ...]) -> Complex:
    """Complex numbers of a shape, from real parts over imaginary ones."""
    real, imaginary = np.split(values, 2)
    return (real + 1j * imaginary).reshape(shape)


def _smoothed(residual: Complex, leverage: Array) -> Complex:
    """(bins, ny, ny) spectra of residuals (bins, ny), in units in which each of the two parts of white noise has one.

    leverage: (bins, ny) share of the noise that the fit has absorbed.
    """
    power = 0.5 * np.einsum("ko,kp->kop", residual, residual.conj())
    lowest = power[1 : SMOOTHED + 1]
    power[0] = lowest[np.argmax(np.trace(lowest.real, axis1=1, axis2=2))]  # a single mean shows no scatter
    count = len(power)
    windows = [slice(max(k - SMOOTHED, 0), min(k + SMOOTHED + 1, count)) for k in range(count)]
    remaining = np.stack([np.maximum(1.0 - leverage[w].mean(axis=0), LEAST_REMAINING) for w in windows])
    spectra = np.stack([power[w].mean(axis=0) for w in windows])
    return np.asarray(spectra / np.sqrt(remaining[:, :, None] * remaining[:, None, :]))


def noise_shapes(problem: FrequencyProblem, point: FrequencyPoint) -> list[list[Array]]:
    """By flight and segment (bins, ny): smoothed spectrum of the residuals relative to its level."""
    shapes: list[list[Array]] = []
    for i, flight in enumerate(problem.stretches):
        shapes.append([])
        for j, stretch in enumerate(flight):
            rows = problem.rows(point, i, j)
            residual = _complex(rows.residual, stretch.z.shape)
            spectra = _smoothed(residual, np.zeros(residual.shape))
            power = np.real(np.einsum("koo->ko", spectra)) * problem.shapes[i][j]
            level = np.maximum(power[1:].mean(axis=0), 1e-300)
            shapes[-1].append(np.where(stretch.compared, np.maximum(power / level, LEAST), 1.0))
    return shapes


@dataclass(frozen=True)
class FrequencyOptions:
    """band: frequencies compared [Hz], by default LOW to HIGH, or lower where samples are further apart. drift: estimate a slow
    drift of every output in every stretch. rounds: fits with the spectrum of the residuals after the first, white one."""

    band: tuple[float, float] | None = None
    drift: bool = True
    rounds: int = 1


AS_USUAL = FrequencyOptions()
Fit = SolverOutcome[FrequencyPoint]


def frequency_output_error(model: Model | str, flights: FlightsToFit, options: FrequencyOptions = AS_USUAL) -> Result:
    """Fit `model`, linearised about each stretch, to the transforms of one flight or of several together.

    Raises DataError or MissingColumnError for a flight that the model cannot use; a fit that fails is a Result that says so.
    """
    loaded = require_states(load_model(model), NAME)
    loaded, data = without_absent_outputs(loaded, prepare_all(loaded, flights))
    band = _band(data, options)
    data = [_without_short_segments(d, band) for d in data]
    simulator = Simulator.build(loaded)
    problem = FrequencyProblem(data, simulator, band, drift=options.drift)
    require_enough_data(problem, round(2.0 * float(problem.counts().sum())), "numbers in the band")
    starts = [loaded.starts(), start_values(simulator, data) or loaded.starts()]
    candidates = [problem.clip(problem.begin(s)) for s in starts]
    first = min(candidates, key=lambda u: problem.evaluate(u, False).cost)
    outcome = minimise(problem, first, AS_USUAL_LOOP)
    for _ in range(options.rounds if outcome.status.usable else 0):
        problem = problem.shaped(noise_shapes(problem, outcome.point))
        outcome = minimise(problem, outcome.unknowns, AS_USUAL_LOOP)
    return _result(problem, outcome)


def _band(data: Sequence[FlightData], options: FrequencyOptions) -> Band:
    """The band of the options, or the default one; DataError where the samples do not allow it."""
    step = max(float(np.median(np.diff(s.time))) for d in data for s in d.segments)
    low, high = options.band or (LOW, min(HIGH, 1.0 / (PER_PERIOD * step)))
    if not 0.0 < low < high <= NYQUIST / step:
        raise DataError(
            f"band {low:g} to {high:g} Hz: give two frequencies in order, the higher at most {NYQUIST / step:.3g} Hz for samples "
            f"{step:.3g} s apart"
        )
    return Band(low, high)


def _without_short_segments(flight: FlightData, band: Band) -> FlightData:
    """The flight without segments with fewer than FEWEST_BINS frequencies in the band, and a note; DataError where none is
    left."""

    def bins(seconds: float) -> int:
        return int(band.high * seconds) - max(1, int(np.ceil(band.low * seconds))) + 1

    long_segments = tuple(s for s in flight.segments if bins(float(s.time[-1] - s.time[0])) >= FEWEST_BINS)
    if not long_segments:
        raise DataError(
            f"{flight.name}: no stretch is long enough for method {NAME}: {FEWEST_BINS / band.high:.2g} s "
            "without a gap are needed; take method ml"
        )
    if len(long_segments) == len(flight.segments):
        return flight
    text = f"{len(flight.segments) - len(long_segments)} stretches too short to be transformed: left out by {NAME}"
    return replace(flight, segments=long_segments, notes=(*flight.notes, Finding(FindingKind.LEFT_OUT, text)))


# ---------------------------------------------------------------------------------------------------------- result


def _result(problem: FrequencyProblem, outcome: Fit) -> Result:
    """The result of an optimisation: estimates with bounds and verdicts, simulated histories."""
    model, unknowns, point = problem.model, outcome.unknowns, outcome.point
    names = tuple(problem.free[i] for i in problem.shared)
    if outcome.status is Status.DIVERGED:
        return failed_result(problem, outcome, NAME)
    problem.segment_blocks(point)
    spread = frequency_bounds(problem, unknowns, point)
    estimated, pairs = judge_estimates(
        model, names, unknowns[: len(names)], spread.covariance, spread.coloured, spread.blind, problem.flights
    )
    flights, R = _flights(problem, unknowns, spread)
    if len(problem.local):
        estimated |= mean_of_locals(flights, tuple(problem.free[i] for i in problem.local))
    ordered = {n: estimated[n] for n in problem.free if n in estimated}
    status, text = judge_status(outcome.status, ordered)
    return Result(
        model, NAME, status, f"{text}; {_band_text(problem)}", outcome.iterations, outcome.evaluations, point.cost, R, names,
        ordered, spread.covariance, spread.coloured, pairs, flights, problem.simulator.kernel.label,
    )  # fmt: skip


def _band_text(problem: FrequencyProblem) -> str:
    bins = sum(s.omega.size - 1 for flight in problem.stretches for s in flight)
    return f"{bins} frequencies from {problem.band.low:.2g} to {problem.band.high:.2g} Hz"


def _flights(problem: FrequencyProblem, unknowns: Array, spread: Bounds) -> tuple[tuple[FlightFit, ...], Array]:
    """Each flight simulated over time with the estimates, from its measured initial states, and R (ny, ny), diagonal."""
    values = [problem.values(unknowns, i) for i in range(len(problem.flights))]
    fits, R = simulated_fits(problem.model, problem.flights, values)
    names = tuple(problem.free[i] for i in problem.local)
    blind = np.zeros(len(names), bool)
    result = []
    for i, (fit, flight) in enumerate(zip(fits, problem.flights, strict=True)):
        local_values = problem.parameters(unknowns, i)[problem.local]
        local, _ = judge_estimates(problem.model, names, local_values, *spread.local[i], blind, [flight])
        result.append(replace(fit, local=local))
    return tuple(result), R
