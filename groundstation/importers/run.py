"""From a foreign file to a flight: reading, mapping, time base, plausibility, provenance."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.contract.recordings.profile import OURS, mcap_profile
from daq.utilities.input_files import check_file
from daq.utilities.plain_words import listed, plain_name
from groundstation.flight import Flight, Provenance
from groundstation.flight.arrays import Array
from groundstation.flight.contradictions import CONTRADICTIONS
from groundstation.flight.files.reading import credible_values
from groundstation.flight.findings import Finding, FindingKind
from groundstation.flight.flight import CHANNELS
from groundstation.flight.marks import PARAMETERS
from groundstation.flight.quality.plausibility import suspicions
from groundstation.importers.columns import ImportedColumns, flight_columns, source_text
from groundstation.importers.endings import BAGS, BEGINNINGS, LOGS, OTHERS, TABLES
from groundstation.importers.errors import ImportDataError
from groundstation.importers.evidence import EVIDENCE
from groundstation.importers.formats.bags import bag_files, parts_of_one_bag
from groundstation.importers.formats.tables import RECORD
from groundstation.importers.functions import function_contradictions
from groundstation.importers.mapping import EXAMPLE, FileFormat, Map, built_in_map, load_map
from groundstation.importers.records import by_boot, joined_flights, joined_topics, topics_of_px4
from groundstation.importers.series import (
    AVERAGING_RATIO,
    Log,
    TimeSeries,
    even_time_base,
    native_rate,
    without_damaged_times,
)
from groundstation.importers.servos import outputs_elsewhere, with_servos
from groundstation.importers.slips import without_slips

DEFAULT_RATE = 50.0
"""Highest rate [Hz] of the common time base of a log whose series have times of their own, unless stated."""
_UNUSED = frozenset({"mx", "my", "mz"})
"""Columns that no model and no reconstruction reads: implausible values in them become notes and do not stop the import."""
_MOTION = frozenset({"p", "q", "r", "ay", "az", "delta_e", "delta_a", "delta_r"})
"""Columns whose rate limits what a flight shows of fast modes."""
ENTRY_POINTS = "sideslip.importers"


def import_data(
    path: str | Path | Sequence[str | Path],
    mapping: Map | str | Path | None = None,
    *,
    rate_hz: float | None = None,
    accept_implausible: bool = False,
) -> Flight:
    """A flight from another program's data: .csv, .parquet, .mat, .ulg (PX4), .bin (ArduPilot), .tlog (MAVLink) or a bag.

    path: a file, or several that hold records in a row, each of which becomes a segment. mapping: a mapping file on top of the
    built-in one for the format. rate_hz: resample to an even time base (always done for logs, at most at DEFAULT_RATE unless
    stated). Values that look like another unit or sign raise ImportDataError with a hint, or become notes with
    `accept_implausible`.
    """
    paths = [Path(path)] if isinstance(path, (str, Path)) else [Path(p) for p in path]
    if not paths:
        raise ImportDataError("no file to import")
    user_map = load_map(mapping) if isinstance(mapping, (str, Path)) else mapping
    for file in paths:
        check_log(file)
    flight = joined_flights([_flight(*record, rate_hz, accept_implausible) for record in _records(paths, user_map)])
    if not any(np.isfinite(values).any() for values in flight.columns.values()):
        raise ImportDataError(f"{paths[0]}: no column holds a value beside the time")
    unknown = flight.unknown_columns
    if unknown and not any(flight.measured(c) for c in flight.known_columns):
        raise ImportDataError(
            f"{paths[0]}: Sideslip knows none of its columns ({listed(unknown)}); name them in a mapping (--map), which"
            f" 'sideslip import {paths[0]} --draft-map -o map.toml' drafts"
        )
    return flight


def refuse_others(path: Path) -> None:
    """Raises ImportDataError for a known kind of file that is not read, with advice on how to convert it."""
    advice = OTHERS.get(path.suffix.lower())
    if advice is not None:
        raise ImportDataError(f"{path}: {advice.format(file=path, stem=path.stem)}")


def refuse_misnamed(path: Path) -> None:
    """Raises ImportDataError for a file whose first bytes show another kind than its ending."""
    with path.open("rb") as file:
        head = file.read(max(map(len, BEGINNINGS)))
    kind, endings = next((v for begin, v in BEGINNINGS.items() if head.startswith(begin)), ("", ()))
    if kind and path.suffix.lower() not in endings:
        raise ImportDataError(f"{path}: by its first bytes {kind}; give it the ending {endings[0]}")


def check_log(path: Path) -> None:
    """Raises ImportDataError for a path that is neither an ordinary file nor the folder of a bag."""
    for file in bag_files(path) if path.is_dir() else [path]:
        check_file(file, error=ImportDataError)


def log_digest(path: Path) -> str:
    """SHA-256 of a log as hexadecimal digits; of a bag's folder, that of its files' digests joined."""
    digests = []
    for file in bag_files(path) if path.is_dir() else [path]:
        with file.open("rb") as stream:
            digests.append(hashlib.file_digest(stream, "sha256").hexdigest())
    return digests[0] if len(digests) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()


def _merged_map(user_map: Map | None, base: Map) -> Map:
    """The user's mapping on top of `base`."""
    return user_map.over(base) if user_map else base


