"""Attitude of a table that gives it as a quaternion."""

from dataclasses import replace

from groundstation.importers.formats.attitude import with_attitudes
from groundstation.importers.mapping import ColumnSource, Map
from groundstation.importers.series import Log

_ANGLES = {"phi": "roll", "theta": "pitch", "psi": "yaw"}


def with_quaternion(log: Log, chosen: Map) -> tuple[Log, Map]:
    """The table with phi, theta and psi of its quaternion, where it has one and nothing else gives them; said in a note."""
    if any(angle in chosen.columns for angle in _ANGLES):
        return log, chosen
    made = with_attitudes(log.series)
    new = [n for n in made if n not in log.series]
    angles = {a: next((n for n in new if n.rpartition(".")[2] == word), None) for a, word in _ANGLES.items()}
    if any(n is None for n in angles.values()):
        return log, chosen
    sources = {a: (ColumnSource(column=n, unit="rad"),) for a, n in angles.items()}
    used = {n for n in angles.values() if n is not None}
    series = {n: s for n, s in made.items() if n in log.series or n in used}
    note = "phi, theta, psi are of the quaternion, taken as scalar first and from north-east-down to the body"
    kinds = {**log.kinds, **dict.fromkeys(used, "computed")}
    told = replace(log, series=series, notes=(*log.notes, note), kinds=kinds)
    return told, chosen.model_copy(update={"columns": {**chosen.columns, **sources}})
