"""CSV and Parquet tables: any header, any order, with the units in the mapping file or in the header."""

import codecs
import csv
import re
from collections.abc import Container
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from groundstation.importers.errors import ImportDataError
from groundstation.importers.mapping import FileFormat, Map, Source, Time
from groundstation.importers.series import Log, Series
from groundstation.importers.units import conversion, find_unit

Array = NDArray[np.float64]

WORDS_AMONG_NUMBERS = 0.1
"""A column with a larger share of cells that are no numbers is one of words."""

_ALIKE = 4  # lines below the column names that must have as many cells
_LONGEST_PREAMBLE = 200

_DECIMAL_COMMA = re.compile(r"^\s*[-+]?\d*,\d+(e[-+]?\d+)?\s*$", re.IGNORECASE)
_DECIMAL_POINT = re.compile(r"^\s*[-+]?\d*\.\d+(e[-+]?\d+)?\s*$", re.IGNORECASE)
_HEADER_UNIT = re.compile(r"^\s*(?P<name>[^\[\](]+?)\s*[\[(]\s*(?P<unit>[^\])]*)\s*[\])]\s*$")


@dataclass(frozen=True)
class Table:
    """A table as read: columns of numbers (N,) and of words by header, units of a row below the header, and notes."""

    numeric: dict[str, Array]
    words: dict[str, list[str]]
    units: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_table(path: Path, layout: FileFormat) -> Table:
    """A CSV or Parquet table. Raises ImportDataError."""
    return _read_parquet(path) if path.suffix.lower() == ".parquet" else _read_csv(path, layout)


def _read_csv(path: Path, layout: FileFormat) -> Table:
    lines = [line for line in _text(path).splitlines() if line.strip() and not line.lstrip().startswith("#")]
    above = _lines_above_header(lines, layout) if layout.header_line is None else layout.header_line - 1
    lines = lines[above:]
    if len(lines) < 2:
        raise ImportDataError(f"{path}: no table with a header line and rows in it")
    delimiter = layout.delimiter or _delimiter(lines[0])
    rows = _cells(lines, delimiter)
    if layout.names:
        rows.insert(0, list(layout.names))
    header = [h.strip() for h in rows[0]]
    _check_header(path, header)
    body = rows[1 + layout.skip_after_header :]
    units = _unit_row(header, body[0]) if body else {}
    if units:
        body = body[1:]
    first = above + 2 + layout.skip_after_header + bool(units)
    for number, row in enumerate(body, start=first):
        if len(row) != len(header):
            raise ImportDataError(
                f"{path}: table line {number} has {len(row)} cells, the header has {len(header)}; if the column names stand "
                "further down, say in which line in a mapping file: [file] header_line"
            )
    decimal = layout.decimal or _decimal(delimiter, body)
    numeric: dict[str, Array] = {}
    words: dict[str, list[str]] = {}
    notes = [f"{above} lines above the column names passed over"] if above and layout.header_line is None else []
    for i, name in enumerate(header):
        if not name:
            continue
        cells = [row[i].strip() for row in body]
        values, wrong = _numbers(cells, decimal)
        if len(wrong) > WORDS_AMONG_NUMBERS * len(cells):
            words[name] = cells
            continue
        numeric[name] = values
        if wrong:
            notes.append(
                f"column {name}: {len(wrong)} cells that are no numbers (the first {cells[wrong[0]]!r} in table line "
                f"{first + wrong[0]}) taken as not measured"
            )
    return Table(numeric, words, units, tuple(notes))


def _lines_above_header(lines: list[str], layout: FileFormat) -> int:
    """How many lines stand above the column names: the first line of words only that has as many cells as the lines below and
    the last one, among which are numbers. 0 where there is none."""
    if layout.names:
        return 0
    for i in range(min(len(lines) - _ALIKE, _LONGEST_PREAMBLE)):
        delimiter = layout.delimiter or _delimiter(lines[i])
        names, *rows = _cells([*lines[i : i + 1 + _ALIKE], lines[-1]], delimiter)
        if any(len(row) != len(names) for row in rows) or len(names) < 2 or all(find_unit(name) for name in names):
            continue
        decimal = layout.decimal or _decimal(delimiter, rows)
        worded = len(_numbers(names, decimal)[1]) == sum(1 for name in names if name.strip())
        if worded and any(len(_numbers(row, decimal)[1]) < len(row) for row in rows[_ALIKE - 1 :]):
            return i
    return 0


