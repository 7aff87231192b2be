"""The aircraft as data: geometry, mass, prior derivatives, and the files they are read from."""

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
