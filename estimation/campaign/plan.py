"""The plan of a campaign: which flights, what is known of each, what is done with them. From TOML or from options."""

import datetime as dt
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from estimation.campaign.errors import CampaignError

GROUPABLE = ("aircraft", "configuration", "day", "manoeuvre")
FLIGHT_SUFFIXES = (".mcap", ".csv", ".parquet")


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Conditions(_Table):
    """What is known of a record besides its columns. mass [kg] goes before that of the aircraft's file; cg [m] behind the
    nose is kept beside the results. segments: stretches of it, as of `estimate --segments`."""

    aircraft: str = ""
    configuration: str = ""
    date: str = ""
    manoeuvre: str = ""
    mass: float | None = Field(default=None, gt=0.0, allow_inf_nan=False)
    cg: float | None = Field(default=None, allow_inf_nan=False)
    segments: str = ""

    @field_validator("date", mode="before")
    @classmethod
    def _as_text(cls, value: object) -> object:
        """A TOML date, or ISO 8601 text; so that text sorts by time."""
        if isinstance(value, dt.date | dt.datetime):
            return value.isoformat()
        if isinstance(value, str) and value:
            return dt.datetime.fromisoformat(value).isoformat() if len(value) > 10 else _day(value)
        return value

    @property
    def day(self) -> str:
        """The date without its time."""
        return self.date[:10]


def _day(text: str) -> str:
    return dt.date.fromisoformat(text).isoformat()


class FlightEntry(Conditions):
    """One [[flight]]: a path, relative to the plan, a pattern, a folder, or a URL that fsspec reads."""

    path: str = Field(min_length=1)


class SimulateEntry(Conditions):
    """One [[simulate]]: a scenario flown `count` times with seeds of its own. `vary`: dotted keys of the scenario, each drawn
    evenly between two ends."""

    scenario: str = Field(min_length=1)
    count: int = Field(default=1, ge=1, le=1_000_000)
    seed: int = Field(default=0, ge=0)
    set: Mapping[str, Any] = Field(default_factory=dict)
    vary: Mapping[str, tuple[float, float]] = Field(default_factory=dict)


class Plan(_Table):
    """What a campaign does. bootstrap: replicates a flight, 0 for none; time_limit [s]: of one piece of work."""

    flights: tuple[str, ...] = ()
    table: str = ""
    model: str = "lateral"
    aircraft: str = ""
    methods: tuple[str, ...] = Field(default=("ml",), min_length=1)
    groups: tuple[Literal["aircraft", "configuration", "day", "manoeuvre"], ...] = ("aircraft", "configuration")
    check: Literal["none", "quality", "full"] = "quality"
    joint: bool = False
    match: bool = False
    envelope: bool = False
    bootstrap: int = Field(default=0, ge=0)
    seed: int = Field(default=0, ge=0)
    each_segment: bool = False
    time_limit: float = Field(default=300.0, gt=0.0, allow_inf_nan=False)
    flight: tuple[FlightEntry, ...] = ()
    simulate: tuple[SimulateEntry, ...] = ()

    @field_validator("flights", "methods", "groups", mode="before")
    @classmethod
    def _listed(cls, value: object) -> object:
        return (value,) if isinstance(value, str) else value


def read_plan(path: Path) -> Plan:
    """The plan in a TOML file; CampaignError names file and key."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CampaignError(f"plan {path}: cannot be read ({error.strerror}); give a file or flights") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise CampaignError(f"plan {path}: not a TOML file: {error}; correct it there") from error
    return plan_from(data, str(path))


def plan_from(data: Mapping[str, Any], where: str) -> Plan:
    """A plan from plain data; CampaignError names `where` and the key."""
    try:
        return Plan.model_validate(dict(data))
    except ValidationError as error:
        raise CampaignError(f"plan {where}: {said_of(error)}; see docs/campaign.md for the keys") from error


def said_of(error: ValidationError) -> str:
    """The first complaint: which key, and what of it."""
    first = error.errors()[0]
    return f"{'.'.join(str(part) for part in first['loc']) or 'the whole'}: {first['msg']}"