def _records(paths: Sequence[Path], user_map: Map | None) -> list[tuple[Path, Log, Map]]:
    """The records of all files, each with its mapping; files with one topic each of the same flight are joined."""
    topics = topics_of_px4(paths) if user_map is None or user_map.time is None else None
    if topics is not None:
        return [(paths[0], EVIDENCE[topics.kind](topics), _merged_map(user_map, built_in_map("px4")))]
    records = [(part[0], log, mapping) for part in _grouped_by_bag(paths) for log, mapping in read_logs(part, user_map)]
    joined_record = joined_topics(records)
    return [(paths[0], *joined_record)] if joined_record is not None else records


def _grouped_by_bag(paths: Sequence[Path]) -> list[list[Path]]:
    """Groups of files: the parts of a bag that was split, and each other file by itself."""
    parts: list[list[Path]] = []
    for path in paths:
        if parts and parts_of_one_bag(parts[-1][-1], path):
            parts[-1].append(path)
        else:
            parts.append([path])
    return parts


def _flight(path: Path, log: Log, mapping: Map, rate_hz: float | None, accept_implausible: bool) -> Flight:
    """The flight of one record. Raises ImportDataError for too few samples, no known column, or implausible values."""
    rate = rate_hz or mapping.rate_hz
    resampled = not log.common or rate is not None
    if resampled:
        series, outliers = without_damaged_times(log.series)
        log = replace(log, series=series)
        log = log.with_notes(f"{outliers} samples with a time far from all others left out") if outliers else log
    log = replace(log, contradictions=(*log.contradictions, *function_contradictions(log, mapping)))
    log, no_output = with_servos(log, mapping.servos)
    time = _time_base(path, log, mapping, rate)
    if np.isfinite(time).sum() < 2:
        raise ImportDataError(f"{path}: fewer than two samples with a time in it")
    with np.errstate(over="ignore", invalid="ignore"):  # `credible_values` removes what overflows
        imported = flight_columns(log, mapping, time, resampled)
    columns, value_notes = credible_values(imported.values)
    columns, slips = without_slips(time, columns)
    if not columns:
        raise ImportDataError(
            f"{path}: nothing in it is known as a flight column; found {listed(log.series, 12)}; "
            "write a mapping file (--map)"
        )
    notes = [*log.notes, *imported.notes, *value_notes, *slips]
    if mapping.title.startswith(EXAMPLE) and mapping.servos:
        notes.append("surfaces by the trim and travel of an example map: copy it and write down those of this aircraft")
    if no_output:
        notes.append(f"servo outputs named in the mapping and not in the file: {listed(no_output)}")
    notes += outputs_elsewhere(log, mapping.servos)
    notes += _averaging_notes(imported, rate)
    notes += _plausibility_notes(path, time, columns, accept_implausible)
    provenance = _provenance(path, log, mapping, imported, time, resampled)
    segment = _segment(log, mapping, rate)
    return Flight.build(path.stem, time, columns, segment=segment, provenance=provenance, notes=notes)


