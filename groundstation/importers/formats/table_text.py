"""A table as text: lines, cells, delimiters, the line with the column names, and lines that are no rows."""

import codecs
import csv
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from daq.utilities.input_files import read_bytes
from groundstation.flight.arrays import Array
from groundstation.importers.errors import ImportDataError
from groundstation.importers.mapping import FileFormat
from groundstation.importers.units import find_unit

DELIMITERS = (";", "\t", "|", ",")
"""Delimiters of cells; first those that rarely have another meaning."""
_UNIFORM_ROWS = 4  # below the column names, that must have as many cells
LONGEST_PREAMBLE = 200  # lines above the column names
_DECIMAL_ROWS = 50  # in which a decimal comma is searched
LONGEST_END = 20  # lines below the last row of a table that are left out
EMPTY = {"", "nan", "na", "n/a", "null", "none", "-", "--"}
_DECIMAL_COMMA = re.compile(r"^\s*[-+]?\d*,\d+(e[-+]?\d+)?\s*$", re.IGNORECASE)
_DECIMAL_POINT = re.compile(r"^\s*[-+]?\d*\.\d+(e[-+]?\d+)?\s*$", re.IGNORECASE)
_BLANK_LINES = re.compile(r"^(?:[^\S\n]*+(?:#[^\n]*+)?\n)++", re.MULTILINE)
"""Consecutive lines that are empty or hold only a comment."""
_LINE = re.compile(r"[^\n]+")


def text_of(path: Path) -> str:
    """The text of a file without comments: UTF-8 or UTF-16 with or without a byte order mark, else Latin-1. A comment with the
    column names (numpy's savetxt) stays, without its #."""
    text = _decoded(path).replace("\r\n", "\n").replace("\r", "\n") + "\n"
    first = _BLANK_LINES.match(text)
    names = _names_in_comment(first[0], text[first.end() :]) if first else ""
    return names + _BLANK_LINES.sub("", text)


def _names_in_comment(comments: str, rest: str) -> str:
    """The last comment above a table without column names, where it has as many words as a row has numbers; else empty."""
    lines = [line.strip().lstrip("#").strip() for line in comments.splitlines() if line.strip()]
    row = next(lines_of(rest), "")
    if not lines or not row:
        return ""
    delimiter = delimiter_of(row)
    names, cells = (next(cells_of([line], delimiter), []) for line in (lines[-1], row))
    if len(names) != len(cells) or len(names) < 2 or numbers_of_cells(cells, decimal_of(delimiter, [cells]))[1]:
        return ""
    return lines[-1] + "\n" if len(numbers_of_cells(names, ".")[1]) == len(names) else ""


def _decoded(path: Path) -> str:
    """The text of a file. Raises ImportDataError for a binary file."""
    data = read_bytes(path, error=ImportDataError)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    text = text.rstrip("\0")  # blocks not written before a power cut
    if "\0" in text:
        raise ImportDataError(f"{path}: not a text file; a CSV is expected")
    return text


def lines_of(text: str) -> Iterator[str]:
    """The lines of a text without empty ones."""
    return (line[0] for line in _LINE.finditer(text))


def cells_of(lines: Iterable[str], delimiter: str) -> Iterator[list[str]]:
    """The cells of each line; a space as delimiter stands for any white space."""
    return (line.split() for line in lines) if delimiter == " " else csv.reader(lines, delimiter=delimiter)


def delimiter_of(line: str) -> str:
    """The most frequent delimiter of a line; a space without one."""
    delimiter = max(DELIMITERS, key=line.count)
    return delimiter if delimiter in line else " "


def decimal_of(delimiter: str, body: list[list[str]]) -> str:
    """The decimal mark: a comma where cells are like 12,5 and the comma is not the delimiter."""
    if delimiter == ",":
        return "."
    cells = [cell for row in body[:_DECIMAL_ROWS] for cell in row]
    comma, point = (any(pattern.match(c) for c in cells) for pattern in (_DECIMAL_COMMA, _DECIMAL_POINT))
    return "," if comma and not point else "."


def without_end(text: str, layout: FileFormat) -> tuple[str, list[str]]:
    """The text without the lines below its last row (a row cut off by a crash, or words), and a note on them."""
    ends = [len(text)]
    while len(ends) <= LONGEST_END + _UNIFORM_ROWS and ends[-1] > 0:
        ends.append(text.rfind("\n", 0, max(ends[-1] - 1, 0)) + 1)
    lines = [text[b : a - 1] for a, b in itertools.pairwise(ends)]
    width, counts = _usual_width(lines, layout.delimiter)
    extra = next((i for i, count in enumerate(counts) if count == width), 0)
    if not extra or extra > LONGEST_END or max(counts[:extra]) > width or ends[extra + 2 :] == []:
        return text, []
    note = f"the last line is cut off ({counts[0]} of {width} cells): left out"
    return text[: ends[extra]], [note if extra == 1 else f"{extra} lines below the last row left out"]


