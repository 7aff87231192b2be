"""The schema of an aircraft file, checked key by key, and the `Aircraft` made from it."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from daq.utilities.input_files import parse_toml
from estimation.aircraft.aircraft import Aircraft, Engine, PriorDerivative, Servos, SimulatedFlight
from estimation.aircraft.handbook import HandbookShape, beliefs
from estimation.errors import AircraftError


def _plain_number(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("is not a number")
    return value


def _as_table(value: object) -> object:
    return value if isinstance(value, Mapping) else {"value": value}


Number = Annotated[float, BeforeValidator(_plain_number), Field(allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0.0)]
NotNegative = Annotated[Number, Field(ge=0.0)]
Place = tuple[Number, Number, Number]
Throw = Annotated[tuple[Annotated[Number, Field(lt=0.0)], Positive], BeforeValidator(lambda value: _both_ways(value))]


class _AircraftTable(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Geometry(_AircraftTable):
    """Reference geometry [m, m2]."""

    span: Positive | None = None
    area: Positive | None = None
    chord: Positive | None = None
    root_chord: Positive | None = None
    taper: NotNegative | None = None
    cg_from_nose: Number | None = None


class Mass(_AircraftTable):
    """Mass [kg] and moments of inertia about the CG, body axes [kg m2]."""

    mass: Positive | None = None
    Ixx: Positive | None = None
    Iyy: Positive | None = None
    Izz: Positive | None = None
    Ixz: Number = 0.0

    @model_validator(mode="after")
    def _possible(self) -> "Mass":
        if self.Ixx is not None and self.Izz is not None and self.Ixz**2 >= self.Ixx * self.Izz:
            raise ValueError(f"Ixz = {self.Ixz} is impossible: Ixz^2 must be less than Ixx Izz")
        return self


class Derivative(_AircraftTable):
    """One prior derivative [1/rad]."""

    value: Number
    std: Positive | None = None
    source: Literal["wind tunnel", "engineering estimate", "flight", "computed", "handbook"] = "engineering estimate"


class ServoTable(_AircraftTable):
    """[servos] of a simulated aircraft."""

    lag: Positive
    rate: Positive
    elevon_limit: Positive
    rudder_limit: Positive


class EngineTable(_AircraftTable):
    """[engine] of a simulated aircraft."""

    static_thrust: Positive
    thrust_fall: NotNegative
    lag: Positive


def _both_ways(value: object) -> object:
    if isinstance(value, list):
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0.0:
        raise ValueError("must be a deflection above zero [rad], or [least, greatest]")
    return (-value, value)


class ThrowTable(_AircraftTable):
    """[throws]: deflection of a surface at full stick [rad], one number where it is the same both ways."""

    delta_e: Throw | None = None
    delta_a: Throw | None = None
    delta_r: Throw | None = None


Share = Annotated[Number, Field(gt=0.0, lt=1.0)]


class UncertaintyTable(_AircraftTable):
    """[uncertainty]: relative 1 sigma of geometry, mass and inertia."""

    span: Share | None = None
    area: Share | None = None
    chord: Share | None = None
    mass: Share | None = None
    Ixx: Share | None = None
    Iyy: Share | None = None
    Izz: Share | None = None


class SimulationTable(_AircraftTable):
    """[simulation]: how a simulated aircraft flies."""

    speed: Positive
    speed_range: tuple[Positive, Positive]
    derivatives: dict[str, Number] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _within(self) -> "SimulationTable":
        if not self.speed_range[0] <= self.speed <= self.speed_range[1]:
            raise ValueError(f"speed = {self.speed:g} must lie within speed_range")
        return self


class AircraftFile(_AircraftTable):
    """The file. Only its values are checked here; missing ones are refused where they are needed."""

    name: Annotated[str, Field(min_length=1)] | None = None
    title: str = ""
    geometry: Geometry = Geometry()
    mass: Mass = Mass()
    sensors: dict[str, Place] = Field(default_factory=dict)
    shape: HandbookShape | None = None
    derivatives: dict[str, Annotated[Derivative, BeforeValidator(_as_table)]] = Field(default_factory=dict)
    servos: ServoTable | None = None
    engine: EngineTable | None = None
    simulation: SimulationTable | None = None
    throws: ThrowTable = ThrowTable()
    uncertainty: UncertaintyTable = UncertaintyTable()


def read_file(text: str, where: str) -> AircraftFile:
    """The checked content of an aircraft file. Raises AircraftError naming `where` and the key."""
    try:
        return AircraftFile.model_validate(parse_toml(text, where, AircraftError))
    except ValidationError as error:
        raise AircraftError(f"{where}: {_sentence(error)}") from error


def aircraft_from_text(text: str, where: str, name: str) -> Aircraft:
    """The aircraft of a file's text. where: name of the file in errors; name: of the aircraft, where the file has none.

    Derivatives that the file does not state come from `handbook.beliefs` where it has a [shape].
    """
    file = read_file(text, where)
    geometry, mass = file.geometry, file.mass
    aircraft = Aircraft(
        name=file.name or name,
        span=_or_nan(geometry.span),
        area=_or_nan(geometry.area),
        chord=_or_nan(geometry.chord),
        mass=_or_nan(mass.mass),
        Ixx=_or_nan(mass.Ixx),
        Iyy=_or_nan(mass.Iyy),
        Izz=_or_nan(mass.Izz),
        Ixz=mass.Ixz,
        sensors=dict(file.sensors),
        title=file.title,
        root_chord=geometry.root_chord,
        taper=geometry.taper,
        cg_from_nose=geometry.cg_from_nose,
        servos=Servos(**file.servos.model_dump()) if file.servos else None,
        engine=Engine(**file.engine.model_dump()) if file.engine else None,
        simulation=SimulatedFlight(**file.simulation.model_dump()) if file.simulation else None,
        throws={name: throw for name, throw in file.throws if throw is not None},
        uncertainty={name: share for name, share in file.uncertainty if share is not None},
        text=text,
    )
    computed = beliefs(aircraft, file.shape) if file.shape else {}
    derivatives = {key: PriorDerivative(**value.model_dump()) for key, value in file.derivatives.items()}
    return replace(aircraft, derivatives={**computed, **derivatives})


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _sentence(error: ValidationError) -> str:
    """The first mistake: key, value and what it must be."""
    first: Any = error.errors(include_url=False)[0]
    key = ".".join(map(str, first["loc"])) or "the file as a whole"
    if first["type"] == "extra_forbidden":
        return f"unknown key {key}; check its spelling or remove it (docs/aircraft.md has all keys)"
    if first["type"] == "missing":
        return f"{key} is missing"
    value_text = f" = {first['input']!r}" if isinstance(first["input"], str | int | float | list) else ""
    message = str(first["msg"]).removeprefix("Value error, ").replace("Input should be", "must be")
    message = message.replace("greater than 0", "greater than zero")
    return (
        f"{key}{value_text} {message}" if message.startswith(("must be", "is not")) else f"{key}{value_text}: {message}"
    )
