"""Flights read at instants at which every control is measured, and attitudes filled in between the instants of their log.

The spectrum of a channel's noise and the path of a surface between samples need evenly spaced samples. Where a few successive
rows are lost, the others still lie on the clock's grid, and the lost ones are put back as not measured. Where only a control
lacks a sample while it moves, a straight line is drawn through its step: the other instruments do not answer that line, and
nothing is compared there.

Autopilots log servo outputs ten times a second and motion fifty times. The path of a surface between two of its values is then a
guess (empty cells, the last value repeated, or straight lines drawn by an import), and an aircraft that turns within a sample
shows its error: a lag of all servos, or an effect that no catalogue holds. The workflow knows how far to trust a surface between
two *samples* and leaves its path open there. So every control needs a new value in every sample, and a flight is read at the rate
of its slowest control. An output that an import drew in straight lines is measured at their ends only.

The attitude of a filter, logged more slowly than the gyros, is filled in with their rates, which the filter integrated itself.
Leaving it out between its values would make holes in the one channel whose errors are slow, and a slow error seen through holes
looks fast. Where the log's instants lie between the samples, no sample shows a value, and straight lines show by cutting off
curvature. An attitude that is measured independently each time (optically, say) stays as it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.gap.criteria import Criteria
from estimation.prepare.pipeline import LONGEST_BRIDGE
from groundstation.flight import Flight
from groundstation.flight.arrays import MAD_TO_SIGMA, Array, Mask, integral, true_runs
from groundstation.flight.kinematics import attitude_rates
from groundstation.flight.quality.repeats import repeats, span_of

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
MOTION = ("p", "q", "r", "phi", "theta")
PHASES = 20  # trial instants within a log interval: the sag of a line is then known to a hundredth
FEWEST = 40  # values of an attitude: the white share is then known to a sixth

# ------------------------------------------------------------------------------------------------ rows on the clock's grid


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
    counts = np.round(np.diff(flight.time) / step)
    missing = (counts > 1.0) & (counts <= LONGEST_BRIDGE + 1) & (np.diff(flight.segment) == 0)
    if not missing.any():
        return flight
    rows = np.concatenate([[0], np.cumsum(np.where(missing, counts, 1.0)).astype(int)])
    all_rows = np.arange(rows[-1] + 1)
    last = np.searchsorted(rows, all_rows, side="right") - 1  # given row at or before each
    columns = {n: np.where(rows[last] == all_rows, values[last], np.nan) for n, values in flight.columns.items()}
    time, lost = np.interp(all_rows, rows, flight.time), all_rows.size - len(flight)
    note = f"{lost} rows lost here and there ({lost / all_rows.size:.0%}): taken as not measured"
    return Flight.build(
        flight.name, time, columns, segment=flight.segment[last], provenance=flight.provenance, notes=flight.notes
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


# ------------------------------------------------------------------------------------------------ moves between samples


def without_unseen_moves(flight: Flight, controls: Sequence[str], outputs: Sequence[str], criteria: Criteria) -> Flight:
    """The flight with NaN in the outputs at samples that a control lacks while it moves, and a note; unchanged where no control
    does so. controls, outputs: columns."""
    hidden = {c: unseen_moves(flight[c], criteria) for c in controls if flight.measured(c)}
    notes = [
        f"{c} not measured at {int(samples.sum())} samples while it moved: nothing is compared there"
        for c, samples in hidden.items()
        if samples.any()
    ]
    if not notes:
        return flight
    unseen = np.logical_or.reduce(list(hidden.values()))
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


# ------------------------------------------------------------------------------------------------ slow and interpolated columns


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
    read = []
    for flight in flights:
        measured = [c for c in outputs if flight.measured(c)]
        thinned = _thinned(flight, [c for c in controls if flight.measured(c)], measured, criteria)
        read.append(_without_drawn_lines(thinned, measured, criteria))
    return tuple(read)


def _without_drawn_lines(flight: Flight, outputs: Sequence[str], criteria: Criteria) -> Flight:
    """The flight with NaN between the ends of straight lines in the outputs."""
    for column in outputs:
        lines = _lines(flight, flight[column])
        if lines.spacing is not None and lines.spacing > criteria.clearly_above:
            rate = 1.0 / (lines.spacing * flight.sample_interval)
            note = f"{column} lies on straight lines between values at {rate:.3g} Hz: compared at these only"
            flight = flight.with_columns(**{column: np.where(lines.ends, lines.values, np.nan)}).with_notes(note)
    return flight


def _thinned(flight: Flight, controls: Sequence[str], outputs: Sequence[str], criteria: Criteria) -> Flight:
    """The flight read at the rate of its slowest control; unchanged where none is slow."""
    candidates = (find_slow_control(flight, c) for c in controls)
    slow_controls = [s for s in candidates if s is not None and s.spacing > criteria.clearly_above]
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
    spacing = _usual_spacing(flight, fresh)
    if spacing is not None and spacing > 1.0:
        return Slow(column, spacing, fresh, _joined(values, fresh, spacing))
    lines = _lines(flight, values)
    logged = flight.native_rate(column)  # before an import interpolated
    is_history = logged is not None and logged * LONGEST >= 1.0
    spacing = 1.0 / (logged * flight.sample_interval) if logged is not None and is_history else lines.spacing
    if spacing is None or spacing <= 1.0 or not fresh[measured].all():
        return None
    if lines.spacing is None:
        return Slow(column, spacing, measured, values)
    interpolated = _joined(lines.values, lines.ends | lines.rest, spacing)
    return Slow(column, spacing, lines.ends, np.where(np.isfinite(interpolated), interpolated, values))


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
    these samples; rest: (N,) samples between two equal ones; spacing: usual one of the ends, None where it is uneven."""

    ends: Mask
    values: Array
    rest: Mask
    spacing: float | None