def _usual_width(lines: Sequence[str], delimiter: str | None) -> tuple[int, list[int]]:
    """The most common number of cells in the lines, and that of each line, by the delimiter with the most equal lines."""
    usual_width, most_lines, usual_counts = 0, 0, list[int]()
    for candidate in (delimiter,) if delimiter else (*DELIMITERS, " "):
        counts = [len(row) for row in cells_of(lines, candidate)]
        width, equal_lines = Counter(counts).most_common(1)[0] if counts else (0, 0)
        if len(counts) == len(lines) and width > 1 and equal_lines > most_lines:
            usual_width, most_lines, usual_counts = width, equal_lines, counts
    return usual_width, usual_counts


def lines_above_header(lines: list[str], last: str, layout: FileFormat) -> int:
    """The number of lines above the column names; 0 where no line holds them. Column names are the first line of words only,
    with as many cells as the lines below and the last line, which hold numbers."""
    if layout.names:
        return 0
    for i in range(min(len(lines) - _UNIFORM_ROWS, LONGEST_PREAMBLE)):
        delimiter = layout.delimiter or delimiter_of(lines[i])
        names, *rows = list(cells_of([*lines[i : i + 1 + _UNIFORM_ROWS], last], delimiter)) or [[]]
        if rows and _is_group_row(names, rows[0]):
            continue
        if any(len(row) != len(names) for row in rows) or len(names) < 2 or all(find_unit(name) for name in names):
            continue
        decimal = layout.decimal or decimal_of(delimiter, rows)
        only_words = len(numbers_of_cells(names, decimal)[1]) == sum(1 for name in names if name.strip())
        if only_words and any(len(numbers_of_cells(row, decimal)[1]) < len(row) for row in rows[_UNIFORM_ROWS - 1 :]):
            return i
    return 0


def _is_group_row(cells: list[str], next_cells: list[str]) -> bool:
    """Whether a line names groups of the columns whose names are in the next line: it repeats or leaves out cells, and the next
    line holds as many names, each once."""
    filled = [c.strip() for c in cells if c.strip()]
    names = [c.strip() for c in next_cells]
    repeats = len(set(filled)) < len(filled) or len(filled) < len(cells)
    return (
        repeats
        and len(names) == len(cells)
        and len(set(names)) == len(names)
        and len(numbers_of_cells(names, ".")[1]) == len(names)
        and not all(find_unit(n) for n in names)
    )


def unit_row(header: list[str], row: list[str]) -> dict[str, str]:
    """The units in a row below the header that holds words, and no number but the unit 1; empty for an ordinary row."""
    cells = [c.strip().strip("[]()") for c in row]
    words = [c for c in cells if c and numbers_of_cells([c], ".")[1]]
    if len(cells) != len(header) or len(words) + cells.count("1") != sum(map(bool, cells)):
        return {}
    if not any(find_unit(c) for c in words):
        return {}
    return {h: c for h, c in zip(header, cells, strict=True) if h and c}


def numbers_of_cells(cells: Sequence[str], decimal: str) -> tuple[Array, list[int]]:
    """(N,) values of a column's cells, NaN where empty, infinite or no number; and the rows of cells that are no numbers."""
    if decimal == ",":
        cells = [c.replace(",", ".") for c in cells]
    bad_rows: list[int] = []
    try:
        values = np.array(cells, float)
    except ValueError:
        values = np.full(len(cells), np.nan)
        number = lru_cache(maxsize=None)(_number)  # a column repeats the same words
        for i, cell in enumerate(cells):
            value = number(cell)
            if value is None:
                bad_rows.append(i)
            else:
                values[i] = value
    values[np.isinf(values)] = np.nan
    return values, bad_rows


def _number(cell: str) -> float | None:
    """The value of a cell, NaN when it is empty, None when it is no number."""
    word = cell.strip().lower()
    if word in EMPTY:
        return np.nan
    if word[0].isalpha() and word[0] not in "in":  # of inf and nan; an exception takes ten times as long
        return None
    try:
        return float(word)
    except ValueError:
        return None