def _cells(lines: list[str], delimiter: str) -> list[list[str]]:
    return [line.split() for line in lines] if delimiter == " " else list(csv.reader(lines, delimiter=delimiter))


def _text(path: Path) -> str:
    """The file as text: UTF-8 or UTF-16 with or without a mark, else Latin-1."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ImportDataError(f"{path}: cannot be read ({error.strerror or error})") from error
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if "\0" in text:
        raise ImportDataError(f"{path}: not a text file; a CSV is expected")
    return text


def _check_header(path: Path, header: list[str]) -> None:
    if all(h and not _numbers([h], ".")[1] for h in header):
        raise ImportDataError(
            f"{path}: the first line holds numbers, not column names; add a line of names above it (time,ax,ay,...) "
            "or give them in a mapping file: [file] names = [...]"
        )
    twice = sorted({h for h in header if h and header.count(h) > 1})
    if twice:
        raise ImportDataError(f"{path}: column {twice[0]!r} appears twice in the header")


def _delimiter(line: str) -> str:
    found = max((";", "\t", ","), key=line.count)
    return found if found in line else " "


def _decimal(delimiter: str, body: list[list[str]]) -> str:
    """A comma where cells are like 12,5 and the comma does not part them."""
    if delimiter == ",":
        return "."
    cells = [cell for row in body[:50] for cell in row]
    return (
        "," if any(_DECIMAL_COMMA.match(c) for c in cells) and not any(_DECIMAL_POINT.match(c) for c in cells) else "."
    )


def _unit_row(header: list[str], row: list[str]) -> dict[str, str]:
    """The units of a row below the header that holds no number at all; empty when it is an ordinary row."""
    cells = [c.strip().strip("[]()") for c in row]
    if len(cells) != len(header) or not any(cells) or not all(_numbers([c], ".")[1] for c in cells if c):
        return {}
    if not any(find_unit(c) for c in cells if c):
        return {}
    return {h: c for h, c in zip(header, cells, strict=True) if h and c}


_EMPTY = {"", "nan", "na", "n/a", "null", "none", "-", "--"}


def _numbers(cells: list[str], decimal: str) -> tuple[Array, list[int]]:
    """Values, NaN where empty, infinite or no number; and the rows of the cells that are no numbers."""
    if decimal == ",":
        cells = [c.replace(",", ".") for c in cells]
    wrong: list[int] = []
    try:
        values = np.array(cells, float)
    except ValueError:
        values = np.full(len(cells), np.nan)
        for i, cell in enumerate(cells):
            if cell.lower() not in _EMPTY:
                try:
                    values[i] = float(cell)
                except ValueError:
                    wrong.append(i)
    values[np.isinf(values)] = np.nan
    return values, wrong


def _read_parquet(path: Path) -> Table:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise ImportDataError(f"{path}: not a readable Parquet file ({error})") from error
    numeric: dict[str, Array] = {}
    words: dict[str, list[str]] = {}
    for name in table.column_names:
        column = table[name]
        if pa.types.is_timestamp(column.type):
            # as ISO text, so that a mapping can name it with unit 'iso'
            words[name] = [value.isoformat() if value is not None else "" for value in column.to_pylist()]
            continue
        try:
            values = np.array(column.cast(pa.float64()).to_numpy(zero_copy_only=False), float)
            numeric[name] = np.where(np.isinf(values), np.nan, values)
        except pa.ArrowException:
            words[name] = [str(value) for value in column.to_pylist()]
    return Table(numeric, words)


def header_map(table: Table, given: Container[str] = ()) -> tuple[Map, tuple[str, ...]]:
    """A mapping guessed from headers that are flight columns, with or without a unit: 'phi', 'phi [deg]', 'V (knots)';
    and notes on what stands in brackets and is no unit. given: columns that need no guess.

    Raises ImportDataError for a unit of another quantity.
    """
    columns: dict[str, tuple[Source, ...]] = {}
    time = None
    segment = None
    notes = []
    for name in [*table.numeric, *table.words]:
        match = _HEADER_UNIT.match(name)
        bare, unit = (match["name"], match["unit"]) if match else (name, table.units.get(name, ""))
        if bare == "time" or (time is None and bare in ("t", "Time", "TIME", "time_s")):
            time = Time(column=name, unit=unit or "s")
        elif bare == "segment":
            segment = name
        elif bare in COLUMN_BY_NAME and bare not in given:
            si = COLUMN_BY_NAME[bare].unit
            known = find_unit(unit) is not None
            if unit and known:
                conversion(unit, bare, si)
            elif unit:
                notes.append(f"header {name!r}: {unit!r} is not a unit known here; taken as {si or 'it stands'}")
            columns[bare] = (Source(column=name, unit=unit if unit and known else si),)
    return Map(format=1, time=time, segment=segment, columns=columns), tuple(notes)


def table_log(path: Path, table: Table, time: Time | None) -> Log:
    """The table as series over its time column [s]. Raises ImportDataError when there is none."""
    if time is None:
        raise ImportDataError(
            f"{path}: no column 'time'; found {', '.join([*table.numeric, *table.words][:12])}; "
            "name the time column in a mapping file (--map), or the rate where there is none: [time] rate_hz = 50"
        )
    seconds = _seconds(path, table.numeric, table.words, time)
    numeric = dict(table.numeric)
    if time.restarts:
        seconds, numeric[RECORD] = _in_a_row(path, seconds)
    series = {name: Series(seconds, values) for name, values in numeric.items() if name != time.column}
    text_columns = tuple(w for w in table.words if w != time.column)
    return Log("table", series, common=True, notes=table.notes, text_columns=text_columns)


RECORD = "record number"
"""Counts the records of a file in which time begins anew."""


def _in_a_row(path: Path, seconds: Array) -> tuple[Array, Array]:
    """Records one after the other in time, a second apart, and the number of each."""
    step = np.diff(seconds)
    back = step <= 0
    if not back.any():
        raise ImportDataError(f"{path}: restarts = true, but time never begins anew")
    number = np.concatenate([[0.0], np.cumsum(back)])
    shift = np.concatenate([[0.0], np.cumsum(np.where(back, 1.0 - step, 0.0))])
    return seconds + shift, number


def _seconds(path: Path, numeric: dict[str, Array], words: dict[str, list[str]], time: Time) -> Array:
    if time.column is None:
        rows = len(next(iter(numeric.values()), np.zeros(0)))
        return np.arange(rows) / float(time.rate_hz or 1.0) + time.offset
    if time.column not in numeric and time.column not in words:
        raise ImportDataError(
            f"{path}: no column {time.column!r} for the time; found {', '.join([*numeric, *words][:12])}"
        )
    if time.unit == "iso":
        return _dates(path, words, time) + time.offset
    if time.column in words:
        bad = next((w for w in words[time.column] if _numbers([w], ".")[1]), "")
        raise ImportDataError(
            f'{path}: time column {time.column!r} holds {bad!r}, not a number; dates need unit = "iso"'
        )
    unit = find_unit(time.unit)
    if unit is None or unit.si != "s":
        raise ImportDataError(f"{path}: time unit {time.unit!r} is not known; s, ms, us, ns, min, h or iso")
    values = numeric[time.column]
    # large integer stamps (us since 1970) lose digits as seconds in double precision: count from the first
    first = np.nanmin(values) if unit.scale < 1 and np.nanmin(values) * unit.scale > 1e6 else 0.0
    return np.asarray((values - first) * unit.scale + time.offset)


def _dates(path: Path, words: dict[str, list[str]], time: Time) -> Array:
    stamps = []
    for cell in words.get(time.column or "", []):
        try:
            stamps.append(datetime.fromisoformat(cell))
        except ValueError:
            raise ImportDataError(
                f"{path}: time column {time.column!r}: {cell!r} is not a date like 2026-11-21T03:15:00.25"
            ) from None
    if not stamps:
        raise ImportDataError(
            f"{path}: time column {time.column!r} is a number, not a date; state its unit instead of iso"
        )
    return np.array([(s - stamps[0]).total_seconds() for s in stamps])
