"""The aircraft of an imported flight: its name, or its whole file, which then travels with the flight."""

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from daq.contract.input_files import parse_toml, read_text
from groundstation.flight import AIRCRAFT_FILE, Flight
from groundstation.importers.errors import ImportDataError


def with_aircraft(flight: Flight, given: str) -> Flight:
    """The flight under the name of a built-in aircraft, or with the aircraft file whose path is given.

    Raises ImportDataError for a file that cannot be read as TOML.
    """
    if not given.endswith(".toml"):
        return replace(flight, provenance=replace(flight.provenance, aircraft=given))
    text = read_text(Path(given), "aircraft file", ImportDataError)
    name = str(parse_toml(text, given, ImportDataError).get("name") or Path(given).stem)
    detail = MappingProxyType({**flight.provenance.detail, AIRCRAFT_FILE: text})
    return replace(flight, provenance=replace(flight.provenance, aircraft=name, detail=detail))
