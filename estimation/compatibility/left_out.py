"""What a data-compatibility check leaves out of a flight, and says: repeats of slow and stuck sensors, wild values, channels that
are not measured or never change."""

from estimation.compatibility.records import COLUMNS, shows_motion
from estimation.engine.conditioned import Conditioned, conditioned, repaired
from estimation.models.kinematic import MEASUREMENTS
from groundstation.flight import Array, Flight
from groundstation.flight.findings import Finding, FindingKind

CHECK = "left out"


def measurements(flight: Flight, *, keep_held: bool = False) -> tuple[Flight, tuple[Finding, ...]]:
    """The flight as a check compares it, and what was left out of it.

    Outputs are NaN where they only repeat themselves; inputs, which are integrated, run on straight lines there.
    Raises DataError where time is in another unit.
    """
    inputs = repaired(flight, COLUMNS, keep_held=keep_held)
    outputs = conditioned(inputs.flight, MEASUREMENTS, keep_held=keep_held)
    notes = [*inputs.notes, *outputs.notes]
    columns = {}
    for name in MEASUREMENTS:
        if not shows_motion(outputs.flight, name):
            notes.append(_not_compared(flight, name))
            continue
        columns[name], said = _compared(outputs, name)
        notes += said
    return outputs.flight.with_columns(**columns), tuple(notes)


def _compared(told: Conditioned, name: str) -> tuple[Array, list[Finding]]:
    values, said = told.compared(name)
    return values, [
        n for n in said if n.kind is not FindingKind.NOT_MEASURED
    ]  # gaps of a channel are the quality report's


def _not_compared(flight: Flight, name: str) -> Finding:
    if flight.measured(name):
        return Finding(FindingKind.STUCK, f"{name} is constant: not compared", columns=(name,))
    return Finding(FindingKind.NOT_MEASURED, f"{name} not measured: not compared", columns=(name,))


def left_out_findings(notes: tuple[Finding, ...]) -> tuple[Finding, ...]:
    """One entry of the quality report for each thing left out."""
    return tuple(Finding(CHECK, n.text, "ok" if n.kind is FindingKind.NOT_MEASURED else "warn") for n in notes)
