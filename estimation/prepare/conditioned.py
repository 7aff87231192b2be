"""What of a flight's columns is a measurement: wild values taken out, repeats of slow and of stuck sensors marked.

Everything left out is said in a note that names the column, and can be kept (`keep_held`).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimation.prepare.plausible import refuse_other_time_unit, wild_values
from groundstation.flight import Array, Flight
from groundstation.flight.findings import Finding, FindingKind
from groundstation.flight.quality.repeats import RepeatedValues, repeats

Mask = NDArray[np.bool_]

KEEP = "--keep-held keeps them"
INTEGRATED = ("ax", "ay", "az", "p", "q", "r")
"""What a reconstruction integrates between fixes."""
WHOLE_TURNS = ("phi", "psi")
"""Angles that go round: an aircraft that rolls on through inverted flight has no jump from half a turn to minus half a turn."""
NOT_SLOWER = 0.9
"""Of the flight's rate: a column logged at more than this is as fast as the samples."""


@dataclass(frozen=True)
class ConditionedFlight:
    """flight: without wild values. repeats: column -> its repeated values; empty where they are kept. notes: on wild values and
    on what stands still with everything else. drawn: column -> (N,) samples that an import drew on straight lines between two
    of a slower sensor."""

    flight: Flight
    repeats: Mapping[str, RepeatedValues]
    notes: tuple[Finding, ...]
    drawn: Mapping[str, Mask] = field(default_factory=dict)

    def held(self, column: str) -> Mask:
        """(N,) samples that repeat the last value of a slow sensor."""
        return self.repeats[column].held if column in self.repeats else np.zeros(len(self.flight), bool)

    def stuck(self, column: str) -> Mask:
        """(N,) samples at which a column's sensor is stuck."""
        return self.repeats[column].stuck if column in self.repeats else np.zeros(len(self.flight), bool)

    def copies(self, column: str) -> Mask:
        """(N,) samples without a measurement of their own: repeats of a slow sensor, and those drawn between two samples."""
        return self.held(column) | self.drawn[column] if column in self.drawn else self.held(column)

    def fresh(self, column: str) -> Mask:
        """(N,) samples at which a column shows a measurement."""
        return np.isfinite(self.flight[column]) & ~self.copies(column)

    def as_output(self, column: str) -> tuple[Array, list[Finding]]:
        """The column as an output: NaN where it shows no measurement; and what was left out, one note a reason."""
        values, notes = self.flight[column].copy(), []
        missing = int((~np.isfinite(values)).sum())
        if missing:
            text = f"{column} not measured at {missing} samples: not compared there"
            notes.append(Finding(FindingKind.NOT_MEASURED, text, columns=(column,)))
        notes += self.slow_notes(column, "repeats are not compared")
        if column in self.drawn:
            count = int((np.isfinite(values) & ~self.drawn[column]).sum())
            text = f"{column} was logged more slowly: compared at {count} samples of its own, not at those drawn between them"
            notes.append(Finding(FindingKind.HELD, text, columns=(column,)))
        notes += self.stuck_notes(column, f"not compared there; {KEEP}")
        values[~self.fresh(column) | self.stuck(column)] = np.nan
        return values, notes

    def slow_notes(self, column: str, consequence: str) -> list[Finding]:
        """The note on a slow sensor, if it is one."""
        if column not in self.repeats or not self.repeats[column].slow:
            return []
        text = (
            f"{column} is slower than the samples: new values come at {self.repeats[column].rate:.3g} Hz, "
            f"{int(self.held(column).sum())} of {len(self.flight)} samples repeat the last: {consequence}; {KEEP}"
        )
        return [Finding(FindingKind.HELD, text, columns=(column,))]

    def stuck_notes(self, column: str, consequence: str) -> list[Finding]:
        """The note on a stuck sensor, if it is one."""
        stuck = self.stuck(column)
        if not stuck.any():
            return []
        text = (
            f"{column} repeats one value for {int(stuck.sum())} samples from t = {self.flight.time[stuck][0]:g} s on, while "
            f"its noise or the other channels say that it must have moved: {consequence}"
        )
        return [Finding(FindingKind.STUCK, text, columns=(column,))]


