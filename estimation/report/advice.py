"""Parameters that flights do not determine, why, and which manoeuvre would determine them."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from estimation.estimators.uncertainty import inputs_beside
from estimation.session.without_sensor import NO_THRUST

if TYPE_CHECKING:
    from estimation.models.base import Model
    from estimation.session.session import EstimationSession

CONTROL_WORDS = {"delta_a": "aileron", "delta_r": "rudder", "delta_e": "elevator"}
MOTION_ADVICE = {
    "beta": "rudder doublets at the Dutch-roll frequency, or steady sideslips to both sides",
    "r": "rudder doublets at the Dutch-roll frequency, several in a row, with the aileron held",
    "p": "sharp aileron 3-2-1-1 inputs to both sides, 10 deg and more, with the rudder held",
    "q": "elevator 3-2-1-1 at the short-period frequency",
    "alpha": "elevator 3-2-1-1 and slow pull-ups over the range of incidence",
}


@dataclass(frozen=True, slots=True)
class Unidentified:
    """A parameter that is not identifiable by a method. where: flights, or "joint"; manoeuvre: what would determine it;
    determined_jointly: by the joint estimate of the method."""

    parameter: str
    method: str
    where: tuple[str, ...]
    why: str
    manoeuvre: str
    determined_jointly: bool


def unidentified_parameters(session: "EstimationSession") -> list[Unidentified]:
    """One entry for each parameter, method and reason, in the model's order."""
    flights_by_reason: dict[tuple[str, str, str], list[str]] = {}
    sources = [(f.flight.name, m, r) for f in session.flights for m, r in f.results.items()]
    sources += [("joint", m, r) for m, r in session.joint.items()]
    for source, method, result in sources:
        for name, e in result.parameters.items():
            if not e.identifiable:
                flights_by_reason.setdefault((name, method, e.why), []).append(source)
    entries = []
    for (name, method, reason), where in flights_by_reason.items():
        joint = session.joint.get(method)
        determined = joint is not None and name in joint.parameters and joint.parameters[name].identifiable
        fly = manoeuvre(session.model, name, reason)
        entries.append(Unidentified(name, method, tuple(where), reason, fly, determined))
    order = list(session.model.parameter_names)
    return sorted(entries, key=lambda u: (order.index(u.parameter), session.methods.index(u.method)))


@dataclass(frozen=True, slots=True)
class AdviceGroup:
    """Parameters that one manoeuvre would determine. methods, where: methods and flights that do not; whys: the different
    reasons; determined_jointly: parameters that all flights together determine."""

    parameters: tuple[str, ...]
    methods: tuple[str, ...]
    where: tuple[str, ...]
    whys: tuple[str, ...]
    manoeuvre: str
    determined_jointly: tuple[str, ...]


def grouped(entries: Sequence[Unidentified]) -> list[AdviceGroup]:
    """One group for each manoeuvre: what to fly next, and all that it would determine."""
    entries_by_manoeuvre: dict[str, list[Unidentified]] = {}
    for entry in entries:
        entries_by_manoeuvre.setdefault(entry.manoeuvre, []).append(entry)
    return [
        AdviceGroup(
            _distinct(u.parameter for u in manoeuvre_entries),
            _distinct(u.method for u in manoeuvre_entries),
            _distinct(w for u in manoeuvre_entries for w in u.where),
            _distinct(reason_without_numbers(u.why) for u in manoeuvre_entries),
            fly,
            _distinct(u.parameter for u in manoeuvre_entries if u.determined_jointly),
        )
        for fly, manoeuvre_entries in entries_by_manoeuvre.items()
    ]


def reason_without_numbers(why: str) -> str:
    """A reason without its numbers, which differ from flight to flight, and without its advice, which has its own column."""
    return re.sub(r": this data cannot tell.*", "", re.sub(r"(?<![\w])[+-]?\d+(\.\d+)?(e[+-]?\d+)?", "…", why))


def _distinct(items: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(items))


def manoeuvre(model: "Model", parameter: str, why: str) -> str:
    """What to fly, to follow the word "fly", so that a parameter becomes identifiable."""
    if why.startswith(NO_THRUST):
        return "with a record of thrust, by a load cell or a map of motor and propeller"
    for control in sorted(inputs_beside(model, parameter)):
        if control in CONTROL_WORDS:
            word = CONTROL_WORDS[control]
            return f"{word} doublet or 3-2-1-1 of 5 deg and more, not in step with another control"
    regressor = parameter.rpartition("_")[2]
    if regressor in MOTION_ADVICE:
        return MOTION_ADVICE[regressor]
    if regressor == "0":
        return "ten seconds of trimmed straight flight before the manoeuvre"
    return (
        "a manoeuvre in which its term of the equations moves on its own"
        if "collinear" in why
        else "larger inputs, and longer"
    )
