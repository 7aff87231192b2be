"""Aircraft by name or file."""

from pathlib import Path

from daq.contract.input_files import read_text
from daq.contract.plain_words import meant
from estimation.aircraft.aircraft import Aircraft
from estimation.aircraft.schema import aircraft_from_text
from estimation.errors import AircraftError

BUILT_IN_FOLDER = Path(__file__).parent


def built_in_aircraft() -> tuple[str, ...]:
    """Names accepted by `load_aircraft` besides paths."""
    return tuple(sorted(path.stem for path in BUILT_IN_FOLDER.glob("*.toml")))


def load_aircraft(name_or_path: str | Path) -> Aircraft:
    """Read an aircraft from a built-in name or a TOML file.

    Raises AircraftError, naming file and key, when the file is missing, not TOML, or says something impossible.
    """
    text = str(name_or_path)
    path = BUILT_IN_FOLDER / f"{text}.toml" if text in built_in_aircraft() else Path(text)
    if not path.is_file():
        known = ", ".join(built_in_aircraft())
        raise AircraftError(
            f"aircraft {text!r}: no such file and no built-in of that name (built in: {known}){meant(text, built_in_aircraft())}"
        )
    return aircraft_from_text(read_text(path, "file", AircraftError), str(path), path.stem)
