"""CSV and Parquet tables: any header, any order, with the units in the mapping file or in the header."""

import csv
import itertools
import re
from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.plain_words import listed, one_line, plain_name
from groundstation.flight.arrays import Array
from groundstation.flight.files.csv_columns import plain_columns
from groundstation.flight.files.parquet_columns import MOST_COLUMNS, read_parquet
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.table_text import (
    EMPTY,
    LONGEST_PREAMBLE,
    cells_of,
    decimal_of,
    delimiter_of,
    lines_above_header,
    lines_of,
    numbers_of_cells,
    text_of,
    unit_row,
    without_end,
)
from groundstation.importers.formats.table_time import sender_stamp, stamp_columns, stamps_of, without_sentinels
from groundstation.importers.mapping import ColumnSource, FileFormat, Map, Time
from groundstation.importers.series import Log, TimeSeries
from groundstation.importers.units import conversion, find_unit, is_unit_of

RECORD = "record number"  # series with the number of each row's record, in a file whose time restarts
WORDS_AMONG_NUMBERS = 0.1  # share of a column's cells that are no numbers, above which it is a column of text
DATE_NAMES = ("date", "Date", "DATE")  # columns that hold the day beside a time of day
_TIME_NAMES = ("time", "t", "Time", "TIME", "time_s")
FEW_UNEVEN, UNEVEN = 2, 0.01
"""Lines with another number of cells than the header that are left out, as a number or a share: more are another table."""
FIRST_ROWS = 50  # by which units and the decimal mark are recognised
_CELLS_AT_ONCE = 400_000  # converted together: 30 MB of text
_HEADER_UNIT = re.compile(r"^\s*(?P<name>[^\[\](]+?)\s*[\[(]\s*(?P<unit>[^\])]*)\s*[\])]\s*$")
_DIGIT = re.compile(r"\d")
NAME_THE_TIME = (
    "name the time column in a mapping file (--map; --draft-map proposes one), or the rate where there is none: "
    "[time] rate_hz = 50"
)


def _bare(header: str) -> str:
    """The name in a header, without the unit in brackets."""
    match = _HEADER_UNIT.match(header)
    return match["name"] if match else header


@dataclass(frozen=True)
class ImportedTable:
    """A table as read. numeric: columns of numbers (N,); words: cells of text columns, empty unless the column can be the time;
    dates: columns of dates (N,) [s] after the first, which is in firsts [s since 1970]; units: of a row below the header."""

    numeric: dict[str, Array]
    words: dict[str, list[str]]
    dates: dict[str, Array] = field(default_factory=dict)
    firsts: dict[str, float] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    of_topic: bool = False
    """Whether its rows are messages of one ROS topic, with the stamps of their headers."""


def read_table(path: Path, layout: FileFormat, time: Time | None = None) -> ImportedTable:
    """A CSV or Parquet table. time: the time column, None where the mapping does not state it. Raises ImportDataError."""

    def can_be_time(name: str) -> bool:
        return name in (time.column, time.date) if time else _bare(name) in (*_TIME_NAMES, *DATE_NAMES)

    if path.suffix.lower() != ".parquet":
        try:
            table = _read_csv(path, layout, can_be_time, needs_time=time is None or time.column is not None)
            return table if time is not None else _with_sender_stamp(table)
        except csv.Error as error:
            raise ImportDataError(f"{path}: not a readable table ({error}); is it a CSV?") from error
    content = read_parquet(path, ImportDataError, can_be_time)
    numeric = {name: np.where(np.isinf(values), np.nan, values) for name, values in content.numeric.items()}
    return ImportedTable(numeric, content.words, content.dates, content.firsts)


def _with_sender_stamp(table: ImportedTable) -> ImportedTable:
    """The table with the stamp of a ROS header as its time, where it has a stamp and no column `time`."""
    stamp = None if any(_bare(n) == "time" for n in table.numeric) else sender_stamp(table.numeric)
    if stamp is None:
        return table
    numeric = {"time": stamp.seconds, **{n: v for n, v in table.numeric.items() if n not in stamp.columns}}
    notes = (*table.notes, f"time by {' and '.join(map(plain_name, stamp.columns))}, the sender's own clock")
    return replace(table, numeric=numeric, firsts={**table.firsts, "time": stamp.first}, notes=notes, of_topic=True)


