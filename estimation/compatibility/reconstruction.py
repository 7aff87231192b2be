"""Maximum-likelihood estimation of instrument factors from the innovations of the kinematic filter.

One flight or several with shared factors. Noise of the inputs is read off the flight itself; that of the outputs, and
the turbulence that moves the air under the aircraft, are estimated with the factors (relaxation). Gauss-Newton with
step halving on the innovations; bounds from their information, and corrected for whatever colour is left in them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from estimation.compatibility.kalman import KalmanFilter, NoiseLevels, Record, Run, delayed_outputs
from estimation.errors import DataError
from estimation.models.base import Model
from estimation.models.kinematic import MEASUREMENTS, STANDARD_FACTORS, compatibility_model
from estimation.preprocess import noise_level
from groundstation.flight import Flight

Array = NDArray[np.float64]

SHORTEST = 40  # samples
COLUMNS = ("ax", "ay", "az", "p", "q", "r")
USEFUL: Mapping[str, float] = {
    "m/s2": 0.2, "rad/s": 0.01, "1": 0.1, "rad": 0.02, "m": 0.25, "s": 0.03, "m/s": 1.0,
}  # fmt: skip
"""A bound wider than this, by unit, says nothing worth knowing of an instrument of this kind."""
CORRELATION_WINDOW_S = 2.0
SINGULAR = 1e-9


@dataclass(frozen=True, slots=True)
class Factor:
    """One instrument factor. std: Cramer-Rao bound; std_coloured: corrected for coloured innovations."""

    name: str
    unit: str
    estimate: float
    std: float
    std_coloured: float
    identifiable: bool
    why: str = ""


@dataclass(frozen=True)
class ReconstructedFlight:
    """reconstructed: (N, ny) motion integrated from accelerations and rates with the factors, NaN outside the records;
    whiteness: lag-one autocorrelation of the normalised innovations per output; fit: r2 per output."""

    name: str
    time: Array
    measured: Array
    reconstructed: Array
    outputs: tuple[str, ...]
    noise: Mapping[str, float]
    whiteness: Mapping[str, float]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Compatibility:
    """Factors of one flight, or shared by several."""

    factors: Mapping[str, Factor]
    correlation: Array
    flights: tuple[ReconstructedFlight, ...]
    converged: bool
    text: str
    iterations: int
    turbulence: float  # m/s per root second


def records_of(model: Model, flight: Flight) -> tuple[list[Record], list[str]]:
    """Gap-free stretches of a flight in which all accelerations and rates are measured.

    Raises MissingColumnError, or DataError when no stretch is long enough.
    """
    flight = with_rate_derivatives(flight, model.input_names)
    flight.require(model.input_names, "the data-compatibility check")
    compared = [o for o in model.output_names if flight.measured(o)]
    if len(compared) < 3:
        raise DataError(
            f"{flight.name}: only {', '.join(compared) or 'none'} of V, alpha, beta, phi, theta, psi measured; "
            "the data-compatibility check needs at least three"
        )
    notes = [f"{o} not measured: not compared" for o in model.output_names if o not in compared]
    u = np.column_stack([flight[c] for c in model.input_names])
    nothing = np.full(len(flight), np.nan)
    z = np.column_stack([_output(flight, o) if o in compared else nothing for o in model.output_names])
    whole: NDArray[np.bool_] = np.all(np.isfinite(u), axis=1)
    found = []
    for part in flight.segments:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], whole[part], [False]]).astype(int)))
        for a, b in zip(edges[::2] + part.start, edges[1::2] + part.start, strict=True):
            if b - a >= SHORTEST:
                found.append(Record(int(a), flight.time[a:b], u[a:b], z[a:b]))
            else:
                notes.append(f"{b - a} samples from t = {flight.time[a]:g} s left out: too short a stretch")
    if not found:
        raise DataError(f"{flight.name}: no {SHORTEST} samples in a row with {', '.join(COLUMNS)} all measured")
    return found, notes


def with_rate_derivatives(flight: Flight, wanted: Sequence[str]) -> Flight:
    """The flight with p_dot, q_dot, r_dot where they are wanted and not measured: local parabolas through 5 samples."""
    columns = {}
    for rate in "pqr":
        if f"{rate}_dot" in wanted and not flight.measured(f"{rate}_dot") and flight.measured(rate):
            derivative = np.full(len(flight), np.nan)
            for part in flight.segments:
                if part.stop - part.start >= SHORTEST:
                    derivative[part] = savgol_filter(flight[rate][part], 5, 2, deriv=1, delta=flight.sample_interval)
            columns[f"{rate}_dot"] = derivative
    return flight.with_columns(**columns) if columns else flight


def _output(flight: Flight, name: str) -> Array:
    values = flight[name]
    if name != "psi":
        return values
    known = np.isfinite(values)
    unwrapped = values.copy()
    unwrapped[known] = np.unwrap(values[known])
    return unwrapped


class _Problem:
    """All records of all flights, with starts and noise levels."""

    def __init__(self, model: Model, flights: Sequence[Flight]) -> None:
        flights = [with_rate_derivatives(f, model.input_names) for f in flights]
        self.model = model
        self.filter = KalmanFilter(model, delayed_outputs(model))
        found = [records_of(model, f) for f in flights]
        self.records = [r for r, _ in found]
        self.notes = [tuple(n) for _, n in found]
        self.inputs = [np.array([noise_level(_joined(f[c])) for c in model.input_names]) for f in flights]
        self.outputs = [self._output_noise(rs) for rs in self.records]
        self.turbulence = 0.05

    def _output_noise(self, records: list[Record]) -> Array:
        levels = []
        for j in range(records[0].z.shape[1]):
            column = _joined(np.concatenate([r.z[:, j] for r in records]))
            span = float(np.ptp(column)) if column.size else 1.0
            levels.append(max(noise_level(column) if column.size else 1.0, 1e-4 * span, 1e-6))
        return np.array(levels)

    def noise(self, flight: int) -> NoiseLevels:
        drift = np.array([self.turbulence if s in "uvw" else 0.0 for s in self.model.state_names])
        return NoiseLevels(self.inputs[flight], self.outputs[flight], drift)

    def runs(self, p: Array) -> list[list[Run]]:
        return [
            [self.filter.run(record, p, self.noise(i), *self._start(record, i)) for record in records]
            for i, records in enumerate(self.records)
        ]

    def _start(self, record: Record, flight: int) -> tuple[Array, Array]:
        """First state from the first tenth of a second of measurements, held loosely: the filter finds it."""
        first = {}
        for j, name in enumerate(self.model.output_names):
            early = record.z[: max(3, round(0.2 / record.step)), j]
            early = early[np.isfinite(early)]
            first[name] = float(early.mean()) if early.size else (15.0 if name == "V" else 0.0)
        v, a, b = first["V"], first["alpha"], first["beta"]
        x = [
            v * np.cos(a) * np.cos(b),
            v * np.sin(b),
            v * np.sin(a) * np.cos(b),
            first["phi"],
            first["theta"],
            first["psi"],
        ]
        return np.array(x), np.array([3.0, 3.0, 3.0, 0.2, 0.2, 0.2])

    def cost(self, runs: list[list[Run]]) -> float:
        return sum(r.cost if np.isfinite(r.log_variance) else np.inf for rs in runs for r in rs)

    def relax(self, p: Array, rounds: int) -> list[list[Run]]:
        """Scale the output noise of each flight until its normalised innovations have variance one."""
        runs = self.runs(p)
        for _ in range(rounds):
            for i, flight_runs in enumerate(runs):
                known = np.vstack([r.known for r in flight_runs])
                e = np.vstack([r.normalised for r in flight_runs])
                count = np.maximum(known.sum(axis=0), 1)
                ratio = np.where(known.any(axis=0), (e**2).sum(axis=0) / count, 1.0)
                self.outputs[i] = self.outputs[i] * np.sqrt(np.clip(ratio, 0.05, 20.0))
            runs = self.runs(p)
        return runs

    def settle_turbulence(self, p: Array) -> None:
        """Turbulence of greatest likelihood, by a search over decades and then within one."""
        centre, width = np.log10(max(self.turbulence, 1e-4)), 1.0
        for _ in range(3):
            candidates = np.clip(centre + width * np.array([-1.0, 0.0, 1.0]), -3.5, 0.7)
            costs = []
            kept = [o.copy() for o in self.outputs]
            for candidate in candidates:
                self.turbulence = float(10**candidate)
                self.outputs = [o.copy() for o in kept]
                costs.append(self.cost(self.relax(p, 2)))
            centre = float(candidates[int(np.argmin(costs))])
            self.outputs = kept
            width *= 0.5
        self.turbulence = float(10**centre)

    def slopes(self, p: Array, steps: Array) -> list[list[Array]]:
        """(N, ny, n) derivative of the normalised innovations by the factors, by central differences."""
        columns = []
        for k in range(p.size):
            up, down = p.copy(), p.copy()
            up[k] += steps[k]
            down[k] -= steps[k]
            plus, minus = self.runs(up), self.runs(down)
            columns.append(
                [
                    [(a.normalised - b.normalised) / (2 * steps[k]) for a, b in zip(x, y, strict=True)]
                    for x, y in zip(plus, minus, strict=True)
                ]
            )
        return [
            [np.stack([c[i][j] for c in columns], axis=2) for j in range(len(records))]
            for i, records in enumerate(self.records)
        ]


def _joined(values: Array) -> Array:
    return values[np.isfinite(values)]


def compatibility(
    flights: Flight | Sequence[Flight],
    factors: Sequence[str] = STANDARD_FACTORS,
    *,
    known: Mapping[str, float] | None = None,
    iterations: int = 15,
) -> Compatibility:
    """Estimate instrument factors of one flight, or shared by several. known: factors held at values given.

    Raises ModelError for an unknown factor, MissingColumnError or DataError for flights that cannot be used, and
    DataError naming them when factors cannot be told from each other at all.
    """
    many = [flights] if isinstance(flights, Flight) else list(flights)
    model = compatibility_model(factors, tuple(MEASUREMENTS), known)
    problem = _Problem(model, many)
    p = np.array([q.start for q in model.parameters])
    steps = np.array([1e-3 * USEFUL[q.unit] for q in model.parameters])
    problem.settle_turbulence(p)
    runs = problem.relax(p, 3)
    cost, converged, used = problem.cost(runs), False, 0
    information = np.eye(p.size)
    for used in range(1, iterations + 1):
        slopes = problem.slopes(p, steps)
        information, gradient = _normal(runs, slopes)
        _refuse_singular(model, information, many)
        change: Array = np.asarray(-np.linalg.solve(information, gradient), float)
        p, runs, moved = _step(problem, p, change, runs)
        if used in (1, 3):
            problem.settle_turbulence(p)
        runs = problem.relax(p, 2)
        cost = problem.cost(runs)
        bound = np.sqrt(np.diag(np.linalg.inv(information)))
        if np.all(np.abs(moved) < 0.02 * bound) and used > 3:
            converged = True
            break
    slopes = problem.slopes(p, steps)
    information, _ = _normal(runs, slopes)
    return _describe(problem, many, p, runs, slopes, information, converged and bool(np.isfinite(cost)), used)


def _normal(runs: list[list[Run]], slopes: list[list[Array]]) -> tuple[Array, Array]:
    n = slopes[0][0].shape[2]
    information, gradient = np.zeros((n, n)), np.zeros(n)
    for flight_runs, flight_slopes in zip(runs, slopes, strict=True):
        for run, s in zip(flight_runs, flight_slopes, strict=True):
            information += np.einsum("kjp,kjq->pq", s, s)
            gradient += np.einsum("kjp,kj->p", s, run.normalised)
    return information, gradient


def _refuse_singular(model: Model, information: Array, flights: Sequence[Flight]) -> None:
    """A set of factors that the data cannot separate at all is refused, by name."""
    scale = np.array([USEFUL[q.unit] for q in model.parameters])
    scaled = information * scale[:, None] * scale[None, :]
    blind = np.diag(scaled) < SINGULAR * max(float(np.diag(scaled).max()), 1e-300)
    names = ", ".join(f.name for f in flights)
    if blind.any():
        gone = ", ".join(n for n, b in zip(model.parameter_names, blind, strict=True) if b)
        raise DataError(f"{names}: {gone} leaves no trace in any measured channel; leave it out with --factors")
    d = np.sqrt(np.diag(scaled))
    values, vectors = np.linalg.eigh(scaled / d[:, None] / d[None, :])
    if values[0] < SINGULAR:
        tied = [n for n, w in zip(model.parameter_names, np.abs(vectors[:, 0]), strict=True) if w > 0.2]
        raise DataError(
            f"{names}: {' and '.join(tied)} cannot be told from each other in this data; leave one of them out with --factors"
        )


def _step(problem: _Problem, p: Array, change: Array, runs: list[list[Run]]) -> tuple[Array, list[list[Run]], Array]:
    """The largest of the step, its half, quarter, ... that lowers the cost."""
    before = problem.cost(runs)
    for scale in 0.5 ** np.arange(8):
        trial = problem.runs(p + scale * change)
        if problem.cost(trial) <= before + 1e-9 * abs(before):
            return p + scale * change, trial, scale * change
    return p, runs, np.zeros_like(p)


def _coloured(runs: list[list[Run]], slopes: list[list[Array]], information: Array, step: float) -> Array:
    """Covariance with the correlation left in the innovations counted (Morelli and Klein 1997): sandwich with the
    estimated autocorrelation per channel, tapered over CORRELATION_WINDOW_S."""
    lags = max(1, round(CORRELATION_WINDOW_S / step))
    meat = np.zeros_like(information)
    for flight_runs, flight_slopes in zip(runs, slopes, strict=True):
        known = np.vstack([r.known for r in flight_runs])
        for j in range(known.shape[1]):
            gamma = _autocorrelation([r.normalised[:, j] for r in flight_runs], lags)
            for s in flight_slopes:
                column = s[:, j, :]
                meat += gamma[0] * column.T @ column
                for lag in range(1, min(lags, len(column) - 1)):
                    taper = 1.0 - lag / lags
                    cross = column[:-lag].T @ column[lag:]
                    meat += taper * gamma[lag] * (cross + cross.T)
    inverse = np.linalg.inv(information)
    covariance = inverse @ meat @ inverse
    plain = np.diag(inverse)
    diagonal = np.maximum(np.diag(covariance), plain)  # the correction never makes a bound smaller
    grow = np.sqrt(diagonal / np.maximum(np.diag(covariance), 1e-300))
    return np.asarray(covariance * grow[:, None] * grow[None, :])


def _autocorrelation(series: list[Array], lags: int) -> Array:
    total = sum(len(s) for s in series)
    return np.array([sum(float(s[: len(s) - k] @ s[k:]) for s in series if len(s) > k) / total for k in range(lags)])


def _describe(
    problem: _Problem,
    flights: Sequence[Flight],
    p: Array,
    runs: list[list[Run]],
    slopes: list[list[Array]],
    information: Array,
    converged: bool,
    used: int,
) -> Compatibility:
    model = problem.model
    plain = np.linalg.inv(information)
    full = _coloured(runs, slopes, information, problem.records[0][0].step)
    std, coloured = np.sqrt(np.diag(plain)), np.sqrt(np.diag(full))
    correlation = full / coloured[:, None] / coloured[None, :]
    factors = {}
    for k, q in enumerate(model.parameters):
        wide = bool(coloured[k] > USEFUL[q.unit])
        partner = int(np.argmax(np.abs(correlation[k]) - 2.0 * (np.arange(p.size) == k)))
        why = ""
        if wide:
            why = f"bound {coloured[k]:.2g} {q.unit} is wider than {USEFUL[q.unit]:g}: this flight cannot tell"
            if abs(correlation[k, partner]) > 0.9:
                why += f" it from {model.parameter_names[partner]} (correlation {correlation[k, partner]:+.2f})"
        factors[q.name] = Factor(q.name, q.unit, float(p[k]), float(std[k]), float(coloured[k]), not wide, why)
    reconstructed = tuple(_reconstructed(problem, i, flight, p, runs[i]) for i, flight in enumerate(flights))
    unsure = [f.name for f in factors.values() if not f.identifiable]
    text = "converged" if converged else f"not converged after {used} iterations: take the numbers as indications"
    if unsure:
        text += f"; this data cannot tell {', '.join(unsure)}"
    return Compatibility(factors, correlation, reconstructed, converged, text, used, problem.turbulence)


def _reconstructed(problem: _Problem, index: int, flight: Flight, p: Array, runs: list[Run]) -> ReconstructedFlight:
    names = problem.model.output_names
    measured = np.full((len(flight), len(names)), np.nan)
    predicted = np.full_like(measured, np.nan)
    for record, run in zip(problem.records[index], runs, strict=True):
        rows = slice(record.first, record.first + len(record.time))
        measured[rows], predicted[rows] = record.z, run.predicted
    whiteness = {}
    for j, name in enumerate(names):
        gamma = _autocorrelation([r.normalised[:, j] for r in runs], 2)
        whiteness[name] = float(gamma[1] / gamma[0]) if gamma[0] > 0 else 0.0
    noise = dict(zip(names, problem.outputs[index].tolist(), strict=True))
    return ReconstructedFlight(
        flight.name, flight.time, measured, predicted, names, noise, whiteness, problem.notes[index]
    )
