"""By how much a regression misses: it takes noisy, sampled and smoothed motion for the motion itself, which no residual shows.

It is asked for an answer that is known: flights are simulated with its own estimates, sampled, given the noise that each channel
shows, smoothed and regressed again, on inputs with what may still be wrong with them; and once more with the estimates less what
that took off them. What comes back differs by the errors of noisy regressors, sampling and smoothing (indirect inference: C.
Gourieroux, A. Monfort, E. Renault, J. Applied Econometrics 8, 1993, S85-S118). Estimates stay as they are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.engine.simulate import Simulator, simulate
from estimation.estimators.arithmetic import NumericalFailure, numerical_failures
from estimation.estimators.equation_error import solve_regression
from estimation.estimators.result import Result
from estimation.models.base import Model
from estimation.prepare.columns import bridge_gaps
from estimation.prepare.flight_data import FlightData, Segment, without_absent_outputs
from estimation.signals.denoise import denoise_many, noise_level

REPLICATES = 3
ROUNDS = 2  # the first says what the motion's noise took off the estimates, the second flies them with that restored
SEED = 0
BOUNDS_LEAVE_OUT = "its bounds leave out noise of the measured motion: they are none to rely on"


def with_regression_errors(result: Result, flights: Sequence[FlightData], *, stepwise: bool = False) -> Result:
    """The result with these errors in its corrected bounds; where there is no telling them, its text says so."""
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
    """Parameter -> rms by which the regression misses an answer that it takes for its own; empty where the model runs away from
    that. flights: as the regression had them."""
    model, data = without_absent_outputs(result.model, list(flights))
    simulator = Simulator.build(model)
    answer, predicted = result.values, [f.outputs for f in result.flights]
    rms: Mapping[str, float] = {}
    for _ in range(ROUNDS):
        if not _complete(predicted, data):
            break
        made = [_made(model, d, y, index) for index, (d, y) in enumerate(zip(data, predicted, strict=True))]
        replicates = [solve_regression(simulator, r, stepwise=stepwise).values for r in zip(*made, strict=True)]
        misses = {n: np.array([values[n] - answer[n] for values in replicates]) for n in result.names}
        rms = {n: float(np.sqrt(np.mean(m**2))) for n, m in misses.items()}
        answer = {**answer, **{n: result.values[n] - float(np.mean(m)) for n, m in misses.items()}}
        predicted = [_simulated(model, d, answer) for d in data]
    return {n: v for n, v in rms.items() if np.isfinite(v)}


def _complete(predicted: Sequence[Array], data: Sequence[FlightData]) -> bool:
    return all(np.isfinite(y[s.rows]).all() for y, d in zip(predicted, data, strict=True) for s in d.segments)


def _simulated(model: Model, data: FlightData, answer: Mapping[str, float]) -> Array:
    """(samples, ny) outputs; infinite where they cannot be computed."""
    try:
        with numerical_failures():
            return simulate(model, data, answer)
    except NumericalFailure:
        return np.full((data.samples, len(model.outputs)), np.inf)


def _made(model: Model, data: FlightData, predicted: Array, index: int) -> list[FlightData]:
    """The flight again and again with outputs as predicted (samples, ny) and noise of the measured ones; states that no output
    shows stay as measured."""
    rng = np.random.default_rng([SEED, index])
    outputs = {s.source: j for j, s in enumerate(model.outputs)}
    shown = [(i, outputs[s.source]) for i, s in enumerate(model.states) if s.source in outputs]
    states = [data.states.copy() for _ in range(REPLICATES)]
    segments: list[list[Segment]] = [[] for _ in range(REPLICATES)]
    errors: NDArray[np.floating] = np.zeros((data.samples, len(model.inputs), REPLICATES))
    if data.errors is not None and data.errors.size:
        errors = data.errors[:, :, np.arange(REPLICATES) % data.errors.shape[2]]
    for s in data.segments:
        levels = np.array([noise_level(column) for column in s.z.T])
        noisy = predicted[s.rows] + levels * rng.standard_normal((REPLICATES, *s.z.shape))
        noisy[:, ~np.isfinite(s.z)] = np.nan
        columns = [(k, i, bridge_gaps(noisy[k, :, j])) for k in range(REPLICATES) for i, j in shown]
        for (k, i, _), smooth in zip(columns, denoise_many([c for *_, c in columns], order=2), strict=True):
            states[k][s.rows, i] = smooth.values
        for k in range(REPLICATES):
            segments[k].append(replace(s, z=noisy[k], u=s.u + errors[s.rows, :, k]))
    return [replace(data, states=x, segments=tuple(parts)) for x, parts in zip(states, segments, strict=True)]
