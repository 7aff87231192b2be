"""Flights read at instants at which every control is measured.

The spectrum of a channel's noise and the path of a surface between samples need evenly spaced samples. Where a few successive
rows are lost, the others still lie on the clock's grid, and the lost ones are put back as not measured. Where only a control
lacks a sample while it moves, a straight line is drawn through its step: the other instruments do not answer that line, and
nothing is compared there.

Autopilots log servo outputs ten times a second and motion fifty times. The path of a surface between two of its values is then a
guess (empty cells, the last value repeated, or straight lines drawn by an import), and an aircraft that turns within a sample
shows its error: a lag of all servos, or an effect that no catalogue holds. The workflow knows how far to trust a surface between
two *samples* and leaves its path open there. So every control needs a new value in every sample, and a flight is read at the rate
of its slowest control. An output that an import drew in straight lines is measured at their ends only.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.gap.criteria import Criteria
from estimation.prepare.pipeline import LONGEST_BRIDGE
from groundstation.flight import Flight
from groundstation.flight.arrays import MAD_TO_SIGMA, true_runs
from groundstation.flight.quality.repeats import repeats, span_of

Array = NDArray[np.float64]

OFF_GRID = 0.25  # of the clock's step: a row farther off is not on the grid
ON_GRID = 0.95  # of the rows, for a grid to exist: clocks are late now and then
FINER = (1, 2, 3)  # clock steps in the usual interval: one or two of three rows may always be lost
SINGLE = 0.05  # of the rows must follow after one step, or the grid comes from rounded times
STRAIGHT = 1e-6  # of the range: a value closer to the middle of its neighbours lies on a line drawn between them
KNOTS = 20  # values that it takes to call a control slow
EVEN = 0.8  # share of the intervals that must be near the usual one: a hand and an ideal input move unevenly
NEAR_USUAL = 0.2  # of the usual interval
BETWEEN = 2  # successive bends of a course made of lines, where a line ends between two samples
EARLY = 0.2  # samples by which a control may be read before its next value
CLOCKS = 2.0  # samples: a slower sensor with its own clock is a sample early now and then
HOLE = 3.5  # usual intervals without a value, which an import takes for a gap
LONGEST = 0.6  # s: values still farther apart are no history of a control


def flown_apart(flight: Flight, criteria: Criteria) -> list[Flight]:
    """The parts of a recording with gaps longer than one record may last, as separate flights.

    Minutes later an aircraft has another speed, height and mass: each part has to repeat the others, like separate files.
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
    """The flight with a row of NaN for each row of a short gap, and a note; unchanged where its rows are on no grid."""
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
    """Step [s] of the clock grid on which the rows lie; None where there is no grid."""
    interval, unbroken = flight.sample_interval, np.diff(flight.segment) == 0
    for finer in FINER:
        steps = np.diff(flight.time)[unbroken] / (interval / finer)
        counts = np.maximum(np.round(steps), 1.0)
        if np.mean(np.abs(steps - counts) < OFF_GRID) >= ON_GRID and np.mean(counts == 1.0) >= SINGLE:
            return interval / finer
    return None


def without_unseen_moves(flight: Flight, controls: Sequence[str], outputs: Sequence[str], criteria: Criteria) -> Flight:
    """The flight with NaN in the outputs at samples that a control lacks while it moves, and a note; unchanged where no control
    does so. controls, outputs: columns."""
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


def smallest_step(changes: Array, criteria: Criteria) -> float:
    """The change from sample to sample from which a control steps. changes: (N - 1,) its changes, in whose scatter it counts."""
    return criteria.surface_step * MAD_TO_SIGMA * float(np.median(np.abs(changes)))


