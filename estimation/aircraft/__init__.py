"""The aircraft as data: what it is, the files it is read from, and what is believed of it before flying."""

from estimation.aircraft.aircraft import (
    SOURCES,
    Aircraft,
    Engine,
    PriorDerivative,
    Servos,
    SimulatedFlight,
    unknown_aircraft,
)
from estimation.aircraft.library import built_in_aircraft, load_aircraft

__all__ = [
    "SOURCES",
    "Aircraft",
    "Engine",
    "PriorDerivative",
    "Servos",
    "SimulatedFlight",
    "built_in_aircraft",
    "load_aircraft",
    "unknown_aircraft",
]
