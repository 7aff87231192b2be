"""The records of all flights of one check that its factors are estimated from, with their starts, noise levels and bounds.

Noise of the inputs is read off the flight itself; that of the outputs, and the turbulence that moves the air under the
aircraft, are scaled until the innovations of the filter are as large as it predicts them (relaxation). Bounds are from the
information of the innovations, with the correlation left in them counted by a lag window.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from estimation.compatibility.excited import LONG_SAMPLES, even_parts, excited_pieces
from estimation.compatibility.kalman import FilterRecord, KalmanFilter, NoiseLevels, Run
from estimation.compatibility.records import attitude_errors, records_of, with_rate_derivatives
from estimation.errors import DataError
from estimation.estimators.coloured import autocovariance
from estimation.models.base import Model
from estimation.models.kinematic import FILTER_ERRORS
from estimation.signals.denoise import noise_level
from groundstation.flight import Array, Flight

_TURBULENCE_LOG10 = (-3.5, 0.7)  # of m/s per root second

SMALLEST = 1e-6
"""Noise [output's unit] below which no channel is believed to be."""


class CompatibilityProblem:
    """Records of all flights, with starts and noise levels. records: those that factors are estimated from; whole: all."""

    def __init__(self, model: Model, flights: Sequence[Flight]) -> None:
        flights = [with_rate_derivatives(f, model.input_names) for f in flights]
        self.attitude = [attitude_errors(f) for f in flights]
        self.model = model
        self.names = ", ".join(f.name for f in flights)
        self.filter = KalmanFilter(model)
        recorded = [records_of(model, f) for f in flights]
        self.whole = [r for r, _ in recorded]
        excited = [excited_pieces(r) for r in self.whole]
        self.records = [r for r, _ in excited]
        self.notes = [
            (*notes, *([part] if part else []), *_filter_note(errors))
            for (_, notes), (_, part), errors in zip(recorded, excited, self.attitude, strict=True)
        ]
        self.inputs = [np.array([noise_level(finite_values(f[c])) for c in model.input_names]) for f in flights]
        self.outputs = [self._output_noise(rs) for rs in self.whole]
        self.turbulence = 0.05

    def _output_noise(self, records: list[FilterRecord]) -> Array:
        levels = []
        for j in range(records[0].z.shape[1]):
            column = finite_values(np.concatenate([r.z[:, j] for r in records]))
            span = float(np.ptp(column)) if column.size else 1.0
            levels.append(max(noise_level(column) if column.size else 1.0, 1e-4 * span, SMALLEST))
        return np.array(levels)

    def noise(self, flight: int) -> NoiseLevels:
        drift = {"u": self.turbulence, "v": self.turbulence, "w": self.turbulence}
        for state, (sigma, memory) in self._filter_errors(flight).items():
            drift[state] = sigma * np.sqrt(2.0 / memory)
        in_order = [drift.get(s, 0.0) for s in self.model.state_names]
        return NoiseLevels(self.inputs[flight], self.outputs[flight], np.array(in_order))

    def _filter_errors(self, flight: int) -> dict[str, tuple[float, float]]:
        """State -> its standard deviation [rad] and time constant [s]."""
        return {
            f"{angle}_{kind}": (share * sigma, memory)
            for angle, sigma in self.attitude[flight].items()
            for kind, (share, memory) in FILTER_ERRORS.items()
        }

    def runs(self, p: Array) -> list[list[Run]]:
        return [[self._filtered(i, r, p) for r in records] for i, records in enumerate(self.records)]

    def whole_runs(self, flight: int, p: Array, runs: list[Run]) -> Iterator[tuple[FilterRecord, Run]]:
        """All of a flight in blocks, each with its run. runs: those over its `records`, used again where they are all of it."""
        if self.whole[flight] is self.records[flight]:
            yield from zip(self.records[flight], runs, strict=True)
            return
        for record in (block for whole in self.whole[flight] for block in even_parts(whole, LONG_SAMPLES)):
            yield record, self._filtered(flight, record, p)

    def _filtered(self, flight: int, record: FilterRecord, p: Array) -> Run:
        return self.filter.run(record, p, self.noise(flight), *self._start(record, flight))

    def _start(self, record: FilterRecord, flight: int) -> tuple[Array, Array]:
        """First state from the first tenth of a second of measurements, held loosely: the filter finds it."""
        first = {}
        for j, name in enumerate(self.model.output_names):
            first_samples = record.z[: max(3, round(0.2 / record.step)), j]
            first_samples = first_samples[np.isfinite(first_samples)]
            first[name] = float(first_samples.mean()) if first_samples.size else (15.0 if name == "V" else 0.0)
        v, a, b = first["V"], first["alpha"], first["beta"]
        start = {
            "u": (v * np.cos(a) * np.cos(b), 3.0),
            "v": (v * np.sin(b), 3.0),
            "w": (v * np.sin(a) * np.cos(b), 3.0),
            "phi": (first["phi"], 0.2),
            "theta": (first["theta"], 0.2),
            "psi": (first["psi"], np.pi),  # nothing else depends on it, so that a late first heading does no harm
            **{name: (0.0, sigma) for name, (sigma, _) in self._filter_errors(flight).items()},
        }
        x, spread = np.array([start[s] for s in self.model.state_names]).T
        return x, spread

    def cost(self, runs: list[list[Run]]) -> float:
        return sum(r.cost if np.isfinite(r.log_variance) else np.inf for rs in runs for r in rs)

    def relax(self, p: Array, rounds: int) -> list[list[Run]]:
        """Scale the output noise of each flight until its normalised innovations have variance one."""
        runs = self.runs(p)
        for _ in range(rounds):
            for i, flight_runs in enumerate(runs):
                measured = np.vstack([r.known for r in flight_runs])
                e = np.vstack([r.normalised for r in flight_runs])
                count = np.maximum(measured.sum(axis=0), 1)
                ratio = np.where(measured.any(axis=0), (e**2).sum(axis=0) / count, 1.0)
                self.outputs[i] = np.maximum(self.outputs[i] * np.sqrt(np.clip(ratio, 0.05, 20.0)), SMALLEST)
            runs = self.runs(p)
        return runs

    def settle_turbulence(self, p: Array, *, known: bool = False) -> None:
        """Turbulence of greatest likelihood, by a search over decades and then within one; known: only near the present."""
        centre, width = float(np.log10(max(self.turbulence, 1e-4))), 0.5 if known else 1.0
        noise_before = [o.copy() for o in self.outputs]
        costs: dict[float, float] = {}
        for _ in range(2 if known else 3):
            for candidate in np.clip(centre + width * np.array([-1.0, 0.0, 1.0]), *_TURBULENCE_LOG10).tolist():
                if candidate not in costs:
                    self.turbulence = float(10**candidate)
                    self.outputs = [o.copy() for o in noise_before]
                    costs[candidate] = self.cost(self.relax(p, 2))
            centre = min(costs, key=lambda c: costs[c])
            width *= 0.5
        self.outputs = noise_before
        self.turbulence = float(10**centre)

    def slopes(self, p: Array, steps: Array) -> list[list[Array]]:
        """(N, ny, n) derivative of the normalised innovations by the factors, by central differences."""
        columns = []
        for k in range(p.size):
            p_plus, p_minus = p.copy(), p.copy()
            p_plus[k] += steps[k]
            p_minus[k] -= steps[k]
            plus, minus = self.runs(p_plus), self.runs(p_minus)
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


def _filter_note(errors: dict[str, float]) -> tuple[str, ...]:
    sizes = [f"{angle} {np.degrees(sigma):.1f} deg" for angle, sigma in errors.items() if sigma]
    if not sizes:
        return ()
    return (
        f"attitude is smoother than its gyro: it comes from a filter, whose slow errors ({', '.join(sizes)}) are allowed for; "
        "no bias of ax or ay can be told much better than that much of gravity",
    )


def finite_values(values: Array) -> Array:
    return values[np.isfinite(values)]


USEFUL: Mapping[str, float] = {"m/s2": 0.2, "rad/s": 0.01, "1": 0.1, "rad": 0.02, "m": 0.25, "s": 0.03, "m/s": 1.0}
"""A bound wider than this, by unit, says nothing worth knowing of an instrument of this kind."""
CORRELATION_WINDOW_S = 2.0
SINGULAR = 1e-9


def information_and_gradient(runs: list[list[Run]], slopes: list[list[Array]]) -> tuple[Array, Array]:
    n = slopes[0][0].shape[2]
    information, gradient = np.zeros((n, n)), np.zeros(n)
    for flight_runs, flight_slopes in zip(runs, slopes, strict=True):
        for run, s in zip(flight_runs, flight_slopes, strict=True):
            information += np.einsum("kjp,kjq->pq", s, s)
            gradient += np.einsum("kjp,kj->p", s, run.normalised)
    return information, gradient


def refuse_singular(model: Model, information: Array, names: str) -> None:
    """A set of factors that the data cannot separate at all is refused, by name. names: of the flights, for the message."""
    if not np.isfinite(information).all():
        raise DataError(f"{names}: the motion integrated from accelerations and rates runs away; check units and signs")
    scale = np.array([USEFUL[q.unit] for q in model.parameters])
    scaled = information * scale[:, None] * scale[None, :]
    blind = np.diag(scaled) < SINGULAR * max(float(np.diag(scaled).max()), 1e-300)
    if blind.any():
        invisible = ", ".join(n for n, b in zip(model.parameter_names, blind, strict=True) if b)
        raise DataError(f"{names}: {invisible} leaves no trace in any measured channel; leave it out with --factors")
    d = np.sqrt(np.diag(scaled))
    values, vectors = np.linalg.eigh(scaled / d[:, None] / d[None, :])
    if values[0] < SINGULAR:
        tied = [n for n, w in zip(model.parameter_names, np.abs(vectors[:, 0]), strict=True) if w > 0.2]
        raise DataError(
            f"{names}: {' and '.join(tied)} cannot be told from each other in this data; leave one of them out with --factors"
        )


def lag_window_covariance(runs: list[list[Run]], slopes: list[list[Array]], information: Array, step: float) -> Array:
    """Covariance with the correlation left in the innovations counted (Morelli and Klein 1997): sandwich with the
    estimated autocorrelation per channel, tapered over CORRELATION_WINDOW_S."""
    lags = max(1, round(CORRELATION_WINDOW_S / step))
    meat = np.zeros_like(information)
    for flight_runs, flight_slopes in zip(runs, slopes, strict=True):
        measured = np.vstack([r.known for r in flight_runs])
        for j in range(measured.shape[1]):
            gamma = lagged_products([r.normalised[:, j] for r in flight_runs], lags)
            for s in flight_slopes:
                column = s[:, j, :]
                meat += gamma[0] * column.T @ column
                for lag in range(1, min(lags, len(column) - 1)):
                    taper = 1.0 - lag / lags
                    cross = column[:-lag].T @ column[lag:]
                    meat += taper * gamma[lag] * (cross + cross.T)
    inverse = np.linalg.inv(information)
    covariance = inverse @ meat @ inverse
    variances = np.diag(inverse)
    diagonal = np.maximum(np.diag(covariance), variances)  # the correction never makes a bound smaller
    grow = np.sqrt(diagonal / np.maximum(np.diag(covariance), 1e-300))
    return np.asarray(covariance * grow[:, None] * grow[None, :])


def lagged_products(series: list[Array], lags: int) -> Array:
    """(lags,) autocovariance of one channel over its stretches (N,), from lag 0 on."""
    return autocovariance([s[:, None] for s in series], [np.ones((len(s), 1), bool) for s in series], lags - 1)[:, 0, 0]
