"""The aircraft as live identification is told of it: from the aircraft file that is given, carried along, or built in."""

import math
from collections.abc import Sequence
from dataclasses import replace

from daq.identification.airframe import Airframe, Belief
from daq.identification.regression import (
    DEFAULT_MODEL,
    LATERAL,
    LONGITUDINAL,
    REGRESSIONS,
    LiveAircraft,
    PlaneRegression,
)
from estimation.aircraft import Aircraft
from estimation.aircraft.library import load_aircraft
from estimation.aircraft.schema import aircraft_from_text

DOUBTED = (
    0.5  # of a believed value: its standard deviation where the file states none, as `estimate --method live` has it
)
NEEDED = ("b", "S", "m", "Ixx", "Iyy", "Izz", "Ixz")


def live_aircraft(name: str, text: str | None = None, model: str = "") -> LiveAircraft:
    """The aircraft of a name or file; text: that of the file which travelled with the recording; model: what is estimated, a
    built-in model's name or the file of one; the gap monitor holds one that is a file against flight.

    Raises AircraftError where there is no such aircraft, or where its file lacks geometry, mass or inertia, ModelError and
    EstimationError where the model cannot be read, or is not linear in its parameters.
    """
    aircraft = (
        load_aircraft(name) if text is None else aircraft_from_text(text, f"aircraft {name} of the recording", name)
    )
    sources = {n: p.source for n, p in aircraft.derivatives.items()}
    if not model or model in REGRESSIONS:
        regressions = REGRESSIONS[model or DEFAULT_MODEL]
        return LiveAircraft(
            aircraft.name, airframe_of_file(aircraft, regressions), sources, None, aircraft.throws, regressions
        )
    modelled, regressions = airframe_of_model(model, aircraft)
    believed = airframe_of_file(aircraft, regressions)
    return LiveAircraft(aircraft.name, believed, sources, modelled, aircraft.throws, regressions)


def airframe_of_model(model: str, aircraft: Aircraft) -> tuple[Airframe, tuple[PlaneRegression, ...]]:
    """An aircraft as a model has it: its values, and what it says that these may be wrong by; and what it estimates."""
    from estimation.estimators.recursive import airframe_of, linear_terms, values_of
    from estimation.models.load import load_model

    read = load_model(model, aircraft)
    airframe, terms = airframe_of(read, aircraft), linear_terms(read)
    values, stds = values_of(read)
    beliefs = {terms.names[n]: Belief(v, stds.get(n, 0.0)) for n, v in values.items()}
    return replace(airframe, beliefs=beliefs), terms.regressions


def airframe_of_file(aircraft: Aircraft, regressions: Sequence[PlaneRegression] = (LATERAL,)) -> Airframe:
    """Geometry, mass and beliefs of an aircraft, as the recursive estimator takes them."""
    pitching = LONGITUDINAL.name in [r.name for r in regressions]
    aircraft.need((*NEEDED, "c") if pitching else NEEDED, "live identification")
    beliefs = {}
    for name in (n for r in regressions for n in r.derivatives):
        prior = aircraft.prior(name)
        if prior is not None:
            beliefs[name] = Belief(prior.value, DOUBTED * abs(prior.value) if prior.std is None else prior.std)
    lag = None if aircraft.servos is None else aircraft.servos.lag
    a = aircraft
    chord = a.chord if pitching else math.nan
    return Airframe(a.span, a.area, a.mass, a.Ixx, a.Iyy, a.Izz, a.Ixz, beliefs, lag, chord)
