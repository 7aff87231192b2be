"""What the verbs of the ground station are given by whoever assembles the command, as click's object: the ground station itself
knows no aircraft files, models and estimators."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from daq.identification.regression import AircraftSource
    from groundstation.flight import Flight


class LogAdvice(Protocol):
    """Which models and methods a log is good for."""

    def lines(self) -> Iterable[str]:
        """For a person."""
        ...

    def to_json(self) -> dict[str, Any]:
        """The same as JSON."""
        ...


@dataclass(frozen=True)
class Services:
    """aircraft: of a name or file, for live identification. recipe: what a flight is good for. estimate: of flights, with model,
    methods and the folder of the report; gives what a person reads."""

    aircraft: "AircraftSource"
    recipe: "Callable[[Flight], LogAdvice]"
    estimate: Callable[[Sequence[Path], str, str, Path], Iterable[str]]
