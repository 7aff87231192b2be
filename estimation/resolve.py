"""The front door: which flights, stretches, model, aircraft, methods and simulation a call is about.

Every verb, every Python function and every worker of a campaign resolves its arguments here, so that the same arguments give the
same numbers.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from daq.utilities.plain_words import comma_separated
from estimation.aircraft import Aircraft, unknown_aircraft
from estimation.aircraft.library import aircraft_of
from estimation.errors import EstimationError
from estimation.estimators.estimator import Estimator
from estimation.estimators.registry import find_estimator
from estimation.models import Model, load_model
from estimation.models.load import asks_for_aircraft, check_model
from estimation.prepare.measured_cg import with_cg_history
from estimation.prepare.measured_mass import with_mass_history
from estimation.prepare.stretches import flights_of_segments, select_segments, unique_names
from estimation.simulation.attach import (
    Attached,
    Free,
    attach,
    estimated_about_its_motion,
    motion_settled,
    renewed_attachment,
)
from groundstation.flight import Flight, read_flight

Flights = Flight | str | Path | Sequence[Flight | str | Path]
AnyModel = str | Path | Model | type
AnyAircraft = str | Path | Aircraft | None
Names = str | Iterable[str]
"""Comma-separated names, or an iterable of them."""


@dataclass(frozen=True)
class ResolvedCall:
    """What a call works on. notes: sentences on what a simulation holds or was not measured, and whose mass is used."""

    model: Model
    aircraft: Aircraft
    flights: tuple[Flight, ...]
    methods: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def resolve(
    flights: Flights,
    model: AnyModel = "lateral",
    aircraft: AnyAircraft = None,
    methods: Names = (),
    *,
    segments: str | None = None,
    each_segment: bool = False,
    simulation: str | None = None,
    free: Free = Free.FACTORS,
    moving: Model | None = None,
    needs_aircraft: bool = False,
    hold_initial: Names = "",
    free_initial: Names = "",
) -> ResolvedCall:
    """The flights under unique names, the model, and its aircraft.

    segments: stretches, as in `select_segments`; each_segment: every stretch becomes a flight. free: what of a simulation is
    estimated; moving: a model of how surfaces and aircraft move, where not as recorded. needs_aircraft: the call itself uses
    geometry and mass, whatever the model. hold_initial, free_initial: as in `with_initial_states`. Raises a UserError of one
    sentence for what cannot be found or does not fit; mistyped methods and models are refused before a flight is read.
    """
    method_names = tuple(dict.fromkeys(comma_separated(methods)))
    estimators = [find_estimator(name) for name in method_names]
    if isinstance(model, str | Path):
        check_model(str(model))
    selected = read_flights(flights, segments, each_segment=each_segment)
    if simulation is not None:
        attached = _on_simulation(simulation, model, selected, aircraft, free, moving)
        loaded, airframe, selected, notes = attached.model, attached.aircraft, list(attached.flights), attached.notes
    else:
        airframe = which_aircraft(selected, aircraft, needed=needs_aircraft or _takes_aircraft(model, estimators))
        loaded, notes = load_model(model, airframe), ()
    loaded, with_mass, mass_notes = with_mass_history(loaded, selected, airframe)
    loaded, with_cg, cg_notes = with_cg_history(loaded, with_mass)
    notes = (*(f"simulation: {note}" for note in notes), *mass_notes, *cg_notes)
    return ResolvedCall(with_initial_states(loaded, hold_initial, free_initial), airframe, with_cg, method_names, notes)


def read_flights(flights: Flights, segments: str | None = None, *, each_segment: bool = False) -> list[Flight]:
    """The stretches `segments` of flights, which are given as such or as files, under unique names."""
    listed = as_listed(flights)
    selected = [select_segments(f if isinstance(f, Flight) else read_flight(f), segments) for f in listed]
    return unique_names([part for f in selected for part in flights_of_segments(f)] if each_segment else selected)


def as_listed(flights: Flights) -> list[Flight | str | Path]:
    """One flight or several as a list."""
    return [flights] if isinstance(flights, Flight | str | Path) else list(flights)


def which_aircraft(flights: Sequence[Flight], given: AnyAircraft, *, needed: bool) -> Aircraft:
    """The aircraft that is given, else the one the flights carry or name; an unknown one where none is needed."""
    if given is None and not needed:
        return unknown_aircraft((flights[0].provenance.aircraft if flights else "") or "not stated")
    return aircraft_of(flights, given)


def _takes_aircraft(model: AnyModel, estimators: Iterable[Estimator]) -> bool:
    return asks_for_aircraft(model) or any(e.needs_aircraft for e in estimators)


def _on_simulation(
    spec: str,
    model: AnyModel,
    flights: Sequence[Flight],
    aircraft: AnyAircraft,
    free: Free,
    moving: Model | None,
) -> Attached:
    """The model with its simulation evaluated along the flights: about the fitted motion where derivatives are free, about the
    predicted motion where nothing is, or where a model `moving` shows it otherwise than it is."""
    if not isinstance(model, str | Path):
        raise EstimationError("a simulation takes its model by name or as a MODEL.toml; give one of these")
    attached = attach(spec, str(model), flights, aircraft, free, moving)
    if moving is not None and moving.instruments != attached.model.instruments:
        return renewed_attachment(attached, moving)
    if free is Free.DERIVATIVES:
        return estimated_about_its_motion(attached)
    return motion_settled(attached) if free is Free.NOTHING else attached


def with_initial_states(model: Model, hold: Names, free: Names) -> Model:
    """The model with initial values of states held or freed. Raises EstimationError for values and names that contradict.

    hold: names of states, held as measured, or NAME=VALUE; free: names. `all` is every state.
    """
    values: dict[str, float] = {}
    names: dict[str, list[str]] = {}
    for option, option_text in (("--hold-initial", hold), ("--free-initial", free)):
        words = comma_separated(option_text)
        names[option] = list(model.state_names) if words == ("all",) else [w for w in words if "=" not in w]
        for name, _, number in (w.partition("=") for w in words if "=" in w):
            try:
                values[name.strip()] = float(number)
            except ValueError:
                raise EstimationError(f"{option} {name}={number}: not a number; write it like phi=0.02") from None
            if option == "--free-initial" or not math.isfinite(values[name.strip()]):
                raise EstimationError(f"{option} {name}={number}: a value is for --hold-initial, and finite")
    held_names, freed_names = names["--hold-initial"], names["--free-initial"]
    if contradictory := sorted({*held_names, *values} & set(freed_names)):
        raise EstimationError(f"{contradictory[0]} is named by --hold-initial and --free-initial: choose one")
    if held_names or values:
        model = model.with_initial(*held_names, held=True, values=values)
    return model.with_initial(*freed_names, held=False) if freed_names else model
