"""Rows that a link or a logger lost, put back as not measured.

The noise of a channel is told by its spectrum, and the path of a surface by how it moves from sample to sample: both need samples
that come evenly. Where a few rows in a row are lost, the others still lie on the clock's grid.
"""

import numpy as np

from estimation.engine.data import LONGEST_BRIDGE
from groundstation.flight import Flight

OFF_GRID = 0.25  # of the clock's step: a row further off is not on its grid
ON_GRID = 0.95  # of the rows, for a grid to be one: clocks are late now and then
FINER = (1, 2, 3)  # steps of the clock in the usual interval: every other row or two may be lost all the time
SINGLE = 0.05  # of the rows that follow one step after another, or the grid is that of rounded times, not of a clock


def with_lost_rows(flight: Flight) -> Flight:
    """The flight with a row of NaN for each of a few in a row that are lost, and a note; itself where its rows are on no grid."""
    step = clock_step(flight)
    if step is None:
        return flight
    steps = np.diff(flight.time) / step
    whole = np.round(steps)
    lost = (whole > 1.0) & (whole <= LONGEST_BRIDGE + 1) & (np.diff(flight.segment) == 0)
    if not lost.any():
        return flight
    rows = np.cumsum(np.where(lost, whole, 1.0)).astype(int)
    rows = np.concatenate([[0], rows])
    time = np.interp(np.arange(rows[-1] + 1), rows, flight.time)
    columns = {n: np.full(time.size, np.nan) for n in flight.columns}
    for name, values in flight.columns.items():
        columns[name][rows] = values
    segment = flight.segment[np.searchsorted(rows, np.arange(time.size), side="right") - 1]
    count = time.size - len(flight)
    said = f"{count} rows lost here and there ({count / time.size:.0%}): taken as not measured"
    return Flight.build(
        flight.name, time, columns, segment=segment, provenance=flight.provenance, notes=flight.notes
    ).with_notes(said)


def clock_step(flight: Flight) -> float | None:
    """Step [s] of the clock on whose grid the rows lie; None where they lie on none."""
    usual, within = flight.sample_interval, np.diff(flight.segment) == 0
    for finer in FINER:
        steps = np.diff(flight.time)[within] / (usual / finer)
        whole = np.maximum(np.round(steps), 1.0)
        if np.mean(np.abs(steps - whole) < OFF_GRID) >= ON_GRID and np.mean(whole == 1.0) >= SINGLE:
            return usual / finer
    return None
