"""Errors of a regression that residuals do not show: it takes noisy, sampled and smoothed motion for the motion itself.

The regression is repeated on flights with known answer: simulated with its own estimates, sampled, with the noise of each channel
added, smoothed, and with redrawn input errors; then again with estimates corrected by the bias found. The differences from the
known answer are the errors due to noisy regressors, sampling and smoothing (indirect inference: C. Gourieroux, A. Monfort, E.
Renault, J. Applied Econometrics 8, 1993, S85-S118). Only bounds change, not the estimates.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator, simulate
from estimation.estimators.arithmetic import NumericalFailure, numerical_failures
from estimation.estimators.equation_error import solve_regression
from estimation.estimators.input_path import HALF_WAY, clocked_controls
from estimation.estimators.result import Result
from estimation.models.base import Model
from estimation.prepare.columns import bridge_gaps
from estimation.prepare.flight_data import FlightData, Segment, without_absent_outputs
from estimation.signals.denoise import denoise_many, noise_level

REPLICATES = 4  # two of them bend edges on the sampling clock one way, and two the other
ROUNDS = 2  # the first finds the bias of the estimates, the second simulates with estimates corrected for it
SEED = 0
MEAN_BEND = 2 / 3 * HALF_WAY  # of a step: mean over an interval of a bend that is HALF_WAY in its middle
BOUNDS_LEAVE_OUT = "its bounds leave out noise of the measured motion: they are none to rely on"


def with_regression_errors(result: Result, flights: Sequence[FlightData], *, stepwise: bool = False) -> Result:
    """The result with these errors in its corrected bounds; where they cannot be found, its text says so."""
    try:
        with numerical_failures():
            errors = regression_errors(result, flights, stepwise=stepwise)
    except NumericalFailure:
        errors = {}
    if not errors:
        return replace(result, text=f"{result.text}; {BOUNDS_LEAVE_OUT}")
    wider = {
        n: replace(e, std_coloured=float(np.hypot(e.std_coloured, errors.get(n, 0.0))))
        for n, e in result.parameters.items()
    }
    return replace(result, parameters={**result.parameters, **wider})


def regression_errors(result: Result, flights: Sequence[FlightData], *, stepwise: bool = False) -> Mapping[str, float]:
    """Parameter -> rms error of the regression on flights with known answer; empty where the model cannot be simulated with the
    estimates. flights: as prepared for the regression."""
    model, data = without_absent_outputs(result.model, list(flights))
    simulator = Simulator.build(model)
    clocked = [model.input_names.index(n) for n in clocked_controls(model, data)]
    answer, predicted = result.values, [f.outputs for f in result.flights]
    rms: Mapping[str, float] = {}
    for _ in range(ROUNDS):
        if not _complete(predicted, data):
            break
        replicates = [
            _replicates(model, d, y, i, clocked) for i, (d, y) in enumerate(zip(data, predicted, strict=True))
        ]
        estimates = [solve_regression(simulator, r, stepwise=stepwise).values for r in zip(*replicates, strict=True)]
        errors = {n: np.array([values[n] - answer[n] for values in estimates]) for n in result.names}
        rms = {n: float(np.sqrt(np.mean(e**2))) for n, e in errors.items()}
        answer = {**answer, **{n: result.values[n] - float(np.mean(e)) for n, e in errors.items()}}
        predicted = [_simulated(model, d, answer) for d in data]
    return {n: v for n, v in rms.items() if np.isfinite(v)}


def _complete(predicted: Sequence[Array], data: Sequence[FlightData]) -> bool:
    """Whether the outputs are finite throughout the segments."""
    return all(np.isfinite(y[s.rows]).all() for y, d in zip(predicted, data, strict=True) for s in d.segments)


def _simulated(model: Model, data: FlightData, answer: Mapping[str, float]) -> Array:
    """(samples, ny) outputs; infinite where the simulation fails."""
    try:
        with numerical_failures():
            return simulate(model, data, answer)
    except NumericalFailure:
        return np.full((data.samples, len(model.outputs)), np.inf)


def _replicates(
    model: Model, data: FlightData, predicted: Array, index: int, clocked: Sequence[int]
) -> list[FlightData]:
    """REPLICATES of a flight with outputs as predicted (samples, ny) plus noise as measured; states without an output stay as
    measured. index: of the flight, for its random numbers; clocked: inputs whose path between samples may lie on either side of
    the straight line."""
    rng = np.random.default_rng([SEED, index])
    outputs = {s.source: j for j, s in enumerate(model.outputs)}
    measured_states = [(i, outputs[s.source]) for i, s in enumerate(model.states) if s.source in outputs]
    states = [data.states.copy() for _ in range(REPLICATES)]
    segments: list[list[Segment]] = [[] for _ in range(REPLICATES)]
    errors: NDArray[np.floating] = np.zeros((data.samples, len(model.inputs), REPLICATES))
    if data.errors is not None and data.errors.size:
        errors += data.errors[:, :, np.arange(REPLICATES) % data.errors.shape[2]]
    for s in data.segments:
        levels = np.array([noise_level(column) for column in s.z.T])
        noisy = predicted[s.rows] + levels * rng.standard_normal((REPLICATES, *s.z.shape))
        noisy[:, ~np.isfinite(s.z)] = np.nan
        columns = [(k, i, bridge_gaps(noisy[k, :, j])) for k in range(REPLICATES) for i, j in measured_states]
        for (k, i, _), smooth in zip(columns, denoise_many([c for *_, c in columns], order=2), strict=True):
            states[k][s.rows, i] = smooth.values
        for k in range(REPLICATES):
            u = s.u + errors[s.rows, :, k]
            u[:, clocked] += (-1) ** k * MEAN_BEND * np.gradient(u[:, clocked], axis=0)
            segments[k].append(replace(s, z=noisy[k], u=u))
    return [replace(data, states=x, segments=tuple(parts)) for x, parts in zip(states, segments, strict=True)]
