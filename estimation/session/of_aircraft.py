"""What the aircraft file itself says against an estimate: constants no aircraft can have, terms that the model has no place
for."""

from dataclasses import dataclass

from estimation.aircraft import Aircraft
from estimation.models.base import Model
from estimation.models.expressions import names_in
from estimation.models.library import BUILDERS, not_in_model
from estimation.session.aircraft_review import ReviewNote, review


@dataclass(frozen=True)
class OfAircraft:
    """impossible: sentences on constants of the model; dropped: stated derivatives that the model has no term for; span,
    area, chord [m, m2, m]: NaN where not stated."""

    impossible: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    aspect: float = float("nan")


NOTHING = OfAircraft()


def of_aircraft(aircraft: Aircraft, model: Model) -> OfAircraft:
    """What the review of an aircraft says of the constants that a model takes from it."""
    from_file = {n for n, v in aircraft.constants().items() if model.constants.get(n) == v}
    used = frozenset[str]().union(*(names_in(text) for text in model.definitions.values())) & from_file
    if "q_dot" not in model.definitions:  # without pitch it only couples, by what q and r or p and q do together
        used = used - {"Iyy"}
    notes = [n for n in review(aircraft) if _concerns(n, used)] if used else []
    beyond = tuple(f"aircraft {aircraft.name}: {n.text} (sideslip aircraft check)" for n in notes)
    built_in = model.name in BUILDERS
    dropped = not_in_model(model, aircraft) if built_in else ()
    return OfAircraft(beyond, dropped, aircraft.span**2 / aircraft.area)


def _concerns(note: ReviewNote, used: frozenset[str]) -> bool:
    """Whether a note doubts what a model takes; that three moments do not go together, only where it takes all of them."""
    if len(note.about) == 3 and note.check == "inertia":
        return used.issuperset(note.about)
    return bool(used.intersection(note.about))
