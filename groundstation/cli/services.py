"""Functions of other packages that the verbs of the ground station call but may not import."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from daq.identification.regression import AircraftSource
    from groundstation.flight import Flight


@dataclass(frozen=True)
class Services:
    """The object of click's context. aircraft: name or file, text of an embedded file, model -> aircraft for live identification.
    recipe: flight -> advice on methods and models. estimate: flights, model, methods, aircraft ("" for that of the flights),
    folder of the report -> lines to print."""

    aircraft: "AircraftSource"
    recipe: "Callable[[Flight], Any]"
    estimate: Callable[[Sequence[Path], str, str, str, Path], Iterable[str]]