def _read_csv(path: Path, layout: FileFormat, can_be_time: Callable[[str], bool], needs_time: bool) -> ImportedTable:
    """A text table. needs_time: whether one of the columns must be the time. Raises ImportDataError."""
    text, notes = without_end(text_of(path), layout)
    first_lines = list(itertools.islice(lines_of(text), LONGEST_PREAMBLE))
    last_line = text[text.rfind("\n", 0, -1) + 1 : -1]
    preamble = layout.header_line - 1 if layout.header_line else lines_above_header(first_lines, last_line, layout)
    if preamble and not layout.header_line:
        notes.insert(0, f"{preamble} lines above the column names passed over")
    lines = itertools.islice(lines_of(text), preamble, None)
    top = next(lines, None)
    if top is None:
        raise ImportDataError(f"{path}: no table with a header line and rows in it")
    delimiter = layout.delimiter or delimiter_of(top)
    rows = cells_of(itertools.chain([top], lines), delimiter)
    header = [h.strip() for h in (list(layout.names) or next(rows))]
    _check_header(path, header)
    if needs_time:
        _check_time_column(path, header, can_be_time)
    first_rows = list(itertools.islice(rows, layout.skip_after_header, layout.skip_after_header + FIRST_ROWS))
    if not first_rows:
        raise ImportDataError(f"{path}: no table with a header line and rows in it")
    units = unit_row(header, first_rows[0])
    decimal = layout.decimal or decimal_of(delimiter, first_rows)
    body_start = preamble + (not layout.names) + layout.skip_after_header + bool(units)
    columns = _plain_columns(text, header, body_start, delimiter, decimal)
    if columns:
        numeric = {h: v for h, v in zip(header, columns, strict=True) if h}
        return ImportedTable(numeric, {}, units=units, notes=tuple(notes))
    body = itertools.chain(first_rows[1:] if units else first_rows, rows)
    cells = _MixedColumns(path, header, decimal, preamble + 2 + layout.skip_after_header + bool(units), can_be_time)
    cells.read(body, needs_time)
    return cells.table(units, notes)


def _check_time_column(path: Path, header: list[str], can_be_time: Callable[[str], bool]) -> None:
    """Raise ImportDataError for a header without a time column, or with nothing else."""
    if not any(can_be_time(h) and h not in DATE_NAMES for h in header) and not stamp_columns(header):
        raise ImportDataError(
            f"{path}: no column 'time', or the one named for it; found {listed(header, 12)}; {NAME_THE_TIME}"
        )
    if len(header) == 1:
        raise ImportDataError(
            f"{path}: one column only, {header[0]!r}; if another character separates the cells, "
            'name it in a mapping file: [file] delimiter = "|"'
        )


