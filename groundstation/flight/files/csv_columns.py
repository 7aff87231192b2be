"""Columns of a CSV file of numbers with a header line.

Rows are read by numpy's reader, which is several times faster than reading cell by cell. A file that it refuses (words, quoted
line breaks, rows of different lengths) is read cell by cell, for an error message with line and column.
"""

import csv
import io
import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.errors import UserError
from daq.utilities.plain_words import one_line, plain_name
from groundstation.flight.arrays import Array
from groundstation.flight.files.parquet_columns import MOST_COLUMNS, MOST_ROWS

_NUMBER = "1"  # unit of numbers without one
_UNITS = {"time": "s", "segment": _NUMBER}
_BLOCK = 2**22  # characters parsed at once


def read_csv(path: Path, error: type[UserError]) -> dict[str, Array]:
    """Column name -> (N,) values, NaN where a cell is empty. Raises `error` with line and column of a cell that is no number."""
    _check_length(path, error)
    try:
        with path.open(newline="", encoding="utf-8-sig") as handle:
            rows = csv.reader(handle)
            header = [h.strip() for h in next(rows, [])]
            _check_header(path, header, error)
            body, units = _without_units(path, header, rows, error)
            # a header with quoted line breaks has more than one line
            columns = plain_columns(path, header, skip_lines=1 + units) if rows.line_num <= 2 else None
            if columns is None:
                cells = np.fromiter(itertools.chain.from_iterable(_numbers(path, header, body, error)), float)
                columns = list(cells.reshape(-1, len(header)).T)
    except UnicodeDecodeError as reason:
        raise error(f"{path}: not a text file ({reason.reason} at byte {reason.start}); a CSV is expected") from reason
    except csv.Error as reason:
        raise error(f"{path}: not a readable CSV ({reason})") from reason
    return {h: values for h, values in zip(header, columns, strict=True) if h}


def _check_length(path: Path, error: type[UserError]) -> None:
    """Raise `error` for more rows than a Parquet file may have: reading a row takes over a microsecond, and a line may have only
    two bytes."""
    limit, lines = max(MOST_ROWS, path.stat().st_size // 4), 0
    with path.open("rb") as handle:
        while block := handle.read(2**20):
            lines += block.count(b"\n")
            if lines > limit + 2:
                raise error(f"{path}: more than {limit} rows; at most {limit} are read; write it in parts")


def _check_header(path: Path, header: list[str], error: type[UserError]) -> None:
    if not any(header) or all(is_number(h) for h in header):
        raise error(f"{path}: the first line is not a header of column names (time,ax,ay,...)")
    if len(header) > MOST_COLUMNS:
        raise error(f"{path}: {len(header)} columns; at most {MOST_COLUMNS} are read")
    duplicates = [name for name, count in Counter(header).items() if count > 1]
    if duplicates:
        raise error(f"{path}: column {plain_name(duplicates[0])} appears twice in the header")


def _without_units(
    path: Path, header: list[str], rows: Iterator[list[str]], error: type[UserError]
) -> tuple[Iterator[tuple[int, list[str]]], bool]:
    """The rows with their line numbers, without a row of units below the header (`sideslip export --units-row`); and whether
    there is such a row. Raises `error` for units other than those of the flight columns."""
    numbered = enumerate(rows, start=2)
    first = next(numbered, None)
    if first is None:
        return numbered, False
    cells = [cell.strip() for cell in first[1]]
    units = [cell for cell in cells if cell and cell != _NUMBER]
    if len(cells) != len(header) or not units or any(map(is_number, units)):
        return itertools.chain([first], numbered), False
    for name, cell in zip(header, cells, strict=True):
        unit = _UNITS.get(name) or (COLUMN_BY_NAME[name].unit if name in COLUMN_BY_NAME else cell)
        if cell and cell != unit:
            raise error(
                f"{path}: line 2, column {plain_name(name)}: {one_line(cell, 60)!r} is not a number, nor the unit {unit} "
                "of a flight; 'sideslip import' converts a table with other units"
            )
    return numbered, True


def _numbers(
    path: Path, header: list[str], rows: Iterator[tuple[int, list[str]]], error: type[UserError]
) -> Iterator[list[float]]:
    """Each row that is not empty as numbers, NaN for an empty cell. Raises `error` with line and column."""
    for number, row in rows:
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(header):
            raise error(f"{path}: line {number} has {len(row)} cells, the header has {len(header)}")
        try:
            yield [float(cell) if cell.strip() else np.nan for cell in row]
        except ValueError:
            index = next(i for i, cell in enumerate(row) if cell.strip() and not is_number(cell))
            raise error(
                f"{path}: line {number}, column {plain_name(header[index])}: {one_line(row[index], 60)!r} is not a number"
            ) from None


def is_number(cell: str) -> bool:
    """Whether `float` reads a cell."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


# ------------------------------------------------------------------------------------------------------- numpy's reader


def plain_columns(
    source: Path | str,
    names: Sequence[str],
    *,
    skip_lines: int = 0,
    delimiter: str = ",",
    decimal: str = ".",
    empty: Sequence[str] = ("",),
) -> list[Array] | None:
    """The columns (N,) of rows of numbers, NaN where a cell is one of `empty`, without rows of such cells only. None where a row
    has another number of cells than `names`, or a cell is no number.

    source: a file, or a text. skip_lines: before the first row.
    """
    blank = _blank_cells(delimiter, empty)
    blocks: list[Array] = [np.zeros((0, len(names)))]
    with io.StringIO(source) if isinstance(source, str) else source.open(encoding="utf-8-sig") as file:
        for _ in range(skip_lines):
            file.readline()
        while text := file.read(_BLOCK):
            text += file.readline()
            if decimal != ".":
                text = text.replace(decimal, ".")
            block = _block(blank(text), len(names), delimiter)
            if block is None:
                return None
            unmeasured = np.isnan(block).all(axis=1)
            if unmeasured.any() and "nan" not in empty and "nan" in text.lower():
                return None  # a row with NaN written in it is not an empty one
            blocks.append(block[~unmeasured] if unmeasured.any() else block)
    return list(np.concatenate(blocks).T)


def _block(text: str, width: int, delimiter: str) -> Array | None:
    """Rows (N, width) of complete lines without empty cells; None where one has another number of cells, or a cell is no
    number."""
    if not text.strip():
        return np.zeros((0, width))
    try:
        rows = np.loadtxt(io.StringIO(text), delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        return None
    return rows if rows.shape[1] == width else None


def _blank_cells(delimiter: str, empty: Sequence[str]) -> Callable[[str], str]:
    """A function that replaces the empty cells in lines by nan. empty: texts of an empty cell."""
    separator, texts = re.escape(delimiter), "|".join(re.escape(text) for text in empty if text)
    pattern = re.compile(rf"(?<![^{separator}\n])(?:{texts})(?![^{separator}\n])") if texts else None

    def filled(text: str) -> str:
        if pattern and pattern.search(text):
            text = pattern.sub("nan", text)
        for _ in range(2):  # neighbours share their delimiter
            text = text.replace(2 * delimiter, f"{delimiter}nan{delimiter}")
        text = text.replace(f"{delimiter}\n", f"{delimiter}nan\n").replace(f"\n{delimiter}", f"\nnan{delimiter}")
        text = f"nan{text}" if text.startswith(delimiter) else text
        return f"{text}nan" if text.endswith(delimiter) else text

    return filled
