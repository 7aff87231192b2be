"""The calibrated flight: columns, noise, quality, manoeuvres. The only part of `groundstation` that `estimation` may import."""

from groundstation.flight.errors import FlightError, MissingColumnError
from groundstation.flight.files.reading import read_flight
from groundstation.flight.flight import AIRCRAFT_FILE, GAP_FACTOR, RECONSTRUCTED, Array, Flight, Provenance
from groundstation.flight.writing import write_flight

__all__ = [
    "AIRCRAFT_FILE",
    "GAP_FACTOR",
    "RECONSTRUCTED",
    "Array",
    "Flight",
    "FlightError",
    "MissingColumnError",
    "Provenance",
]
__all__ += ["read_flight", "write_flight"]
