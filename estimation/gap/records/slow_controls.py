"""Flights of which a control is known more rarely than the rest is sampled, read at the instants at which it is known.

Autopilots log servo outputs ten times a second and motion fifty times. What a surface did between two of its values is then a
guess, whoever makes it (empty cells, the last value repeated, or straight lines that an import drew), and an aircraft that turns
within a sample shows what is wrong with it: a lag of all servos, or something that no catalogue holds. The workflow knows how far
to trust a surface between two *samples* and leaves its path open there. So every control has to be new in every sample.

An output that an import drew in straight lines is measured at their ends only; what lies on them is no measurement.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.gap.criteria import Criteria
from groundstation.flight import Flight
from groundstation.flight.arrays import true_runs
from groundstation.flight.quality.repeats import repeats, span_of

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
        every = _usual(np.flatnonzero(lines.ends), flight)
        if every is not None and every > criteria.slow_control:
            rate = 1.0 / (every * flight.sample_interval)
            said = f"{column} lies on straight lines between values at {rate:.3g} Hz: compared at these only"
            flight = flight.with_columns(**{column: np.where(lines.ends, lines.values, np.nan)}).with_notes(said)
    return flight


def _thinned(flight: Flight, controls: Sequence[str], outputs: Sequence[str], criteria: Criteria) -> Flight:
    found = [s for s in (slow(flight, c) for c in controls) if s is not None and s.every > criteria.slow_control]
    if not found:
        return flight
    slowest = max(found, key=lambda s: s.every)
    every = int(np.ceil(slowest.every - EARLY))
    fresh = {c: _fresh(flight, c) for c in outputs}
    keep = np.zeros(len(flight), bool)
    for whole in flight.segments:
        first = whole.start + _phase(slowest.new[whole], [f[whole] for f in fresh.values()], every)
        keep[first : whole.stop : every] = True
    if not all((f & keep).any() for f in fresh.values()):  # a sensor that is new only where the control is not
        return flight
    rate = 1.0 / (slowest.every * flight.sample_interval)
    names = " and ".join(s.column for s in found)
    read = flight.with_columns(
        **{c: np.where(f, flight[c], np.nan) for c, f in fresh.items()}, **{s.column: s.values for s in found}
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


def slow(flight: Flight, column: str) -> Slow | None:
    """What is known of a control whose values come more rarely than samples; None of one that is new in each."""
    values = flight[column]
    known = np.isfinite(values)
    if known.sum() < KNOTS or np.ptp(values[known]) == 0.0:
        return None
    fresh = _fresh(flight, column)
    every = _usual(np.flatnonzero(fresh), flight)
    if every is not None and every > 1.0:
        return Slow(column, every, fresh, _joined(values, fresh, every))
    lines = _lines(flight, values)
    logged = flight.native_rate(column)  # before an import drew its lines
    stated = 1.0 / (logged * flight.sample_interval) if logged is not None and logged * LONGEST >= 1.0 else None
    seen = _usual(np.flatnonzero(lines.ends), flight)
    every = stated or seen
    if every is None or every <= 1.0 or not fresh[known].all():
        return None
    if seen is None:
        return Slow(column, every, known, values)
    drawn = _joined(lines.values, lines.ends | lines.rest, every)
    return Slow(column, every, lines.ends, np.where(np.isfinite(drawn), drawn, values))


def _fresh(flight: Flight, column: str) -> Mask:
    """(N,) samples at which a column shows a measurement, and no repeat of a slow sensor."""
    return np.isfinite(flight[column]) & ~repeats(flight, column).held


def _joined(values: Array, known: Mask, every: float) -> Array:
    """Straight lines from one known value to the next, NaN across holes of more than a few of their intervals."""
    at = np.flatnonzero(known)
    here = np.arange(values.size)
    after = np.clip(np.searchsorted(at, here), 1, at.size - 1)
    close = (at[after] - at[after - 1] <= HOLE * every) & (here >= at[0]) & (here <= at[-1])
    return np.where(close, np.interp(here, at, values[at]), np.nan)


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
        least = STRAIGHT * span_of(values[np.isfinite(values)])
        moves, bends = np.abs(np.diff(values)) > least, np.diff(values, 2)
        rest[1:-1] = (np.abs(np.diff(values))[:-1] <= least) & (np.abs(np.diff(values))[1:] <= least)
        bend[1:-1] = ~((np.abs(bends) <= least) & moves[:-1])
    ends, at_ends = np.zeros(values.size, bool), values.copy()
    for a, b in true_runs(bend & inner):
        share = 0.0
        if (
            b - a == BETWEEN and bends[a - 1] * bends[a] > 0.0
        ):  # the end of a line between two samples bends the course at both
            share = float(bends[a] / (bends[a - 1] + bends[a]))
        near = a + round(share)
        ends[near] = True
        at_ends[near] = values[a] + share * (values[a] - values[a - 1])
    return _Lines(ends, at_ends, rest)


def _usual(at: NDArray[np.int64], flight: Flight) -> float | None:
    """Samples from one of `at` to the next, where these come evenly; None where they do not, or are too few."""
    steps = np.diff(at)
    steps = steps[steps * flight.sample_interval <= LONGEST]
    if steps.size < KNOTS:
        return None
    usual = float(np.median(steps))
    close = np.abs(steps - usual) <= max(APART * usual, float(usual >= CLOCKS))
    return float(np.mean(steps[close])) if np.mean(close) >= EVEN else None
