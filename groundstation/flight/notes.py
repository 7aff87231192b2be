"""What a person should know of a flight's data: a sentence, and what kind of fact it states, so that nobody reads sentences.

In a flight file and in every JSON a note is its sentence; a file keeps kinds beside them, under `facts`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from daq.contract.plain_words import one_line
from daq.contract.recordings.flight_rows import as_mapping, as_texts


class NoteKind(Enum):
    """What a note states."""

    OTHER = "other"
    TIME_ORDER = "time order"  # rows were unsorted, repeated or without a time
    GAP = "gap"  # time is missing
    UNKNOWN_COLUMNS = "unknown columns"  # kept, though no table here names them
    NOT_MEASURED = "not measured"  # wholly or in part
    LEFT_OUT = "left out"  # samples or channels that a fit does not see
    STUCK = "stuck"  # a sensor that repeats one value
    HELD = "held"  # a sensor slower than the samples, whose last value is repeated
    OUTLIER = "outlier"  # values that no motion makes
    DERIVED = "derived"  # a column made from others
    UNLIKELY = "unlikely"  # values that look like another unit


@dataclass(frozen=True, slots=True)
class Note:
    """columns: those of the flight that it is about, each with what its file calls it."""

    kind: NoteKind
    text: str
    columns: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        return self.text


def as_note(said: Note | str) -> Note:
    """A sentence of no particular kind, or a note as it is."""
    return said if isinstance(said, Note) else Note(NoteKind.OTHER, said)


def texts(notes: Iterable[Note]) -> list[str]:
    """The sentences, as JSON has them."""
    return [n.text for n in notes]


def once(notes: Iterable[Note | str]) -> tuple[Note, ...]:
    """Every sentence once, in order; of those that say the same the newest, for an older file may not know its kind."""
    return tuple({n.text: n for n in map(as_note, notes)}.values())


def unknown_columns(labels: Mapping[str, str]) -> Note:
    """Columns that no table here names. labels: column of the flight -> what its file calls it."""
    said = ", ".join(column if column == label else f"{label} as {column}" for column, label in labels.items())
    return Note(
        NoteKind.UNKNOWN_COLUMNS, f"columns not known to Sideslip, kept as they are: {said}", tuple(labels.items())
    )


def to_meta(notes: Iterable[Note]) -> dict[str, Any]:
    """Notes as a flight file keeps them; `from_meta` gives the same notes."""
    kept = tuple(notes)
    facts = [
        {"note": i, "kind": n.kind.value, "columns": [list(c) for c in n.columns]}
        for i, n in enumerate(kept)
        if n.kind is not NoteKind.OTHER
    ]
    return {"notes": texts(kept), **({"facts": facts} if facts else {})}


def from_meta(meta: Mapping[str, Any]) -> list[Note]:
    """Notes of a flight file. A kind that is not known here, of a newer file, is `OTHER`."""
    notes = [Note(NoteKind.OTHER, one_line(text)) for text in as_texts(meta.get("notes"))]
    known = {k.value: k for k in NoteKind}
    facts = meta.get("facts")
    for fact in map(as_mapping, facts if isinstance(facts, list) else ()):
        index = fact.get("note")
        pairs = [as_texts(pair) for pair in fact.get("columns") or () if isinstance(pair, list)]
        if isinstance(index, int) and 0 <= index < len(notes):
            columns = tuple((pair[0], pair[1]) for pair in pairs if len(pair) == 2)
            notes[index] = Note(known.get(str(fact.get("kind")), NoteKind.OTHER), notes[index].text, columns)
    return notes
