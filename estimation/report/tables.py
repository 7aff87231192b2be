"""A report's table as data, written as CSV and LaTeX, and cut into slices where it is too wide for a page."""

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from daq.utilities.durable import whole_text, write_text
from daq.utilities.plain_words import visible
from estimation.report.names import tex

CANNOT_TELL = "cannot tell"
_SENTENCES = r"p{0.6\linewidth}"  # LaTeX column whose cells break into lines


@dataclass(frozen=True)
class ReportTable:
    """A table. name: of its files. groups: (label, columns spanned) over `head`, or empty. symbols: the first cell of each row is
    a name of a parameter or signal, shown as a symbol. note: explains the columns. texts: columns of sentences, which may break
    into lines. failed: (row, column) of the cells beyond their limit, marked on the page only. filed: write files too."""

    name: str
    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    groups: tuple[tuple[str, int], ...] = ()
    symbols: bool = True
    note: str = ""
    texts: tuple[int, ...] = ()
    failed: frozenset[tuple[int, int]] = frozenset()
    filed: bool = True

    def write(self, folder: Path) -> None:
        """Write <name>.csv and <name>.tex into `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        with whole_text(folder / f"{self.name}.csv") as file:
            writer = csv.writer(file)
            writer.writerow(self._flat_head())
            writer.writerows([[_no_formula(visible(cell)) for cell in row] for row in self.rows])
        write_text(folder / f"{self.name}.tex", self.latex())

    def _flat_head(self) -> list[str]:
        group_labels = [label for label, span in self.groups for _ in range(span)] or [""] * len(self.head)
        return [f"{a} {h}".strip() for a, h in zip(group_labels, self.head, strict=True)]

    def latex(self) -> str:
        """A booktabs tabular with its caption."""
        lines = [
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{latex_text(self.caption)}}}",
            rf"\label{{tab:{self.name}}}",
        ]
        kinds = "".join(_SENTENCES if i in self.texts else "r" for i in range(1, len(self.head)))
        lines += [rf"\begin{{tabular}}{{l{kinds}}}", r"\toprule"]
        if self.groups:
            lines.append(" & ".join(rf"\multicolumn{{{n}}}{{c}}{{{latex_text(g)}}}" for g, n in self.groups) + r" \\")
        lines += [" & ".join(latex_text(h) for h in self.head) + r" \\", r"\midrule"]
        for row in self.rows:
            first = f"${tex(row[0])}$" if self.symbols else latex_text(row[0])
            lines.append(" & ".join([first, *self._latex_cells(row)]) + r" \\")
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}", ""])

    def _latex_cells(self, row: tuple[str, ...]) -> list[str]:
        """Cells after the first. A group of columns that ends in `cannot tell` shows only these words, because readers of a
        thesis would believe the numbers beside them."""
        cells: list[str] = []
        position = 1
        for _, span in self.groups[1:] or [("", 1)] * (len(row) - 1):
            group = row[position : position + span]
            position += span
            if span > 1 and group and group[-1] == CANNOT_TELL:
                cells.append(rf"\multicolumn{{{span}}}{{c}}{{{CANNOT_TELL}}}")
            else:
                cells += [latex_text(c) for c in group]
        return [*cells, *(latex_text(c) for c in row[position:])]


def _no_formula(cell: str) -> str:
    """A cell that a spreadsheet does not execute: one that begins like a formula gets an apostrophe in front."""
    signed = cell[:1] in ("+", "-") and cell[1:].replace(".", "", 1).replace("e-", "", 1).isdigit()
    return f"'{cell}" if cell[:1] in ("=", "+", "-", "@") and not signed and cell != "-" else cell


_ESCAPES = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "\n": " ", "±": r"$\pm$", "²": "$^2$", "−": "$-$", "–": "--",
    "Δ": r"$\Delta$", "·": r"$\cdot$", "~": r"$\sim$",
    "α": r"$\alpha$", "β": r"$\beta$", "φ": r"$\phi$", "θ": r"$\theta$", "ψ": r"$\psi$",
}  # fmt: skip


def latex_text(text: str) -> str:
    """Text of a cell or of a sentence with the special characters of LaTeX escaped."""
    return "".join(_ESCAPES.get(c, c) for c in visible(text))


def number(value: float | None, digits: int = 4) -> str:
    """Fixed decimals, or two figures where these would show only zeros; empty for None or a value that is not finite."""
    if value is None or not math.isfinite(value):
        return ""
    if digits >= 4 and 0.0 < abs(value) < 20.0 * 10.0**-digits:
        return f"{value:.2g}"
    return _unsigned_zero(f"{value:.{digits}f}")


def significant(value: float | None, digits: int = 3) -> str:
    """Significant figures; empty for None or a value that is not finite."""
    return "" if value is None or not math.isfinite(value) else f"{value:.{digits}g}"


def rounded(value: float, bound: float | None) -> tuple[str, str]:
    """Value and bound as text, both to the second figure of the bound; without one, four figures and ""."""
    if bound is None or not math.isfinite(bound) or bound <= 0.0:
        return f"{value:.4g}", ""
    places = max(0, 1 - math.floor(math.log10(bound)))
    return _unsigned_zero(f"{value:.{places}f}"), f"{bound:.{places}f}"


def _unsigned_zero(text: str) -> str:
    """A number as text, without the sign of a rounded zero."""
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def value_and_bound(value: float | None, bound: float | None) -> list[str]:
    """Two cells: a value and its bound, both rounded to the second figure of the bound; empty where there is no value."""
    return ["", ""] if value is None or not math.isfinite(value) else list(rounded(value, bound))


# A table that is too wide for a page is cut between groups of columns; each slice repeats the first column. Widths are estimated
# from the number of characters in a column, for the widest font of the style sheet (DejaVu Sans).

SHEET = 1124
"""Width of a page's text [CSS pixels]: 1180 minus its margins, as in style.css; fits a window of 1280."""

