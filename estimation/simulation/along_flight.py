"""A simulation along measured flights: its coefficients and their slopes at the measured motion, as columns of the flight.

At each sample the simulation gives its coefficients C and, by central differences, their slopes J with each variable x of the
model, at the measured (de-noised) motion x_m. The columns hold J and C - J x_m, so the model computes C + J (x - x_m) at its own
motion x: exact at the measured motion, and to second order near it. Control surfaces are among the variables, so an effect on a
surface also reaches the simulation. Where a model delays its surfaces or gives them play, x_m contains the surfaces as that model
moves them, because a drag by |elevator| has no slope that holds on both sides of zero.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.transforms import acting_on, apply_transforms
from estimation.models.base import Model, Signal
from estimation.prepare.columns import alpha_rate
from estimation.prepare.flight_data import FEWEST_DRAWS, FlightData, Preparation
from estimation.prepare.pipeline import prepare
from estimation.simulation.oracle import (
    ALPHA_RATE,
    COEFFICIENTS,
    SURFACES,
    VARIABLES,
    Array,
    Simulation,
    SimulationError,
    States,
)
from groundstation.flight import Flight

SIMULATION_PREFIX = "sim_"  # of the columns with the simulation's values at each sample
STEPS: Mapping[str, float] = {
    "alpha": 0.005, "beta": 0.005, "delta_e": 0.005, "delta_a": 0.005, "delta_r": 0.005,
    "p": 0.05, "q": 0.05, "r": 0.05, ALPHA_RATE: 0.05,
}  # fmt: skip
"""Steps of the central differences [rad, rad/s]: a third of a degree, small against the cells of a wind tunnel's table, and a
thousand times larger than rounding needs. For airspeed and thrust `RELATIVE_STEP` of their mean."""
RELATIVE_STEP = 0.01
TINY = 1e-300  # keeps a constant input from dividing by zero
LEAST_SLOPE = 1e-9  # a slope smaller than this everywhere is rounding
UNITS = {"V": "m/s", "alpha": "rad", "beta": "rad", "p": "rad/s", "q": "rad/s", "r": "rad/s", "thrust": "N"}
AS_MOTION = Preparation(draws=FEWEST_DRAWS, feedback=False)
STABILITY = ("CL", "CD")
BY_ALPHA_RATE = ("CL", "Cl", "Cm", "Cn")  # coefficients that have slopes with the rate of alpha


@dataclass(frozen=True)
class AlongFlights:
    """A simulation along several flights.

    columns: for each flight, name -> (samples,), NaN where the flight cannot be used: `sim_<C>_0` and `sim_<C>_<variable>` [per
    rad, rad/s, m/s or N]. names: of all columns. means: (coefficient, variable) -> mean slope. speed: mean airspeed [m/s].
    unmeasured: variables taken as zero because no flight measures them.
    """

    columns: tuple[Mapping[str, Array], ...]
    names: tuple[str, ...]
    means: Mapping[tuple[str, str], float]
    speed: float
    unmeasured: tuple[str, ...]


def simulate_along(
    simulation: Simulation,
    model: Model,
    flights: Sequence[Flight],
    motions: Sequence[Mapping[str, Array]] = (),
    preparation: Preparation = AS_MOTION,
    names: Sequence[str] | None = None,
    controls: Model | None = None,
) -> AlongFlights:
    """Evaluate a simulation along flights for the coefficients and variables of `model`, which has lines for them.

    motions: for each flight, variable -> (samples,) motion that replaces the measured one where it is finite. controls: a model
    whose input transforms delay control surfaces or give them play; by default they move as measured. names: the columns that an
    existing model reads; by default those that are not zero throughout. Slopes without a column stay in the constant part, at
    their values along the motion. Raises SimulationError where the simulation lacks a coefficient of the model, DataError or
    MissingColumnError for a flight that cannot feed it.
    """
    coefficients = coefficients_in(model)
    variables = variables_of(model)
    slopes: list[dict[str, Array]] = []
    evaluations, absent = [], set(VARIABLES)
    for i, flight in enumerate(flights):
        states, usable, unmeasured = motion(
            model, flight, motions[i] if i < len(motions) else {}, preparation, controls
        )
        absent &= unmeasured
        base_values, flight_slopes = _values_and_slopes(simulation, states, coefficients, variables)
        evaluations.append((states, usable, base_values))
        slopes.append(flight_slopes)
    if names is None:
        slope_names = [n for n in slopes[0] if any(np.max(np.abs(s[n])) > LEAST_SLOPE for s in slopes)]
        names = (*slope_names, *(column_name(c) for c in coefficients))
    columns = []
    for (states, usable, base_values), flight_slopes in zip(evaluations, slopes, strict=True):
        table = {n: _over_flight(flight_slopes[n], usable) for n in names if n in flight_slopes}
        for k, c in enumerate(coefficients):
            with_column = [v for v in variables if column_name(c, v) in table]
            by_slopes = [flight_slopes[column_name(c, v)] * _variable(states, v) for v in with_column]
            table[column_name(c)] = _over_flight(base_values[:, k] - sum(by_slopes, np.zeros(len(states))), usable)
        columns.append(table)
    means = {
        (c, v): float(np.mean([np.mean(s[column_name(c, v)]) for s in slopes]))
        for c in coefficients for v in variables if column_name(c, v) in slopes[0]
    }  # fmt: skip
    speed = float(np.mean([np.mean(states.values["V"]) for states, _, _ in evaluations]))
    return AlongFlights(tuple(columns), tuple(names), means, speed, tuple(v for v in VARIABLES if v in absent))


def variables_of(model: Model) -> list[str]:
    """The variables with which coefficients are differentiated: those of VARIABLES that are signals of the model, and the rate
    of alpha where the model has a line for it."""
    signal_names = {*model.state_names, *model.input_names}
    return [v for v in VARIABLES if v in signal_names] + ([ALPHA_RATE] if ALPHA_RATE in model.definitions else [])


def _variable(states: States, variable: str) -> Array:
    return states.alpha_dot if variable == ALPHA_RATE else states.values[variable]


def column_name(coefficient: str, variable: str = "0") -> str:
    """Name of the column of a slope, or of the coefficient less its slopes times the variables."""
    return f"{SIMULATION_PREFIX}{coefficient}_{variable}"


def coefficients_in(model: Model) -> tuple[str, ...]:
    """The coefficients that a model has lines for: lift and drag rather than CX and CZ where it has both."""
    lines = model.definitions
    forces = [c for c in STABILITY if c in lines]
    body = [c for c in COEFFICIENTS if c in lines and not (forces and c in ("CX", "CZ"))]
    return (*forces, *body)


def motion(
    model: Model,
    flight: Flight,
    replacement: Mapping[str, Array],
    preparation: Preparation,
    controls: Model | None = None,
) -> tuple[States, np.ndarray, set[str]]:  # type: ignore[type-arg]
    """(states, usable, unmeasured): de-noised states at the usable samples, (samples,) which are usable, variables that the
    flight does not measure. Raises SimulationError where the airspeed is not above zero."""
    signal_names = {s.name for s in (*model.inputs, *model.states)}
    absent_signals = [
        Signal(v, UNITS.get(v, "rad"), control=v in SURFACES, optional=True) for v in VARIABLES if v not in signal_names
    ]
    probe = model.plus(inputs=[*absent_signals, *([Signal("rho", "kg/m3")] if "rho" not in signal_names else [])])
    data = prepare(probe, flight, preparation)
    if preparation.denoise:
        data = _without_noise_alone(probe, data)
    usable = np.zeros(data.samples, bool)
    values = {name: np.zeros(data.samples) for name in (*VARIABLES, "rho", ALPHA_RATE)}
    for segment in data.segments:
        s = slice(segment.first, segment.first + len(segment))
        usable[s] = True
        for name in (*VARIABLES, "rho"):
            measured = _history(probe, data, s, segment.u, name)
            if controls is not None and name in SURFACES:
                measured = as_moved_by(controls, name, segment.time, measured)
            if name in replacement:
                measured = np.where(np.isfinite(replacement[name][s]), replacement[name][s], measured)
            values[name][s] = measured
        if not preparation.denoise and flight.measured(ALPHA_RATE):
            values[ALPHA_RATE][s] = flight[ALPHA_RATE][s]
        else:
            values[ALPHA_RATE][s] = alpha_rate(flight, s, segment.time, {n: v[s] for n, v in values.items()})
    if not (values["V"][usable] > 0.0).all():
        raise SimulationError(
            f"{flight.name}: V is not above zero everywhere; cut the flight to where it flies (--segments)"
        )
    unmeasured = {v for v in VARIABLES if not flight.measured(v)}
    usable_values = {n: values[n][usable] for n in VARIABLES}
    return States(usable_values, values["rho"][usable], values[ALPHA_RATE][usable]), usable, unmeasured


def _without_noise_alone(probe: Model, data: FlightData) -> FlightData:
    """The flight with each de-noised input, controls aside, drawn to its mean by the share of its variance that is error.

    What is left of a vane's noise where nothing moves it has a mean size, and a drag by |sideslip| would take that for sideslip.
    """
    motion = [i for i, s in enumerate(probe.inputs) if not s.control]
    if data.errors is None or not data.segments:
        return data
    u = np.concatenate([s.u[:, motion] for s in data.segments])
    errors = np.concatenate([data.errors[s.rows][:, motion] for s in data.segments])
    mean, variance = u.mean(axis=0), np.maximum(u.var(axis=0), TINY)
    share = np.ones(len(probe.inputs))
    share[motion] = np.maximum(1.0 - (errors**2).mean(axis=(0, 2)) / variance, 0.0)
    center = np.zeros(len(probe.inputs))
    center[motion] = mean
    return replace(data, segments=tuple(replace(s, u=center + share * (s.u - center)) for s in data.segments))


def as_moved_by(model: Model, control: str, time: Array, measured: Array) -> Array:
    """(N,) history of a control surface after a model's delays, lags and plays; `measured` itself without any."""
    transforms, _ = acting_on({control}, model.transforms, model.input_names)
    return apply_transforms(transforms, (control,), time, measured[:, None], model.starts())[:, 0]


