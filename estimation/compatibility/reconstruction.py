"""Maximum-likelihood estimation of instrument factors from the innovations of the kinematic filter.

One flight, or several with shared factors. Noise of the inputs is measured in the flight; that of the outputs, and the
turbulence, are estimated with the factors (relaxation between Gauss-Newton steps on the innovations). Bounds come from the
information of the innovations, and are corrected for the colour that is left in them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.compatibility.kalman import Run
from estimation.compatibility.motion import integrated_motion
from estimation.compatibility.problem import (
    USEFUL,
    CompatibilityProblem,
    information_and_gradient,
    lag_window_covariance,
    lagged_products,
    refuse_singular,
)
from estimation.compatibility.records import ATTITUDE_ERROR, attitude_errors, compared_measurements, shows_motion
from estimation.errors import DataError
from estimation.estimators.gauss_newton import halve_until
from estimation.models.base import Model
from estimation.models.kinematic import FACTORS, MEASUREMENTS, STANDARD_FACTORS, compatibility_model
from groundstation.flight import Array, Flight, MissingColumnError
from groundstation.flight.findings import Finding

STEP = 1e-3  # of the widest useful bound of a factor, for differences
RETUNED = (1, 3)  # iterations after which the turbulence is estimated again
CONVERGED = 0.02  # bounds: an iteration that moves every factor by less is the last
ROUNDING = 1e-9  # of the cost: an increase by less is none
HALVINGS = 8  # of a step that raises the cost
CORRELATED = 0.9  # from which the partner of a factor with a wide bound is named
DRIFT = {"V": 0.2, "alpha": 0.01, "beta": 0.01}  # m/s, rad: of the integration over half a minute, with turbulence
LEAST_SLOW_ERROR = 0.2  # of an attitude, over ATTITUDE_ERROR


@dataclass(frozen=True, slots=True)
class FactorEstimate:
    """One instrument factor. std: bound from the information of the innovations; std_coloured: corrected for their colour. Where
    its channel is not measured, all three are NaN and `why` has the reason."""

    name: str
    unit: str
    estimate: float
    std: float
    std_coloured: float
    identifiable: bool
    why: str = ""


@dataclass(frozen=True)
class ReconstructedFlight:
    """measured: (N, ny), NaN where not measured or left out; reconstructed: (N, ny) motion integrated from accelerations
    and rates with the factors, NaN outside the records; noise: of each output, 1 sigma; whiteness: lag-one autocorrelation of the
    normalised innovations of each output; left_out: findings on what was not compared."""

    name: str
    time: Array
    measured: Array
    reconstructed: Array
    outputs: tuple[str, ...]
    noise: Mapping[str, float]
    whiteness: Mapping[str, float]
    notes: tuple[str, ...]
    left_out: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Compatibility:
    """Factors of one flight, or shared by several. correlation: (n, n) of the estimated ones; turbulence: [m/s per root second];
    known: factors held at given values."""

    factors: Mapping[str, FactorEstimate]
    correlation: Array
    flights: tuple[ReconstructedFlight, ...]
    converged: bool
    text: str
    iterations: int
    turbulence: float
    known: Mapping[str, float] = field(default_factory=dict)


def compatibility(
    flights: Flight | Sequence[Flight],
    factors: Sequence[str] = STANDARD_FACTORS,
    *,
    known: Mapping[str, float] | None = None,
    iterations: int = 15,
    keep_held: bool = False,
) -> Compatibility:
    """Estimate instrument factors of one flight, or shared by several. known: factors held at given values. keep_held: repeated
    values of slow and stuck sensors count as measurements.

    A factor whose channel is not measured is not estimated: it is returned as not identifiable, with the reason.
    Raises ModelError for an unknown factor, MissingColumnError or DataError for flights that cannot be used, and
    DataError naming factors that the data cannot separate.
    """
    flight_list = [flights] if isinstance(flights, Flight) else list(flights)
    conditioned, left_out = zip(*(compared_measurements(f, keep_held=keep_held) for f in flight_list), strict=True)
    full_model = compatibility_model(factors, tuple(MEASUREMENTS), known)
    absent = _absent(full_model, conditioned)
    filtered = any(max(attitude_errors(f).values()) > 0 for f in conditioned)
    present = tuple(f for f in full_model.parameter_names if f not in absent)
    model = compatibility_model(present, tuple(MEASUREMENTS), known, filtered_attitude=filtered)
    problem = CompatibilityProblem(model, conditioned)
    p, runs, converged, count = _estimate(problem, iterations)
    slopes = problem.slopes(p, _steps(model))
    described = _describe(problem, conditioned, absent, full_model, p, runs, slopes, converged, count)
    shown = tuple(replace(f, left_out=notes) for f, notes in zip(described.flights, left_out, strict=True))
    return replace(described, flights=shown, known=dict(known or {}))


def _absent(full_model: Model, flights: Sequence[Flight]) -> dict[str, str]:
    """Factor -> why it cannot be estimated. Raises MissingColumnError where none can."""
    absent: dict[str, str] = {}
    columns: list[str] = []
    for name in full_model.parameter_names:
        channels = FACTORS[name].channels
        if channels and not any(shows_motion(f, c) for f in flights for c in channels):
            absent[name] = f"{' and '.join(channels)} not measured, or stuck at one value"
            columns += channels
    if absent and len(absent) == len(full_model.parameters):
        names = ", ".join(f.name for f in flights)
        raise MissingColumnError(names, list(dict.fromkeys(columns)), f"the factors {', '.join(absent)}")
    return absent


def _steps(model: Model) -> Array:
    """(n,) steps of the factors for differences."""
    return np.array([STEP * USEFUL[q.unit] for q in model.parameters])


def _estimate(problem: CompatibilityProblem, iterations: int) -> tuple[Array, list[list[Run]], bool, int]:
    """Factors, the runs of the filter with them, whether converged, and iterations used."""
    p = np.array([q.start for q in problem.model.parameters])
    problem.settle_turbulence(p)
    runs = problem.relax(p, 3)
    if not np.isfinite(problem.cost(runs)):
        raise DataError(
            f"{problem.names}: the motion integrated from accelerations and rates runs away at once; check their units and signs"
        )
    for iteration in range(1, iterations + 1):
        information, gradient = information_and_gradient(runs, problem.slopes(p, _steps(problem.model)))
        refuse_singular(problem.model, information, problem.names)
        change: Array = np.asarray(-np.linalg.solve(information, gradient), float)
        p, runs, change_made = _step(problem, p, change, runs)
        if iteration in RETUNED:
            problem.settle_turbulence(p, known=True)
        runs = problem.relax(p, 2)
        bound = np.sqrt(np.diag(np.linalg.inv(information)))
        if np.all(np.abs(change_made) < CONVERGED * bound) and iteration > max(RETUNED):
            return p, runs, bool(np.isfinite(problem.cost(runs))), iteration
    return p, runs, False, iterations


def _step(
    problem: CompatibilityProblem, p: Array, change: Array, runs: list[list[Run]]
) -> tuple[Array, list[list[Run]], Array]:
    """The largest of the step, its half, quarter, ... that does not raise the cost: factors, runs, step made."""
    cost = problem.cost(runs)
    limit = cost + ROUNDING * abs(cost)
    lowered = halve_until(
        lambda part: problem.runs(p + part * change), lambda trial: problem.cost(trial) <= limit, HALVINGS
    )
    if lowered is None:
        return p, runs, np.zeros_like(p)
    fraction, trial = lowered
    return p + fraction * change, trial, fraction * change


def _describe(
    problem: CompatibilityProblem,
    flights: Sequence[Flight],
    absent: Mapping[str, str],
    full_model: Model,
    p: Array,
    runs: list[list[Run]],
    slopes: list[list[Array]],
    converged: bool,
    iterations: int,
) -> Compatibility:
    information, _ = information_and_gradient(runs, slopes)
    cramer_rao = np.asarray(np.linalg.inv(information), float)
    full = lag_window_covariance(runs, slopes, information, problem.records[0][0].step)
    estimated = _factors(problem.model, p, cramer_rao, full)
    nan = float("nan")
    factors = {
        q.name: estimated.get(q.name) or FactorEstimate(q.name, q.unit, nan, nan, nan, False, absent[q.name])
        for q in full_model.parameters
    }
    reconstructed = tuple(_reconstructed(problem, i, flight, p, runs[i]) for i, flight in enumerate(flights))
    unsure = [f.name for f in factors.values() if not f.identifiable]
    text = "converged" if converged else f"not converged after {iterations} iterations: take the numbers as indications"
    if unsure:
        text += f"; this data cannot tell {', '.join(unsure)}"
    spread = np.sqrt(np.diag(full))
    correlation = full / spread[:, None] / spread[None, :]
    return Compatibility(factors, correlation, reconstructed, converged, text, iterations, problem.turbulence)


def _factors(model: Model, p: Array, cramer_rao: Array, full: Array) -> dict[str, FactorEstimate]:
    """Estimates with both bounds, and whether these are useful. cramer_rao, full: (n, n) covariances."""
    std, wider = np.sqrt(np.diag(cramer_rao)), np.sqrt(np.diag(full))
    correlation = full / wider[:, None] / wider[None, :]
    factors = {}
    for k, q in enumerate(model.parameters):
        wide = bool(wider[k] > USEFUL[q.unit])
        reason = ""
        if wide:
            reason = f"bound {wider[k]:.2g} {q.unit} is wider than {USEFUL[q.unit]:g}: this flight cannot tell"
            partner = int(np.argmax(np.abs(correlation[k]) - 2.0 * (np.arange(p.size) == k)))
            if abs(correlation[k, partner]) > CORRELATED and partner != k:
                reason += f" it from {model.parameter_names[partner]} (correlation {correlation[k, partner]:+.2f})"
        factors[q.name] = FactorEstimate(q.name, q.unit, float(p[k]), float(std[k]), float(wider[k]), not wide, reason)
    return factors


def _reconstructed(
    problem: CompatibilityProblem, index: int, flight: Flight, p: Array, runs: list[Run]
) -> ReconstructedFlight:
    names = problem.model.output_names
    measured = np.full((len(flight), len(names)), np.nan)
    motion = np.full_like(measured, np.nan)
    spread = _expected_difference(problem, index)
    innovations = []
    for record, run in problem.full_runs(index, p, runs):
        innovations.append(run.normalised.copy())  # a copy lets go of the run, which is large
        rows = slice(record.first, record.first + len(record.time))
        measured[rows] = record.z
        motion[rows] = integrated_motion(problem.model, record, p, run.states, spread)
    whiteness = {}
    for j, name in enumerate(names):
        gamma = lagged_products([e[:, j] for e in innovations], 2)
        whiteness[name] = float(gamma[1] / gamma[0]) if gamma[0] > 0 else 0.0
    noise = dict(zip(names, problem.outputs[index].tolist(), strict=True))
    return ReconstructedFlight(
        flight.name, flight.time, measured, motion, names, noise, whiteness, problem.notes[index]
    )


def _expected_difference(problem: CompatibilityProblem, index: int) -> Array:
    """(ny,) difference of measured and integrated motion in good data: noise, and slow errors of either."""
    slow = dict(DRIFT)
    slow |= {a: max(e, LEAST_SLOW_ERROR * ATTITUDE_ERROR[a]) for a, e in problem.attitude[index].items()}
    return np.array(
        [np.hypot(n, slow[o]) for n, o in zip(problem.outputs[index], problem.model.output_names, strict=True)]
    )