def unseen_moves(control: Array, criteria: Criteria) -> NDArray[np.bool_]:
    """(N,) samples of short gaps in a control (N,) across which it changes by more than its scatter."""
    unseen = np.zeros(control.size, bool)
    measured = control[np.isfinite(control)]
    if measured.size < 2:
        return unseen
    limit = smallest_step(np.diff(measured), criteria)
    for a, b in true_runs(~np.isfinite(control)):
        bridged = a > 0 and b < control.size and b - a <= LONGEST_BRIDGE
        if bridged and abs(control[b] - control[a - 1]) > limit:
            unseen[a:b] = True
    return unseen


def command_times(control: Array, step: float, interval: float, draws: int, rng: np.random.Generator) -> Array:
    """(draws, N) possible errors of a command (N,) recorded every `interval` [s], in samples `step` [s] apart: each move began
    anywhere within one interval, and is early or late by the same time until the next move begins."""
    change = np.abs(np.diff(control, prepend=control[:1]))
    begins = np.zeros(control.size, bool)  # a sample before the change grows: its slope belongs to the move
    begins[1:-1] = (change[2:] > change[1:-1]) & (change[1:-1] <= change[:-2])
    move = np.cumsum(begins)
    delay = rng.uniform(-0.5 * interval, 0.5 * interval, (draws, int(move[-1]) + 1))
    return np.asarray(-delay[:, move] * np.gradient(control, step))


def unseen_paths(control: Array, draws: int, rng: np.random.Generator, criteria: Criteria) -> Array:
    """(draws, N) possible errors of straight lines across unseen moves: the step was anywhere between the samples on either
    side."""
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
    """A control with fewer values than samples. spacing: usual number of samples from one value to the next; new: (N,) samples
    that hold a value, or all samples where the values lie between them; values: (N,) interpolated by straight lines."""

    column: str
    spacing: float
    new: Mask
    values: Array


def at_own_rates(
    flights: Sequence[Flight], controls: Sequence[str], outputs: Sequence[str], criteria: Criteria
) -> tuple[Flight, ...]:
    """The flights, read at the rate of their slowest control, and with outputs only where they were measured; each with a note.
    controls, outputs: columns."""
    thinned = (
        _thinned(f, [c for c in controls if f.measured(c)], [c for c in outputs if f.measured(c)], criteria)
        for f in flights
    )
    return tuple(_without_drawn_lines(f, [c for c in outputs if f.measured(c)], criteria) for f in thinned)


def _without_drawn_lines(flight: Flight, outputs: Sequence[str], criteria: Criteria) -> Flight:
    """The flight with NaN between the ends of straight lines in the outputs."""
    for column in outputs:
        lines = _lines(flight, flight[column])
        spacing = _usual(np.flatnonzero(lines.ends), flight)
        if spacing is not None and spacing > criteria.slow_control:
            rate = 1.0 / (spacing * flight.sample_interval)
            note = f"{column} lies on straight lines between values at {rate:.3g} Hz: compared at these only"
            flight = flight.with_columns(**{column: np.where(lines.ends, lines.values, np.nan)}).with_notes(note)
    return flight


def _thinned(flight: Flight, controls: Sequence[str], outputs: Sequence[str], criteria: Criteria) -> Flight:
    """The flight read at the rate of its slowest control; unchanged where none is slow."""
    candidates = (find_slow_control(flight, c) for c in controls)
    slow_controls = [s for s in candidates if s is not None and s.spacing > criteria.slow_control]
    if not slow_controls:
        return flight
    slowest = max(slow_controls, key=lambda s: s.spacing)
    spacing = int(np.ceil(slowest.spacing - EARLY))
    fresh = {c: _fresh(flight, c) for c in outputs}
    keep = np.zeros(len(flight), bool)
    for segment in flight.segments:
        first = segment.start + _phase(slowest.new[segment], [f[segment] for f in fresh.values()], spacing)
        keep[first : segment.stop : spacing] = True
    if not all((f & keep).any() for f in fresh.values()):  # a sensor has new values only where the control has none
        return flight
    rate = 1.0 / (slowest.spacing * flight.sample_interval)
    names = " and ".join(s.column for s in slow_controls)
    read = flight.with_columns(
        **{c: np.where(f, flight[c], np.nan) for c, f in fresh.items()}, **{s.column: s.values for s in slow_controls}
    ).part(keep)
    return read.with_notes(
        f"values of {names} come at {rate:.3g} Hz only: the flight is read at {1.0 / read.sample_interval:.3g} Hz, because "
        "the path of a surface between two values is unknown; log it as often as the motion"
    )


