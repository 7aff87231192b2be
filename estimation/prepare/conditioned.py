"""Which samples of a flight are measurements: wild values removed, repeats of slow and of stuck sensors marked.

A note names each column of which something is left out; `keep_held` keeps repeated values.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimation.prepare.plausible import TURNING_ANGLES, refuse_other_time_unit, wild_values
from groundstation.flight import Array, Flight
from groundstation.flight.findings import Finding, FindingKind
from groundstation.flight.quality.repeats import RepeatedValues, repeats

Mask = NDArray[np.bool_]

KEEP = "--keep-held keeps them"
INTEGRATED = ("ax", "ay", "az", "p", "q", "r")
"""Columns that a reconstruction integrates between fixes."""
NOT_SLOWER = 0.9
"""Of the flight's sample rate: a column logged faster than this is as fast as the samples."""


@dataclass(frozen=True)
class ConditionedFlight:
    """flight: without wild values. repeats: column -> its repeated values; empty where they are kept. notes: on wild values.
    drawn: column -> (N,) samples that an import put on straight lines between two samples of a slower sensor."""

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
        """(N,) samples without a measurement of their own: repeats of a slow sensor, and those drawn between two of its
        samples."""
        return self.held(column) | self.drawn[column] if column in self.drawn else self.held(column)

    def fresh(self, column: str) -> Mask:
        """(N,) samples at which a column has a measurement of its own."""
        return np.isfinite(self.flight[column]) & ~self.copies(column)

    def as_output(self, column: str) -> tuple[Array, list[Finding]]:
        """(N,) the column as an output, NaN without a measurement; and a note for each reason for which samples are left out."""
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
        """A note where the column's sensor is slow, else none."""
        if column not in self.repeats or not self.repeats[column].slow:
            return []
        text = (
            f"{column} is slower than the samples: new values come at {self.repeats[column].rate:.3g} Hz, "
            f"{int(self.held(column).sum())} of {len(self.flight)} samples repeat the last: {consequence}; {KEEP}"
        )
        return [Finding(FindingKind.HELD, text, columns=(column,))]

    def stuck_notes(self, column: str, consequence: str) -> list[Finding]:
        """A note where the column's sensor is stuck, else none."""
        stuck = self.stuck(column)
        if not stuck.any():
            return []
        text = (
            f"{column} repeats one value for {int(stuck.sum())} samples from t = {self.flight.time[stuck][0]:g} s on, while "
            f"its noise or the other channels say that it must have moved: {consequence}"
        )
        return [Finding(FindingKind.STUCK, text, columns=(column,))]


def condition_columns(flight: Flight, columns: Iterable[str], *, keep_held: bool = False) -> ConditionedFlight:
    """The flight with its named columns conditioned, as far as they are measured. keep_held: repeated values count as
    measurements.

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
        if name in TURNING_ANGLES:
            unwrapped = _unwrapped(changed.get(name, flight[name]), flight.segments)
            if unwrapped is not None:
                changed[name] = unwrapped
    if changed:
        flight = flight.with_columns(**changed)
    if keep_held:
        return ConditionedFlight(flight, {}, tuple(notes))
    return ConditionedFlight(flight, {n: repeats(flight, n) for n in names}, tuple(notes), drawn_between(flight, names))


def _unwrapped(angle: Array, segments: Iterable[slice]) -> Array | None:
    """The angle (N,) [rad] without jumps of a full turn within a segment; None where it has none."""
    unwrapped = angle.copy()
    for part in segments:
        known = np.flatnonzero(np.isfinite(angle[part])) + part.start
        unwrapped[known] = np.unwrap(angle[known])
    return None if np.array_equal(unwrapped, angle, equal_nan=True) else unwrapped


def repair_columns(flight: Flight, columns: Iterable[str], *, keep_held: bool = False) -> ConditionedFlight:
    """The flight for a method that reads its columns itself: wild values and repeats of slow sensors replaced by straight lines
    between their neighbours, samples of stuck sensors NaN; with notes."""
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
    """Column -> (N,) samples that an import interpolated, of each column that was logged more slowly than the flight is sampled.

    In each logging interval one sample counts as logged: the one at which the straight lines meet, where the second differences
    of all columns of that rate are largest. A reconstructed column was logged as often as the gyros and accelerometers that it
    was integrated from. So the information of a log does not depend on the grid of its import.
    """
    by_rate: dict[float, list[str]] = {}
    for column in columns:
        if flight.held(column) is not None:  # a command: it holds, and nothing is drawn between its records
            continue
        native_rates = [flight.native_rate(c) for c in (INTEGRATED if column in flight.reconstructed else (column,))]
        rate = min((r for r in native_rates if r is not None), default=None)
        if rate is not None and rate < NOT_SLOWER / flight.sample_interval:
            by_rate.setdefault(round(rate, 1), []).append(column)
    masks = {rate: _drawn_at_rate(flight, names, rate) for rate, names in by_rate.items()}
    return {name: masks[rate] for rate, names in by_rate.items() for name in names}


def _drawn_at_rate(flight: Flight, columns: Sequence[str], rate: float) -> Mask:
    """(N,) interpolated samples of columns that were logged at `rate` [Hz]."""
    bend = np.zeros(len(flight))
    for column in columns:
        if column not in flight.reconstructed:
            second = np.nan_to_num(np.abs(np.diff(flight[column], 2)))
            bend[1:-1] += second / max(float(second.mean()), 1e-300)
    interval = np.floor((flight.time - flight.time[0]) * rate + 1e-6).astype(np.int64)  # 1e-6: rounding of the times
    order = np.lexsort((-bend, interval))
    first = np.concatenate([[True], np.diff(interval[order]) > 0])
    drawn = np.ones(len(flight), bool)
    drawn[order[first]] = False
    return drawn


def _wild_note(flight: Flight, name: str, rows: NDArray[np.intp]) -> Finding:
    count, first = (f"{rows.size} wild values", " first") if rows.size > 1 else ("a wild value", "")
    place = f"{flight[name][rows[0]]:.3g} at t = {flight.time[rows[0]]:g} s"
    return Finding(
        FindingKind.OUTLIER, f"{name}: {count} left out, far beyond all others: {place}{first}", columns=(name,)
    )
