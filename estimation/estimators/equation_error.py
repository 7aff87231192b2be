"""Equation error: parameters by least squares at the measured states, no simulation (`ls`).

The increments of the measured (smoothed) states over each interval are compared with the mean of the model's rates at
both ends, and the measured outputs with the model's at each sample. Where the parameters enter linearly this is one least-squares
solution. All states of the model must be measured. `stepwise` selects parameters by partial F ratios
(V. Klein and E. A. Morelli, Aircraft System Identification, 2nd ed., section 5.4).

Known error: at 20 Hz a roll mode of 20 rad/s is near the sampling rate, and de-noising flattens the increments of measured rates;
roll derivatives are some 10 % off. The estimates serve as start values and for comparison.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator, simulate
from estimation.errors import DataError
from estimation.estimators.coloured import ResidualSegment, score_covariance
from estimation.estimators.gauss_newton import Status
from estimation.estimators.normal_equations import pseudo_inverse
from estimation.estimators.result import FlightFit, Result
from estimation.estimators.uncertainty import TIED, judge_estimates
from estimation.models import load_model
from estimation.models.base import Model
from estimation.prepare.flight_data import FOR_REGRESSION, FlightData, without_absent_outputs
from estimation.prepare.pipeline import FlightsToFit, prepare_all
from estimation.signals.goodness_of_fit import channel_fits

Index = NDArray[np.intp]

ROUNDS = 2  # of relinearisation (for parameters that enter nonlinearly) and reweighting
F_IN = 25.0  # partial F ratio above which a term enters: the nominal 4 is too low for coloured residuals at 20 Hz
F_OUT = 20.0  # partial F ratio below which a term leaves: less than F_IN, so that none enters and leaves in turn
WEIGHT_ROUNDS = 3  # of weighting each equation by its misfit
LEAST_MISFIT = 1e-9  # of the largest: an equation that fits exactly must not get infinite weight


@dataclass
class Regression:
    """The m equations of one segment: e (N, m) misfit at the present values, A (N, m, n) derivatives by the free parameters."""

    e: Array
    A: Array


@dataclass(frozen=True)
class EquationError:
    """Solution of a regression over flights. values: of all parameters; covariance (Cramer-Rao), coloured (corrected),
    undetermined: in the order of `names`, the free parameters; weights: (m,) of the equations."""

    names: tuple[str, ...]
    values: dict[str, float]
    covariance: Array
    coloured: Array
    undetermined: NDArray[np.bool_]
    weights: Array = field(default_factory=lambda: np.zeros(0))


def states_measured(flights: Sequence[FlightData]) -> bool:
    """Whether every state is measured throughout the segments."""
    return all(np.isfinite(f.states[s.rows]).all() for f in flights for s in f.segments)


def start_values(simulator: Simulator, flights: Sequence[FlightData]) -> dict[str, float] | None:
    """Parameter values by equation error over all flights, or None where a state is not measured."""
    if not simulator.free or not states_measured(flights):
        return None
    values = simulator.model.starts()
    for _ in range(ROUNDS):
        regressions = _regressions(simulator, flights, values)
        change, _ = _solve(regressions, np.arange(len(simulator.free)))
        if not np.all(np.isfinite(change)):
            return None
        _apply(simulator, values, change)
    return values


def equation_error(model: Model | str, flights: FlightsToFit, *, stepwise: bool = False) -> Result:
    """Estimates by equation error with bounds, over one flight or several together.

    stepwise: select parameters by partial F; the others are zero. Raises DataError where a state of the model is not
    measured.
    """
    loaded = load_model(model)
    loaded, data = without_absent_outputs(loaded, prepare_all(loaded, flights, FOR_REGRESSION))
    if not states_measured(data):
        raise DataError(f"model {loaded.name}: equation error needs every state measured; use method ml")
    simulator = Simulator.build(loaded)
    solution = solve_regression(simulator, data, stepwise=stepwise)
    return _describe(simulator, data, solution, stepwise)


def solve_regression(simulator: Simulator, flights: Sequence[FlightData], *, stepwise: bool = False) -> EquationError:
    """Weighted least squares with Cramer-Rao and coloured covariances."""
    values = simulator.model.starts()
    active = np.arange(len(simulator.free))
    if stepwise:
        values |= dict.fromkeys(simulator.free, 0.0)
        active = stepwise_choice(_regressions(simulator, flights, values))
    for _ in range(ROUNDS):
        regressions = _regressions(simulator, flights, values)
        change, weights = _solve(regressions, active)
        _apply(simulator, values, change)
    regressions = _regressions(simulator, flights, values)
    n = len(simulator.free)
    remaining = iter(regressions)
    flight_pieces = [[_piece(next(remaining), weights) for _ in flight.segments] for flight in flights]
    stacked = np.concatenate([p.jacobian for pieces in flight_pieces for p in pieces])
    information = stacked.T @ stacked
    covariance, coloured = np.zeros((n, n)), np.zeros((n, n))
    pick = np.ix_(active, active)
    inverse, blind = pseudo_inverse(information[pick])
    repeated = np.sqrt(np.tile(_repeats(simulator.model, flights), len(stacked) // len(weights)))[:, None] * stacked
    covariance[pick] = inverse @ (repeated.T @ repeated)[pick] @ inverse
    middle = np.zeros((n, n))
    for pieces in flight_pieces:
        middle += score_covariance(pieces, covariance, [np.zeros((0, 0))] * len(pieces))
    coloured[pick] = inverse @ middle[pick] @ inverse
    undetermined = np.zeros(n, bool)
    undetermined[active] = np.any(np.abs(blind) > TIED, axis=1)
    return EquationError(simulator.free, values, covariance, coloured, undetermined, weights)


def _piece(regression: Regression, weights: Array) -> ResidualSegment:
    """A regression in units of its noise."""
    measured = np.isfinite(regression.e)
    count, equations, n = regression.A.shape
    J = np.where(measured[:, :, None], regression.A, 0.0) * weights[None, :, None]
    e = np.where(measured, regression.e, 0.0) * weights
    return ResidualSegment(e, J.reshape(count * equations, n), np.zeros((count * equations, 0)), measured)


def stepwise_choice(regressions: list[Regression]) -> Index:
    """Indices of the parameters that a backward-forward selection by partial F chooses.

    It starts with all of them: a forward selection would miss terms that only together explain the motion (roll damping and
    dihedral).
    """
    A, e = _stacked(regressions)
    _, weight = _solve(regressions, np.arange(A.shape[2]))
    flat, z = (A * weight[None, :, None]).reshape(-1, A.shape[2]), (e * weight).ravel()
    gram, moment, energy = flat.T @ flat, flat.T @ z, float(z @ z)
    candidates = [j for j in range(gram.shape[0]) if gram[j, j] > 0]
    active = list(candidates)
    for _ in range(4 * len(candidates)):
        full = _residual_energy(gram, moment, energy, active)
        losses = {
            j: _partial_f(
                _residual_energy(gram, moment, energy, [i for i in active if i != j]), full, z.size - len(active)
            )
            for j in active
        }
        weakest = min(losses, key=lambda j: losses[j], default=None)
        if weakest is not None and losses[weakest] < F_OUT:
            active.remove(weakest)
            continue
        gains = {
            j: _partial_f(full, _residual_energy(gram, moment, energy, [*active, j]), z.size - len(active) - 1)
            for j in candidates
            if j not in active
        }
        strongest = max(gains, key=lambda j: gains[j], default=None)
        if strongest is None or gains[strongest] < F_IN:
            break
        active.append(strongest)
    return np.array(sorted(active), int)


def _residual_energy(gram: Array, moment: Array, energy: float, columns: Sequence[int]) -> float:
    """Sum of squared residuals of a regression on some columns; energy: the sum without any."""
    if not len(columns):
        return energy
    pick = np.array(columns, int)
    return max(energy - float(moment[pick] @ pseudo_inverse(gram[np.ix_(pick, pick)])[0] @ moment[pick]), 1e-300)


def _partial_f(energy_without: float, energy_with: float, freedom: int) -> float:
    """Partial F ratio of a term, from the sums of squared residuals without and with it."""
    return (energy_without - energy_with) / (energy_with / max(freedom, 1))


def _regressions(simulator: Simulator, flights: Sequence[FlightData], values: Mapping[str, float]) -> list[Regression]:
    """The equations of every segment at parameter `values`: increments of the states, then outputs."""
    names = simulator.model.parameter_names
    free = [names.index(n) for n in simulator.free]
    result = []
    for flight in flights:
        for segment in flight.segments:
            x = flight.states[segment.rows]
            u = simulator.drive(segment, values, False).u
            f, fp, y, yp = simulator.kernel.evaluate(x, u, simulator.vector(values))
            A = np.concatenate([_means(fp[:, :, free]), yp[:, :, free]], axis=1)
            rates = np.diff(x, axis=0, append=np.nan) / np.append(np.diff(segment.time), 1.0)[:, None]
            e = np.concatenate([rates - _means(f), segment.z - y], axis=1)
            result.append(Regression(np.where(np.all(np.isfinite(A), axis=2), e, np.nan), np.nan_to_num(A)))
    return result


def _repeats(model: Model, flights: Sequence[FlightData]) -> Array:
    """(m,) samples of the flight per measured sample of each equation's state: increments of a state that is logged more slowly
    repeat the same information. 1 for outputs, which are compared at their own samples only."""
    z = np.concatenate([s.z for f in flights for s in f.segments])
    measured_share = np.isfinite(z).mean(axis=0)
    outputs = {s.source: measured_share[j] for j, s in enumerate(model.outputs)}
    shares = [outputs.get(s.source, 1.0) or 1.0 for s in model.states]
    return np.concatenate([1.0 / np.array(shares), np.ones(len(model.outputs))])


def _means(values: Array) -> Array:
    """Mean over the interval from each sample to the next (NaN after the last)."""
    result = np.full_like(values, np.nan)
    result[:-1] = 0.5 * (values[:-1] + values[1:])
    return result


def _stacked(regressions: list[Regression]) -> tuple[Array, Array]:
    """A (N, m, n) and e (N, m) of all segments, zero where not measured."""
    e = np.concatenate([r.e for r in regressions])
    A = np.concatenate([r.A for r in regressions])
    measured = np.isfinite(e)
    return np.where(measured[:, :, None], A, 0.0), np.where(measured, e, 0.0)


def _solve(regressions: list[Regression], active: Index) -> tuple[Array, Array]:
    """Least-squares change (n,) of the free parameters, zero but for the `active` ones, and weights (m,) of the equations: the
    inverse of their rms misfit."""
    A, e = _stacked(regressions)
    weight = np.ones(e.shape[1])
    change = np.zeros(A.shape[2])
    for _ in range(WEIGHT_ROUNDS):
        flat = (A[:, :, active] * weight[None, :, None]).reshape(-1, len(active))
        change[active] = pseudo_inverse(flat.T @ flat)[0] @ (flat.T @ (e * weight).ravel())
        misfit = e - A @ change
        size = np.sqrt(np.mean(misfit**2, axis=0))
        weight = 1.0 / np.maximum(size, LEAST_MISFIT * max(float(size.max()), 1e-300))
    return change, weight


def _apply(simulator: Simulator, values: dict[str, float], change: Array) -> None:
    """Add a change (n,) of the free parameters to `values`, in place, within their limits."""
    for name, step in zip(simulator.free, change.tolist(), strict=True):
        p = simulator.model.parameter(name)
        values[name] = float(np.clip(values[name] + step, p.lower, p.upper))


def _describe(simulator: Simulator, data: list[FlightData], solution: EquationError, stepwise: bool) -> Result:
    """The result of a solution: estimates with bounds and verdicts, simulated histories."""
    model = simulator.model
    vector = np.array([solution.values[n] for n in solution.names])
    parameters, pairs = judge_estimates(
        model, solution.names, vector, solution.covariance, solution.coloured, solution.undetermined, data
    )
    flights, R = simulated_fits(model, data, [solution.values] * len(data))
    text = "solved" + (" with terms chosen by partial F" if stepwise else "")
    blind = [n for n, e in parameters.items() if not e.identifiable]
    status = Status.NOT_IDENTIFIABLE if blind else Status.CONVERGED
    text += f"; cannot be told from this data: {', '.join(blind)}" if blind else ""
    return Result(
        model, "ls", status, text, ROUNDS, ROUNDS, float("nan"), R, solution.names, parameters, solution.covariance,
        solution.coloured, pairs, tuple(flights), simulator.kernel.label,
    )  # fmt: skip


def simulated_fits(
    model: Model, data: Sequence[FlightData], values: Sequence[Mapping[str, float]]
) -> tuple[list[FlightFit], Array]:
    """The comparison of each flight with the model simulated at its `values`, and R (ny, ny) of the residuals, diagonal."""
    flights, residuals = [], []
    for flight, parameters in zip(data, values, strict=True):
        predicted = simulate(model, flight, parameters)
        time, measured = flight.histories(len(model.outputs))
        fit = channel_fits(model.output_names, measured, predicted)
        x0 = tuple(s.x0 for s in flight.segments)
        residuals.append(measured - predicted)
        states = np.full((flight.samples, len(model.states)), np.nan)
        flights.append(
            FlightFit(
                flight.name,
                flight.samples,
                time,
                measured,
                predicted,
                measured - predicted,
                states,
                x0,
                {},
                fit,
                flight.notes,
            )
        )
    stacked = np.concatenate(residuals)
    measured_rows = np.isfinite(stacked)
    variance = np.where(measured_rows, stacked, 0.0) ** 2
    return flights, np.diag(variance.sum(axis=0) / np.maximum(measured_rows.sum(axis=0), 1))
