"""A time-varying extended Kalman filter for any traced model, as one CasADi function per step.

Flight-path reconstruction integrates measured accelerations and rates. Their noise integrates to a random walk, which output
error would take for biases, with bounds tens of times too small. Here the noise of each input sample is process noise of known
size, and the likelihood is that of the innovations (Maine and Iliff 1981; Jategaonkar, Flight Vehicle System Identification,
ch. 5). The bounds hold if normalised innovations are white with variance one, as they are for the right model and noise levels.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from estimation.engine.compiled import Chain
from estimation.engine.trace import rk4, trace
from estimation.models.base import Model
from estimation.models.parts import ModelStructure

Array = NDArray[np.float64]

LONGEST_DELAY = 0.3
"""Largest delay or lead of a channel [s] that is estimated."""


@dataclass(frozen=True)
class FilterRecord:
    """One stretch without a gap. first: row in the flight; time: (N,); u: (N, nu) inputs; z: (N, ny) outputs, NaN if not
    measured."""

    first: int
    time: Array
    u: Array
    z: Array

    @cached_property
    def step(self) -> float:
        """Sample interval [s]."""
        return float(np.median(np.diff(self.time)))

    @cached_property
    def measured(self) -> NDArray[np.bool_]:
        """(N, ny) which outputs were measured."""
        return np.isfinite(self.z)

    @cached_property
    def table(self) -> Array:
        """(N, 2 nu + 2 ny) rows that the filter reads: inputs at this sample and the next, outputs, whether measured. Cached,
        because an estimate of factors reads it a hundred times."""
        return rows_of(self.u, self.z)

    def parts(self, count: int) -> list["FilterRecord"]:
        """The record in `count` pieces of equal length."""
        edges = np.linspace(0, len(self.time), count + 1).astype(int).tolist()
        return [FilterRecord(self.first + a, self.time[a:b], self.u[a:b], self.z[a:b]) for a, b in pairwise(edges)]


def rows_of(u: Array, z: Array) -> Array:
    """`FilterRecord.table` of inputs (N, nu) and outputs (N, ny)."""
    measured = np.isfinite(z)
    return np.hstack([u, np.vstack([u[1:], u[-1:]]), np.where(measured, z, 0.0), measured.astype(float)])


@dataclass(frozen=True)
class NoiseLevels:
    """Standard deviations: of the inputs (nu,), of the outputs (ny,); drift: of the states per root second (nx,)."""

    inputs: Array
    outputs: Array
    drift: Array


@dataclass(frozen=True)
class Run:
    """normalised: (N, ny) innovations over their predicted deviation, 0 where not measured; known: (N, ny) bool;
    log_variance: sum over known samples; states: (N, nx) after each update; predicted: (N, ny) before it."""

    normalised: Array
    known: NDArray[np.bool_]
    log_variance: float
    states: Array
    predicted: Array

    @property
    def cost(self) -> float:
        """Negative log likelihood, without constants."""
        return 0.5 * float(np.sum(self.normalised**2)) + 0.5 * self.log_variance


class KalmanFilter:
    """Filter of one model. Parameters are given as the vector of all model parameters. delayed: as of `delayed_outputs`."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.delayed = delayed_outputs(model)
        self._constants = np.array([model.constants[n] for n in model.structure.remaining_constants])
        self._chain = _filter_chain(model.structure, self.delayed)

    def run(self, record: FilterRecord, p: Array, noise: NoiseLevels, x0: Array, spread: Array) -> Run:
        """Filter one record. x0: (nx,) start; spread: (nx,) its standard deviation."""
        model, count = self.model, len(record.time)
        nx, ny = len(model.states), len(model.outputs)
        if self.delayed:
            z, fractions = self._at_their_instants(record, p)
            rows, measured = rows_of(record.u, z), self._usable(record)
        else:
            rows, measured, fractions = record.table, record.measured, np.zeros(0)
        levels = (noise.inputs**2, noise.outputs**2, noise.drift**2)
        fixed = np.concatenate([p, self._constants, *levels, [record.step], fractions])
        state = np.concatenate([x0, np.diag(spread**2).ravel()])
        rows_out = self._in_rows_of_the_record(self._chain.run(state, rows, fixed), record, p)
        normalised, log_s = rows_out[:, :ny], rows_out[:, ny : 2 * ny]
        finite = len(rows_out) == count and bool(np.all(np.isfinite(rows_out)))
        log_variance = float(np.sum(log_s[measured[: len(rows_out)]])) if finite else np.inf
        return Run(normalised, measured, log_variance, rows_out[:, 2 * ny : 2 * ny + nx], rows_out[:, 2 * ny + nx :])

    def _usable(self, record: FilterRecord) -> NDArray[np.bool_]:
        """(N, ny) which samples count: of a delayed channel none within LONGEST_DELAY of the ends, so that the same samples count
        whatever the delay."""
        usable = np.isfinite(record.z)
        edge = int(np.ceil(LONGEST_DELAY / record.step))
        for output, _ in self.delayed:
            usable[:edge, output] = usable[len(usable) - edge :, output] = False
        return usable

    def _at_their_instants(self, record: FilterRecord, p: Array) -> tuple[Array, Array]:
        """(N, ny) outputs, delayed ones moved to the last sample before the instant that they show; and that instant within the
        sample interval after it, as a fraction."""
        z, fractions = np.where(self._usable(record), record.z, np.nan), []
        for output, parameter in self.delayed:
            delay = float(p[parameter]) / record.step
            rows = int(np.ceil(delay))
            z[:, output] = _moved(z[:, output], -rows, np.nan)
            fractions.append(rows - delay)
        return z, np.array(fractions)

    def _in_rows_of_the_record(self, rows_out: Array, record: FilterRecord, p: Array) -> Array:
        """Rows of the filter with those of a delayed channel back where it was measured."""
        ny = len(self.model.outputs)
        for output, parameter in self.delayed:
            rows = int(np.ceil(float(p[parameter]) / record.step))
            for column in (output, ny + output, rows_out.shape[1] - ny + output):
                rows_out[:, column] = _moved(rows_out[:, column], rows, 0.0)
        return rows_out


