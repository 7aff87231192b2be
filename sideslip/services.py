"""The services of `groundstation.cli`: aircraft files, recipes and estimates, imported when they are first used."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from groundstation.cli.services import Services

if TYPE_CHECKING:
    from daq.identification.regression import LiveAircraft
    from groundstation.flight import Flight


def _aircraft(name: str, text: str | None = None, model: str = "") -> "LiveAircraft":
    from sideslip.live_aircraft import live_aircraft

    return live_aircraft(name, text, model)


def _recipe(flight: "Flight") -> Any:
    from estimation.session.recipe import recipe

    return recipe(flight)


def _estimate(flights: Sequence[Path], model: str, methods: str, aircraft: str, report: Path) -> Iterable[str]:
    from estimation.answers.estimates import estimate

    answer = estimate(flights, model, methods, aircraft=aircraft or None)
    return [*answer.lines(), f"report: {answer.report(report)}"]


SERVICES = Services(_aircraft, _recipe, _estimate)