def _lines(flight: Flight, values: Array) -> _Lines:
    """The straight lines of a course, which end where it bends. A course that rests or is not made of lines bends everywhere."""
    inner, bend, rest, ends = (np.zeros(values.size, bool) for _ in range(4))
    inner[1:-1] = np.diff(flight.segment, 2) == 0
    with np.errstate(invalid="ignore"):
        limit = STRAIGHT * span_of(values[np.isfinite(values)])
        changes, bends = np.abs(np.diff(values)), np.diff(values, 2)
        rest[1:-1] = (changes[:-1] <= limit) & (changes[1:] <= limit)
        bend[1:-1] = ~((np.abs(bends) <= limit) & (changes[:-1] > limit))
    at_ends = values.copy()
    for a, b in true_runs(bend & inner):
        # a line that ends between two samples bends the course at both
        is_between = b - a == BETWEEN and bends[a - 1] * bends[a] > 0.0
        share = float(bends[a] / (bends[a - 1] + bends[a])) if is_between else 0.0
        nearest = a + round(share)
        ends[nearest] = True
        at_ends[nearest] = values[a] + share * (values[a] - values[a - 1])
    return _Lines(ends, at_ends, rest, _usual_spacing(flight, ends))


def _usual_spacing(flight: Flight, known: Mask) -> float | None:
    """Usual number of samples from one known value to the next; None where that is uneven or values are too few."""
    steps = np.diff(np.flatnonzero(known))
    steps = steps[steps * flight.sample_interval <= LONGEST]
    if steps.size < KNOTS:
        return None
    spacing = float(np.median(steps))
    close = np.abs(steps - spacing) <= max(NEAR_USUAL * spacing, float(spacing >= CLOCKS))
    return float(np.mean(steps[close])) if np.mean(close) >= EVEN else None


# ------------------------------------------------------------------------------------------------ attitudes of a filter


def with_attitudes_between(flight: Flight, criteria: Criteria) -> Flight:
    """The flight with a filter's bank and pitch attitude filled in between the logged values, and a note for each; unchanged
    where there is nothing to fill."""
    if not all(flight.measured(c) for c in MOTION):
        return flight
    attitudes = {c: _logged(flight, c) for c in ("phi", "theta")}
    rates = attitude_rates(*(_interpolated(flight, c, attitudes.get(c, np.isfinite(flight[c]))) for c in MOTION))
    for attitude, known in attitudes.items():
        if np.count_nonzero(known) < FEWEST:
            continue
        spacing = float(np.median(np.diff(np.flatnonzero(known))))
        if spacing > criteria.clearly_above:
            filled = _filled(flight, flight[attitude], known, rates[attitude], criteria)
        else:
            spacing = 1.0 / ((flight.native_rate(attitude) or np.inf) * flight.sample_interval)
            filled = _rounded(flight, flight[attitude], spacing, rates[attitude], criteria)
        if filled is not None:
            rate = 1.0 / (spacing * flight.sample_interval)
            note = (
                f"{attitude} is a filter's, logged at {rate:.3g} Hz: filled in between its values with the gyro rates"
            )
            flight = flight.with_columns(**{attitude: filled}).with_notes(note)
    return flight


