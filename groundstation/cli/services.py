"""What the verbs of the ground station are given by whoever assembles the command line."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.identification.regression import AircraftSource
    from groundstation.flight import Flight


@dataclass(frozen=True)
class Services:
    """What the command line gives the verbs, as click's object; they know no aircraft files, models and estimators.

    aircraft: of a name or file, for live identification. recipe: what a flight is good for. estimate: of flights, with model,
    methods, aircraft ("": the one the flights name) and the folder of the report; gives what a person reads."""

    aircraft: "AircraftSource"
    recipe: "Callable[[Flight], Any]"
    estimate: Callable[[Sequence[Path], str, str, str, Path], Iterable[str]]
