"""Flights read at instants at which all that drives the model is known.

The noise of a channel is told by its spectrum, and the path of a surface by how it moves from sample to sample: both need samples
that come evenly. Where a few rows in a row are lost, the others still lie on the clock's grid, and the lost ones are put back as
not measured. Where a control alone lacks a sample while it moves, a straight line is drawn through its step: what the other
instruments show there is no answer to that line.

Autopilots log servo outputs ten times a second and motion fifty times. What a surface did between two of its values is then a
guess, whoever makes it (empty cells, the last value repeated, or straight lines that an import drew), and an aircraft that turns
within a sample shows what is wrong with it: a lag of all servos, or something that no catalogue holds. The workflow knows how far
to trust a surface between two *samples* and leaves its path open there. So every control has to be new in every sample, and a
flight is read at the rate of its slowest. An output that an import drew in straight lines is measured at their ends only.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.gap.criteria import Criteria
from estimation.prepare.pipeline import LONGEST_BRIDGE
from groundstation.flight import Flight
from groundstation.flight.arrays import true_runs
from groundstation.flight.quality.repeats import repeats, span_of

Array = NDArray[np.float64]

GAUSSIAN = 1.4826  # standard deviation over median absolute deviation of normal noise
OFF_GRID = 0.25  # of the clock's step: a row further off is not on its grid
ON_GRID = 0.95  # of the rows, for a grid to be one: clocks are late now and then
FINER = (1, 2, 3)  # steps of the clock in the usual interval: every other row or two may be lost all the time
SINGLE = 0.05  # of the rows that follow one step after another, or the grid is that of rounded times, not of a clock
STRAIGHT = (
    1e-6  # of the range: a value closer to the middle of its neighbours lies on a line that somebody drew between them
)
KNOTS = 20  # values, at least, before a control is called slow
EVEN = 0.8  # share of their intervals within a fifth of the usual one: a hand and an ideal input move unevenly
APART = 0.2  # of the usual interval
BETWEEN = 2  # samples at which a course bends whose line ends between them
EARLY = 0.2  # samples by which a control may be read before its next value is there
CLOCKS = 2.0  # samples: from here on a clock of its own comes a sample early now and then
HOLE = 3.5  # usual intervals without a value, as an import takes for a gap
LONGEST = 0.6  # s: what is known still more rarely is no history of a control


def flown_apart(flight: Flight, criteria: Criteria) -> list[Flight]:
    """The parts of a recording between which more time lies than one record may last, as flights of their own.

    Minutes later an aircraft has another speed, height and mass: whether it repeats itself has to be asked of each part, as of
    files that somebody cut.
    """
    parts: list[slice] = []
    for segment in flight.segments:
        near = bool(parts) and flight.time[segment.start] - flight.time[parts[-1].stop - 1] <= criteria.longest_record
        if parts and (near or segment.stop - segment.start < KNOTS):
            parts[-1] = slice(parts[-1].start, segment.stop)
        else:
            parts.append(segment)
    if len(parts) < 2:
        return [flight]
    return [flight.part(part, f"{flight.name} from {flight.time[part.start]:.0f} s") for part in parts]


def with_lost_rows(flight: Flight) -> Flight:
    """The flight with a row of NaN for each of a few in a row that are lost, and a note; itself where its rows are on no grid."""
    step = clock_step(flight)
    if step is None:
        return flight
    steps = np.diff(flight.time) / step
    counts = np.round(steps)
    missing = (counts > 1.0) & (counts <= LONGEST_BRIDGE + 1) & (np.diff(flight.segment) == 0)
    if not missing.any():
        return flight
    rows = np.cumsum(np.where(missing, counts, 1.0)).astype(int)
    rows = np.concatenate([[0], rows])
    time = np.interp(np.arange(rows[-1] + 1), rows, flight.time)
    columns = {n: np.full(time.size, np.nan) for n in flight.columns}
    for name, values in flight.columns.items():
        columns[name][rows] = values
    segment = flight.segment[np.searchsorted(rows, np.arange(time.size), side="right") - 1]
    count = time.size - len(flight)
    note = f"{count} rows lost here and there ({count / time.size:.0%}): taken as not measured"
    return Flight.build(
        flight.name, time, columns, segment=segment, provenance=flight.provenance, notes=flight.notes
    ).with_notes(note)


def clock_step(flight: Flight) -> float | None:
    """Step [s] of the clock on whose grid the rows lie; None where they lie on none."""
    interval, unbroken = flight.sample_interval, np.diff(flight.segment) == 0
    for finer in FINER:
        steps = np.diff(flight.time)[unbroken] / (interval / finer)
        counts = np.maximum(np.round(steps), 1.0)
        if np.mean(np.abs(steps - counts) < OFF_GRID) >= ON_GRID and np.mean(counts == 1.0) >= SINGLE:
            return interval / finer
    return None


def without_unseen_moves(flight: Flight, controls: Sequence[str], outputs: Sequence[str], criteria: Criteria) -> Flight:
    """The flight without what outputs show at samples that a control lacks while it moves, and a note; itself where none does so.
    controls, outputs: columns."""
    unseen = np.zeros(len(flight), bool)
    notes = []
    for control in (c for c in controls if flight.measured(c)):
        hidden = unseen_moves(flight[control], criteria)
        if hidden.any():
            notes.append(
                f"{control} not measured at {int(hidden.sum())} samples while it moved: nothing is compared there"
            )
        unseen |= hidden
    if not notes:
        return flight
    compared = {c: np.where(unseen, np.nan, flight[c]) for c in outputs if flight.measured(c)}
    return flight.with_columns(**compared).with_notes(*notes)


def unseen_moves(control: Array, criteria: Criteria) -> NDArray[np.bool_]:
    """(N,) samples of a few in a row that a control (N,) lacks, across which it changes by more than its scatter."""
    unseen = np.zeros(control.size, bool)
    measured = control[np.isfinite(control)]
    if measured.size < 2:
        return unseen
    limit = criteria.surface_step * GAUSSIAN * float(np.median(np.abs(np.diff(measured))))
    for a, b in true_runs(~np.isfinite(control)):
        bridged = a > 0 and b < control.size and b - a <= LONGEST_BRIDGE
        if bridged and abs(control[b] - control[a - 1]) > limit:
            unseen[a:b] = True
    return unseen


def command_times(control: Array, step: float, interval: float, draws: int, rng: np.random.Generator) -> Array:
    """(draws, N) what may be wrong with a command (N,) recorded every `interval` [s], in samples `step` [s] apart: each of its
    moves began anywhere within one interval, and is as much early or late from its beginning to the next one's."""
    change = np.abs(np.diff(control, prepend=control[:1]))
    begins = np.zeros(control.size, bool)  # a sample before the change grows: the slope there is the move's
    begins[1:-1] = (change[2:] > change[1:-1]) & (change[1:-1] <= change[:-2])
    move = np.cumsum(begins)
    late = rng.uniform(-0.5 * interval, 0.5 * interval, (draws, int(move[-1]) + 1))
    return np.asarray(-late[:, move] * np.gradient(control, step))


