"""The records of all flights of one check, with starts of the filter, noise levels and bounds of the factors.

Noise of the inputs is measured in the flight; that of the outputs, and the turbulence, are scaled until the innovations of the
filter are as large as predicted (relaxation). Bounds come from the information of the innovations; a lag window allows for the
correlation that is left in them.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from estimation.compatibility.excited import LONG_SAMPLES, even_parts, excited_pieces
from estimation.compatibility.kalman import FilterRecord, KalmanFilter, NoiseLevels, Run
from estimation.compatibility.records import attitude_errors, finite_values, records_of, with_rate_derivatives
from estimation.errors import DataError
from estimation.estimators.coloured import autocovariance
from estimation.models.base import Model
from estimation.models.kinematic import FILTER_ERRORS
from estimation.signals.denoise import noise_level
from groundstation.flight import Array, Flight

_TURBULENCE_LOG10 = (-3.5, 0.7)  # range of the search, of m/s per root second
_SEARCH, _NARROW_SEARCH = (
    (1.0, 3),
    (0.5, 2),
)  # first step [decades], rounds; from scratch, near a known value

SMALLEST, SMALLEST_SHARE = 1e-6, 1e-4
"""Least noise of a channel: in its unit, and of its range."""
FIRST_TURBULENCE = 0.05  # m/s per root second
UNKNOWN_SPEED = 15.0  # m/s, of a small aircraft: start of the filter where airspeed is not measured
START_S = 0.2  # s of measurements that the first state is a mean of
MOST_SCALING = (0.05, 20.0)  # least and greatest factor of an output's noise variance in one round of relaxation
TIED = 0.2  # component of an eigenvector from which a factor is named as part of an inseparable set


class CompatibilityProblem:
    """Records of all flights, with starts and noise levels. records: those that factors are estimated from; full_records: all."""

    def __init__(self, model: Model, flights: Sequence[Flight]) -> None:
        flights = [with_rate_derivatives(f, model.input_names) for f in flights]
        self.attitude = [attitude_errors(f) for f in flights]
        self.model = model
        self.names = ", ".join(f.name for f in flights)
        self.filter = KalmanFilter(model)
        recorded = [records_of(model, f) for f in flights]
        self.full_records = [r for r, _ in recorded]
        excited = [excited_pieces(r) for r in self.full_records]
        self.records = [r for r, _ in excited]
        self.notes = [
            (*notes, *([part] if part else []), *_filter_note(errors))
            for (_, notes), (_, part), errors in zip(recorded, excited, self.attitude, strict=True)
        ]
        self.inputs = [np.array([noise_level(finite_values(f[c])) for c in model.input_names]) for f in flights]
        self.outputs = [self._output_noise(rs) for rs in self.full_records]
        self.turbulence = FIRST_TURBULENCE

    def _output_noise(self, records: list[FilterRecord]) -> Array:
        levels = []
        for j in range(records[0].z.shape[1]):
            column = finite_values(np.concatenate([r.z[:, j] for r in records]))
            span = float(np.ptp(column)) if column.size else 1.0
            levels.append(max(noise_level(column) if column.size else 1.0, SMALLEST_SHARE * span, SMALLEST))
        return np.array(levels)

    def noise(self, flight: int) -> NoiseLevels:
        """The present noise levels of a flight."""
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
        """Runs of the filter over the records of each flight with factors p (n,)."""
        return [[self._filtered(i, r, p) for r in records] for i, records in enumerate(self.records)]

    def full_runs(self, flight: int, p: Array, runs: list[Run]) -> Iterator[tuple[FilterRecord, Run]]:
        """The full records of a flight in blocks, each with its run. runs: over its `records`, used again where these are all."""
        if self.full_records[flight] is self.records[flight]:
            yield from zip(self.records[flight], runs, strict=True)
            return
        for record in (block for full in self.full_records[flight] for block in even_parts(full, LONG_SAMPLES)):
            yield record, self._filtered(flight, record, p)

    def _filtered(self, flight: int, record: FilterRecord, p: Array) -> Run:
        return self.filter.run(record, p, self.noise(flight), *self._start(record, flight))

    def _start(self, record: FilterRecord, flight: int) -> tuple[Array, Array]:
        """First state and its standard deviations, from the mean of the first measurements; loose, for the filter to correct."""
        first = {}
        for j, name in enumerate(self.model.output_names):
            first_samples = record.z[: max(3, round(START_S / record.step)), j]
            first_samples = first_samples[np.isfinite(first_samples)]
            first[name] = float(first_samples.mean()) if first_samples.size else (UNKNOWN_SPEED if name == "V" else 0.0)
        v, a, b = first["V"], first["alpha"], first["beta"]
        start = {
            "u": (v * np.cos(a) * np.cos(b), 3.0),
            "v": (v * np.sin(b), 3.0),
            "w": (v * np.sin(a) * np.cos(b), 3.0),
            "phi": (first["phi"], 0.2),
            "theta": (first["theta"], 0.2),
            "psi": (first["psi"], np.pi),  # no other state depends on it, so that a late first heading does no harm
            **{name: (0.0, sigma) for name, (sigma, _) in self._filter_errors(flight).items()},
        }
        x, spread = np.array([start[s] for s in self.model.state_names]).T
        return x, spread

    def cost(self, runs: list[list[Run]]) -> float:
        """Negative log likelihood of all runs, without constants; infinite where one diverged."""
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
                self.outputs[i] = np.maximum(self.outputs[i] * np.sqrt(np.clip(ratio, *MOST_SCALING)), SMALLEST)
            runs = self.runs(p)
        return runs

    def settle_turbulence(self, p: Array, *, known: bool = False) -> None:
        """Set the turbulence of greatest likelihood, by a search over decades, then finer. known: search near the present one."""
        centre = float(np.log10(max(self.turbulence, 1e-4)))
        width, rounds = _NARROW_SEARCH if known else _SEARCH
        noise_before = [o.copy() for o in self.outputs]
        costs: dict[float, float] = {}
        for _ in range(rounds):
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
        """(N, ny, n) derivatives of the normalised innovations of each record by the factors: central differences of `steps`
        (n,)."""
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
        "a bias of ax or ay cannot be known much better than that share of gravity",
    )


USEFUL: Mapping[str, float] = {"m/s2": 0.2, "rad/s": 0.01, "1": 0.1, "rad": 0.02, "m": 0.25, "s": 0.03, "m/s": 1.0}
"""Widest useful bound of a factor, by its unit."""
CORRELATION_WINDOW_S = 2.0  # lag beyond which innovations count as uncorrelated
SINGULAR = 1e-9  # of the largest information, or of an eigenvalue of its correlations: less is none


def information_and_gradient(runs: list[list[Run]], slopes: list[list[Array]]) -> tuple[Array, Array]:
    """(n, n) information of the factors and (n,) gradient of the cost."""
    n = slopes[0][0].shape[2]
    information, gradient = np.zeros((n, n)), np.zeros(n)
    for flight_runs, flight_slopes in zip(runs, slopes, strict=True):
        for run, s in zip(flight_runs, flight_slopes, strict=True):
            information += np.einsum("kjp,kjq->pq", s, s)
            gradient += np.einsum("kjp,kj->p", s, run.normalised)
    return information, gradient


def refuse_singular(model: Model, information: Array, names: str) -> None:
    """Raise DataError naming factors that the data cannot separate. names: of the flights, for the message."""
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
        tied = [n for n, w in zip(model.parameter_names, np.abs(vectors[:, 0]), strict=True) if w > TIED]
        raise DataError(
            f"{names}: {' and '.join(tied)} cannot be told from each other in this data; leave one of them out with --factors"
        )


def lag_window_covariance(runs: list[list[Run]], slopes: list[list[Array]], information: Array, step: float) -> Array:
    """(n, n) covariance of the factors that allows for the correlation left in the innovations (Morelli and Klein 1997): sandwich
    with the autocorrelation of each channel, tapered over CORRELATION_WINDOW_S. step: sample interval [s]."""
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
    widening = np.sqrt(diagonal / np.maximum(np.diag(covariance), 1e-300))
    return np.asarray(covariance * widening[:, None] * widening[None, :])


def lagged_products(series: list[Array], lags: int) -> Array:
    """(lags,) autocovariance of one channel over its stretches (N,), from lag 0 on."""
    return autocovariance([s[:, None] for s in series], [np.ones((len(s), 1), bool) for s in series], lags - 1)[:, 0, 0]