PORTRAIT = 840
"""A table wider than this [CSS pixels of the screen] is printed in landscape: A4 in portrait has 703, and print is scaled by
0.83."""

# [CSS pixels]: mean width of digits, signs and points in DejaVu Sans at 13.2 px; both margins of a cell
LETTER, MARGIN = 7.6, 14.0
SMALL_LETTER, SMALL_MARGIN = 6.8, 10.0  # the same at 12 px, the class `wide`
SENTENCE = 24  # characters of a column of sentences
SHORT = 16  # rows up to which print does not break a table


@dataclass(frozen=True, slots=True)
class TableSlice:
    """Columns of a table that are shown together. groups: (label, columns spanned); wide: in small font; short: not broken."""

    columns: tuple[int, ...]
    groups: tuple[tuple[str, int], ...]
    wide: bool
    short: bool


def table_width(table: ReportTable, columns: Sequence[int], *, small: bool = False) -> float:
    """Width of some columns of a table [CSS pixels]."""
    letter, margin = (SMALL_LETTER, SMALL_MARGIN) if small else (LETTER, MARGIN)
    return sum(letter * _letters(table, c) + margin for c in columns)


def _letters(table: ReportTable, column: int) -> int:
    longest_word = max((len(word) for word in table.head[column].split()), default=0)
    if column in table.texts:
        return max(longest_word, SENTENCE)
    return max(longest_word, *(len(row[column]) for row in table.rows), 1)


def table_slices(table: ReportTable) -> list[TableSlice]:
    """The table in as few slices as fit the page; without groups it is not cut."""
    columns = tuple(range(len(table.head)))
    groups = _spans(table)
    if table_width(table, columns) <= SHEET or len(groups) < 3:
        return [_slice(table, groups)]
    first, rest = groups[0], groups[1:]
    parts: list[list[tuple[str, tuple[int, ...]]]] = [[]]
    for group in rest:
        columns_together = [c for _, span in (first, *parts[-1], group) for c in span]
        if parts[-1] and table_width(table, columns_together, small=True) > SHEET:
            parts.append([])
        parts[-1].append(group)
    return [_slice(table, [first, *part]) for part in parts]


def _spans(table: ReportTable) -> list[tuple[str, tuple[int, ...]]]:
    """Groups with the columns that they span; one group of all columns where the table has none."""
    if not table.groups:
        return [("", tuple(range(len(table.head))))]
    spans, position = [], 0
    for label, count in table.groups:
        spans.append((label, tuple(range(position, position + count))))
        position += count
    return spans


def _slice(table: ReportTable, groups: Sequence[tuple[str, tuple[int, ...]]]) -> TableSlice:
    columns = tuple(c for _, span in groups for c in span)
    named_groups = tuple((label, len(span)) for label, span in groups) if table.groups else ()
    return TableSlice(columns, named_groups, table_width(table, columns) > SHEET, len(table.rows) <= SHORT)


def word_columns(table: ReportTable) -> frozenset[int]:
    """Columns of words, which are aligned left: no cell begins with a number."""
    return frozenset(
        c
        for c in range(len(table.head))
        if not any(ch.isdigit() for row in table.rows for ch in row[c].strip("+-−(.")[:1])
    ) - _columns_without_text(table)


def _columns_without_text(table: ReportTable) -> frozenset[int]:
    """Columns whose cells are all empty or `cannot tell`."""
    return frozenset(c for c in range(len(table.head)) if {row[c] for row in table.rows} <= {"", CANNOT_TELL})


def cell_label(table: ReportTable, column: int) -> str:
    """The label of a cell on a narrow page, which has no column heads: group and head."""
    group_label = next((g for g, span in _spans(table) if column in span), "")
    return f"{group_label} {table.head[column]}".strip()


def needs_width(tables: Iterable[ReportTable]) -> bool:
    """Whether any table of a page needs to be printed in landscape."""
    return any(table_width(t, p.columns, small=p.wide) > PORTRAIT for t in tables for p in table_slices(t))