def unseen_paths(control: Array, draws: int, rng: np.random.Generator, criteria: Criteria) -> Array:
    """(draws, N) what may be wrong with straight lines across unseen moves: the step may have been anywhere between the samples
    on either side."""
    errors = np.zeros((draws, control.size))
    for a, b in true_runs(unseen_moves(control, criteria)):
        samples = np.arange(a, b)
        share = (samples - (a - 1.0)) / (b - (a - 1.0))
        instant = rng.uniform(a - 1.0, b, (draws, 1))
        errors[:, a:b] = ((samples > instant) - share) * (control[b] - control[a - 1])
    return errors


Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Slow:
    """A control whose values come more rarely than samples. every: samples from one value to the next, usually; new: (N,) samples
    that hold one, or all of a line where they lie between samples; values: (N,) straight from one to the next."""

    column: str
    every: float
    new: Mask
    values: Array


def at_own_rates(
    flights: Sequence[Flight], controls: Sequence[str], outputs: Sequence[str], criteria: Criteria
) -> tuple[Flight, ...]:
    """The flights, those with a slow control read at its rate, and outputs without what was drawn between their values; each with
    a note. controls, outputs: columns."""
    read = (
        _thinned(f, [c for c in controls if f.measured(c)], [c for c in outputs if f.measured(c)], criteria)
        for f in flights
    )
    return tuple(_undrawn(f, [c for c in outputs if f.measured(c)], criteria) for f in read)


def _undrawn(flight: Flight, outputs: Sequence[str], criteria: Criteria) -> Flight:
    for column in outputs:
        lines = _lines(flight, flight[column])
        spacing = _usual(np.flatnonzero(lines.ends), flight)
        if spacing is not None and spacing > criteria.slow_control:
            rate = 1.0 / (spacing * flight.sample_interval)
            note = f"{column} lies on straight lines between values at {rate:.3g} Hz: compared at these only"
            flight = flight.with_columns(**{column: np.where(lines.ends, lines.values, np.nan)}).with_notes(note)
    return flight


def _thinned(flight: Flight, controls: Sequence[str], outputs: Sequence[str], criteria: Criteria) -> Flight:
    slow_controls = [
        s for s in (find_slow_control(flight, c) for c in controls) if s is not None and s.every > criteria.slow_control
    ]
    if not slow_controls:
        return flight
    slowest = max(slow_controls, key=lambda s: s.every)
    spacing = int(np.ceil(slowest.every - EARLY))
    fresh = {c: _fresh(flight, c) for c in outputs}
    keep = np.zeros(len(flight), bool)
    for segment in flight.segments:
        first = segment.start + _phase(slowest.new[segment], [f[segment] for f in fresh.values()], spacing)
        keep[first : segment.stop : spacing] = True
    if not all((f & keep).any() for f in fresh.values()):  # a sensor that is new only where the control is not
        return flight
    rate = 1.0 / (slowest.every * flight.sample_interval)
    names = " and ".join(s.column for s in slow_controls)
    read = flight.with_columns(
        **{c: np.where(f, flight[c], np.nan) for c, f in fresh.items()}, **{s.column: s.values for s in slow_controls}
    ).part(keep)
    return read.with_notes(
        f"values of {names} come at {rate:.3g} Hz only: the flight is read at {1.0 / read.sample_interval:.3g} Hz, for where "
        "a surface was between two of them is not known; log it as often as the motion"
    )


