"""Maximum likelihood by filter error (`fem`, `fem-noise`): for flights in turbulence, where output error converges slowly and to
wrong estimates.

The model is corrected by its own one-step prediction errors: x <- x + K (z - y) at every sample (steady-state Kalman filter in
innovations form; Jategaonkar, Flight Vehicle System Identification, 2nd ed., chapter 5). Innovations of the right model are
white, so both bounds agree. A result reports the fit of one-step predictions. A delayed output is compared but corrects no
state, because it shows a past one. Two forms:

- `filter_error`: the gain is estimated together with the parameters, with exact sensitivities, instead of being derived from a
  process-noise model: asymptotically the same estimate without a Riccati equation.
- `process_noise_error`: the published form. The process noise of each state that forces drive is estimated; the gain follows from
  it by the Riccati equation of the model, linearised about the mean of the flight (`GainLaw`) and again at the estimates. It has
  few unknowns and is always stable: in calm air a free gain can make the filter unstable, while this form becomes output error.

Small motion about a point of flight, dx = (A x + w) dt, y = C x + v, sampled every `dt`: Phi = exp(A dt), P the covariance of
the prediction from the discrete Riccati equation, K = P C' (C P C' + R)^-1 (Maine and Iliff, NASA RP-1168, section 6).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from estimation.engine.kernel import Array, SegmentMotion
from estimation.engine.simulate import Simulator
from estimation.engine.trace import trace
from estimation.estimators.frequency_domain.transformed import state_matrices
from estimation.estimators.gauss_newton import LoopOptions, Status, minimise
from estimation.estimators.input_path import in_own_terms, with_paths, without_nuisance_parameters
from estimation.estimators.likelihood import OutputErrorProblem
from estimation.estimators.output_error import STANDARD, OutputErrorOptions, fit_result, free_states_of, output_error
from estimation.estimators.result import Result
from estimation.models import load_model
from estimation.models.base import Model, Parameter
from estimation.models.dependence import force_states, require_states
from estimation.prepare.flight_data import FlightData, without_absent_outputs
from estimation.prepare.pipeline import FlightsToFit, prepare_all
from groundstation.flight.quality.noise import noise as noise_of

SLOPE_STEP = 1e-4  # of a relative process noise: step of the central difference of the gain
TINY = 1e-12  # of the largest process noise, or of the smallest measurement noise: added to process noise
FIRST_GAIN = 0.2  # of each measured state on itself: the filter follows the measurement from the first step
LOOP = LoopOptions(iterations=150, tolerance=1e-3)  # relaxation of the full covariance converges slowly
FIRST_NOISE = 0.3  # start of a state's process noise in a sample interval, over its measurement noise
NOISE_PRIOR = 3.0  # standard deviation of its prior about zero
LINEARISATIONS = 2  # at the estimates of output error, and at those of the first fit
GAIN_PRIOR = 1.0  # standard deviation of a gain, in units of the noise of state over the noise of output


@dataclass(frozen=True)
class GainLaw:
    """The gain as a function of process noise. transition: Phi (nx, nx); C: (ny, nx); noise: (ny,) std of the measurements;
    states: (n,) index of each state with process noise; unit: (n,) std of its change in a sample interval at a relative noise of
    1."""

    transition: Array
    C: Array
    noise: Array
    unit: Array
    states: tuple[int, ...]

    def gain(self, relative: Array) -> Array:
        """K (nx, ny) at process noise `relative` (n,), in units of `unit`. LinAlgError where the filter has no steady state that
        can be calculated, for instance because the model overflows within a sample interval."""
        Q = np.zeros(self.transition.shape)
        for state, unit, size in zip(self.states, self.unit, relative, strict=True):
            Q[state, state] = (unit * size) ** 2
        P = self._prediction(Q)
        S = self.C @ P @ self.C.T + np.diag(self.noise**2)
        return np.asarray(np.linalg.solve(S, self.C @ P).T)

    def slopes(self, relative: Array) -> Array:
        """dK/d relative (n, nx, ny); one-sided at zero, the lower limit. LinAlgError as in `gain`."""
        slopes = []
        for i in range(relative.size):
            plus, minus = relative.copy(), relative.copy()
            plus[i] += SLOPE_STEP
            minus[i] = max(minus[i] - SLOPE_STEP, 0.0)
            slopes.append((self.gain(plus) - self.gain(minus)) / (plus[i] - minus[i]))
        return np.array(slopes).reshape(relative.size, *self.transition.shape[:1], self.C.shape[0])

    def _prediction(self, Q: Array) -> Array:
        """(nx, nx) covariance of the one-step prediction. LinAlgError where the linearised motion has no steady filter."""
        if not (np.isfinite(self.transition).all() and np.isfinite(self.C).all() and np.isfinite(Q).all()):
            raise np.linalg.LinAlgError("the linearised motion grows beyond all numbers within one sample interval")
        R = np.diag(self.noise**2)
        # without it, a state without noise or decay becomes known exactly, and its only steady gain is zero
        floor = TINY * max(float(Q.max()), float(R.min())) * np.eye(len(Q))
        try:
            return np.asarray(solve_discrete_are(self.transition.T, self.C.T, Q + floor, R))
        except ValueError as error:  # scipy raises it for infinite intermediate results
            raise np.linalg.LinAlgError("the Riccati equation of its filter has no finite solution") from error


def gain_law(A: Array, C: Array, dt: float, noise: Array, unit: Array, states: tuple[int, ...]) -> GainLaw:
    """The law at one flight condition; A (nx, nx), C (ny, nx), dt [s] between samples."""
    with np.errstate(over="ignore", invalid="ignore"):  # `gain` raises where the transition has overflowed
        return GainLaw(np.asarray(expm(A * dt)), C, noise, unit, states)


class _Filtered(OutputErrorProblem, ABC):
    """Output error with state corrections."""

    @abstractmethod
    def _gain(self, values: Mapping[str, float]) -> Array:
        """K (nx, ny)."""

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

    def motion(self, unknowns: Array, flight: int, segment: int, derivatives: bool) -> SegmentMotion:
        values = self.values(unknowns, flight)
        try:
            gain = self._gain(values)
            motion = self.simulator.run(
                self.flights[flight].segments[segment],
                values,
                self.initial_state(unknowns, flight, segment),
                sensitivities=derivatives,
                gain=gain,
                gain_free=self._free_entries() if derivatives else None,
            )
            if motion.dy is None:
                return motion
            count = len(self.free) + self.nx
            dy = motion.dy[:, :, :count].copy()
            self._by_unknowns(values, motion.dy[:, :, count:], dy)
        except np.linalg.LinAlgError:  # no such filter: an infinite cost makes the search halve its step
            return self._no_motion(flight, segment)
        return replace(motion, dy=dy) if np.isfinite(dy).all() else replace(motion, dy=None, reached=0)

    def _no_motion(self, flight: int, segment: int) -> SegmentMotion:
        """A motion that is not finite from the first sample on."""
        count = len(self.flights[flight].segments[segment])
        return SegmentMotion(np.full((count, self.nx), np.nan), np.full((count, self.ny), np.nan), None, 0)

    @abstractmethod
    def _free_entries(self) -> Array:
        """(nx, ny) entries of the gain that get a sensitivity column."""

    @abstractmethod
    def _by_unknowns(self, values: Mapping[str, float], by_gain: Array, dy: Array) -> None:
        """Add to dy (N, ny, unknowns) the derivatives through the gain; by_gain: (N, ny, entries)."""


class FilterErrorProblem(_Filtered):
    """The entries of the gain are unknowns. gains: (nx, ny) names of these parameters, '' where the gain is zero."""

    gains: Sequence[Sequence[str]] = ()

    def _gain(self, values: Mapping[str, float]) -> Array:
        return np.array([[values[n] if n else 0.0 for n in row] for row in self.gains])

    def _free_entries(self) -> Array:
        return np.array([[float(bool(n)) for n in row] for row in self.gains])

    def _by_unknowns(self, values: Mapping[str, float], by_gain: Array, dy: Array) -> None:
        for k, name in enumerate(n for row in self.gains for n in row if n):
            dy[:, :, self.free.index(name)] = by_gain[:, :, k]


class ProcessNoiseProblem(_Filtered):
    """The gain follows from process noise. noises: names of its parameters, in the order of the states of the law."""

    law: GainLaw
    noises: Sequence[str] = ()

    def _relative(self, values: Mapping[str, float]) -> Array:
        return np.array([values[n] for n in self.noises])

    def _gain(self, values: Mapping[str, float]) -> Array:
        return self.law.gain(self._relative(values))

    def _free_entries(self) -> Array:
        return np.ones((self.nx, self.ny))

    def _by_unknowns(self, values: Mapping[str, float], by_gain: Array, dy: Array) -> None:
        slopes = self.law.slopes(self._relative(values)).reshape(len(self.noises), -1)
        for name, slope in zip(self.noises, slopes, strict=True):
            dy[:, :, self.free.index(name)] = by_gain @ slope


def filter_error(
    model: Model | str,
    flights: FlightsToFit,
    start: Mapping[str, float] | None = None,
    options: OutputErrorOptions = STANDARD,
) -> Result:
    """Fit `model` with state corrections to one flight or several together; arguments as `output_error`.

    `extra["gain"]`: state -> output -> number. Where the fit of a free gain fails, or gives no information because its filter is
    unstable, the gain is that of process noise, and `extra["process_noise"]` is there too.
    """
    loaded = require_states(load_model(model), "fem").with_starts(start or {})
    loaded, data = without_absent_outputs(loaded, prepare_all(loaded, flights, options.preparation))
    return in_own_terms(_by_free_gain(with_paths(loaded, data) if options.paths else loaded, data, options), loaded)


def _by_free_gain(model: Model, data: list[FlightData], options: OutputErrorOptions) -> Result:
    """The fit with a free gain, of a model that has the nuisance parameters of its inputs."""
    first = output_error(model, data, options=options)
    if first.status is Status.DIVERGED:
        return first.with_method("fem")
    correcting = {o for o in model.output_names if o in model.state_names and o not in model.output_delays}
    names = [[f"gain_{s}_{o}" if o in correcting else "" for o in model.output_names] for s in model.state_names]
    noise = first.noise
    fallback = float(np.median(list(noise.values())))
    parameters = [
        Parameter(
            name,
            start=FIRST_GAIN if state == output else 0.0,
            prior_mean=0.0,
            prior_std=GAIN_PRIOR * noise.get(state, fallback) / noise[output],
        )
        for state, row in zip(model.state_names, names, strict=True)
        for output, name in zip(model.output_names, row, strict=True)
        if name
    ]
    extended = model.with_starts(first.values).plus(parameters=parameters)
    simulator = Simulator.build(extended, compile_=options.compile_, substeps=options.substeps, hold=options.hold)
    problem = FilterErrorProblem(extended, data, simulator, noise="full", free_states=free_states_of(extended, options))
    problem.gains = names
    outcome = minimise(problem, problem.pack(extended.starts()), LOOP)
    result = _without_gains(fit_result(problem, outcome, "fem"), model, names)
    if result.converged and result.informative:
        return result
    return _by_process_noise(model, data, first, options).with_method("fem")


def process_noise_error(
    model: Model | str,
    flights: FlightsToFit,
    start: Mapping[str, float] | None = None,
    options: OutputErrorOptions = STANDARD,
) -> Result:
    """Fit `model` with the steady-state Kalman filter of its process noise; arguments as `output_error`.

    `extra["process_noise"]`: state -> std of its random change in one second [unit/sqrt(s)]; `extra["gain"]` as of
    `filter_error`."""
    loaded = require_states(load_model(model), "fem-noise").with_starts(start or {})
    loaded, data = without_absent_outputs(loaded, prepare_all(loaded, flights, options.preparation))
    full = with_paths(loaded, data) if options.paths else loaded
    first = output_error(full, data, options=replace(options, paths=False))
    if first.status is Status.DIVERGED:
        return in_own_terms(first.with_method("fem-noise"), loaded)
    return in_own_terms(_by_process_noise(full, data, first, options), loaded)


def _by_process_noise(model: Model, data: list[FlightData], first: Result, options: OutputErrorOptions) -> Result:
    """The fit from the result of output error; a diverged result with the reason where no filter can be calculated."""
    try:
        with np.errstate(all="ignore"):  # code below tests for results that are not finite
            return _steady_filter(model, data, first, options)
    except (np.linalg.LinAlgError, ArithmeticError) as error:
        text = (
            f"no filter could be found ({error}): the model is unstable or too stiff for these samples; use method ml"
        )
        return replace(first, method="fem-noise", status=Status.DIVERGED, text=text)


def _steady_filter(model: Model, data: list[FlightData], first: Result, options: OutputErrorOptions) -> Result:
    """The fit with the filter of its process noise. LinAlgError where there is no gain at the start values."""
    noise = _white_noise(model, data, first)
    noisy_states = force_states(model)
    fallback = float(np.median(noise))
    unit = {s: float(noise[model.output_names.index(s)]) if s in model.output_names else fallback for s in noisy_states}
    names = [f"noise_{s}" for s in noisy_states]
    values, last = {**first.values, **dict.fromkeys(names, FIRST_NOISE)}, None
    for _ in range(LINEARISATIONS):
        extended = model.with_starts({n: values[n] for n in first.values}).plus(
            parameters=[Parameter(n, start=values[n], lower=0.0, prior_mean=0.0, prior_std=NOISE_PRIOR) for n in names]
        )
        simulator = Simulator.build(extended, compile_=options.compile_, substeps=options.substeps, hold=options.hold)
        problem = ProcessNoiseProblem(
            extended, data, simulator, noise="full", free_states=free_states_of(extended, options)
        )
        problem.noises = names
        problem.law = _linearised_law(simulator, data, values, noise, unit)
        problem.law.gain(np.array([values[n] for n in names]))  # raises LinAlgError with the reason
        outcome = minimise(problem, problem.pack(extended.starts()), LOOP)
        last = fit_result(problem, outcome, "fem-noise")
        if not last.converged:
            break
        values = last.values
    assert last is not None
    if last.status is Status.DIVERGED:
        return without_nuisance_parameters(last, model, set(names), {})
    dt = _sample_interval(data)
    sizes = {s: float(last.values[n] * unit[s] / np.sqrt(dt)) for s, n in zip(noisy_states, names, strict=True)}
    K = problem.law.gain(np.array([last.values[n] for n in names]))
    gain = {
        s: dict(zip(model.output_names, row.tolist(), strict=True)) for s, row in zip(model.state_names, K, strict=True)
    }
    return without_nuisance_parameters(last, model, set(names), {"gain": gain, "process_noise": sizes})


def _white_noise(model: Model, data: Sequence[FlightData], first: Result) -> Array:
    """(ny,) standard deviation of the outputs' white noise; of a channel without any, the rms residual of output error."""
    levels = []
    for i, name in enumerate(model.output_names):
        segment_levels = [noise_of(s.z[:, i]) for flight in data for s in flight.segments]
        nonzero = [level for level in segment_levels if level]
        levels.append(float(np.median(nonzero)) if nonzero else first.noise[name])
    return np.array(levels)


