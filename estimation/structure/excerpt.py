"""Long flights, tested by their first part: what a model lacks shows in minutes, and an hour would take longer than its fit."""

from dataclasses import replace

import numpy as np

from estimation.estimators.result import FlightFit, Result
from estimation.prepare.flight_data import FlightData, Segment

MOST_SAMPLES = 16_000
"""Of one flight: 80 s at 200 Hz, a quarter of an hour at 20 Hz. With some 50 columns and as many draws of the inputs that is
130 MB."""


def excerpt(result: Result, data: list[FlightData]) -> tuple[Result, list[FlightData]]:
    """A result and its flights, of each no more than MOST_SAMPLES from its beginning."""
    if all(d.used <= MOST_SAMPLES for d in data) or any(
        len(d.segments) != len(f.initial_states) for d, f in zip(data, result.flights, strict=True)
    ):
        return result, data
    parts = [_part(d, f) for d, f in zip(data, result.flights, strict=True)]
    return replace(result, flights=tuple(f for _, f in parts)), [d for d, _ in parts]


def _part(data: FlightData, fit: FlightFit) -> tuple[FlightData, FlightFit]:
    segments: list[Segment] = []
    room = MOST_SAMPLES
    for s in data.segments:
        if room < 8:
            break
        taken = min(len(s), room)
        segments.append(s if taken == len(s) else s.part(0, taken, np.array(s.x0)))
        room -= taken
    kept = fit.initial_states[: len(segments)]
    return replace(data, segments=tuple(segments)), replace(fit, initial_states=kept)
