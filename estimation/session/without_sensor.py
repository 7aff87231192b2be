"""The built-in lateral models on a flight without a sideslip vane, or without a side accelerometer.

Sideslip follows from p, r, phi and ay by the kinematics of the model, but for where it began. Both lacking is refused as before:
side force would then be told by nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from estimation.models.base import Model
from groundstation.flight import Flight
from groundstation.flight.notes import Note, NoteKind

MODELS = ("lateral", "lateral-simple")

LACKING: Mapping[str, str] = {
    "beta": (
        "beta not measured: it follows from p, r, phi and ay and begins at zero as an unknown, so that CY_0, Cl_0 and Cn_0 "
        "cannot be told from the sideslip at the beginning, and what is slower than the manoeuvres tells nothing of beta"
    ),
    "ay": (
        "ay not measured: the side force CY is told by how beta moves alone, and what turns the air or the vane passes for it: "
        "the bounds of every CY are several times as wide"
    ),
}
"""Column that may be lacking -> what that leaves open."""


def without_sensor(model: Model, flights: Sequence[Flight]) -> tuple[Model, Sequence[Flight]]:
    """Model and flights as a fit can use them: where a flight lacks one of LACKING, the model does not ask for it, and the flight
    says what can no longer be told. Both as they are where nothing, or more than one, is lacking, and for other models."""
    absent = [[n for n in LACKING if not f.measured(n)] for f in flights]
    columns = {n for names in absent for n in names}
    if model.name not in MODELS or not columns or any(len(names) > 1 for names in absent):
        return model, flights
    outputs = tuple(replace(s, optional=True) if s.source in columns else s for s in model.outputs)
    states = tuple(
        replace(s, start=0.0) if s.source in columns and s.start is None and not s.held else s for s in model.states
    )
    stated = [
        f.with_notes(*(Note(NoteKind.NOT_MEASURED, LACKING[n]) for n in names)) if names else f
        for f, names in zip(flights, absent, strict=True)
    ]
    return replace(model, outputs=outputs, states=states), stated
