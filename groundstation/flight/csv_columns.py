"""The columns of a CSV file with a header line of names, all of them numbers."""

import csv
import itertools
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.contract.errors import UserError
from daq.contract.plain_words import one_line, plain_name
from groundstation.flight.parquet_columns import MOST_COLUMNS

Array = NDArray[np.float64]


def read_csv(path: Path, error: type[UserError]) -> dict[str, Array]:
    """Columns by name (N,), NaN where a cell is empty. Raises `error` naming line and column of what is no number."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as handle:
            rows = csv.reader(handle)
            header = [h.strip() for h in next(rows, [])]
            _check_header(path, header, error)
            cells = np.fromiter(itertools.chain.from_iterable(_numbers(path, header, rows, error)), float)
    except UnicodeDecodeError as reason:
        raise error(f"{path}: not a text file ({reason.reason} at byte {reason.start}); a CSV is expected") from reason
    except csv.Error as reason:
        raise error(f"{path}: not a readable CSV ({reason})") from reason
    values = cells.reshape(-1, len(header))
    return {h: values[:, i] for i, h in enumerate(header) if h}


def _check_header(path: Path, header: list[str], error: type[UserError]) -> None:
    if not any(header) or all(_is_number(h) for h in header):
        raise error(f"{path}: the first line is not a header of column names (time,ax,ay,...)")
    if len(header) > MOST_COLUMNS:
        raise error(f"{path}: {len(header)} columns; at most {MOST_COLUMNS} are read")
    twice = [name for name, count in Counter(header).items() if count > 1]
    if twice:
        raise error(f"{path}: column {plain_name(twice[0])} appears twice in the header")


def _numbers(path: Path, header: list[str], rows: Iterator[list[str]], error: type[UserError]) -> Iterator[list[float]]:
    for number, row in enumerate(rows, start=2):
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
