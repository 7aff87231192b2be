"""Rows that a link or a logger lost, put back as not measured.

The noise of a channel is told by its spectrum, and the path of a surface by how it moves from sample to sample: both need samples
that come evenly. Where a few rows in a row are lost, the others still lie on the clock's grid.

Where a control alone lacks a sample while it moves, a straight line is drawn through its step: what the other instruments show
there is no answer to that line.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.gap.criteria import Criteria
from estimation.prepare.pipeline import LONGEST_BRIDGE
from groundstation.flight import Flight
from groundstation.flight.quality.repeats import runs_of

Array = NDArray[np.float64]

GAUSSIAN = 1.4826  # standard deviation over median absolute deviation of normal noise
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


def without_unseen_moves(flight: Flight, controls: Sequence[str], outputs: Sequence[str], criteria: Criteria) -> Flight:
    """The flight without what outputs show at samples that a control lacks while it moves, and a note; itself where none does so.
    controls, outputs: columns."""
    unseen = np.zeros(len(flight), bool)
    notes = []
    for control in (c for c in controls if flight.measured(c)):
        moved = unseen_moves(flight[control], criteria)
        if moved.any():
            notes.append(
                f"{control} not measured at {int(moved.sum())} samples while it moved: nothing is compared there"
            )
        unseen |= moved
    if not notes:
        return flight
    compared = {c: np.where(unseen, np.nan, flight[c]) for c in outputs if flight.measured(c)}
    return flight.with_columns(**compared).with_notes(*notes)


def unseen_moves(control: Array, criteria: Criteria) -> NDArray[np.bool_]:
    """(N,) samples of a few in a row that a control (N,) lacks, across which it changes by more than its scatter."""
    unseen = np.zeros(control.size, bool)
    known = control[np.isfinite(control)]
    if known.size < 2:
        return unseen
    least = criteria.surface_step * GAUSSIAN * float(np.median(np.abs(np.diff(known))))
    for a, b in runs_of(~np.isfinite(control)):
        inside = a > 0 and b < control.size and b - a <= LONGEST_BRIDGE
        if inside and abs(control[b] - control[a - 1]) > least:
            unseen[a:b] = True
    return unseen


def unseen_paths(control: Array, draws: int, rng: np.random.Generator, criteria: Criteria) -> Array:
    """(draws, N) what may be wrong with straight lines across unseen moves: the step may have been anywhere between the samples
    on either side."""
    wrong = np.zeros((draws, control.size))
    for a, b in runs_of(unseen_moves(control, criteria)):
        at = np.arange(a, b)
        share = (at - (a - 1.0)) / (b - (a - 1.0))
        when = rng.uniform(a - 1.0, b, (draws, 1))
        wrong[:, a:b] = ((at > when) - share) * (control[b] - control[a - 1])
    return wrong
