"""Several records in a row as one flight: each becomes segments of its own."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from groundstation.flight import Flight
from groundstation.flight.findings import Finding, FindingKind
from groundstation.flight.marks import marks_of, together

APART = 1.0
"""Time [s] put between records whose clocks begin anew."""


def joined(flights: Sequence[Flight]) -> Flight:
    """The records one after the other. Where one does not begin after the last has ended its time is moved, and said.

    A column that a record lacks is NaN in it.
    """
    if len(flights) == 1:
        return flights[0]
    names = list(dict.fromkeys(n for f in flights for n in f.columns))
    times, segments, moved = [], [], 0
    marks = []
    last, first_segment = -np.inf, 0
    for flight in flights:
        time = flight.time
        if time[0] <= last:
            time, moved = time - time[0] + last + APART, moved + 1
        times.append(time)
        marks.append(marks_of(flight).moved(float(time[0] - flight.time[0])))
        segments.append(flight.segment + first_segment)
        last, first_segment = float(time[-1]), int(segments[-1][-1]) + 1
    columns = {n: np.concatenate([f.columns[n] if n in f else np.full(len(f), np.nan) for f in flights]) for n in names}
    said = [Finding(FindingKind.OTHER, f"{len(flights)} records in a row, each with segments of its own")]
    if moved:
        said.append(
            Finding(FindingKind.OTHER, f"{moved} of them begin anew in time: moved to {APART:g} s after the one before")
        )
    notes = [n for f in flights for n in f.notes]
    made = Flight.build(
        flights[0].name,
        np.concatenate(times),
        columns,
        segment=np.concatenate(segments),
        provenance=flights[0].provenance,
        notes=[*notes, *said],
    )
    origin = {f.provenance.path: f.provenance.sha256 for f in flights}
    detail = {**made.provenance.detail, **together(marks).to_json()}
    if len(origin) > 1:
        detail["files"] = origin
    return replace(made, provenance=replace(made.provenance, detail=detail))