def _phase(new: Mask, others: Sequence[Mask], spacing: int) -> int:
    """First of every `spacing` samples, so that these hold most values of the control, and then most of the others."""

    def counts(first: int) -> tuple[int, int, int]:
        return int(new[first::spacing].sum()), sum(int(o[first::spacing].sum()) for o in others), -first

    return max(range(min(spacing, new.size)), key=counts)


def find_slow_control(flight: Flight, column: str) -> Slow | None:
    """A control with fewer values than samples; None where it has a new value in each, or rests."""
    values = flight[column]
    measured = np.isfinite(values)
    if measured.sum() < KNOTS or np.ptp(values[measured]) == 0.0:
        return None
    fresh = _fresh(flight, column)
    spacing = _usual(np.flatnonzero(fresh), flight)
    if spacing is not None and spacing > 1.0:
        return Slow(column, spacing, fresh, _joined(values, fresh, spacing))
    lines = _lines(flight, values)
    logged = flight.native_rate(column)  # before an import interpolated
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
    """(N,) samples at which a column is measured: no repeats of a slow sensor, and of interpolated lines only the ends."""
    fresh, lines = _fresh(flight, column), _lines(flight, flight[column])
    spacing = _usual(np.flatnonzero(lines.ends), flight)
    return fresh if spacing is None or spacing <= 1.0 else fresh & lines.ends


def _fresh(flight: Flight, column: str) -> Mask:
    """(N,) samples at which a column is measured and does not repeat a value of a slow sensor."""
    return np.isfinite(flight[column]) & ~repeats(flight, column).held


def _joined(values: Array, known: Mask, spacing: float) -> Array:
    """(N,) straight lines from one known value to the next; NaN across holes of several times `spacing` samples."""
    knots = np.flatnonzero(known)
    samples = np.arange(values.size)
    next_knot = np.clip(np.searchsorted(knots, samples), 1, knots.size - 1)
    close = (knots[next_knot] - knots[next_knot - 1] <= HOLE * spacing) & (samples >= knots[0]) & (samples <= knots[-1])
    return np.where(close, np.interp(samples, knots, values[knots]), np.nan)


@dataclass(frozen=True)
class _Lines:
    """A course made of straight lines. ends: (N,) samples nearest to the end of a line; values: (N,) with the value of the end at
    these samples; rest: (N,) samples between two equal ones."""

    ends: Mask
    values: Array
    rest: Mask


def _lines(flight: Flight, values: Array) -> _Lines:
    """The straight lines of a course, which end where it bends. A course that rests or is not made of lines bends everywhere."""
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
        ):  # a line that ends between two samples bends the course at both
            share = float(bends[a] / (bends[a - 1] + bends[a]))
        nearest = a + round(share)
        ends[nearest] = True
        at_ends[nearest] = values[a] + share * (values[a] - values[a - 1])
    return _Lines(ends, at_ends, rest)


def _usual(at: NDArray[np.int64], flight: Flight) -> float | None:
    """Usual spacing of the samples `at`; None where they are uneven or too few."""
    steps = np.diff(at)
    steps = steps[steps * flight.sample_interval <= LONGEST]
    if steps.size < KNOTS:
        return None
    spacing = float(np.median(steps))
    close = np.abs(steps - spacing) <= max(NEAR_USUAL * spacing, float(spacing >= CLOCKS))
    return float(np.mean(steps[close])) if np.mean(close) >= EVEN else None
