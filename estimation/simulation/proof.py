"""Proof of an export: JSBSim flies the written aircraft, the model flies by its own equations in the same steps."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimation.engine.simulate import Simulator, simulate
from estimation.engine.trace import trace
from estimation.models.base import Model
from estimation.prepare.flight_data import FlightData, Preparation, Segment
from estimation.prepare.pipeline import prepare
from estimation.simulation.along_flight import BY_ALPHA_RATE, column_name, simulate_along
from estimation.simulation.attach import computed, with_simulation_columns, without_simulation
from estimation.simulation.jsbsim.export import WrittenAircraft
from estimation.simulation.jsbsim.flying import fly_aircraft
from estimation.simulation.jsbsim.increments import Increments
from estimation.simulation.oracle import ALPHA_RATE, Array, Simulation
from groundstation.flight import Flight

# The model is integrated by JSBSim's own rule, so that the comparison shows equations and not integrators.
#
# For the proof, JSBSim uses the Adams-Bashforth rule of second order,
#
#     x[k+1] = x[k] + h (3 f[k] - f[k-1]) / 2
#
# with f[k] at the surfaces of that frame. While a surface moves, this is half a frame late compared with inputs interpolated
# linearly: a rate differs by h/2 times the change of its acceleration over the last frame, though both are right. First-order
# lags of effects are `lag_filter`s in JSBSim, integrated by the trapezoidal rule, and so they are here.

UNIT = 1.0  # step of a filter's state: its rate is linear in it, so any step gives its slope


def step_model(model: Model, data: FlightData, x0: Array, filters: tuple[str, ...]) -> Array:
    """(samples, ny) outputs of a model integrated by JSBSim's rule, one step a sample, from x0 (nx,); NaN outside segments.

    filters: its states of the form x_dot = (input - x)/tau, which are filters of JSBSim's flight control. The flight begins
    steady: the rate before the first sample is taken as that of the first.
    """
    simulator = Simulator.build(model, (), substeps=1)
    values = model.starts()
    outputs = np.full((data.samples, len(model.outputs)), np.nan)
    p = simulator.vector(values)
    filtered = [model.state_names.index(n) for n in filters]
    for segment in data.segments:
        u = simulator.drive(segment, values, False).u
        outputs[segment.first : segment.first + len(segment)] = _step_motion(model, segment, u, p, x0, filtered)
    return outputs


def _step_motion(model: Model, segment: Segment, u: Array, p: Array, x0: Array, filtered: list[int]) -> Array:
    """(N, ny) outputs of one segment with inputs u (N, nu)."""
    functions = trace(model.structure)

    def rates(x: Array, k: int) -> Array:
        return np.asarray(functions.rates(x, u[k], p), float).ravel()

    x, h = x0.astype(float), np.diff(segment.time)
    f = last_rates = rates(x, 0)
    output_rows = [np.asarray(functions.outputs(x, u[0], p), float).ravel()]
    for k in range(len(segment) - 1):
        next_state = x + 0.5 * h[k] * (3.0 * f - last_rates)
        next_state[filtered] = x[filtered]
        for i in filtered:  # in JSBSim's order, since one may read another
            drive = rates(next_state, k + 1)[i]
            filtered_state = next_state.copy()
            filtered_state[i] += UNIT
            slope = rates(filtered_state, k + 1)[i] - drive
            next_state[i] += 0.5 * h[k] * (f[i] + drive) / (1.0 - 0.5 * h[k] * slope)
        x, last_rates, f = next_state, f, rates(next_state, k + 1)
        output_rows.append(np.asarray(functions.outputs(x, u[k + 1], p), float).ravel())
        if not np.isfinite(x).all():
            output_rows += [np.full(len(model.outputs), np.nan)] * (len(segment) - len(output_rows))
            break
    return np.array(output_rows)


# The comparison: both fly with the same surfaces, and their difference is measured in units of sensor noise.
#
# The model takes JSBSim's steps and reads the rate of alpha that JSBSim reads, that of the step before. The difference then comes
# from forces, moments, inertia and actuators only, whatever the rate. The same model integrated exactly shows the error of the
# steps themselves.

DEG = float(np.pi / 180.0)
NOISE: Mapping[str, float] = {
    "p": 0.3 * DEG, "q": 0.3 * DEG, "r": 0.3 * DEG, "phi": 0.2 * DEG, "theta": 0.2 * DEG, "alpha": 0.2 * DEG, "beta": 0.2 * DEG,
    "V": 0.15, "ax": 0.05, "ay": 0.05, "az": 0.08,
}  # fmt: skip
"""Noise of good sensors of a small aircraft, 1 sigma [SI]."""
SHARE = 0.1  # of that noise is allowed: no flight shows such a difference
AS_IT_IS = Preparation(denoise=False, draws=0, keep_held=True)  # for a flight without noise


@dataclass(frozen=True)
class ExportProof:
    """rms: output -> root mean square of our model in JSBSim's steps minus JSBSim [SI]; allowed: `SHARE` of a sensor's noise;
    steps: of the model in these steps minus the same model integrated exactly; flight: as JSBSim flew it."""

    rms: Mapping[str, float]
    allowed: Mapping[str, float]
    steps: Mapping[str, float]
    flight: Flight

    @property
    def failed(self) -> tuple[str, ...]:
        """Outputs whose difference is not within what is allowed."""
        return tuple(n for n, v in self.rms.items() if not v <= self.allowed[n])


def proof_of(
    source: Path, simulation: Simulation, written_aircraft: WrittenAircraft, increments: Increments, rate: float
) -> ExportProof:
    """Fly the written aircraft and the model side by side. Raises SimulationError where there is nothing to fly."""
    values = increments.physical.starts()
    plays = {t.input: abs(values[t.parameters[0]]) for t in increments.transforms if t.kind == "backlash"}
    flight = fly_aircraft(
        source, written_aircraft.root, any(t.startswith("fcs/") for t in written_aircraft.terms), rate, plays
    )
    model_motions = move_model(simulation, increments.physical, flight, increments.states)
    names = [n for n in increments.physical.output_names if n in NOISE]
    column = {n: increments.physical.output_names.index(n) for n in names}
    rms = {n: _rms(model_motions.stepped[:, c] - flight[n]) for n, c in column.items()}
    steps = {n: _rms(model_motions.stepped[:, c] - model_motions.exact[:, c]) for n, c in column.items()}
    return ExportProof(rms, {n: SHARE * NOISE[n] for n in names}, steps, flight)


@dataclass(frozen=True)
class SteppedMotion:
    """(N, ny) outputs of a model integrated by JSBSim's rule, and exactly with inputs linear between samples."""

    stepped: Array
    exact: Array


