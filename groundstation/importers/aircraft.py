"""The aircraft of an imported flight: its name, or its whole file, which then travels with the flight."""

import tomllib
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from groundstation.flight import AIRCRAFT_FILE, Flight
from groundstation.importers.errors import ImportDataError


def with_aircraft(flight: Flight, given: str) -> Flight:
    """The flight under the name of a built-in aircraft, or with the aircraft file whose path is given.

    Raises ImportDataError for a file that cannot be read as TOML.
    """
    if not given.endswith(".toml"):
        return replace(flight, provenance=replace(flight.provenance, aircraft=given))
    try:
        text = Path(given).read_text(encoding="utf-8")
        name = str(tomllib.loads(text).get("name") or Path(given).stem)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ImportDataError(f"--aircraft {given}: cannot be read as an aircraft file ({error})") from error
    detail = MappingProxyType({**flight.provenance.detail, AIRCRAFT_FILE: text})
    return replace(flight, provenance=replace(flight.provenance, aircraft=name, detail=detail))
