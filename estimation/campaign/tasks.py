"""The tasks of a campaign: work for a worker and its results, as plain, picklable data; and a campaign's errors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from estimation.errors import EstimationError

Row = dict[str, Any]
"""One row of a result table, by the names of `estimation.campaign.schema`."""

Maker = Callable[[Mapping[str, Any]], bytes]
"""Flies a simulated flight from its description and returns the bytes of a CSV. Every worker must be able to import it."""


@dataclass(frozen=True)
class FlightMaker:
    """The simulator of a plan's simulated flights, passed in by the caller: this package must not import one.

    describe: scenario and dotted changes -> checked description. fly: description -> bytes of a CSV. digest: of its code.
    """

    describe: Callable[[str, Mapping[str, Any]], Mapping[str, Any]]
    fly: Maker
    digest: str


@dataclass(frozen=True)
class FlightSource:
    """Where the bytes of a flight come from: `path` (local), `url` (fsspec), or `made` by the maker from a description.

    sha256: of the bytes, or of the description. data: the bytes themselves, for workers on other computers.
    """

    name: str
    suffix: str
    sha256: str
    path: str = ""
    url: str = ""
    made: Mapping[str, Any] | None = None
    maker: Maker | None = None
    data: bytes | None = None

    @property
    def location(self) -> str:
        """Path or URL as it is printed."""
        return self.path or self.url or f"simulated:{self.name}"


@dataclass(frozen=True)
class Subject:
    """One flight and how to read it.

    model: name; model_text: its TOML, empty for a built-in one. aircraft: name; aircraft_text: its file, empty for none. mass
    [kg]: in place of that in the file. segments: stretches, as of `--segments`.
    """

    source: FlightSource
    model: str
    model_text: str = ""
    aircraft: str = ""
    aircraft_text: str = ""
    mass: float | None = None
    segments: str = ""


@dataclass(frozen=True)
class Work:
    """Work on one flight, or on several together. pieces: name of a piece -> its key in the store (`keys.key_of`).

    kind: `flight` (pieces are methods, and `check`), `joint` (pieces are methods), `envelope` (one piece) or `match` (pieces
    are methods; `values` has the parameters that each predicts with). versions: from `keys.versions`. seeds: method -> seed.
    quality: refuse data that fail their checks. bootstrap: replicates. each_segment: fit each segment by itself. limit_s: time
    [s] after which it is abandoned.
    """

    kind: str
    name: str
    pieces: Mapping[str, str]
    subjects: Sequence[Subject]
    versions: Mapping[str, str]
    quality: bool = True
    bootstrap: int = 0
    seeds: Mapping[str, int] = field(default_factory=dict)
    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    each_segment: bool = False
    limit_s: float = 300.0
    group: str = ""

    @property
    def identity(self) -> str:
        """The first key, which identifies the whole work."""
        return next(iter(self.pieces.values()))


@dataclass(frozen=True)
class Finished:
    """rows: results, or the reason of a failure. attempts: how often the work was started."""

    work: Work
    rows: list[Row]
    attempts: int = 1


class CampaignError(EstimationError):
    """A plan, an output folder or an engine that cannot be used."""


class OverdueError(EstimationError):
    """A piece of work that took longer than it may."""
