"""A model on a simulation (`--simulation`): the simulation is evaluated along the flights, and its coefficients become columns of
the flights that the model reads as inputs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from daq.utilities.errors import UserError
from estimation.aircraft import Aircraft
from estimation.aircraft.library import aircraft_of
from estimation.estimators.arithmetic import NumericalFailure, numerical_failures
from estimation.estimators.output_error import OutputErrorOptions, output_error
from estimation.models.base import Model
from estimation.models.expressions import names_in
from estimation.models.library import BUILDERS
from estimation.models.load import load_model, read_model
from estimation.simulation.along_flight import AlongFlights, simulate_along
from estimation.simulation.autopilot.simulations import ARDUPILOT, GAZEBO, ardupilot_simulation, gazebo_simulation
from estimation.simulation.base_model import Free, base_model
from estimation.simulation.jsbsim.aircraft import jsbsim_simulation
from estimation.simulation.jsbsim.library import PREFIX
from estimation.simulation.oracle import COEFFICIENTS, VARIABLES, Array, Simulation, SimulationError
from estimation.simulation.own_simulations import function_simulation, text_simulation
from groundstation.flight import Flight


def simulation_of(spec: str) -> Simulation:
    """The simulation named by `spec`: `jsbsim:AIRCRAFT`, `ardupilot:FILE.json`, `gazebo:FILE.sdf`, `module:function` or
    `MODEL.toml`. Raises SimulationError (one sentence) where there is none."""
    if spec.startswith(PREFIX):
        return jsbsim_simulation(spec.removeprefix(PREFIX))
    if spec.startswith(ARDUPILOT):
        return ardupilot_simulation(spec.removeprefix(ARDUPILOT))
    if spec.startswith(GAZEBO):
        return gazebo_simulation(spec.removeprefix(GAZEBO))
    if spec.endswith(".toml"):
        return text_simulation(spec)
    if ":" in spec:
        return function_simulation(spec)
    raise SimulationError(
        f"simulation {spec!r}: write jsbsim:AIRCRAFT (a name or a folder), ardupilot:FILE.json, gazebo:FILE.sdf,"
        " module:function, or a MODEL.toml"
    )


MOST_RENEWALS = 6  # each squares the remaining distance, so more would not help
SETTLED = 1e-3  # largest change over a motion's standard deviation: far below the noise of its measurement


@dataclass(frozen=True)
class Attached:
    """A model on a simulation, and the flights with its columns. notes: which inputs of the simulation are constant or not
    measured."""

    simulation: Simulation
    aircraft: Aircraft
    model: Model
    flights: tuple[Flight, ...]
    notes: tuple[str, ...]

    def training(self, count: int) -> list[Flight]:
        """The first `count` flights."""
        return list(self.flights[:count])

    def holdout(self, count: int) -> list[Flight]:
        """The flights after the first `count`."""
        return list(self.flights[count:])


def attach(
    spec: str,
    which: str,
    flights: Sequence[Flight],
    given: str | Path | Aircraft | None = None,
    free: Free = Free.FACTORS,
    controls: Model | None = None,
) -> Attached:
    """The simulation `spec` with the model `which`: a built-in name, or a MODEL.toml that was estimated on a simulation.

    given: the requested aircraft; by default that of the flights, else the simulation's. controls: a model whose input transforms
    move the control surfaces, where they did not move as recorded; a MODEL.toml brings its own. Raises SimulationError,
    ModelError, AircraftError or DataError (one sentence each).
    """
    simulation = simulation_of(spec)
    aircraft = aircraft_for(simulation, flights, given)
    if simulation.referred is not None:
        simulation = simulation.referred(aircraft)
    if which in BUILDERS:
        along_flights = simulate_along(simulation, load_model(which, aircraft), flights, controls=controls)
        model = base_model(simulation, which, aircraft, along_flights, free)
    else:
        model = _model_on_simulation(which)
        along_flights = simulate_along(
            simulation, without_simulation(model), flights, names=computed(model), controls=controls or model
        )
    notes = (*simulation.notes, *_unmeasured_notes(along_flights))
    return Attached(simulation, aircraft, model, with_simulation_columns(flights, along_flights), notes)


def renewed_attachment(attached: Attached, fitted: Model | None = None) -> Attached:
    """The attachment with the simulation evaluated at the motion that `fitted` (by default the present model) predicts for each
    flight, instead of at the measured motion.

    The prediction can differ from the measured motion by some degrees, and the slopes at the measured motion do not hold there.
    Flights whose initial states cannot be fitted keep the measured motion. The derivatives' starts do not change.
    """
    motion_model = fitted or attached.model
    along_flights = simulate_along(
        attached.simulation, without_simulation(attached.model), attached.flights,
        [_motion_of(motion_model, flight) for flight in attached.flights], names=computed(attached.model),
        controls=motion_model,
    )  # fmt: skip
    return replace(attached, flights=with_simulation_columns(attached.flights, along_flights))


def motion_settled(attached: Attached) -> Attached:
    """The attachment evaluated at the predicted motion, repeated until the prediction no longer changes."""
    old_motions = [_motion_of(attached.model, flight) for flight in attached.flights]
    for _ in range(MOST_RENEWALS):
        attached = renewed_attachment(attached)
        new_motions = [_motion_of(attached.model, flight) for flight in attached.flights]
        if all(_same_motion(old, new) for old, new in zip(old_motions, new_motions, strict=True)):
            break
        old_motions = new_motions
    return attached


def estimated_about_its_motion(attached: Attached) -> Attached:
    """The attachment evaluated at the motion of the best fit to all flights; unchanged where that fit fails."""
    try:
        with numerical_failures():
            first = output_error(attached.model, attached.flights)
    except (UserError, NumericalFailure):
        return attached
    return renewed_attachment(attached, first.fitted_model) if first.converged else attached


def aircraft_for(simulation: Simulation, flights: Sequence[Flight], given: str | Path | Aircraft | None) -> Aircraft:
    """The given aircraft, else that of the flights, else the simulation's. Area, span and chord are the simulation's where it has
    them, because its coefficients refer to these, unless it can refer them to any aircraft."""
    own = simulation.aircraft
    if given is None and own is not None and not any(f.provenance.aircraft for f in flights):
        return own
    aircraft = aircraft_of(flights, given)
    if simulation.referred is not None or own is None or np.isnan([own.area, own.span, own.chord]).any():
        return aircraft
    return aircraft.with_values(area=own.area, span=own.span, chord=own.chord)


def without_simulation(model: Model) -> Model:
    """The model with the simulation's coefficients at zero, which needs only variables and columns that flights have."""
    inputs, columns = tuple(s for s in model.inputs if not s.computed), set(computed(model))
    zero = {f"{c}_sim" for c in ("CL", "CD", *COEFFICIENTS) if c in model.definitions}
    lines = {n: "0" if n in zero else text for n, text in model.definitions.items()}
    equations = tuple(f"{n} = {text}" for n, text in lines.items() if not names_in(text) & columns)
    return replace(model, inputs=inputs, equations=equations)