class _MixedColumns:
    """Columns of numbers and text, converted _CELLS_AT_ONCE cells at a time. first: line of the first row."""

    def __init__(
        self, path: Path, header: list[str], decimal: str, first: int, can_be_time: Callable[[str], bool]
    ) -> None:
        self._path, self._header, self._decimal, self._first, self._line = path, header, decimal, first, first
        self._values: list[list[Array]] = [[] for _ in header]
        self._wrong = [0] * len(header)
        self._example: list[tuple[str, int] | None] = [None] * len(header)
        self._rows = self._repeated = 0
        self._uneven: list[tuple[int, int]] = []
        self._words: dict[int, list[str]] = {i: [] for i, name in enumerate(header) if can_be_time(name)}

    def read(self, rows: Iterator[list[str]], needs_time: bool) -> None:
        """Read all rows. Raises ImportDataError naming the first line, where many have another number of cells than the header.

        needs_time: whether a column must hold the time; reading stops where none of the first block's rows has a digit there.
        """
        rows_at_once = max(1, _CELLS_AT_ONCE // len(self._header))
        while block := list(itertools.islice(rows, rows_at_once)):
            complete = self._complete_rows(block)
            columns = list(zip(*(row for _, row in complete), strict=True))
            if needs_time and len(complete) == rows_at_once and self._line == self._first:
                self._check_time(columns)
            for i, cells in enumerate(columns):
                values, bad_rows = numbers_of_cells(cells, self._decimal)
                self._values[i].append(values)
                self._wrong[i] += len(bad_rows)
                if bad_rows and self._example[i] is None:
                    self._example[i] = (cells[bad_rows[0]].strip(), complete[bad_rows[0]][0])
                if i in self._words:
                    self._words[i] += [cell.strip() for cell in cells]
            self._line += len(block)

    def _complete_rows(self, block: list[list[str]]) -> list[tuple[int, list[str]]]:
        """The rows of a block with as many cells as the header that do not repeat it, each with its line number."""
        width = len(self._header)
        numbered = list(enumerate(block, start=self._line))
        if set(map(len, block)) == {width} and self._header not in block:
            self._rows += len(block)
            return numbered
        self._uneven += [(line, len(row)) for line, row in numbered if len(row) != width]
        complete = [(line, row) for line, row in numbered if len(row) == width and row != self._header]
        self._repeated += block.count(self._header)
        self._rows += len(complete)
        rows_read = self._line + len(block) - self._first
        if len(self._uneven) > max(FEW_UNEVEN, UNEVEN * rows_read) or not complete:
            line, cells = self._uneven[0] if self._uneven else (self._first, width)
            raise ImportDataError(
                f"{self._path}: table line {line} has {cells} cells, the header has {width}; if the column names stand further "
                "down, state their line in a mapping file: [file] header_line"
            )
        return complete

    def _check_time(self, columns: Sequence[Sequence[str]]) -> None:
        """Raise ImportDataError where no cell of a column that can be the time has a digit."""
        if not self._words or any(_DIGIT.search(" ".join(columns[i])) for i in self._words):
            return  # without such columns the time is a stamp of numbers
        i = next(iter(self._words))
        word = next((cell.strip() for cell in columns[i] if cell.strip()), "")
        raise ImportDataError(
            f"{self._path}: time column {self._header[i]!r} holds {one_line(word, 60)!r} and the like, neither numbers nor dates"
        )

    def table(self, units: dict[str, str], notes: list[str]) -> ImportedTable:
        """The table of all rows read, with notes added to `notes`."""
        numeric: dict[str, Array] = {}
        words: dict[str, list[str]] = {}
        if self._repeated:
            notes.append(f"{self._repeated} lines that repeat the column names left out")
        if self._uneven:
            (line, cells), width = self._uneven[0], len(self._header)
            notes.append(
                f"{len(self._uneven)} lines without {width} cells left out (the first, of {cells}, table line {line})"
            )
        for i, name in enumerate(self._header):
            example = self._example[i]
            if not name:
                continue
            if self._wrong[i] > WORDS_AMONG_NUMBERS * self._rows:
                words[name] = self._words.get(i, [])
                continue
            numeric[name] = np.concatenate(self._values[i]) if self._values[i] else np.zeros(0)
            if example is not None:
                notes.append(
                    f"column {plain_name(name)}: {self._wrong[i]} cells that are no numbers (the first "
                    f"{one_line(example[0], 60)!r} in table line {example[1]}) taken as not measured"
                )
        return ImportedTable(numeric, words, units=units, notes=tuple(notes))


def _plain_columns(text: str, header: list[str], skip_lines: int, delimiter: str, decimal: str) -> list[Array] | None:
    """The columns (N,) below the skipped lines where all cells are numbers or empty; else None."""
    if '"' in text or delimiter == " " or len(set(header)) < len(header):
        return None
    style = {"delimiter": delimiter, "decimal": decimal}
    columns = plain_columns(text, header, skip_lines=skip_lines, empty=tuple(EMPTY), **style)
    return columns and [np.where(np.isinf(values), np.nan, values) for values in columns]


def _check_header(path: Path, header: list[str]) -> None:
    """Raise ImportDataError for no or too many names, numbers in place of names, or a repeated name."""
    if not any(header) or len(header) > MOST_COLUMNS:
        raise ImportDataError(
            f"{path}: {sum(map(bool, header))} column names of {len(header)}; 1 to {MOST_COLUMNS} can be read"
        )
    if all(h and not numbers_of_cells([h], ".")[1] for h in header):
        raise ImportDataError(
            f"{path}: the first line holds numbers, not column names; add a line of names above it (time,ax,ay,...) "
            "or give them in a mapping file: [file] names = [...]"
        )
    duplicates = sorted(name for name, count in Counter(header).items() if name and count > 1)
    if duplicates:
        raise ImportDataError(f"{path}: column {plain_name(duplicates[0])!r} appears twice in the header")


def header_map(table: ImportedTable, mapped: Container[str] = ()) -> tuple[Map, tuple[str, ...]]:
    """A mapping guessed from headers that are flight columns, with or without a unit: 'phi', 'phi [deg]', 'V (knots)';
    and notes on text in brackets that is no unit. mapped: columns that need no guess.

    Raises ImportDataError for a unit of another quantity.
    """
    columns: dict[str, tuple[ColumnSource, ...]] = {}
    time = segment = date = None
    notes = []
    for name in [*table.numeric, *table.words, *table.dates]:
        match = _HEADER_UNIT.match(name)
        bare, unit = (match["name"], match["unit"]) if match else (name, table.units.get(name, ""))
        lower = bare.lower()
        if bare not in COLUMN_BY_NAME and lower in COLUMN_BY_NAME and is_unit_of(unit, COLUMN_BY_NAME[lower].unit):
            bare = lower  # a name in other capitals counts only with a fitting unit
        if bare == "time" or (time is None and bare in _TIME_NAMES):
            time = Time(column=name, unit=unit or "s")
        elif bare in DATE_NAMES and name in table.words:
            date = name
        elif bare == "segment":
            segment = name
        elif bare in COLUMN_BY_NAME and bare not in mapped:
            si = COLUMN_BY_NAME[bare].unit
            if unit and find_unit(unit) is None:
                taken_as = f"taken as {si or 'it stands'}"
                notes.append(f"header {plain_name(name)!r}: {plain_name(unit)!r} is not a unit known here; {taken_as}")
                unit = ""
            if unit:
                conversion(unit, bare, si)
            columns[bare] = (ColumnSource(column=name, unit=unit or si),)
    if time is None and len(table.dates) == 1:
        time = Time(column=next(iter(table.dates)))
    if time is not None and date is not None and time.column in table.words:
        time = time.model_copy(update={"date": date})
    return Map(format=1, time=time, segment=segment, columns=columns), tuple(notes)


def table_log(path: Path, table: ImportedTable, time: Time | None) -> Log:
    """The table as series over its time [s]. Raises ImportDataError for one without time."""
    if time is None:
        columns = listed([*table.numeric, *table.words, *table.dates], 12)
        raise ImportDataError(f"{path}: no column 'time'; found {columns}; {NAME_THE_TIME}")
    stamps = stamps_of(path, table.numeric, table.words, table.dates, time)
    time_columns = {time.column, time.date}
    numeric, absent = without_sentinels({n: v for n, v in table.numeric.items() if n not in time_columns})
    if stamps.record is not None:
        numeric[RECORD] = stamps.record
    series = {name: TimeSeries(stamps.seconds, values) for name, values in numeric.items()}
    text_columns = tuple(w for w in (*table.words, *table.dates) if w not in time_columns)
    units = {**_header_units(series), **table.units}
    notes = (*table.notes, *stamps.notes, *absent)
    origin = stamps.origin + table.firsts.get(time.column or "", 0.0)
    return Log("table", series, common=True, notes=notes, text_columns=text_columns, units=units, origin=origin)


def _header_units(names: Iterable[str]) -> dict[str, str]:
    """Name -> the unit in brackets after it."""
    matches = {name: _HEADER_UNIT.match(name) for name in names}
    return {name: match["unit"] for name, match in matches.items() if match}