def _logged(flight: Flight, column: str) -> Mask:
    """(N,) samples at which a column is measured: no repeats of a slow sensor, and of interpolated lines only the ends."""
    fresh, lines = _fresh(flight, column), _lines(flight, flight[column])
    return fresh & lines.ends if lines.spacing is not None and lines.spacing > 1.0 else fresh


def _interpolated(flight: Flight, column: str, known: Mask) -> Array:
    """(N,) straight lines through the known values of a column."""
    return np.interp(flight.time, flight.time[known], flight[column][known]) if known.any() else np.zeros(len(flight))


def white_share(known: Array, summed: Array) -> float:
    """Share of white measurement noise in the steps of an attitude beside the integrated rates, 0 to 1; 1 for too few steps.

    known, summed: (N,) successive values, NaN where not measured, and the integral of the rates there.

    White noise makes one step too large and the next too small by as much: successive steps have a correlation of -1/2. The
    errors of a filter are slow, with its gyros' noise, and give no correlation. Only samples with a steady rate count: a late
    attitude errs where the rate changes.
    """
    steps, turned = np.diff(known - summed), np.abs(np.diff(summed, 2))
    pairs = np.column_stack([steps[:-1], steps[1:]])
    measured = np.isfinite(pairs).all(axis=1) & np.isfinite(turned)
    if np.count_nonzero(measured) < FEWEST:
        return 1.0
    even = measured & (turned <= np.median(turned[measured]))
    pairs = pairs[even] - np.median(steps[np.isfinite(steps)])
    power = float(np.mean(pairs**2))
    return float(np.clip(-2.0 * np.mean(pairs[:, 0] * pairs[:, 1]) / power, 0.0, 1.0)) if power > 0.0 else 0.0


def _filled(flight: Flight, values: Array, known: Mask, rate: Array, criteria: Criteria) -> Array | None:
    """(N,) an attitude logged at the samples `known`, with the integrated rate between them; None where it is no filter's."""
    filled, shares = np.where(known, values, np.nan), []
    for segment in flight.segments:
        time, knots = flight.time[segment], np.flatnonzero(known[segment])
        if knots.size < FEWEST:
            continue
        summed = integral(time, rate[segment])
        at_knots = values[segment][knots]
        shares.append(white_share(at_knots, summed[knots]))
        reach = int(np.median(np.diff(knots)))  # no value was held for longer
        inside = np.arange(max(knots[0] - reach, 0), min(knots[-1] + reach, time.size))
        between = np.interp(time[inside], time[knots], at_knots - summed[knots])
        filled[segment.start + inside] = summed[inside] + between
    return filled if shares and max(shares) < criteria.halfway else None


def _rounded(flight: Flight, values: Array, spacing: float, rate: Array, criteria: Criteria) -> Array | None:
    """(N,) an attitude logged every `spacing` samples and interpolated by straight lines, with the curvature that these cut off.

    The integrated rates, interpolated in the same way, lose as much. Of the trial instants of the log those count that leave the
    smallest second differences. None where the attitude is no filter's.
    """
    if spacing <= criteria.clearly_above:
        return None
    from scipy.interpolate import CubicSpline  # here: rarely needed, and long to import

    filled, shares = values.copy(), []
    for segment in flight.segments:
        time, course = flight.time[segment], values[segment]
        if np.isfinite(course).sum() <= FEWEST * spacing:
            continue
        summed, interval = integral(time, rate[segment]), spacing * flight.sample_interval
        knots = np.arange(time[0] - interval, time[-1] + 2.0 * interval, interval)
        smooth = CubicSpline(time, summed)
        drawn = [
            np.interp(time, knots + begin, smooth(knots + begin))
            for begin in np.linspace(0.0, interval, PHASES, endpoint=False)
        ]
        roughness = [float(np.nanmean(np.diff(course - lines, 2) ** 2)) for lines in drawn]
        filled[segment] = course - drawn[int(np.argmin(roughness))] + summed
        logged = slice(None, None, round(spacing))
        shares.append(white_share(course[logged], summed[logged]))
    return filled if shares and max(shares) < criteria.halfway else None