def _sample_interval(data: Sequence[FlightData]) -> float:
    """Median sample interval [s]."""
    return float(np.median(np.concatenate([np.diff(s.time) for flight in data for s in flight.segments])))


def mean_matrices(simulator: Simulator, data: Sequence[FlightData], values: Mapping[str, float]) -> tuple[Array, Array]:
    """A (nx, nx) and C (ny, nx) of the motion, linearised about the mean of the flights."""
    model = simulator.model
    inputs = np.concatenate([s.u for flight in data for s in flight.segments])
    starts = np.mean([s.x0 for flight in data for s in flight.segments], axis=0)
    measured = [
        np.nanmean(np.concatenate([s.z[:, model.output_names.index(n)] for flight in data for s in flight.segments]))
        if n in model.output_names
        else starts[i]
        for i, n in enumerate(model.state_names)
    ]
    return state_matrices(
        trace(model.structure), np.array(measured), np.nanmean(inputs, axis=0), simulator.vector(values)
    )


def _linearised_law(
    simulator: Simulator,
    data: Sequence[FlightData],
    values: Mapping[str, float],
    noise: Array,
    unit: Mapping[str, float],
) -> GainLaw:
    """The gain as a function of process noise, about the mean of the flights. unit: state -> std as in `GainLaw`."""
    A, C = mean_matrices(simulator, data, values)
    delayed = [simulator.model.output_names.index(o) for o in simulator.model.output_delays]
    C[delayed] = 0.0  # delayed outputs correct no state
    states = tuple(simulator.model.state_names.index(s) for s in unit)
    return gain_law(A, C, _sample_interval(data), noise, np.array(list(unit.values())), states)


def _without_gains(result: Result, model: Model, names: list[list[str]]) -> Result:
    """The result in terms of the parameters of `model`, the gain in `extra`."""
    gain = {
        state: {o: result.parameters[n].estimate for o, n in zip(model.output_names, row, strict=True) if n}
        for state, row in zip(model.state_names, names, strict=True)
    }
    return without_nuisance_parameters(result, model, {n for row in names for n in row if n}, {"gain": gain})