def _moved(values: Array, rows: int, empty: float) -> Array:
    """Values shifted down by `rows`; `empty` in the rows that this leaves free."""
    result = np.full_like(values, empty)
    count = len(values)
    if abs(rows) < count:
        result[max(0, rows) : count + min(0, rows)] = values[max(0, -rows) : count - max(0, rows)]
    return result


@lru_cache(maxsize=32)
def _filter_chain(structure: ModelStructure, delayed: tuple[tuple[int, int], ...]) -> Chain:
    return Chain(_filter_step(structure, delayed))


def delayed_outputs(model: Model) -> tuple[tuple[int, int], ...]:
    """Pairs (output index, parameter index) of the delayed outputs of a model."""
    return tuple(
        (model.output_names.index(o), model.parameter_names.index(p)) for o, p in sorted(model.output_delays.items())
    )


def _filter_step(structure: ModelStructure, delayed: tuple[tuple[int, int], ...]) -> ca.Function:
    """(state and covariance; data; constants) -> (state and covariance one sample later; normalised innovations, log variances,
    corrected state, predicted outputs)."""
    traced = trace(structure)
    nx, nu, np_, ny = traced.sizes
    x, P = ca.SX.sym("x", nx), ca.SX.sym("P", nx, nx)
    u0, u1 = ca.SX.sym("u0", nu), ca.SX.sym("u1", nu)
    z, measured = ca.SX.sym("z", ny), ca.SX.sym("known", ny)
    p, h = ca.SX.sym("p", np_), ca.SX.sym("h")
    q, r, drift = ca.SX.sym("q", nu), ca.SX.sym("r", ny), ca.SX.sym("drift", nx)

    fraction = ca.SX.sym("fraction", len(delayed))
    xs, d = ca.SX.sym("xs", nx), ca.SX.sym("d", nu)
    zero = ca.DM.zeros(nu)

    def integrated(state: ca.SX, inputs: tuple[ca.SX, ca.SX, ca.SX], step: ca.SX) -> ca.SX:
        return rk4(lambda states, u: (traced.rates(*states, u, p),), (state,), inputs, step)[0]

    lagging = {output: i for i, (output, _) in enumerate(delayed)}
    y_now = traced.outputs(x, u0, p)
    predicted, delay_variances = [], []
    for j in range(ny):
        if j in lagging:
            part = fraction[lagging[j]]
            u_end = u0 + part * (u1 - u0)
            delayed_state = integrated(x, (u0 + d, (u0 + u_end) / 2 + d, u_end + d), part * h)
            delayed_output = traced.outputs(delayed_state, u_end, p)[j]
            # noise of the inputs within that part of the interval, which is not in the covariance of the state
            by_noise = ca.substitute(ca.jacobian(delayed_output, d), d, zero)
            predicted.append(ca.substitute(delayed_output, d, zero))
            delay_variances.append(ca.mtimes(ca.mtimes(by_noise, ca.diag(q)), by_noise.T))
        else:
            predicted.append(y_now[j])
            delay_variances.append(ca.SX(0))
    y = ca.vertcat(*predicted)
    H = ca.jacobian(y, x)
    xf, Pf, normalised, logs = _measurement_update(x, P, H, measured, z - y, r, delay_variances)
    advanced = integrated(xs, (u0 + d, (u0 + u1) / 2 + d, u1 + d), h)
    F, G = (ca.substitute(ca.jacobian(advanced, v), d, zero) for v in (xs, d))
    move = ca.Function("move", [xs, u0, u1, p, h], [ca.substitute(advanced, d, zero), F, G])
    next_state, Fk, Gk = move(xf, u0, u1, p, h)
    Pn = ca.mtimes(ca.mtimes(Fk, Pf), Fk.T) + ca.mtimes(ca.mtimes(Gk, ca.diag(q)), Gk.T) + ca.diag(drift) * h

    state_in = ca.vertcat(x, ca.reshape(P, nx * nx, 1))
    data = ca.vertcat(u0, u1, z, measured)
    fixed = ca.vertcat(p, q, r, drift, h, fraction)
    state_out = ca.vertcat(next_state, ca.reshape(Pn, nx * nx, 1))
    outputs = ca.vertcat(normalised, logs, xf, y)
    return ca.Function("kalman", [state_in, data, fixed], ca.cse([state_out, outputs]))


def _measurement_update(
    x: ca.SX,
    P: ca.SX,
    H: ca.SX,
    measured: ca.SX,
    difference: ca.SX,
    r: ca.SX,
    delay_variances: Sequence[ca.SX],
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Corrected state and covariance, normalised innovations and log variances (ny,) of the measured outputs.

    difference: measured minus predicted outputs (ny,); r: variances of their noise (ny,), which is independent, so that the
    outputs are processed one after the other without inverting a matrix; delay_variances: of the inputs' noise during an
    output's delay."""
    xf, Pf = x, P
    normalised, logs = [], []
    for j in range(difference.numel()):
        row = H[j, :]
        innovation = difference[j] - ca.mtimes(row, xf - x)
        s = ca.mtimes(ca.mtimes(row, Pf), row.T) + r[j] + delay_variances[j]
        gain = measured[j] * ca.mtimes(Pf, row.T) / s
        xf = xf + gain * innovation
        Pf = Pf - ca.mtimes(gain, ca.mtimes(row, Pf))
        normalised.append(measured[j] * innovation / ca.sqrt(s))
        logs.append(ca.log(s))
    return xf, (Pf + Pf.T) / 2, ca.vertcat(*normalised), ca.vertcat(*logs)
