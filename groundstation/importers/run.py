"""Importing: foreign file, mapping, one time base, plausibility, provenance."""

import hashlib
import re
import unicodedata
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from daq.contract.input_files import check_file
from daq.contract.plain_words import LONGEST_NAME, listed, plain_name
from groundstation.flight import Flight, Provenance
from groundstation.flight.credible_columns import credible_values
from groundstation.flight.notes import Note, unknown_columns
from groundstation.flight.quality.plausibility import suspicions
from groundstation.importers.endings import LOGS, TABLES
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.tables import RECORD
from groundstation.importers.join import joined
from groundstation.importers.mapping import EXAMPLE, FileFormat, Map, Source, built_in_map, load_map
from groundstation.importers.series import Log, Series, credible, grid, native_rate, resample
from groundstation.importers.servos import with_servos
from groundstation.importers.units import conversion, find_unit, known_units

Array = NDArray[np.float64]

DEFAULT_RATE = 50.0
"""Highest rate [Hz] of the common time base of a log whose series have times of their own, unless stated."""

_WRAPPED = ("phi", "psi")
ENTRY_POINTS = "sideslip.importers"


def import_data(
    path: str | Path | Sequence[str | Path],
    mapping: Map | str | Path | None = None,
    *,
    rate_hz: float | None = None,
    accept_implausible: bool = False,
) -> Flight:
    """A flight from somebody else's data: .csv, .parquet, .mat, .ulg (PX4), .bin (ArduPilot) or .tlog (MAVLink).

    path: a file, or several that hold records in a row, each of which becomes a segment. mapping: a mapping file on top of the
    built-in one for the format. rate_hz: resample to an even time base (always done for logs, at most at DEFAULT_RATE unless
    stated). Values that look like another unit or sign raise ImportDataError with a hint, or become notes with
    `accept_implausible`.
    """
    paths = [Path(path)] if isinstance(path, (str, Path)) else [Path(p) for p in path]
    if not paths:
        raise ImportDataError("no file to import")
    given = load_map(mapping) if isinstance(mapping, (str, Path)) else mapping
    records = []
    for one in paths:
        check_file(one, error=ImportDataError)
        records += [_record(one, log, chosen, rate_hz, accept_implausible) for log, chosen in read_logs(one, given)]
    return joined(records)


def _record(path: Path, log: Log, chosen: Map, rate_hz: float | None, accept_implausible: bool) -> Flight:
    rate = rate_hz or chosen.rate_hz
    if not log.common or rate is not None:
        series, dropped = credible(log.series)
        said = (f"{dropped} samples with a time far from all others left out",) if dropped else ()
        log = replace(log, series=series, notes=(*log.notes, *said))
    log, no_output = with_servos(log, chosen.servos)
    time = _time_base(path, log, chosen, rate)
    if np.isfinite(time).sum() < 2:
        raise ImportDataError(f"{path}: fewer than two samples with a time in it")
    with np.errstate(over="ignore", invalid="ignore"):  # what is beyond any measurement is left out just below
        columns, used, notes = _columns(log, chosen, time)
    columns, beyond = credible_values(columns)
    notes += beyond
    if not columns:
        raise ImportDataError(
            f"{path}: nothing in it is known as a flight column; found {listed(log.series, 12)}; "
            "write a mapping file (--map)"
        )
    if chosen.title.startswith(EXAMPLE):
        notes.append("surfaces by the trim and travel of an example map: copy it and write down those of this aircraft")
    if no_output:
        notes.append(f"servo outputs named in the mapping and not in the file: {listed(no_output)}")
    notes = [*log.notes, *notes]
    doubts = [s.text for s in suspicions(time, columns)]
    if doubts and not accept_implausible:
        raise ImportDataError(
            f"{path}: {'; '.join(doubts)}; if the data are right as they are, add --accept-implausible"
        )
    notes += doubts
    provenance = Provenance(
        source="imported",
        path=str(path),
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        aircraft=plain_name(chosen.aircraft),
        detail={
            "format": log.kind,
            "mapping": {name: _spoken(source) for name, source in used.items()},
            "resampled_hz": None if log.common and rate is None else float(1 / np.median(np.diff(time))),
            "native_hz": {} if log.common and rate is None else _native_rates(log, used),
            **log.detail,
        },
    )
    segment = _segment(log, chosen, rate)
    return Flight.build(path.stem, time, columns, segment=segment, provenance=provenance, notes=notes)


