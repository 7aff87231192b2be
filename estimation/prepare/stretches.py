"""The flights, and the stretches of them, that a call works on."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.errors import EstimationError
from estimation.prepare.flight_data import SHORTEST_SEGMENT
from groundstation.flight import Flight
from groundstation.flight.stretches import airborne, is_times, stretches_where


def unique_names(flights: Sequence[Flight]) -> list[Flight]:
    """Flights with unique names, so that no result hides another."""
    counts: dict[str, int] = {}
    result = []
    for flight in flights:
        counts[flight.name] = counts.get(flight.name, 0) + 1
        count = counts[flight.name]
        result.append(flight if count == 1 else replace(flight, name=f"{flight.name}#{count}"))
    return result


def spans_of(text: str) -> dict[str, tuple[float, float]]:
    """Text of each stretch of `2:12,15:25` -> (begin, end) [s]; EstimationError where it cannot be read or stretches overlap."""
    spans: dict[str, tuple[float, float]] = {}
    for part in text.split(","):
        begin, _, end = part.partition(":")
        try:
            a, b = float(begin), float(end)
        except ValueError:
            a = b = np.nan
        if not a < b < np.inf or a == -np.inf:
            raise EstimationError(f"--segments {text!r}: write stretches as begin:end in seconds, like 2:12,15:25")
        if any(a < other_end and b > other_begin for other_begin, other_end in spans.values()):
            raise EstimationError(f"--segments {text}: {part} overlaps another stretch; give each sample once")
        spans[part] = (a, b)
    return spans


def select_segments(flight: Flight, text: str | None) -> Flight:
    """Stretches of a flight as segments: by times `2:12,15:25` [s], by a mode or by a condition
    (`groundstation.flight.stretches`); without a text, all but standing, taxiing and landing. EstimationError or FlightError for
    a text that cannot be used."""
    if text is None:
        phase = airborne(flight)
        return cut(flight, np.where(phase.flying, flight.segment, -1), (phase.text,)) if phase.stood else flight
    if not is_times(text):
        selection = stretches_where(flight, text)
        return cut(flight, selection.label, selection.notes)
    label = np.full(len(flight), -1, np.int64)
    for i, (part, (a, b)) in enumerate(spans_of(text).items()):
        in_span = (flight.time >= a) & (flight.time <= b)
        if not in_span.any():
            raise EstimationError(
                f"--segments {part}: no samples of {flight.name} there; it runs from {flight.time[0]:g} to {flight.time[-1]:g} s"
            )
        if in_span.sum() < SHORTEST_SEGMENT:
            raise EstimationError(
                f"--segments {part}: only {int(in_span.sum())} samples of {flight.name} lie there, one each "
                f"{flight.sample_interval:.3g} s; a stretch needs at least {SHORTEST_SEGMENT}"
            )
        label[in_span] = i
    return cut(flight, label)


def cut(flight: Flight, label: NDArray[np.int64], notes: Sequence[str] = ()) -> Flight:
    """The samples of a flight whose label is 0 or more, each label a segment."""
    keep = label >= 0
    part = flight.part(keep)
    return Flight.build(
        flight.name,
        part.time,
        dict(part.columns),
        segment=label[keep],
        provenance=flight.provenance,
        notes=[*flight.notes, *notes],
    )


def flights_of_segments(flight: Flight) -> list[Flight]:
    """Every segment as a flight, named <flight>.1, <flight>.2 ...; the flight itself where it has one segment."""
    parts = flight.segments
    if len(parts) == 1:
        return [flight]
    return [flight.part(part, f"{flight.name}.{i}") for i, part in enumerate(parts, start=1)]
