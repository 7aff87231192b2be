"""The columns of a CSV file with a header line of names, all of them numbers."""

import csv
import itertools
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from daq.contract.errors import UserError
from daq.contract.plain_words import one_line, plain_name
from groundstation.flight.files.parquet_columns import MOST_COLUMNS, MOST_ROWS
from groundstation.flight.files.plain_csv import plain_columns

Array = NDArray[np.float64]


def read_csv(path: Path, error: type[UserError]) -> dict[str, Array]:
    """Columns by name (N,), NaN where a cell is empty. Raises `error` naming line and column of what is no number."""
    _check_length(path, error)
    try:
        with path.open(newline="", encoding="utf-8-sig") as handle:
            rows = csv.reader(handle)
            header = [h.strip() for h in next(rows, [])]
            _check_header(path, header, error)
            body, units = _without_units(path, header, rows, error)
            # rows.line_num: a quoted name can stand on several lines
            plain = plain_columns(path, header, skip_lines=1 + units) if rows.line_num <= 2 else None
            if plain is None:
                cells = np.fromiter(itertools.chain.from_iterable(_numbers(path, header, body, error)), float)
                plain = list(cells.reshape(-1, len(header)).T)
    except UnicodeDecodeError as reason:
        raise error(f"{path}: not a text file ({reason.reason} at byte {reason.start}); a CSV is expected") from reason
    except csv.Error as reason:
        raise error(f"{path}: not a readable CSV ({reason})") from reason
    return {h: values for h, values in zip(header, plain, strict=True) if h}


def _check_length(path: Path, error: type[UserError]) -> None:
    """Raise `error` for more rows than of a Parquet file: at a microsecond a row and more, a file of two-letter lines takes
    longer than anyone waits."""
    most, lines = max(MOST_ROWS, path.stat().st_size // 4), 0
    with path.open("rb") as handle:
        while block := handle.read(2**20):
            lines += block.count(b"\n")
            if lines > most + 2:
                raise error(f"{path}: more than {most} rows; at most {most} are read; write it in parts")


def _check_header(path: Path, header: list[str], error: type[UserError]) -> None:
    if not any(header) or all(_is_number(h) for h in header):
        raise error(f"{path}: the first line is not a header of column names (time,ax,ay,...)")
    if len(header) > MOST_COLUMNS:
        raise error(f"{path}: {len(header)} columns; at most {MOST_COLUMNS} are read")
    twice = [name for name, count in Counter(header).items() if count > 1]
    if twice:
        raise error(f"{path}: column {plain_name(twice[0])} appears twice in the header")


def _without_units(
    path: Path, header: list[str], rows: Iterator[list[str]], error: type[UserError]
) -> tuple[Iterator[tuple[int, list[str]]], bool]:
    """The rows with their line numbers, without a row of units below the header, as `sideslip export --units-row` writes it; and
    whether there is one.

    Raises `error` for units that are not those of a flight.
    """
    numbered = enumerate(rows, start=2)
    first = next(numbered, None)
    if first is None:
        return numbered, False
    cells = [cell.strip() for cell in first[1]]
    worded = [cell for cell in cells if cell and cell != _NUMBER]
    if len(cells) != len(header) or not worded or any(map(_is_number, worded)):
        return itertools.chain([first], numbered), False
    for name, cell in zip(header, cells, strict=True):
        wanted = _UNITS.get(name) or (COLUMN_BY_NAME[name].unit if name in COLUMN_BY_NAME else cell)
        if cell and cell != wanted:
            raise error(
                f"{path}: line 2, column {plain_name(name)}: {one_line(cell, 60)!r} is not a number, nor the unit {wanted} "
                "of a flight; 'sideslip import' converts a table with other units"
            )
    return numbered, True


_NUMBER = "1"
"""Unit of numbers without one."""
_UNITS = {"time": "s", "segment": _NUMBER}


def _numbers(
    path: Path, header: list[str], rows: Iterator[tuple[int, list[str]]], error: type[UserError]
) -> Iterator[list[float]]:
    for number, row in rows:
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(header):
            raise error(f"{path}: line {number} has {len(row)} cells, the header has {len(header)}")
        try:
            yield [float(cell) if cell.strip() else np.nan for cell in row]
        except ValueError:
            bad = next(i for i, cell in enumerate(row) if cell.strip() and not _is_number(cell))
            raise error(
                f"{path}: line {number}, column {plain_name(header[bad])}: {one_line(row[bad], 60)!r} is not a number"
            ) from None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