def read_logs(path: Path, given: Map | None = None) -> list[tuple[Log, Map]]:
    """The records of a file, each with its mapping. Raises ImportDataError for a file that cannot be read."""
    suffix = path.suffix.lower()
    if suffix in TABLES:
        return _read_tables(path, given)
    if suffix not in LOGS:
        return [_read_with_package(path, given)]
    readers: dict[str, Callable[[Path], Log]] = {"px4": _ulog, "ardupilot": _dataflash, "mavlink": _tlog}
    name = LOGS[suffix]
    base = built_in_map(name)
    return [(readers[name](path), given.over(base) if given else base)]


def _read_with_package(path: Path, given: Map | None) -> tuple[Log, Map]:
    """A file of a kind that an installed package reads: entry point group `sideslip.importers`, named by the suffix."""
    packages = entry_points(group=ENTRY_POINTS)
    found = next((p for p in packages if p.name == path.suffix.lower().removeprefix(".")), None)
    if found is None:
        known = (*TABLES, *LOGS, *(f".{p.name}" for p in packages))
        raise ImportDataError(f"{path}: files of this kind are not known; give {', '.join(known)}")
    try:
        log, base = found.load()(path)
    except (ImportError, AttributeError) as error:
        raise ImportDataError(
            f"entry point {ENTRY_POINTS} {found.name} = {found.value}: no reader there ({error})"
        ) from error
    return log, given.over(base) if given else base


def _read_tables(path: Path, given: Map | None) -> list[tuple[Log, Map]]:
    from groundstation.importers.formats.tables import header_map, read_table, table_log

    layout = given.file if given else FileFormat()
    if path.suffix.lower() == ".mat":
        from groundstation.importers.formats.matlab import read_matlab

        tables = read_matlab(path, layout)
    else:
        tables = [read_table(path, layout, given.time if given else None)]
    records = []
    for table in tables:
        guessed, notes = header_map(table, given.columns if given else ())
        chosen = given.over(guessed) if given else guessed
        log = table_log(path, table, chosen.time)
        records.append((replace(log, notes=(*log.notes, *notes)), chosen))
    return records


def _ulog(path: Path) -> Log:
    from groundstation.importers.formats.ulog import read_ulog

    return read_ulog(path)


def _dataflash(path: Path) -> Log:
    from groundstation.importers.formats.dataflash import read_dataflash

    return read_dataflash(path)


def _tlog(path: Path) -> Log:
    from groundstation.importers.formats.tlog import read_tlog

    return read_tlog(path)


def _time_base(path: Path, log: Log, chosen: Map, rate: float | None) -> Array:
    if log.common and rate is None:
        return next(iter(log.series.values())).time if log.series else np.zeros(0)
    wanted = {t.column for sources in chosen.columns.values() for s in sources for t in s.parts}
    series = {n: s for n, s in log.series.items() if n in wanted and s.time.size >= 2}
    if not series:
        raise ImportDataError(
            f"{path}: none of the expected messages is in this log; it has {listed(_topics(log), 15) or 'nothing'}; "
            "name columns in a mapping file (--map)"
        )
    fastest = max(native_rate(s) for s in series.values())
    return grid(series, rate or min(DEFAULT_RATE, fastest))


def _native_rates(log: Log, used: dict[str, Source]) -> dict[str, float]:
    """Rate [Hz] of the slowest series of each column, before all were brought to one time base."""
    return {n: min(native_rate(log.series[t.column]) for t in s.parts) for n, s in used.items()}


def _topics(log: Log) -> list[str]:
    return sorted({name.split(".")[0] for name in log.series})


def _columns(log: Log, chosen: Map, time: Array) -> tuple[dict[str, Array], dict[str, Source], list[Note | str]]:
    columns: dict[str, Array] = {}
    used: dict[str, Source] = {}
    absent: list[str] = []
    for name, sources in chosen.columns.items():
        source = next((s for s in sources if all(t.column in log.series for t in s.parts)), None)
        if source is None:
            absent.append(f"{name} ({' + '.join(t.column for t in sources[0].parts)})")
            continue
        used[name] = source.model_copy(update={"unit": _unit(log, source, name)})
        columns[name] = _value(log, used[name], name, time)
    notes: list[Note | str] = [f"not in the file, so not measured: {listed(absent, 60)}"] if absent else []
    taken = {t.column for s in used.values() for t in s.parts} | {chosen.segment or RECORD, RECORD}
    if log.common:
        left = {n: _plain_name(n, set(columns)) for n in log.series if n not in taken}
        columns.update(
            {
                to: log.series[n].values if time is log.series[n].time else resample(log.series[n], time)
                for n, to in left.items()
            }
        )
        if left:
            notes.append(unknown_columns({to: n for n, to in left.items()}))
        if log.text_columns:
            notes.append(f"columns that are not numbers, left out: {listed(log.text_columns)}")
    return columns, used, notes


