"""Aircraft by name or file, and the aircraft of a flight: the one given by the caller, carried by the flight, or named in it."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from daq.utilities.input_files import read_text
from daq.utilities.plain_words import did_you_mean
from estimation.aircraft.aircraft import Aircraft
from estimation.aircraft.schema import aircraft_from_text
from estimation.errors import AircraftError

if TYPE_CHECKING:
    from groundstation.flight import Flight

BUILT_IN_FOLDER = Path(__file__).parent


def built_in_aircraft() -> tuple[str, ...]:
    """Names accepted by `load_aircraft` besides paths."""
    return tuple(sorted(path.stem for path in BUILT_IN_FOLDER.glob("*.toml")))


def load_aircraft(name_or_path: str | Path) -> Aircraft:
    """Read an aircraft from a built-in name or a TOML file.

    Raises AircraftError, naming file and key, when the file is missing, not TOML, or has an impossible value.
    """
    text = str(name_or_path)
    path = BUILT_IN_FOLDER / f"{text}.toml" if text in built_in_aircraft() else Path(text)
    if not path.is_file():
        built_in_names = ", ".join(built_in_aircraft())
        raise AircraftError(
            f"aircraft {text!r}: no such file and no built-in of that name (built in: {built_in_names})"
            f"{did_you_mean(text, built_in_aircraft())}; give its file, which 'sideslip aircraft new NAME' begins"
        )
    return aircraft_from_text(read_text(path, "file", AircraftError), str(path), path.stem)


def aircraft_of(flights: "Sequence[Flight]", given: str | Path | Aircraft | None = None) -> Aircraft:
    """The aircraft of all flights: `given` (an aircraft, a built-in name or a file), else the one that the flights name.

    Raises AircraftError with a way out where a flight names none, or one that is neither built in nor carried, or where the
    flights are of different aircraft.
    """
    from groundstation.flight import AIRCRAFT_FILE

    if isinstance(given, Aircraft):
        return given
    if given is not None:
        return load_aircraft(given)
    for flight in flights:
        _check_named(flight)
    if not flights:
        raise AircraftError("no flight is given; name a flight file, or several")
    names = list(dict.fromkeys(f.provenance.aircraft for f in flights))
    if len(names) != 1:
        raise AircraftError(
            f"the flights are of different aircraft ({', '.join(names)}); estimate each by itself, or say whose"
            " geometry and mass to take with --aircraft"
        )
    carried_files = [str(f.provenance.detail[AIRCRAFT_FILE]) for f in flights if AIRCRAFT_FILE in f.provenance.detail]
    if not carried_files:
        return load_aircraft(names[0])
    if len(set(carried_files)) > 1:
        raise AircraftError(
            f"the flights carry different files of aircraft {names[0]}; choose one with --aircraft FILE"
        )
    return aircraft_from_text(carried_files[0], f"aircraft carried by {flights[0].name}", names[0])


def _check_named(flight: "Flight") -> None:
    from groundstation.flight import AIRCRAFT_FILE

    name, built_in_names = flight.provenance.aircraft, ", ".join(built_in_aircraft())
    if not name:
        raise AircraftError(
            f"{flight.name} names no aircraft; say which with --aircraft NAME or FILE (built in: {built_in_names}), or write"
            " one's file with: sideslip aircraft new NAME"
        )
    if AIRCRAFT_FILE not in flight.provenance.detail and name not in built_in_aircraft():
        raise AircraftError(
            f"{flight.name} is of aircraft {name!r}, which is not built in ({built_in_names}) and whose file the flight does not"
            f" carry; give it with --aircraft {name}.toml, or write it with: sideslip aircraft new {name}"
        )