def _history(probe: Model, data: FlightData, s: slice, u: Array, name: str) -> Array:
    if name in probe.input_names:
        return np.asarray(u[:, probe.input_names.index(name)])
    return np.nan_to_num(data.states[s, probe.state_names.index(name)])


def _values_and_slopes(
    simulation: Simulation, states: States, wanted: Sequence[str], variables: Sequence[str]
) -> tuple[Array, dict[str, Array]]:
    """(N, wanted) coefficients of one flight; column -> (N,) slopes."""
    steps = {
        v: STEPS.get(v) or RELATIVE_STEP * max(float(np.mean(np.abs(_variable(states, v)))), 1.0) for v in variables
    }
    shifted_states = [states, *(states.moved(v, sign * steps[v]) for v in variables for sign in (1.0, -1.0))]
    base_values, *shifted_values = np.split(
        _coefficient_columns(simulation, States.joined(shifted_states), wanted), len(shifted_states)
    )
    slopes = {
        column_name(c, v): (shifted_values[2 * j][:, k] - shifted_values[2 * j + 1][:, k]) / (2.0 * steps[v])
        for k, c in enumerate(wanted)
        for j, v in enumerate(variables)
        if v != ALPHA_RATE or c in BY_ALPHA_RATE
    }
    return base_values, slopes


def _over_flight(values: Array, usable: np.ndarray) -> Array:  # type: ignore[type-arg]
    """(samples,) values at the usable samples, NaN elsewhere."""
    result = np.full(usable.size, np.nan)
    result[usable] = values
    return result


def _coefficient_columns(simulation: Simulation, states: States, wanted: Sequence[str]) -> Array:
    """(N, wanted) coefficients; lift and drag are rotated from body axes by the angle of attack."""
    body = simulation.oracle.coefficients(states)
    alpha = states.values["alpha"]
    X, Z = body[:, 0], body[:, 2]
    coefficient_values = {
        **{c: body[:, i] for i, c in enumerate(COEFFICIENTS)},
        "CL": X * np.sin(alpha) - Z * np.cos(alpha),
        "CD": -X * np.cos(alpha) - Z * np.sin(alpha),
    }
    missing_coefficients = [c for c in wanted if not np.isfinite(coefficient_values[c]).all()]
    if missing_coefficients:
        raise SimulationError(
            f"simulation {simulation.spec}: gives no {', '.join(missing_coefficients)}, which this model needs;"
            " choose a --model that does without"
        )
    return np.column_stack([coefficient_values[c] for c in wanted])