def condition_columns(flight: Flight, columns: Iterable[str], *, keep_held: bool = False) -> ConditionedFlight:
    """Look at the named columns (those that are measured). keep_held: repeated values are taken for measurements.

    Raises DataError where time is in another unit.
    """
    refuse_other_time_unit(flight)
    names = [c for c in dict.fromkeys(columns) if flight.measured(c)]
    notes, changed = [], {}
    for name in names:
        wild = wild_values(flight[name])
        if wild.any():
            changed[name] = np.where(wild, np.nan, flight[name])
            notes.append(_wild_note(flight, name, np.flatnonzero(wild)))
    changed |= {
        n: v
        for n in names
        if n in WHOLE_TURNS and (v := _unwrapped(changed.get(n, flight[n]), flight.segments)) is not None
    }
    if changed:
        flight = flight.with_columns(**changed)
    if keep_held:
        return ConditionedFlight(flight, {}, tuple(notes))
    return ConditionedFlight(flight, {n: repeats(flight, n) for n in names}, tuple(notes), drawn_between(flight, names))


def _unwrapped(angle: Array, segments: Iterable[slice]) -> Array | None:
    """The angle (N,) [rad] without jumps of a turn in any segment; None where it has none. From one to the next it may have."""
    unwrapped = angle.copy()
    for part in segments:
        known = np.flatnonzero(np.isfinite(angle[part])) + part.start
        unwrapped[known] = np.unwrap(angle[known])
    return None if np.array_equal(unwrapped, angle, equal_nan=True) else unwrapped


def repair_columns(flight: Flight, columns: Iterable[str], *, keep_held: bool = False) -> ConditionedFlight:
    """The flight for a method that reads its columns itself: wild values and repeats of slow sensors on straight lines between
    their neighbours, samples of stuck sensors NaN; all said in the notes."""
    conditioned = condition_columns(flight, columns, keep_held=keep_held)
    notes, changed = list(conditioned.notes), {}
    for name in dict.fromkeys(columns):
        if not conditioned.flight.measured(name):
            continue
        values, stuck = conditioned.flight[name], conditioned.stuck(name)
        measured = conditioned.fresh(name) & ~stuck
        bridged = (~np.isfinite(values) & np.isfinite(flight[name])) | conditioned.held(name)
        if not measured.any() or not (bridged.any() or stuck.any()):
            continue
        values = np.where(measured, values, np.nan)
        values[bridged] = np.interp(flight.time[bridged], flight.time[measured], values[measured])
        changed[name] = values
        notes += conditioned.slow_notes(name, "taken on straight lines between new values")
        notes += conditioned.stuck_notes(name, f"left out there; {KEEP}")
    repaired = conditioned.flight.with_columns(**changed)
    return ConditionedFlight(repaired, conditioned.repeats, tuple(notes), conditioned.drawn)


def drawn_between(flight: Flight, columns: Iterable[str]) -> dict[str, Mask]:
    """Column -> (N,) samples that its import drew between those that were logged, of columns logged more slowly than the flight
    samples.

    One sample stands for each that was logged, in each of its intervals the one at which the straight lines meet: there the
    second differences of all columns of that rate are largest. A column that was reconstructed has a value for each sample of the
    gyros and accelerometers it was integrated from. So a log has the information it has, on whatever grid.
    """
    by_rate: dict[float, list[str]] = {}
    sensed = [c for c in columns if flight.held(c) is None]  # a command holds: nothing is drawn between its records
    for column in sensed:
        native_rates = [flight.native_rate(c) for c in (INTEGRATED if column in flight.reconstructed else (column,))]
        rate = min((r for r in native_rates if r is not None), default=None)
        if rate is not None and rate < NOT_SLOWER / flight.sample_interval:
            by_rate.setdefault(round(rate, 1), []).append(column)
    masks = {rate: _drawn_at_rate(flight, names, rate) for rate, names in by_rate.items()}
    return {name: masks[rate] for rate, names in by_rate.items() for name in names}


def _drawn_at_rate(flight: Flight, columns: Sequence[str], rate: float) -> Mask:
    bend = np.zeros(len(flight))
    for column in columns:
        if column not in flight.reconstructed:
            second = np.nan_to_num(np.abs(np.diff(flight[column], 2)))
            bend[1:-1] += second / max(float(second.mean()), 1e-300)
    interval = np.floor((flight.time - flight.time[0]) * rate + 1e-6).astype(np.int64)
    order = np.lexsort((-bend, interval))
    first = np.concatenate([[True], np.diff(interval[order]) > 0])
    mask = np.ones(len(flight), bool)
    mask[order[first]] = False
    return mask


def _wild_note(flight: Flight, name: str, rows: NDArray[np.intp]) -> Finding:
    count, first = (f"{rows.size} wild values", " first") if rows.size > 1 else ("a wild value", "")
    place = f"{flight[name][rows[0]]:.3g} at t = {flight.time[rows[0]]:g} s"
    return Finding(
        FindingKind.OUTLIER, f"{name}: {count} left out, far beyond all others: {place}{first}", columns=(name,)
    )
