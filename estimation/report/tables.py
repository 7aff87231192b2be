"""A table as data: the same rows become HTML in the page, CSV and LaTeX beside it."""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

from daq.contract.durable import whole_text, write_text
from daq.contract.plain_words import visible
from estimation.report.names import tex

CANNOT_TELL = "cannot tell"


@dataclass(frozen=True)
class ReportTable:
    """name: of its files. groups: (label, columns spanned) over `head`, or empty. The first cell of a row is a parameter
    or signal name where `symbols`. note: what the reader must know of the columns. texts: columns of sentences, which may
    break. failed: (row, column) of the cells that are beyond their limit; marked on the page alone. filed: whether it is also
    written beside the page."""

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
        """<name>.csv and <name>.tex in `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        with whole_text(folder / f"{self.name}.csv") as file:
            writer = csv.writer(file)
            writer.writerow(self._flat_head())
            writer.writerows([[_no_formula(visible(cell)) for cell in row] for row in self.rows])
        write_text(folder / f"{self.name}.tex", self.latex())

    def _flat_head(self) -> list[str]:
        above = [label for label, span in self.groups for _ in range(span)] or [""] * len(self.head)
        return [f"{a} {h}".strip() for a, h in zip(above, self.head, strict=True)]

    def latex(self) -> str:
        """A booktabs tabular with its caption."""
        lines = [r"\begin{table}", r"\centering", rf"\caption{{{_plain(self.caption)}}}", rf"\label{{tab:{self.name}}}"]
        lines += [rf"\begin{{tabular}}{{l{'r' * (len(self.head) - 1)}}}", r"\toprule"]
        if self.groups:
            lines.append(" & ".join(rf"\multicolumn{{{n}}}{{c}}{{{_plain(g)}}}" for g, n in self.groups) + r" \\")
        lines += [" & ".join(_plain(h) for h in self.head) + r" \\", r"\midrule"]
        for row in self.rows:
            first = f"${tex(row[0])}$" if self.symbols else _plain(row[0])
            lines.append(" & ".join([first, *self._latex_cells(row)]) + r" \\")
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}", ""])

    def _latex_cells(self, row: tuple[str, ...]) -> list[str]:
        """Cells after the first. A group of columns that ends in `cannot tell` says only that: a number printed in a thesis is
        believed, whatever stands beside it."""
        cells: list[str] = []
        at = 1
        for _, span in self.groups[1:] or [("", 1)] * (len(row) - 1):
            group = row[at : at + span]
            at += span
            if span > 1 and group and group[-1] == CANNOT_TELL:
                cells.append(rf"\multicolumn{{{span}}}{{c}}{{{CANNOT_TELL}}}")
            else:
                cells += [_plain(c) for c in group]
        return [*cells, *(_plain(c) for c in row[at:])]


def _no_formula(cell: str) -> str:
    """A cell that a spreadsheet takes for text or a number, never for a formula: one that begins like a formula gets a mark."""
    signed = cell[:1] in ("+", "-") and cell[1:].replace(".", "", 1).replace("e-", "", 1).isdigit()
    return f"'{cell}" if cell[:1] in ("=", "+", "-", "@") and not signed and cell != "-" else cell


_ESCAPES = {c: f"\\{c}" for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}", "±": r"$\pm$", "²": "$^2$", "−": "$-$", "–": "--",
    "Δ": r"$\Delta$", "·": r"$\cdot$", "~": r"$\sim$",
    "α": r"$\alpha$", "β": r"$\beta$", "φ": r"$\phi$", "θ": r"$\theta$", "ψ": r"$\psi$",
}  # fmt: skip


def _plain(text: str) -> str:
    return "".join(_ESCAPES.get(c, c) for c in visible(text))


def number(value: float | None, digits: int = 4) -> str:
    """Fixed decimals, or two figures where those would show none; empty for a value that is not there or not finite."""
    if value is None or value - value != 0.0:
        return ""
    if digits >= 4 and 0.0 < abs(value) < 20.0 * 10.0**-digits:
        return f"{value:.2g}"
    return _unsigned_zero(f"{value:.{digits}f}")


def significant(value: float | None, digits: int = 3) -> str:
    """Significant figures, empty for a value that is not there or not finite."""
    return "" if value is None or value - value != 0.0 else f"{value:.{digits}g}"


def rounded(value: float, bound: float | None) -> tuple[str, str]:
    """Value and bound as text, both to the second figure of the bound; without one, four figures and ""."""
    if bound is None or not math.isfinite(bound) or bound <= 0.0:
        return f"{value:.4g}", ""
    places = max(0, 1 - math.floor(math.log10(bound)))
    return _unsigned_zero(f"{value:.{places}f}"), f"{bound:.{places}f}"


def _unsigned_zero(text: str) -> str:
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def pair(value: float | None, bound: float | None) -> list[str]:
    """Two cells: a value and its bound, both to the second figure of the bound; empty where they are not there."""
    return ["", ""] if value is None or not math.isfinite(value) else list(rounded(value, bound))
