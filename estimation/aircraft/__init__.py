"""The aircraft as data: geometry, mass, sensor positions and what is believed of its derivatives before flying.

Light on purpose (standard library only): the simulator reads geometry and mass from here, the estimators their
constants, starting values and the columns printed beside their results. Aircraft live in TOML files; the built-in
ones are beside this module.

SI and radians; body axes x forward, y right, z down, origin at the CG. Derivatives are per radian, rates
non-dimensional as p b / 2V, q c / 2V, r b / 2V. Source of the built-in CDFP: The Aeronautical Journal (2018),
pp 889-912, doi 10.1017/aer.2018.36; what was not published is marked "engineering estimate" in the file.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from estimation.errors import AircraftError

GRAVITY = 9.80665  # m/s2, standard
SOURCES = ("wind tunnel", "engineering estimate", "flight", "computed")
BUILT_IN_FOLDER = Path(__file__).parent

_GEOMETRY_KEYS = {"span": "span", "area": "area", "chord": "chord"}
_OPTIONAL_GEOMETRY = ("root_chord", "taper", "cg_from_nose")
_MASS_KEYS = ("mass", "Ixx", "Iyy", "Izz", "Ixz")


@dataclass(frozen=True, slots=True)
class PriorDerivative:
    """What is believed of one derivative before flying: value and standard deviation, per rad, and who says so."""

    value: float
    std: float | None = None
    source: str = "engineering estimate"


@dataclass(frozen=True)
class Aircraft:
    """Geometry [m, m2], mass [kg, kg m2], sensor positions [m from the CG, body axes] and prior derivatives [1/rad].

    `Ixz` is the product of inertia as it stands in the equations of motion (positive for a nose-down principal axis).
    """

    name: str
    span: float
    area: float
    chord: float
    mass: float
    Ixx: float
    Iyy: float
    Izz: float
    Ixz: float
    derivatives: Mapping[str, PriorDerivative] = field(default_factory=dict)
    sensors: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    title: str = ""
    root_chord: float | None = None
    taper: float | None = None
    cg_from_nose: float | None = None

    def prior(self, name: str) -> PriorDerivative | None:
        """The prior of derivative `name`, or None where nothing is believed of it."""
        return self.derivatives.get(name)

    def constants(self) -> dict[str, float]:
        """Names and values that the equations of a model may use: m S b c Ixx Iyy Izz Ixz g."""
        return {
            "m": self.mass,
            "S": self.area,
            "b": self.span,
            "c": self.chord,
            "Ixx": self.Ixx,
            "Iyy": self.Iyy,
            "Izz": self.Izz,
            "Ixz": self.Ixz,
            "g": GRAVITY,
        }

    def with_values(self, **changes: float) -> "Aircraft":
        """A copy with other geometry or mass, e.g. `with_values(Ixx=0.26)`."""
        return replace(self, **changes)  # type: ignore[arg-type]


def built_in_aircraft() -> tuple[str, ...]:
    """Names accepted by `load_aircraft` besides paths."""
    return tuple(sorted(path.stem for path in BUILT_IN_FOLDER.glob("*.toml")))


def load_aircraft(name_or_path: str | Path = "cdfp") -> Aircraft:
    """Read an aircraft from a built-in name or a TOML file.

    Raises AircraftError, naming file and key, when the file is missing, not TOML, or says something impossible.
    """
    text = str(name_or_path)
    path = BUILT_IN_FOLDER / f"{text}.toml" if text in built_in_aircraft() else Path(text)
    if not path.is_file():
        known = ", ".join(built_in_aircraft())
        raise AircraftError(f"aircraft {text!r}: no such file and no built-in of that name (built in: {known})")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise AircraftError(f"{path}: not a TOML file: {error}") from error
    return _aircraft_from(data, path)


def _aircraft_from(data: Mapping[str, Any], path: Path) -> Aircraft:
    known = {"name", "title", "geometry", "mass", "sensors", "derivatives"}
    unknown = sorted(set(data) - known)
    if unknown:
        raise AircraftError(f"{path}: unknown key {unknown[0]!r}; known are {', '.join(sorted(known))}")
    geometry = _table(data, "geometry", path)
    mass = _table(data, "mass", path)
    numbers = {key: _positive(geometry, "geometry", key, path) for key in _GEOMETRY_KEYS}
    numbers |= {key: _positive(mass, "mass", key, path) for key in _MASS_KEYS if key != "Ixz"}
    numbers["Ixz"] = _number(mass.get("Ixz", 0.0), "mass.Ixz", path)
    if numbers["Ixz"] ** 2 >= numbers["Ixx"] * numbers["Izz"]:
        raise AircraftError(f"{path}: mass.Ixz = {numbers['Ixz']} is impossible: Ixz^2 must be less than Ixx Izz")
    optional = {key: _number(geometry[key], f"geometry.{key}", path) for key in _OPTIONAL_GEOMETRY if key in geometry}
    return Aircraft(
        name=str(data.get("name", path.stem)),
        title=str(data.get("title", "")),
        derivatives={
            key: _derivative(key, value, path)
            for key, value in _table(data, "derivatives", path, optional=True).items()
        },
        sensors={
            key: _position(key, value, path) for key, value in _table(data, "sensors", path, optional=True).items()
        },
        **numbers,  # type: ignore[arg-type]
        **optional,  # type: ignore[arg-type]
    )


def _table(data: Mapping[str, Any], key: str, path: Path, *, optional: bool = False) -> Mapping[str, Any]:
    value = data.get(key, {} if optional else None)
    if not isinstance(value, Mapping):
        raise AircraftError(f"{path}: a table [{key}] is needed")
    return value


def _number(value: object, key: str, path: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise AircraftError(f"{path}: {key} = {value!r} is not a number")
    return float(value)


def _positive(table: Mapping[str, Any], table_name: str, key: str, path: Path) -> float:
    if key not in table:
        raise AircraftError(f"{path}: {table_name}.{key} is missing")
    value = _number(table[key], f"{table_name}.{key}", path)
    if not value > 0.0:
        raise AircraftError(f"{path}: {table_name}.{key} = {value} must be greater than zero")
    return value


def _derivative(key: str, value: object, path: Path) -> PriorDerivative:
    if not isinstance(value, Mapping):
        return PriorDerivative(_number(value, f"derivatives.{key}", path))
    unknown = sorted(set(value) - {"value", "std", "source"})
    if unknown or "value" not in value:
        what = f"unknown key {unknown[0]!r}" if unknown else "value is missing"
        raise AircraftError(f"{path}: derivatives.{key}: {what}; give value, std and source")
    source = str(value.get("source", "engineering estimate"))
    if source not in SOURCES:
        raise AircraftError(f"{path}: derivatives.{key}.source = {source!r} is none of {', '.join(SOURCES)}")
    std = value.get("std")
    return PriorDerivative(
        value=_number(value["value"], f"derivatives.{key}.value", path),
        std=None if std is None else _number(std, f"derivatives.{key}.std", path),
        source=source,
    )


def _position(key: str, value: object, path: Path) -> tuple[float, float, float]:
    if not isinstance(value, list) or len(value) != 3:
        raise AircraftError(f"{path}: sensors.{key} must be three numbers: x, y, z from the CG in metres")
    x, y, z = (_number(item, f"sensors.{key}", path) for item in value)
    return x, y, z