def _plausibility_notes(
    path: Path, time: Array, columns: Mapping[str, Array], accept_implausible: bool
) -> list[Finding | str]:
    """Notes on implausible values (N,). Raises ImportDataError for those of columns in use, unless they are accepted."""
    suspected = suspicions(time, columns)
    harmless = [s for s in suspected if set(s.columns) <= _UNUSED]
    serious = [s.text for s in suspected if s not in harmless]
    if serious and not accept_implausible:
        raise ImportDataError(
            f"{path}: {'; '.join(serious)}; if the data are right as they are, add --accept-implausible"
        )
    return [*(Finding(FindingKind.UNLIKELY, s.text) for s in harmless), *serious]


def _averaging_notes(imported: ImportedColumns, rate: float | None) -> list[str]:
    """A note where a requested rate averages motion and surfaces that the log has at a higher rate."""
    if rate is None:
        return []
    rates = {n: c.rate for n, c in imported.origins.items() if n in _MOTION and c.rate is not None}
    fast = {n: native for n, native in rates.items() if native >= AVERAGING_RATIO * rate}
    if not fast:
        return []
    return [
        f"{listed(fast)} logged at {max(fast.values()):.3g} Hz, averaged to the {rate:g} Hz asked for: information on fast modes "
        "and surface steps is lost, and bounds are wider than at the log's own rate"
    ]


def _provenance(
    path: Path, log: Log, mapping: Map, imported: ImportedColumns, time: Array, resampled: bool
) -> Provenance:
    origins = imported.origins
    base_rate = native_rate(TimeSeries(time, time))
    detail = {
        "format": log.kind,
        "mapping": {name: source_text(column.source) for name, column in origins.items()},
        CHANNELS: {name: column.to_json(base_rate) for name, column in origins.items()},
        "resampled_hz": float(1 / np.median(np.diff(time))) if resampled else None,
        "native_hz": {column.name: column.rate for column in origins.values() if column.rate is not None},
        **({CONTRADICTIONS: [c.to_json() for c in log.contradictions]} if log.contradictions else {}),
        **log.detail,
        **log.marks.to_json(),
        **({PARAMETERS: dict(log.parameters)} if log.parameters else {}),
    }
    return Provenance("imported", str(path), log_digest(path), plain_name(mapping.aircraft), detail=detail)


def read_logs(path: Path | Sequence[Path], user_map: Map | None = None) -> list[tuple[Log, Map]]:
    """The records of a file, each with its mapping. path: a bag may also be its folder, or the files that it was split into.

    Raises ImportDataError for a file that cannot be read.
    """
    paths = [path] if isinstance(path, Path) else list(path)
    path = paths[0]
    suffix = path.suffix.lower()
    if path.is_dir():
        paths = bag_files(path)
    else:
        refuse_others(path)
        refuse_misnamed(path)
    if path.is_dir() or suffix in BAGS:
        log, base = _read_bag(paths)
        return [(log, _merged_map(user_map, base))]
    if suffix in TABLES:
        return _read_tables(path, user_map)
    if suffix not in LOGS:
        log, base = _package_reader(path)(path)
        return [(log, _merged_map(user_map, base))]
    kind = LOGS[suffix]
    mapping = _merged_map(user_map, built_in_map(kind))
    boots = [boot for log in _read_autopilot(kind, path) for boot in by_boot(log)]
    return [(EVIDENCE[log.kind](log), mapping) for log in boots]


def _read_autopilot(kind: str, path: Path) -> list[Log]:
    if kind == "px4":
        from groundstation.importers.formats.ulog import read_ulog

        return [read_ulog(path)]
    if kind == "ardupilot":
        from groundstation.importers.formats.dataflash import read_dataflash

        return [read_dataflash(path)]
    from groundstation.importers.formats.tlog import read_tlog

    return read_tlog(path)


def _read_bag(paths: Sequence[Path]) -> tuple[Log, Map]:
    from groundstation.importers.ros import read_ros

    if paths[0].suffix.lower() == ".mcap" and mcap_profile(paths[0]) == OURS:
        raise ImportDataError(
            f"{paths[0]}: written by this program: a flight is taken as it is, a raw recording by 'sideslip calibrate'"
        )
    return read_ros(paths)