def _plain_name(name: str, taken: set[str]) -> str:
    """A column name of letters, digits and underscores, as the flight format needs it; not one that is taken."""
    ascii_name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    plain = re.sub(r"\W+", "_", ascii_name[:LONGEST_NAME]).strip("_") or "column"
    plain = f"_{plain}" if plain[0].isdigit() else plain
    if plain in ("time", "segment") or (plain != name and plain in COLUMN_BY_NAME):
        plain += "_other"
    first, number = plain, 1
    while plain in taken:
        plain, number = f"{first}_{number}", number + 1
    taken.add(plain)
    return plain


def _unit(log: Log, source: Source, name: str) -> str:
    """The unit of a source: as the mapping states it, else as the file does. Raises ImportDataError where one is needed and
    neither does."""
    if source.unit is not None:
        return source.unit
    stated = {log.units.get(t.column, "") for t in source.parts}
    if len(stated) == 1 and find_unit(unit := stated.pop()) is not None and unit:
        return unit
    si = COLUMN_BY_NAME[name].unit if name in COLUMN_BY_NAME else "1"
    if si == "1":
        return si
    named = listed(t.column for t in source.parts)
    raise ImportDataError(
        f"column {name}: the mapping does not say in which unit {named} is; add it, for example "
        f'{name} = {{ column = "{named}", unit = "{si}" }}, or one of: {known_units(si)}'
    )


def _value(log: Log, source: Source, name: str, time: Array) -> Array:
    si = COLUMN_BY_NAME[name].unit if name in COLUMN_BY_NAME else None
    scale, offset = conversion(source.unit or "1", name, si) if si is not None else (1.0, 0.0)
    total = np.zeros(time.size)
    for term in source.parts:
        series = log.series[term.column]
        values = (
            series.values if time is series.time else resample(_unwrapped(series, name, scale), time, hold=source.hold)
        )
        total = total + term.factor * values
    value = (source.sign * source.factor * total + source.offset) * scale + offset
    if name in _WRAPPED and not log.common:
        value = (value + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(value)


def _unwrapped(series: Series, name: str, scale: float) -> Series:
    """A heading made continuous before it is interpolated: between 359 and 1 deg lies 0, not 180."""
    if name not in _WRAPPED:
        return series
    values = series.values.copy()
    good = np.isfinite(values)
    values[good] = np.unwrap(values[good] * scale) / scale
    return Series(series.time, values)


def _segment(log: Log, chosen: Map, rate: float | None) -> NDArray[np.int64] | None:
    if rate is not None:
        return None
    count = len(next(iter(log.series.values())).values) if log.series else 0
    if chosen.segment_rows:
        if not log.common or sum(chosen.segment_rows) != count:
            raise ImportDataError(f"segment_rows adds up to {sum(chosen.segment_rows)} rows; the file has {count}")
        return np.repeat(np.arange(len(chosen.segment_rows)), chosen.segment_rows)
    name = chosen.segment or (RECORD if log.common and RECORD in log.series else None)
    if name is None or name not in log.series:
        return None
    values = log.series[name].values
    if not np.all(np.isfinite(values)):
        raise ImportDataError(f"column {name}: empty cells; give an integer in each row or leave the column out")
    return values.astype(np.int64)


def _spoken(source: Source) -> str:
    """How a column was made, for the provenance."""
    terms = " + ".join(t.column if t.factor == 1 else f"{t.factor:g} {t.column}" for t in source.parts)
    sign = "-" if source.sign < 0 else ""
    factor = "" if source.factor == 1 else f"{source.factor:g} "
    shift = f" + {source.offset:g}" if source.offset else ""
    return f"{sign}{factor}({terms}){shift} [{source.unit}]"
