"""What a data-compatibility check leaves out of a flight, and says: repeats of slow and stuck sensors, wild values, channels that
are not measured or never change."""

from estimation.compatibility.records import COLUMNS, shows_motion
from estimation.models.kinematic import MEASUREMENTS
from estimation.prepare.conditioned import ConditionedFlight, condition, repair
from groundstation.flight import Array, Flight
from groundstation.flight.notes import Note, NoteKind
from groundstation.flight.quality.report import Finding

CHECK = "left out"


def measurements(flight: Flight, *, keep_held: bool = False) -> tuple[Flight, tuple[Note, ...]]:
    """The flight as a check compares it, and what was left out of it.

    Outputs are NaN where they only repeat themselves; inputs, which are integrated, run on straight lines there.
    Raises DataError where time is in another unit.
    """
    inputs = repair(flight, COLUMNS, keep_held=keep_held)
    outputs = condition(inputs.flight, MEASUREMENTS, keep_held=keep_held)
    notes = [*inputs.notes, *outputs.notes]
    columns = {}
    for name in MEASUREMENTS:
        if not shows_motion(outputs.flight, name):
            notes.append(_not_compared(flight, name))
            continue
        columns[name], said = _compared(outputs, name)
        notes += said
    return outputs.flight.with_columns(**columns), tuple(notes)


def _compared(told: ConditionedFlight, name: str) -> tuple[Array, list[Note]]:
    values, said = told.as_output(name)
    return values, [
        n for n in said if n.kind is not NoteKind.NOT_MEASURED
    ]  # gaps of a channel are the quality report's


def _not_compared(flight: Flight, name: str) -> Note:
    if flight.measured(name):
        return Note(NoteKind.STUCK, f"{name} is constant: not compared", ((name, name),))
    return Note(NoteKind.NOT_MEASURED, f"{name} not measured: not compared", ((name, name),))


def left_out_findings(notes: tuple[Note, ...]) -> tuple[Finding, ...]:
    """One entry of the quality report for each thing left out."""
    return tuple(Finding(CHECK, "ok" if n.kind is NoteKind.NOT_MEASURED else "warn", n.text) for n in notes)