def _phase(new: Mask, others: Sequence[Mask], every: int) -> int:
    """Sample to begin with, so that most values of the control, and then most of the others, are among those kept."""

    def kept(first: int) -> tuple[int, int, int]:
        return int(new[first::every].sum()), sum(int(o[first::every].sum()) for o in others), -first

    return max(range(min(every, new.size)), key=kept)


def find_slow_control(flight: Flight, column: str) -> Slow | None:
    """What is known of a control whose values come more rarely than samples; None of one that is new in each."""
    values = flight[column]
    measured = np.isfinite(values)
    if measured.sum() < KNOTS or np.ptp(values[measured]) == 0.0:
        return None
    fresh = _fresh(flight, column)
    spacing = _usual(np.flatnonzero(fresh), flight)
    if spacing is not None and spacing > 1.0:
        return Slow(column, spacing, fresh, _joined(values, fresh, spacing))
    lines = _lines(flight, values)
    logged = flight.native_rate(column)  # before an import drew its lines
    logged_spacing = 1.0 / (logged * flight.sample_interval) if logged is not None and logged * LONGEST >= 1.0 else None
    line_spacing = _usual(np.flatnonzero(lines.ends), flight)
    spacing = logged_spacing or line_spacing
    if spacing is None or spacing <= 1.0 or not fresh[measured].all():
        return None
    if line_spacing is None:
        return Slow(column, spacing, measured, values)
    interpolated = _joined(lines.values, lines.ends | lines.rest, spacing)
    return Slow(column, spacing, lines.ends, np.where(np.isfinite(interpolated), interpolated, values))


def known_at(flight: Flight, column: str) -> Mask:
    """(N,) samples at which a column shows a measurement: no repeat of a slow sensor, of lines that an import drew their ends."""
    fresh, lines = _fresh(flight, column), _lines(flight, flight[column])
    spacing = _usual(np.flatnonzero(lines.ends), flight)
    return fresh if spacing is None or spacing <= 1.0 else fresh & lines.ends


def _fresh(flight: Flight, column: str) -> Mask:
    """(N,) samples at which a column shows a measurement, and no repeat of a slow sensor."""
    return np.isfinite(flight[column]) & ~repeats(flight, column).held


def _joined(values: Array, known: Mask, every: float) -> Array:
    """Straight lines from one known value to the next, NaN across holes of more than a few of their intervals."""
    knots = np.flatnonzero(known)
    samples = np.arange(values.size)
    next_knot = np.clip(np.searchsorted(knots, samples), 1, knots.size - 1)
    close = (knots[next_knot] - knots[next_knot - 1] <= HOLE * every) & (samples >= knots[0]) & (samples <= knots[-1])
    return np.where(close, np.interp(samples, knots, values[knots]), np.nan)


@dataclass(frozen=True)
class _Lines:
    """A course made of straight lines. ends: (N,) samples nearest to where one ends; values: (N,) those of the ends there, as
    they are elsewhere; rest: (N,) samples between two equal ones."""

    ends: Mask
    values: Array
    rest: Mask


def _lines(flight: Flight, values: Array) -> _Lines:
    """Where a course bends. One that rests or is not made of lines is one long bend: values that repeat are no line."""
    inner, bend, rest = (np.zeros(values.size, bool) for _ in range(3))
    inner[1:-1] = np.diff(flight.segment, 2) == 0
    with np.errstate(invalid="ignore"):
        limit = STRAIGHT * span_of(values[np.isfinite(values)])
        moves, bends = np.abs(np.diff(values)) > limit, np.diff(values, 2)
        rest[1:-1] = (np.abs(np.diff(values))[:-1] <= limit) & (np.abs(np.diff(values))[1:] <= limit)
        bend[1:-1] = ~((np.abs(bends) <= limit) & moves[:-1])
    ends, at_ends = np.zeros(values.size, bool), values.copy()
    for a, b in true_runs(bend & inner):
        share = 0.0
        if (
            b - a == BETWEEN and bends[a - 1] * bends[a] > 0.0
        ):  # the end of a line between two samples bends the course at both
            share = float(bends[a] / (bends[a - 1] + bends[a]))
        nearest = a + round(share)
        ends[nearest] = True
        at_ends[nearest] = values[a] + share * (values[a] - values[a - 1])
    return _Lines(ends, at_ends, rest)


def _usual(at: NDArray[np.int64], flight: Flight) -> float | None:
    """Samples from one of `at` to the next, where these come evenly; None where they do not, or are too few."""
    steps = np.diff(at)
    steps = steps[steps * flight.sample_interval <= LONGEST]
    if steps.size < KNOTS:
        return None
    spacing = float(np.median(steps))
    close = np.abs(steps - spacing) <= max(APART * spacing, float(spacing >= CLOCKS))
    return float(np.mean(steps[close])) if np.mean(close) >= EVEN else None
