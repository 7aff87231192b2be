"""Flights made ready for one model, several at once: prepared, compared in what they measure, cut into pieces."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from estimation.engine.data import AS_USUAL, FlightData, Preparation, prepare
from estimation.errors import DataError
from estimation.models.base import Model
from groundstation.flight import Flight

PIECES = (8.0, 4.0, 2.0, 1.0)  # s, of an unstable motion, the longest first that can be simulated


def prepared(
    model: Model,
    flights: Flight | FlightData | Sequence[Flight | FlightData],
    preparation: Preparation = AS_USUAL,
) -> list[FlightData]:
    """Flights prepared for a model, those that are so already taken as they are."""
    many = [flights] if isinstance(flights, Flight | FlightData) else list(flights)
    if not many:
        raise DataError("no flight given: at least one is needed")
    return [f if isinstance(f, FlightData) else prepare(model, f, preparation) for f in many]


def compared(model: Model, data: list[FlightData]) -> tuple[Model, list[FlightData]]:
    """Model and data without the outputs that no flight measures."""
    absent = set(data[0].absent_outputs).intersection(*(d.absent_outputs for d in data[1:]))
    if not absent:
        return model, data
    keep = [i for i, n in enumerate(model.output_names) if n not in absent]
    slim = [
        replace(
            d, segments=tuple(replace(s, z=np.ascontiguousarray(s.z[:, keep])) for s in d.segments), absent_outputs=()
        )
        for d in data
    ]
    return model.without_outputs(*absent), slim


def cut(data: FlightData, seconds: float) -> FlightData:
    """The same flight in pieces of about `seconds`, each starting from its measured state."""
    parts = []
    for s in data.segments:
        count = max(1, round((s.time[-1] - s.time[0]) / seconds))
        edges = np.linspace(0, len(s), count + 1).round().astype(int).tolist()
        for a, b in pairwise(edges):
            measured = data.states[s.first + a]
            parts.append(s.part(a, b, np.where(np.isfinite(measured), measured, s.x0)))
    return replace(data, segments=tuple(parts))