def move_model(simulation: Simulation, model: Model, flight: Flight, filters: tuple[str, ...] = ()) -> SteppedMotion:
    """A model on a simulation, flown through a flight without noise from its first state. filters: as in `step_model`."""
    along_flight = simulate_along(
        simulation, without_simulation(model), [flight], preparation=AS_IT_IS, names=computed(model)
    )
    (with_columns,) = with_simulation_columns([flight], along_flight)
    x0 = _initial_state(model, flight)
    as_read = prepare(model, _with_recorded_alpha_rate(with_columns), AS_IT_IS)
    exact = simulate(model, prepare(model, with_columns, AS_IT_IS), x0=x0, substeps=1)
    return SteppedMotion(step_model(model, as_read, x0, filters), exact)


def _with_recorded_alpha_rate(flight: Flight) -> Flight:
    """The flight with lift and moments at the rate of alpha that JSBSim's functions read (of its last step), not the model's."""
    columns = {}
    for c in BY_ALPHA_RATE:
        slope = column_name(c, ALPHA_RATE)
        if slope in flight.columns and flight.measured(ALPHA_RATE):
            columns[column_name(c)] = flight[column_name(c)] + flight[slope] * flight[ALPHA_RATE]
            columns[slope] = np.zeros(len(flight.time))
    return flight.with_columns(**columns)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _initial_state(model: Model, flight: Flight) -> Array:
    """(nx,) the first state: as flown; states of effects start at their signal."""
    first = {n: float(flight[n][0]) for n in flight.columns}
    return np.array([
        first[s.name] if s.name in first else first[s.start] if isinstance(s.start, str) else float(s.start or 0.0)
        for s in model.states
    ])  # fmt: skip
