"""Findings on a flight's data, from import to report: one type for notes, suspected mistakes and checks.

Flight files and JSON store a note as its sentence; a flight file also stores kinds and columns, under `facts`.
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
    """The subject of a note; a check of the quality report has its name as kind instead."""

    OTHER = "other"
    TIME_ORDER = "time order"  # rows were unsorted, repeated or without a time
    GAP = "gap"  # time is missing
    UNKNOWN_COLUMNS = "unknown columns"  # of the flight that are not in the channel table
    NOT_MEASURED = "not measured"  # wholly or in part
    LEFT_OUT = "left out"  # samples or channels that a fit does not use
    STUCK = "stuck"  # a sensor that repeats one value
    HELD = "held"  # a sensor slower than the samples, whose last value is repeated
    OUTLIER = "outlier"  # values that no motion explains
    DERIVED = "derived"  # a column calculated from others
    UNLIKELY = "unlikely"  # values that look like another unit, sign or axis


@dataclass(frozen=True, slots=True)
class Finding:
    """kind: a FindingKind or the name of a check; text: the fact, its time, and what to do; columns: those of the flight that it
    concerns; labels: their names in the file that was read, where these differ."""

    kind: str
    text: str
    severity: Severity = "note"
    columns: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.text

    def to_json(self) -> dict[str, str]:
        """An entry of `quality` in the JSON of `sideslip check`."""
        return {"check": self.kind, "verdict": self.severity, "text": self.text}


def as_finding(note: Finding | str) -> Finding:
    """A sentence as a finding of kind OTHER; a finding unchanged."""
    return note if isinstance(note, Finding) else Finding(FindingKind.OTHER, note)


def finding_texts(findings: Iterable[Finding]) -> list[str]:
    """The sentences alone, for JSON."""
    return [finding.text for finding in findings]


def worst(findings: Iterable[Finding]) -> Severity:
    """The worst severity among them."""
    return max((finding.severity for finding in findings), key=_SEVERITIES.index, default="ok")


def without_repeats(notes: Iterable[Finding | str]) -> tuple[Finding, ...]:
    """One finding for each sentence, in order; the last of equal ones, since only newer ones may have a kind."""
    return tuple({finding.text: finding for finding in map(as_finding, notes)}.values())


def unknown_columns(labels: Mapping[str, str]) -> Finding:
    """The finding on columns that are not in the channel table. labels: column of the flight -> its name in the file."""
    names = ", ".join(column if column == label else f"{label} as {column}" for column, label in labels.items())
    text = f"columns not known to Sideslip, kept as they are: {names}"
    return Finding(FindingKind.UNKNOWN_COLUMNS, text, columns=tuple(labels), labels=tuple(labels.values()))


def to_meta(findings: Iterable[Finding]) -> dict[str, Any]:
    """Findings as metadata of a flight file, without severities; the inverse of `from_meta`."""
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
    """Findings of a flight file's metadata. An unknown kind, of a newer file, becomes OTHER."""
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
