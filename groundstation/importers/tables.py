"""CSV and Parquet tables: any header, any order, with the units in the mapping file or in the header."""

import csv
import re
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from groundstation.importers.errors import ImportDataError
from groundstation.importers.mapping import FileFormat, Map, Source, Time
from groundstation.importers.series import Log, Series
from groundstation.importers.units import find_unit

Array = NDArray[np.float64]

_HEADER_UNIT = re.compile(r"^\s*(?P<name>[^\[\](]+?)\s*[\[(]\s*(?P<unit>[^\])]*)\s*[\])]\s*$")


def read_table(path: Path, layout: FileFormat) -> tuple[dict[str, Array], dict[str, list[str]]]:
    """Numeric columns, and text columns, of a CSV or Parquet table by header. Raises ImportDataError."""
    return _read_parquet(path) if path.suffix.lower() == ".parquet" else _read_csv(path, layout)


def _read_csv(path: Path, layout: FileFormat) -> tuple[dict[str, Array], dict[str, list[str]]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        text = path.read_text(encoding="latin-1")
        if "\0" in text:
            raise ImportDataError(f"{path}: not a text file; a CSV is expected") from None
    except OSError as error:
        raise ImportDataError(f"{path}: cannot be read ({error.strerror or error})") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    lines = lines[layout.header_line - 1 :]
    if len(lines) < 2:
        raise ImportDataError(f"{path}: no table with a header line and rows in it")
    rows = list(csv.reader(lines, delimiter=layout.delimiter or _delimiter(lines[0])))
    header = [h.strip() for h in rows[0]]
    twice = sorted({h for h in header if h and header.count(h) > 1})
    if twice:
        raise ImportDataError(f"{path}: column {twice[0]!r} appears twice in the header")
    body = rows[1 + layout.skip_after_header :]
    for number, row in enumerate(body, start=layout.header_line + 1 + layout.skip_after_header):
        if len(row) != len(header):
            raise ImportDataError(f"{path}: table line {number} has {len(row)} cells, the header has {len(header)}")
    numeric: dict[str, Array] = {}
    words: dict[str, list[str]] = {}
    for i, name in enumerate(header):
        cells = [row[i].strip() for row in body]
        values = _numbers(cells, layout.decimal)
        if values is None:
            words[name] = cells
        elif name:
            numeric[name] = values
    return numeric, words


def _delimiter(line: str) -> str:
    return max((";", "\t", ","), key=line.count)


_EMPTY = {"", "nan", "na", "n/a", "null", "none", "-", "--"}


def _numbers(cells: list[str], decimal: str) -> Array | None:
    try:
        return np.array(
            [np.nan if c.lower() in _EMPTY else float(c.replace(",", ".") if decimal == "," else c) for c in cells],
            float,
        )
    except ValueError:
        return None


def _read_parquet(path: Path) -> tuple[dict[str, Array], dict[str, list[str]]]:
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
            numeric[name] = np.asarray(column.cast(pa.float64()).to_numpy(zero_copy_only=False), float)
        except pa.ArrowException:
            words[name] = [str(value) for value in column.to_pylist()]
    return numeric, words


def header_map(names: list[str]) -> Map:
    """A mapping guessed from headers that are flight columns, with or without a unit: 'phi', 'phi [deg]', 'V (knots)'."""
    columns: dict[str, tuple[Source, ...]] = {}
    time = None
    segment = None
    for name in names:
        match = _HEADER_UNIT.match(name)
        bare, unit = (match["name"], match["unit"]) if match else (name, "")
        if bare == "time" or (time is None and bare in ("t", "Time", "TIME", "time_s")):
            time = Time(column=name, unit=unit or "s")
        elif bare == "segment":
            segment = name
        elif bare in COLUMN_BY_NAME:
            stated = unit if find_unit(unit) is not None and unit else COLUMN_BY_NAME[bare].unit
            columns[bare] = (Source(column=name, unit=stated),)
    return Map(format=1, time=time, segment=segment, columns=columns)


def table_log(path: Path, numeric: dict[str, Array], words: dict[str, list[str]], time: Time | None) -> Log:
    """The table as series over its time column [s]. Raises ImportDataError when there is none."""
    if time is None:
        raise ImportDataError(
            f"{path}: no column 'time'; found {', '.join([*numeric, *words][:12])}; "
            "name the time column in a mapping file (--map)"
        )
    seconds = _seconds(path, numeric, words, time)
    series = {name: Series(seconds, values) for name, values in numeric.items() if name != time.column}
    return Log("table", series, common=True, text_columns=tuple(w for w in words if w != time.column))


def _seconds(path: Path, numeric: dict[str, Array], words: dict[str, list[str]], time: Time) -> Array:
    if time.column not in numeric and time.column not in words:
        raise ImportDataError(
            f"{path}: no column {time.column!r} for the time; found {', '.join([*numeric, *words][:12])}"
        )
    if time.unit == "iso":
        return _dates(path, words, time) + time.offset
    if time.column in words:
        bad = next((w for w in words[time.column] if _numbers([w], ".") is None), "")
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
    for cell in words.get(time.column, []):
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