def _model_on_simulation(which: str) -> Model:
    """The model of a file. Raises SimulationError where it has no inputs from a simulation."""
    if not which.endswith(".toml"):
        raise SimulationError(
            f"--simulation with model {which!r}: choose a built-in model ({', '.join(BUILDERS)}),"
            " or a MODEL.toml found on a simulation"
        )
    model = read_model(which)
    if not any(s.computed for s in model.inputs):
        raise SimulationError(
            f"{which}: this model stands on no simulation; leave --simulation away, or name a built-in model"
        )
    return model


def computed(model: Model) -> tuple[str, ...]:
    """Names of the simulation's columns that a model reads."""
    return tuple(s.name for s in model.inputs if s.computed)


def with_simulation_columns(flights: Sequence[Flight], along_flights: AlongFlights) -> tuple[Flight, ...]:
    """The flights with the columns of the simulation."""
    return tuple(flight.with_columns(**columns) for flight, columns in zip(flights, along_flights.columns, strict=True))


def _unmeasured_notes(along_flights: AlongFlights) -> tuple[str, ...]:
    surfaces = [v for v in along_flights.unmeasured if v != "thrust"]
    return (f"no flight measures {', '.join(surfaces)}: the simulation has them at zero",) if surfaces else ()


def _motion_of(model: Model, flight: Flight) -> Mapping[str, Array]:
    """State -> predicted history (N,) with only the initial states fitted, not as the model's instruments show it; empty where
    that does not converge."""
    frozen = model.fixed(*model.parameter_names)
    result = output_error(frozen, flight, options=OutputErrorOptions(improve_start=False))
    if not result.converged:
        return {}
    histories = zip(result.model.state_names, result.flights[0].states.T, strict=True)
    return {n: history for n, history in histories if n in VARIABLES}


def _same_motion(old: Mapping[str, Array], new: Mapping[str, Array]) -> bool:
    return old.keys() == new.keys() and all(np.nanstd(new[n] - old[n]) <= SETTLED * np.nanstd(new[n]) for n in new)
