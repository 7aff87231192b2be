"""Which columns a model needs of a flight, and which of the models of Sideslip would do with what a flight has."""

from collections.abc import Iterable

from estimation.aircraft import unknown_aircraft
from estimation.engine.derived import DERIVED, way_to
from estimation.models.base import Model
from estimation.models.library import BUILDERS
from groundstation.flight import Flight, MissingColumnError


def require_columns(model: Model, flight: Flight) -> None:
    """Raise one MissingColumnError naming every column that the model needs and the flight has not and cannot make of others,
    with the built-in models that would do without."""
    lacking = missing(model, flight)
    if lacking:
        fit = () if flight_without_motion(lacking, model) else models_for(flight)
        raise MissingColumnError(flight.name, lacking, f"model {model.name}", fit, flight.unknown_columns)


def flight_without_motion(lacking: Iterable[str], model: Model) -> bool:
    """Whether a flight lacks all that the model compares with: no other model would help."""
    return {s.source for s in model.outputs if not s.optional} <= set(lacking)


def missing(model: Model, flight: Flight) -> list[str]:
    """Columns that the model needs and the flight lacks; one that could be made of others is named with these ways."""
    needed = dict.fromkeys(s.source for s in (*model.inputs, *model.outputs) if not s.optional)
    plain = [c for c in needed if c not in DERIVED and not flight.measured(c)]
    made = [c for c in needed if c in DERIVED and not flight.measured(c) and way_to(flight, c) is None]
    return plain + [_with_ways(c) for c in made if not _comes_with(c, flight, plain)]


def _comes_with(column: str, flight: Flight, lacking: list[str]) -> bool:
    """Whether a derived column could be made once the lacking plain ones are there."""
    return any(all(n in lacking or flight.measured(n) for n in way.needs) for way in DERIVED[column])


def _with_ways(column: str) -> str:
    return f"{column} (or {' or '.join(' and '.join(w.needs) for w in DERIVED[column])} to derive it from)"


def models_for(flight: Flight) -> tuple[str, ...]:
    """Built-in models whose columns the flight has. Which they are does not depend on the aircraft."""
    craft = unknown_aircraft("any")
    return tuple(name for name, build in BUILDERS.items() if not missing(build(craft), flight))
