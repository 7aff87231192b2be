"""The plan of a campaign, from TOML or from options: which flights, the conditions of each, and what to do with them."""

import contextlib
import datetime as dt
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, ValidationError, field_validator, model_validator

from daq.utilities import limits
from daq.utilities.errors import UserError
from daq.utilities.input_files import read_toml
from daq.utilities.plain_words import did_you_mean
from estimation.campaign.tasks import CampaignError
from estimation.estimators.estimator import Extra
from estimation.estimators.registry import check_extras, find_estimator

GROUPABLE = ("aircraft", "configuration", "day", "manoeuvre")
LONGEST_LIMIT = 1e6  # s, eleven days: the timers that end work hold no longer times
MOST_REPLICATES = 100_000  # a flight: a spread is then known to 0.3 %
DATE_LENGTH = len("2026-03-01")
FLIGHT_SUFFIXES = (".mcap", ".csv", ".parquet")

Finite = Annotated[float, Field(allow_inf_nan=False)]


class _CampaignTable(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def _path(value: object) -> str:
    """A path that need not be valid Unicode, which pydantic's own text type refuses."""
    if not isinstance(value, str) or not value:
        raise ValueError("should be a path, a pattern or an address")
    return value


SomePath = Annotated[str, PlainValidator(_path)]


class RecordConditions(_CampaignTable):
    """The conditions of a flight. mass [kg]: in place of that in the aircraft's file; cg [m]: behind the nose, only copied into
    the results. segments: its stretches, as of `estimate --segments`."""

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
        """A TOML date or ISO 8601 text as ISO 8601 text, whose order is that of time."""
        if isinstance(value, dt.date | dt.datetime):
            return value.isoformat()
        if isinstance(value, str) and value:
            try:
                kind = dt.datetime if len(value) > DATE_LENGTH else dt.date
                return kind.fromisoformat(value).isoformat()
            except ValueError as error:
                raise ValueError(f"{value!r} is no date; write it like 2026-03-01 or 2026-03-01T10:30:00") from error
        return value

    @field_validator("segments")
    @classmethod
    def _stretches(cls, text: str) -> str:
        from estimation.prepare.stretches import spans_of
        from groundstation.flight.expression import parse_condition
        from groundstation.flight.stretches import is_times

        if text:
            with _as_value_error():
                _ = spans_of(text) if is_times(text) else parse_condition(text)
        return text

    @property
    def day(self) -> str:
        """The date without its time."""
        return self.date[:DATE_LENGTH]


@contextlib.contextmanager
def _as_value_error() -> Iterator[None]:
    """Turn a UserError into a ValueError, before whose message pydantic puts the key."""
    try:
        yield
    except UserError as error:
        raise ValueError(str(error)) from error


class FlightEntry(RecordConditions):
    """One [[flight]]: a path, relative to the plan, a pattern, a folder, or a URL that fsspec reads."""

    path: SomePath


class SimulateEntry(RecordConditions):
    """One [[simulate]]: a scenario flown `count` times, each time with another seed. set: dotted keys of the scenario, or tables
    of keys, and their values; vary: dotted keys, each drawn evenly between two ends."""

    scenario: str = Field(min_length=1)
    count: int = Field(default=1, ge=1, le=limits.FLIGHTS)
    seed: int = Field(default=0, ge=0)
    set: Mapping[str, Any] = Field(default_factory=dict)
    vary: Mapping[str, tuple[Finite, Finite]] = Field(default_factory=dict)

    @field_validator("set")
    @classmethod
    def _dotted(cls, changes: Mapping[str, Any]) -> Mapping[str, Any]:
        dotted: dict[str, Any] = {}
        for key, value in changes.items():
            entries = {f"{key}.{name}": v for name, v in value.items()} if isinstance(value, Mapping) else {key: value}
            if repeated_keys := sorted(entries.keys() & dotted.keys()):
                raise ValueError(f"{repeated_keys[0]} is given twice; give it once")
            dotted |= entries
        return dotted

    @model_validator(mode="after")
    def _ranges(self) -> "SimulateEntry":
        for key, (low, high) in self.vary.items():
            if low > high:
                raise ValueError(f"vary: {key} from {low:g} to {high:g} begins above its end; give the lower one first")
            if key in self.set:
                raise ValueError(f"{key} is both in set and in vary; leave one of them out")
        return self


class CampaignPlan(_CampaignTable):
    """What a campaign does. bootstrap: replicates a flight, 0 for none; time_limit [s]: of one piece of work."""

    flights: tuple[SomePath, ...] = ()
    table: str = ""
    model: str = "lateral"
    aircraft: str = ""
    methods: tuple[str, ...] = Field(default=("ml",), min_length=1)
    groups: tuple[Literal["aircraft", "configuration", "day", "manoeuvre"], ...] = ("aircraft", "configuration")
    check: Literal["none", "quality", "full"] = "quality"
    joint: bool = False
    match: bool = False
    envelope: bool = False
    bootstrap: int = Field(default=0, ge=0, le=MOST_REPLICATES)
    seed: int = Field(default=0, ge=0)
    each_segment: bool = False
    time_limit: float = Field(default=300.0, gt=0.0, le=LONGEST_LIMIT, allow_inf_nan=False)
    flight: tuple[FlightEntry, ...] = ()
    simulate: tuple[SimulateEntry, ...] = ()

    @field_validator("flights", "methods", "groups", mode="before")
    @classmethod
    def _listed(cls, value: object) -> object:
        return (value,) if isinstance(value, str) else value

    @field_validator("methods", "groups")
    @classmethod
    def _once(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(dict.fromkeys(names))

    @field_validator("methods")
    @classmethod
    def _known_methods(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            with _as_value_error():
                find_estimator(name)
        return names

    @model_validator(mode="after")
    def _replicates_can_be_had(self) -> "CampaignPlan":
        if self.bootstrap:
            from estimation.estimators.refits import check_replicates

            with _as_value_error():
                check_replicates(self.bootstrap)
                check_extras((Extra.BOOTSTRAP,), [find_estimator(name) for name in self.methods])
        return self


def read_plan(path: Path, *, trust_code: bool = False) -> CampaignPlan:
    """The plan in a TOML file; CampaignError names file and key.

    trust_code: whether programs that it names may run. If not, a plan that names one is refused before anything is imported.
    """
    data = read_toml(path, "plan", CampaignError)
    programs = named_programs(data)
    if programs and not trust_code:
        raise CampaignError(
            f"plan {path}: {', '.join(programs)} is a program that the plan would run; read it as you would read any program,"
            " then add --trust-code"
        )
    return plan_from(data, str(path))


def named_programs(data: Mapping[str, Any]) -> tuple[str, ...]:
    """The model and methods that a plan names as `module:NAME`: Python code that would run."""
    methods = data.get("methods", ())
    program_names = [data.get("model", ""), *(methods if isinstance(methods, list | tuple) else [methods])]
    return tuple(
        dict.fromkeys(
            n[:80] for n in program_names if isinstance(n, str) and ":" in n and not n.endswith((".toml", ".xml"))
        )
    )


def plan_from(data: Mapping[str, Any], where: str) -> CampaignPlan:
    """A plan from the content of a TOML file; CampaignError names `where` and the key."""
    try:
        return CampaignPlan.model_validate(dict(data))
    except ValidationError as error:
        raise CampaignError(f"plan {where}: {first_mistake(error)}; see docs/campaign.md for the keys") from error


def first_mistake(error: ValidationError) -> str:
    """The first mistake: its key, and what is wrong."""
    first = error.errors()[0]
    key_path = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"{key_path}: no such key{did_you_mean(str(first['loc'][-1]), _keys_beside(first['loc']))}"
    message = first["msg"].removeprefix("Value error, ")
    return f"{key_path}: {message}" if key_path else message


def _keys_beside(where: tuple[int | str, ...]) -> Iterable[str]:
    """Names of the keys of the table that an unknown key stands in."""
    tables: dict[str, type[BaseModel]] = {"flight": FlightEntry, "simulate": SimulateEntry}
    return (tables.get(str(where[0]), CampaignPlan) if len(where) > 1 else CampaignPlan).model_fields
