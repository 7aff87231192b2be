"""Maximum likelihood by filter error (`fem`): for flights in turbulence, where output error alone gives nonsense slowly.

The model is driven by its own one-step prediction errors: x <- x + K (z - y) at every sample (steady-state Kalman
filter in innovations form; Jategaonkar, Flight Vehicle System Identification, 2nd ed., chapter 5). The gain K is
estimated together with the parameters, with exact sensitivities, instead of being derived from a process-noise model:
asymptotically the same estimate without a Riccati equation. Innovations of the right model are white, so both bounds
agree. The fit that a result reports is that of one-step predictions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.engine.data import FlightData
from estimation.engine.kernel import Array, Motion
from estimation.engine.prepared import compared, prepared
from estimation.engine.simulate import Simulator
from estimation.estimators.gauss_newton import LoopOptions, Status, minimise
from estimation.estimators.likelihood import OutputErrorProblem
from estimation.estimators.output_error import (
    STANDARD,
    OutputErrorOptions,
    describe,
    free_states_of,
    output_error,
)
from estimation.estimators.result import Result
from estimation.models import load_model
from estimation.models.base import Model, Parameter
from groundstation.flight import Flight

FIRST_GAIN = 0.2  # of each measured state on itself: a filter that follows from the first step
LOOP = LoopOptions(iterations=150, tolerance=1e-3)  # relaxation of the full covariance converges slowly
GAIN_PRIOR = 1.0  # standard deviation of a gain, in units of the noise of state over the noise of output


class FilterErrorProblem(OutputErrorProblem):
    """Output error with state corrections; `gains`: (nx, ny) names of the gain parameters, '' where the gain is zero."""

    gains: Sequence[Sequence[str]] = ()

    def _gain(self, values: Mapping[str, float]) -> Array:
        return np.array([[values[n] if n else 0.0 for n in row] for row in self.gains])

    def response(self, unknowns: Array, flight: int, segment: int, du: Array, du_mid: Array) -> Array:
        values = self.values(unknowns, flight)
        return self.simulator.response(
            self.flights[flight].segments[segment],
            values,
            self.initial_state(unknowns, flight, segment),
            du,
            du_mid,
            gain=self._gain(values),
        )

    def motion(self, unknowns: Array, flight: int, segment: int, derivatives: bool) -> Motion:
        values = self.values(unknowns, flight)
        gain = self._gain(values)
        mask = np.array([[bool(n) for n in row] for row in self.gains])
        motion = self.simulator.run(
            self.flights[flight].segments[segment],
            values,
            self.initial_state(unknowns, flight, segment),
            sensitivities=derivatives,
            gain=gain,
            gain_free=mask if derivatives else None,
        )
        if motion.dy is None:
            return motion
        dy = motion.dy[:, :, : len(self.free) + self.nx].copy()
        names = [n for row in self.gains for n in row if n]
        for k, name in enumerate(names):
            dy[:, :, self.free.index(name)] = motion.dy[:, :, len(self.free) + self.nx + k]
        return replace(motion, dy=dy)


def filter_error(
    model: Model | str,
    flights: Flight | FlightData | Sequence[Flight | FlightData],
    start: Mapping[str, float] | None = None,
    options: OutputErrorOptions = STANDARD,
) -> Result:
    """Fit `model` with state corrections to one flight or several together; arguments as `output_error`.

    The gain is in `extra["gain"]`: state -> output -> number.
    """
    chosen = load_model(model).with_starts(start or {})
    chosen, data = compared(chosen, prepared(chosen, flights, options.preparation))
    first = output_error(chosen, data, options=options)
    if first.status is Status.DIVERGED:
        return first.with_method("fem")
    names = [
        [f"gain_{s}_{o}" if o in chosen.state_names else "" for o in chosen.output_names] for s in chosen.state_names
    ]
    noise = first.noise
    fallback = float(np.median(list(noise.values())))
    parameters = [
        Parameter(
            name,
            start=FIRST_GAIN if state == output else 0.0,
            prior_mean=0.0,
            prior_std=GAIN_PRIOR * noise.get(state, fallback) / noise[output],
        )
        for state, row in zip(chosen.state_names, names, strict=True)
        for output, name in zip(chosen.output_names, row, strict=True)
        if name
    ]
    extended = chosen.with_starts(first.values).plus(parameters=parameters)
    simulator = Simulator.build(
        extended, work=1e9, compile_=options.compile_, substeps=options.substeps, hold=options.hold
    )
    problem = FilterErrorProblem(extended, data, simulator, noise="full", free_states=free_states_of(extended, options))
    problem.gains = names
    outcome = minimise(problem, problem.pack(extended.starts()), LOOP)
    return _without_gains(describe(problem, outcome, "fem"), chosen, names)


def _without_gains(result: Result, model: Model, names: list[list[str]]) -> Result:
    """The result in terms of the model's own parameters, the gain beside them."""
    gain_names = {n for row in names for n in row if n}
    keep = np.array([i for i, n in enumerate(result.names) if n not in gain_names])
    parameters = {n: e for n, e in result.parameters.items() if n not in gain_names}
    gain = {
        state: {o: result.parameters[n].estimate for o, n in zip(model.output_names, row, strict=True) if n}
        for state, row in zip(model.state_names, names, strict=True)
    }
    blind = [n for n, e in parameters.items() if not e.identifiable]
    status, text = result.status, result.text
    if status in (Status.CONVERGED, Status.NOT_IDENTIFIABLE):
        status = Status.NOT_IDENTIFIABLE if blind else Status.CONVERGED
        text = status.value + (f": {', '.join(blind)}" if blind else "")
    pick = np.ix_(keep, keep)
    return replace(
        result,
        model=model,
        status=status,
        text=text,
        names=tuple(n for n in result.names if n not in gain_names),
        parameters=parameters,
        covariance=result.covariance[pick],
        covariance_coloured=result.covariance_coloured[pick],
        collinear=tuple(c for c in result.collinear if not gain_names & {c[0], c[1]}),
        extra={**result.extra, "gain": gain},
    )
