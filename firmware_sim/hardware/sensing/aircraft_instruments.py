"""Instruments where the aircraft's file says they are: in the simulation, and in the calibration its recordings carry."""

import tomllib
from pathlib import Path
from typing import Any

from daq.utilities.durable import write_text
from estimation.aircraft import Aircraft
from firmware_sim.tables import toml_text

_SECTIONS = {"imu": "imu", "alpha_vane": "alpha_vane", "beta_vane": "beta_vane", "gps": "gnss"}
"""Name in the aircraft's file -> table of the scenario's [sensors]."""

_FILES = {"accelerometer": ("mount", "imu"), "alpha_vane": ("vane", "alpha_vane"), "beta_vane": ("vane", "beta_vane")}
"""Instrument of a calibration file -> its table with a position, name in the aircraft's file."""


def placed(aircraft: Aircraft) -> dict[str, Any]:
    """Positions as the scenario's [sensors] has them; instruments that the file does not place keep their defaults."""
    return {
        section: {"position": aircraft.sensors[name]} for name, section in _SECTIONS.items() if name in aircraft.sensors
    }


def calibration_of(aircraft: Aircraft, directory: Path, folder: Path) -> Path:
    """The calibration directory with the aircraft's positions: itself where they are there, else a copy in `folder`."""
    texts = {file.name: file.read_text(encoding="utf-8") for file in sorted(directory.glob("*.toml"))}
    changed_files = {name: changed for name, text in texts.items() if (changed := _moved(text, aircraft)) is not None}
    if not changed_files:
        return directory
    copy = folder / "calibration"
    copy.mkdir(parents=True, exist_ok=True)
    for name, text in {**texts, **changed_files}.items():
        write_text(copy / name, text)
    return copy


def _moved(text: str, aircraft: Aircraft) -> str | None:
    """A calibration file with its instrument's place on the aircraft; None where it says so already, or need not."""
    file = tomllib.loads(text)
    table, name = _FILES.get(file.get("instrument", ""), ("", ""))
    place = aircraft.sensors.get(name)
    if place is None or table not in file or tuple(file[table].get("position", ())) == tuple(place):
        return None
    return toml_text({**file, table: {**file[table], "position": list(place)}})
