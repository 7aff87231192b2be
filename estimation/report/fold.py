"""Where a table is too wide for a sheet: it is cut between groups of columns, and each piece repeats the first column.

Widths are counted from the characters of a column, for the widest of the fonts that the style sheet names (DejaVu Sans).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from estimation.report.tables import CANNOT_TELL, ReportTable

SHEET = 1124
"""Width of a page's text [CSS pixels]: 1180 less its margins, as in style.css; fits a window of 1280."""

PORTRAIT = 840
"""A table wider than this [CSS pixels of the screen] is printed on a sheet laid across: A4 upright has 703 of them, and print
is set 0.83 times as large."""

LETTER, MARGIN = (
    7.6,
    14.0,
)  # a letter of DejaVu Sans at 13.2 px, digits, signs and points together; both margins of a cell
SMALL_LETTER, SMALL_MARGIN = 6.8, 10.0  # at 12 px, the class `wide`
SENTENCE = 24  # characters that a column of sentences is given
SHORT = 16  # rows of a table that a printed page keeps in one piece


@dataclass(frozen=True, slots=True)
class TableSlice:
    """Columns of a table that go beside each other. groups: (label, columns spanned); wide: to be set small."""

    columns: tuple[int, ...]
    groups: tuple[tuple[str, int], ...]
    wide: bool
    short: bool


def width(table: ReportTable, columns: Sequence[int], *, small: bool = False) -> float:
    """Width of some columns of a table [CSS pixels]."""
    letter, margin = (SMALL_LETTER, SMALL_MARGIN) if small else (LETTER, MARGIN)
    return sum(letter * _letters(table, c) + margin for c in columns)


def _letters(table: ReportTable, column: int) -> int:
    longest_word = max((len(word) for word in table.head[column].split()), default=0)
    if column in table.texts:
        return max(longest_word, SENTENCE)
    return max(longest_word, *(len(row[column]) for row in table.rows), 1)


def pieces(table: ReportTable) -> list[TableSlice]:
    """The table in as few pieces as fit the sheet; one that has no groups stays whole."""
    columns = tuple(range(len(table.head)))
    groups = _spans(table)
    if width(table, columns) <= SHEET or len(groups) < 3:
        return [_piece(table, groups)]
    first, rest = groups[0], groups[1:]
    found: list[list[tuple[str, tuple[int, ...]]]] = [[]]
    for group in rest:
        together = [c for _, span in (first, *found[-1], group) for c in span]
        if found[-1] and width(table, together, small=True) > SHEET:
            found.append([])
        found[-1].append(group)
    return [_piece(table, [first, *part]) for part in found]


def _spans(table: ReportTable) -> list[tuple[str, tuple[int, ...]]]:
    """Groups with the columns that they span; all in one without groups."""
    if not table.groups:
        return [("", tuple(range(len(table.head))))]
    found, at = [], 0
    for label, count in table.groups:
        found.append((label, tuple(range(at, at + count))))
        at += count
    return found


def _piece(table: ReportTable, groups: Sequence[tuple[str, tuple[int, ...]]]) -> TableSlice:
    columns = tuple(c for _, span in groups for c in span)
    named = tuple((label, len(span)) for label, span in groups) if table.groups else ()
    return TableSlice(columns, named, width(table, columns) > SHEET, len(table.rows) <= SHORT)


def words(table: ReportTable) -> frozenset[int]:
    """Columns that hold no number: they are read from the left."""
    return frozenset(
        c
        for c in range(len(table.head))
        if not any(ch.isdigit() for row in table.rows for ch in row[c].strip("+-−(.")[:1])
    ) - _without_words(table)


def _without_words(table: ReportTable) -> frozenset[int]:
    """Columns that are empty, or say of a number that it cannot be told."""
    return frozenset(c for c in range(len(table.head)) if {row[c] for row in table.rows} <= {"", CANNOT_TELL})


def label(table: ReportTable, column: int) -> str:
    """What a cell is called where the head of its table is not in sight: group and head."""
    above = next((g for g, span in _spans(table) if column in span), "")
    return f"{above} {table.head[column]}".strip()


def needs_width(tables: Iterable[ReportTable]) -> bool:
    """Whether any of the tables of a page is better printed across."""
    return any(width(t, p.columns, small=p.wide) > PORTRAIT for t in tables for p in pieces(t))
