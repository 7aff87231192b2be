"""The aircraft for live identification, from a given, embedded or built-in aircraft file, or a model."""

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

DEFAULT_STD = 0.5  # share of a believed value where the file states no std; the same in `estimate --method live`
NEEDED = ("b", "S", "m", "Ixx", "Iyy", "Izz", "Ixz")  # keys of the aircraft file; also "c" for the pitching plane


def live_aircraft(name: str, text: str | None = None, model: str = "") -> LiveAircraft:
    """The aircraft of a name or file. text: content of the aircraft file embedded in the recording, which replaces these. model:
    name of a built-in model, or a model file, whose values the gap monitor then compares with the flight; "" for the default.

    Raises AircraftError for an unknown aircraft, or one without geometry, mass or inertia; ModelError and EstimationError for a
    model that cannot be read, or is not linear in its parameters.
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
    """The airframe with the values and standard deviations of a model as beliefs; and the regressions of that model."""
    from estimation.estimators.recursive import airframe_of, linear_terms, values_of
    from estimation.models.load import load_model

    loaded = load_model(model, aircraft)
    airframe, terms = airframe_of(loaded, aircraft), linear_terms(loaded)
    values, stds = values_of(loaded)
    beliefs = {terms.names[n]: Belief(v, stds.get(n, 0.0)) for n, v in values.items()}
    return replace(airframe, beliefs=beliefs), terms.regressions


def airframe_of_file(aircraft: Aircraft, regressions: Sequence[PlaneRegression] = (LATERAL,)) -> Airframe:
    """Geometry, mass, inertia and beliefs of an aircraft for the recursive estimator. regressions: the planes to be estimated."""
    pitching = LONGITUDINAL.name in [r.name for r in regressions]
    aircraft.need((*NEEDED, "c") if pitching else NEEDED, "live identification")
    beliefs = {}
    for name in (n for r in regressions for n in r.derivatives):
        prior = aircraft.prior(name)
        if prior is not None:
            beliefs[name] = Belief(prior.value, DEFAULT_STD * abs(prior.value) if prior.std is None else prior.std)
    lag = None if aircraft.servos is None else aircraft.servos.lag
    a = aircraft
    chord = a.chord if pitching else math.nan
    return Airframe(a.span, a.area, a.mass, a.Ixx, a.Iyy, a.Izz, a.Ixz, beliefs, lag, chord)