def _package_reader(path: Path) -> Callable[[Path], tuple[Log, Map]]:
    """The reader of an installed package for this kind of file: entry point group `sideslip.importers`, named by the suffix."""
    packages = entry_points(group=ENTRY_POINTS)
    package = next((p for p in packages if p.name == path.suffix.lower().removeprefix(".")), None)
    if package is None:
        endings = (*TABLES, *LOGS, *BAGS, *(f".{p.name}" for p in packages))
        raise ImportDataError(f"{path}: files of this kind are not known; give {', '.join(endings)}")
    try:
        reader: Callable[[Path], tuple[Log, Map]] = package.load()
    except (ImportError, AttributeError) as error:
        raise ImportDataError(
            f"entry point {ENTRY_POINTS} {package.name} = {package.value}: no reader there ({error})"
        ) from error
    return reader


def _read_tables(path: Path, user_map: Map | None) -> list[tuple[Log, Map]]:
    from groundstation.importers.attitude import with_quaternion
    from groundstation.importers.formats.tables import header_map, read_table, table_log

    layout = user_map.file if user_map else FileFormat()
    if path.suffix.lower() == ".mat":
        from groundstation.importers.formats.matlab import read_variables, tables_of
        from groundstation.importers.formats.matlab_topics import topics_of

        variables, excluded = read_variables(path)
        guess = layout == FileFormat() and (user_map is None or user_map.time is None)
        topics = topics_of(variables) if guess else None
        if topics is not None:
            log, base = topics
            return [(EVIDENCE[log.kind](log) if log.kind in EVIDENCE else log, _merged_map(user_map, base))]
        tables = tables_of(path, variables, excluded, layout)
    else:
        tables = [read_table(path, layout, user_map.time if user_map else None)]
    records = []
    for table in tables:
        guessed, notes = header_map(table, user_map.columns if user_map else ())
        mapping = _merged_map(user_map, guessed)
        log, mapping = with_quaternion(table_log(path, table, mapping.time), mapping)
        if table.of_topic:
            from groundstation.importers.ros import of_topic_table

            log, mapping = of_topic_table(path, log, mapping)
        records.append((log.with_notes(*notes), mapping))
    return records


def _time_base(path: Path, log: Log, mapping: Map, rate: float | None) -> Array:
    """(N,) [s]: the times of a table where no rate is requested, else even ones."""
    if log.common and rate is None:
        return next(iter(log.series.values())).time if log.series else np.zeros(0)
    mapped = mapping.source_columns
    series = {n: s for n, s in log.series.items() if n in mapped and s.time.size >= 2}
    if not series:
        topics = sorted({name.split(".")[0] for name in log.series})
        raise ImportDataError(
            f"{path}: none of the expected messages is in this log; it has {listed(topics, 15) or 'nothing'}; "
            "name columns in a mapping file (--map; --draft-map proposes one)"
        )
    fastest = max(native_rate(s) for s in series.values())
    return even_time_base(series, rate or min(DEFAULT_RATE, fastest))


def _segment(log: Log, mapping: Map, rate: float | None) -> NDArray[np.int64] | None:
    """(N,) segment of each row by the mapping or the file's records; None for one segment, and after resampling."""
    if rate is not None:
        return None
    count = len(next(iter(log.series.values())).values) if log.series else 0
    if mapping.segment_rows:
        if not log.common or sum(mapping.segment_rows) != count:
            raise ImportDataError(f"segment_rows adds up to {sum(mapping.segment_rows)} rows; the file has {count}")
        return np.repeat(np.arange(len(mapping.segment_rows)), mapping.segment_rows)
    name = mapping.segment or (RECORD if log.common and RECORD in log.series else None)
    if name is None or name not in log.series:
        return None
    values = log.series[name].values
    if not np.all(np.isfinite(values)):
        raise ImportDataError(f"column {name}: empty cells; give an integer in each row or leave the column out")
    return values.astype(np.int64)
