"""The aircraft as live identification is told of it: from the aircraft file that is given, carried along, or built in."""

from dataclasses import replace

from daq.identification.airframe import DERIVATIVES, Airframe, Belief, LiveAircraft
from estimation.aircraft import Aircraft
from estimation.aircraft.library import load_aircraft
from estimation.aircraft.schema import aircraft_from_text

DOUBTED = (
    0.5  # of a believed value: its standard deviation where the file states none, as `estimate --method live` has it
)
NEEDED = ("b", "S", "m", "Ixx", "Iyy", "Izz", "Ixz")


def live_aircraft(name: str, text: str | None = None, model: str = "") -> LiveAircraft:
    """The aircraft of a name or file; text: that of the file which travelled with the recording; model: file of a model of its
    lateral derivatives that the gap monitor holds against flight.

    Raises AircraftError where there is no such aircraft, or where its file lacks geometry, mass or inertia, ModelError and
    EstimationError where the model cannot be read, or has other parameters.
    """
    aircraft = (
        load_aircraft(name) if text is None else aircraft_from_text(text, f"aircraft {name} of the recording", name)
    )
    aircraft.need(NEEDED, "live identification")
    sources = {n: p.source for n, p in aircraft.derivatives.items()}
    return LiveAircraft(
        aircraft.name, airframe_of_file(aircraft), sources, airframe_of_model(model, aircraft) if model else None
    )


def airframe_of_model(model: str, aircraft: Aircraft) -> Airframe:
    """An aircraft as a model has it: its values, and what it says that these may be wrong by."""
    from estimation.estimators.recursive import airframe_of, values_of
    from estimation.models.load import load_model

    read = load_model(model, aircraft)
    airframe = airframe_of(read, aircraft)
    values, stds = values_of(read)
    return replace(airframe, beliefs={n: Belief(v, stds.get(n, 0.0)) for n, v in values.items()})


def airframe_of_file(aircraft: Aircraft) -> Airframe:
    """Geometry, mass and beliefs of an aircraft, as the recursive estimator takes them."""
    beliefs = {}
    for name in DERIVATIVES:
        prior = aircraft.prior(name)
        if prior is not None:
            beliefs[name] = Belief(prior.value, DOUBTED * abs(prior.value) if prior.std is None else prior.std)
    lag = None if aircraft.servos is None else aircraft.servos.lag
    a = aircraft
    return Airframe(a.span, a.area, a.mass, a.Ixx, a.Iyy, a.Izz, a.Ixz, beliefs, lag)
