"""What a person should know of a flight's data, from its import to its report: one type for notes, suspicions and checks.

In a flight file and in every JSON a note is its sentence; a file keeps kinds and columns beside them, under `facts`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Literal

from daq.contract.recordings.flight_rows import as_mapping, as_texts
from daq.utilities.plain_words import one_line

Severity = Literal["ok", "note", "warn", "fail"]
_SEVERITIES: tuple[Severity, ...] = ("ok", "note", "warn", "fail")


class FindingKind(StrEnum):
    """What a note states; a check of the quality report has its own name instead."""

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
class Finding:
    """kind: a FindingKind or the name of a check; text: what was found, where in time, and what to do.

    columns: those of the flight that it is about; labels: what their file calls them, where that is another name.
    """

    kind: str
    text: str
    severity: Severity = "note"
    columns: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.text

    def to_json(self) -> dict[str, str]:
        """As in the JSON of `sideslip check`."""
        return {"check": self.kind, "verdict": self.severity, "text": self.text}


def as_finding(note: Finding | str) -> Finding:
    """A sentence of no particular kind, or a finding as it is."""
    return note if isinstance(note, Finding) else Finding(FindingKind.OTHER, note)


def finding_texts(findings: Iterable[Finding]) -> list[str]:
    """The sentences, as JSON has them."""
    return [finding.text for finding in findings]


def worst(findings: Iterable[Finding]) -> Severity:
    """The worst severity among them."""
    return max((finding.severity for finding in findings), key=_SEVERITIES.index, default="ok")


def without_repeats(notes: Iterable[Finding | str]) -> tuple[Finding, ...]:
    """Every sentence once, in order; of those that say the same the newest, for an older file may not know its kind."""
    return tuple({finding.text: finding for finding in map(as_finding, notes)}.values())


def unknown_columns(labels: Mapping[str, str]) -> Finding:
    """Columns that no table here names. labels: column of the flight -> what its file calls it."""
    names = ", ".join(column if column == label else f"{label} as {column}" for column, label in labels.items())
    text = f"columns not known to Sideslip, kept as they are: {names}"
    return Finding(FindingKind.UNKNOWN_COLUMNS, text, columns=tuple(labels), labels=tuple(labels.values()))


def to_meta(findings: Iterable[Finding]) -> dict[str, Any]:
    """Findings as a flight file keeps them; `from_meta` gives the same ones."""
    notes = tuple(findings)
    facts = [
        {
            "note": i,
            "kind": str(n.kind),
            "columns": [list(c) for c in zip(n.columns, n.labels or n.columns, strict=True)],
        }
        for i, n in enumerate(notes)
        if n.kind != FindingKind.OTHER
    ]
    return {"notes": finding_texts(notes), **({"facts": facts} if facts else {})}


def from_meta(meta: Mapping[str, Any]) -> list[Finding]:
    """Findings of a flight file. A kind that is not known here, of a newer file, is `OTHER`."""
    notes = [as_finding(one_line(text)) for text in as_texts(meta.get("notes"))]
    known_kinds = {kind.value: kind for kind in FindingKind}
    facts = meta.get("facts")
    for fact in map(as_mapping, facts if isinstance(facts, list) else ()):
        index = fact.get("note")
        pairs = [as_texts(pair) for pair in fact.get("columns") or () if isinstance(pair, list)]
        if isinstance(index, int) and 0 <= index < len(notes):
            kind = known_kinds.get(str(fact.get("kind")), FindingKind.OTHER)
            columns, labels = (tuple(pair[i] for pair in pairs if len(pair) == 2) for i in (0, 1))
            notes[index] = Finding(kind, notes[index].text, columns=columns, labels=() if labels == columns else labels)
    return notes
