"""What of a flight's columns is a measurement: wild values taken out, repeats of slow and of stuck sensors marked.

Everything left out is said in a note that names the column, and can be kept (`keep_held`).
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.engine.plausible import refuse_other_time_unit, wild
from groundstation.flight import Flight
from groundstation.flight.findings import Finding, FindingKind
from groundstation.flight.quality.repeats import RepeatedValues, repeats

KEEP = "--keep-held keeps them"


@dataclass(frozen=True)
class Conditioned:
    """flight: without wild values. found: column -> its repeated values; empty where they are kept. notes: on wild values and
    on what stands still with everything else. between: column -> (N,) samples that an import drew on straight lines between two
    of a slower sensor."""

    flight: Flight
    found: Mapping[str, RepeatedValues]
    notes: tuple[Finding, ...]
    between: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)

    def fresh(self, column: str) -> NDArray[np.bool_]:
        """(N,) samples at which a column shows a measurement: no repeat of a slow sensor, nothing drawn between two samples."""
        told = np.isfinite(self.flight[column])
        if column in self.between:
            told = told & ~self.between[column]
        return told & ~self.found[column].held if column in self.found else told

    def stuck(self, column: str) -> NDArray[np.bool_]:
        """(N,) samples at which a column's sensor is stuck."""
        return self.found[column].stuck if column in self.found else np.zeros(len(self.flight), bool)

    def compared(self, column: str) -> tuple[Array, list[Finding]]:
        """The column as an output: NaN where it shows no measurement; and what was left out, one note a reason."""
        values, notes = self.flight[column].copy(), []
        missing = int((~np.isfinite(values)).sum())
        if missing:
            text = f"{column} not measured at {missing} samples: not compared there"
            notes.append(Finding(FindingKind.NOT_MEASURED, text, columns=(column,)))
        notes += self.of_slow(column, "repeats are not compared")
        if column in self.between:
            count = int((np.isfinite(values) & ~self.between[column]).sum())
            text = f"{column} was logged more slowly: compared at {count} samples of its own, not at those drawn between them"
            notes.append(Finding(FindingKind.HELD, text, columns=(column,)))
        notes += self.of_stuck(column, f"not compared there; {KEEP}")
        values[~self.fresh(column) | self.stuck(column)] = np.nan
        return values, notes

    def of_slow(self, column: str, what: str) -> list[Finding]:
        """The note on a slow sensor, if it is one."""
        if column not in self.found or not self.found[column].slow:
            return []
        held = int(self.found[column].held.sum())
        text = (
            f"{column} is slower than the samples: new values come at {self.found[column].rate:.3g} Hz, {held} of "
            f"{len(self.flight)} samples repeat the last: {what}; {KEEP}"
        )
        return [Finding(FindingKind.HELD, text, columns=(column,))]

    def of_stuck(self, column: str, what: str) -> list[Finding]:
        """The note on a stuck sensor, if it is one."""
        still = self.stuck(column)
        if not still.any():
            return []
        text = (
            f"{column} repeats one value for {int(still.sum())} samples from t = {self.flight.time[still][0]:g} s on, while "
            f"its noise or the other channels say that it must have moved: {what}"
        )
        return [Finding(FindingKind.STUCK, text, columns=(column,))]


def conditioned(flight: Flight, columns: Iterable[str], *, keep_held: bool = False) -> Conditioned:
    """Look at the named columns (those that are measured). keep_held: repeated values are taken for measurements.

    Raises DataError where time is in another unit.
    """
    refuse_other_time_unit(flight)
    names = [c for c in dict.fromkeys(columns) if flight.measured(c)]
    notes, changed = [], {}
    for name in names:
        off = wild(flight[name])
        if off.any():
            changed[name] = np.where(off, np.nan, flight[name])
            notes.append(_wild_note(flight, name, off))
    if changed:
        flight = flight.with_columns(**changed)
    found = {} if keep_held else {name: repeats(flight, name) for name in names}
    drawn = {} if keep_held else drawn_between(flight, names)
    return Conditioned(flight, found, tuple(notes), drawn)


INTEGRATED = ("ax", "ay", "az", "p", "q", "r")
"""What a reconstruction integrates between fixes."""
NOT_SLOWER = 0.9
"""Of the flight's rate: a column logged at more than this is as fast as the samples."""


def drawn_between(flight: Flight, columns: Iterable[str]) -> dict[str, NDArray[np.bool_]]:
    """Column -> (N,) samples that its import drew between those that were logged, of columns logged more slowly than the flight
    samples.

    One sample stands for each that was logged, in each of its intervals the one at which the straight lines meet: there the
    second differences of all columns of that rate are largest. A column that was reconstructed has a value for each sample of the
    gyros and accelerometers it was integrated from. So a log has the information it has, on whatever grid.
    """
    together: dict[float, list[str]] = {}
    sensed = [c for c in columns if flight.held(c) is None]  # a command holds: nothing is drawn between its records
    for column in sensed:
        stated = [flight.native_rate(c) for c in (INTEGRATED if column in flight.reconstructed else (column,))]
        rate = min((r for r in stated if r is not None), default=None)
        if rate is not None and rate < NOT_SLOWER / flight.sample_interval:
            together.setdefault(round(rate, 1), []).append(column)
    return {name: mask for rate, names in together.items() for mask in (_drawn(flight, names, rate),) for name in names}


def _drawn(flight: Flight, columns: Sequence[str], rate: float) -> NDArray[np.bool_]:
    bend = np.zeros(len(flight))
    for column in columns:
        if column not in flight.reconstructed:
            second = np.nan_to_num(np.abs(np.diff(flight[column], 2)))
            bend[1:-1] += second / max(float(second.mean()), 1e-300)
    interval = np.floor((flight.time - flight.time[0]) * rate + 1e-6).astype(np.int64)
    order = np.lexsort((-bend, interval))
    first = np.concatenate([[True], np.diff(interval[order]) > 0])
    drawn = np.ones(len(flight), bool)
    drawn[order[first]] = False
    return drawn


def repaired(flight: Flight, columns: Iterable[str], *, keep_held: bool = False) -> Conditioned:
    """The flight for a method that reads its columns itself: wild values and repeats of slow sensors on straight lines between
    their neighbours, samples of stuck sensors NaN; all said in the notes."""
    told = conditioned(flight, columns, keep_held=keep_held)
    notes, changed = list(told.notes), {}
    for name in dict.fromkeys(columns):
        if not told.flight.measured(name):
            continue
        measured = told.fresh(name) & ~told.stuck(name)
        between = (~np.isfinite(told.flight[name]) & np.isfinite(flight[name])) | (
            told.found[name].held if name in told.found else False
        )
        if not measured.any() or not (between.any() or told.stuck(name).any()):
            continue
        values = np.where(measured, told.flight[name], np.nan)
        values[between] = np.interp(flight.time[between], flight.time[measured], values[measured])
        changed[name] = values
        notes += told.of_slow(name, "taken on straight lines between new values")
        notes += told.of_stuck(name, f"left out there; {KEEP}")
    return Conditioned(told.flight.with_columns(**changed), told.found, tuple(notes), told.between)


def _wild_note(flight: Flight, name: str, off: NDArray[np.bool_]) -> Finding:
    at = np.flatnonzero(off)
    count = f"{at.size} wild values" if at.size > 1 else "a wild value"
    text = (
        f"{name}: {count} left out, far beyond all others: {flight[name][at[0]]:.3g} at t = {flight.time[at[0]]:g} s"
        + (" first" if at.size > 1 else "")
    )
    return Finding(FindingKind.OUTLIER, text, columns=(name,))
