"""Importing: foreign file, mapping, one time base, plausibility, provenance."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from daq.contract.input_files import check_file
from daq.contract.plain_words import listed, plain_name
from groundstation.flight import Flight, Provenance
from groundstation.flight.contradictions import CONTRADICTIONS
from groundstation.flight.files.reading import credible_values
from groundstation.flight.findings import Finding, FindingKind
from groundstation.flight.flight import CHANNELS
from groundstation.flight.marks import PARAMETERS
from groundstation.flight.quality.plausibility import suspicions
from groundstation.importers.boots import by_boot
from groundstation.importers.columns import flight_columns, spoken
from groundstation.importers.endings import BAGS, LOGS, TABLES
from groundstation.importers.errors import ImportDataError
from groundstation.importers.evidence import EVIDENCE
from groundstation.importers.formats.tables import RECORD
from groundstation.importers.functions import misnamed
from groundstation.importers.join import joined
from groundstation.importers.mapping import EXAMPLE, FileFormat, Map, built_in_map, load_map
from groundstation.importers.series import Log, TimeSeries, credible, grid, native_rate
from groundstation.importers.servos import outputs_elsewhere, with_servos
from groundstation.importers.topics import joined_topics, topics_of_px4

Array = NDArray[np.float64]

DEFAULT_RATE = 50.0
"""Highest rate [Hz] of the common time base of a log whose series have times of their own, unless stated."""

_NEEDED_BY_NONE = frozenset({"mx", "my", "mz"})
"""Columns that no model and no reconstruction reads: odd values of theirs are told, and stop nothing."""
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
    for one in paths:
        check_file(one, error=ImportDataError)
    records = [_record(one, log, chosen, rate_hz, accept_implausible) for one, log, chosen in _logs(paths, given)]
    return joined(records)


def _logs(paths: Sequence[Path], given: Map | None) -> list[tuple[Path, Log, Map]]:
    """The records of all files, each with its mapping; those of one flight with a topic each as one."""
    topics = topics_of_px4(paths) if given is None or given.time is None else None
    if topics is not None:
        base = built_in_map("px4")
        return [(paths[0], EVIDENCE[topics.kind](topics), given.over(base) if given else base)]
    found = [(one, log, chosen) for one in paths for log, chosen in read_logs(one, given)]
    together = joined_topics(found)
    return [(paths[0], *together)] if together is not None else found


def _record(path: Path, log: Log, chosen: Map, rate_hz: float | None, accept_implausible: bool) -> Flight:
    rate = rate_hz or chosen.rate_hz
    if not log.common or rate is not None:
        series, dropped = credible(log.series)
        said = (f"{dropped} samples with a time far from all others left out",) if dropped else ()
        log = replace(log, series=series, notes=(*log.notes, *said))
    log = replace(log, contradictions=(*log.contradictions, *misnamed(log, chosen)))
    log, no_output = with_servos(log, chosen.servos)
    time = _time_base(path, log, chosen, rate)
    if np.isfinite(time).sum() < 2:
        raise ImportDataError(f"{path}: fewer than two samples with a time in it")
    resampled = not log.common or rate is not None
    with np.errstate(over="ignore", invalid="ignore"):  # what is beyond any measurement is left out just below
        found = flight_columns(log, chosen, time, resampled)
    columns, beyond = credible_values(found.values)
    notes = [*found.notes, *beyond]
    if not columns:
        raise ImportDataError(
            f"{path}: nothing in it is known as a flight column; found {listed(log.series, 12)}; "
            "write a mapping file (--map)"
        )
    if chosen.title.startswith(EXAMPLE):
        notes.append("surfaces by the trim and travel of an example map: copy it and write down those of this aircraft")
    if no_output:
        notes.append(f"servo outputs named in the mapping and not in the file: {listed(no_output)}")
    notes += outputs_elsewhere(log, chosen.servos)
    notes = [*log.notes, *notes]
    suspected = suspicions(time, columns)
    doubts = [s.text for s in suspected if not set(s.columns) <= _NEEDED_BY_NONE]
    notes += [Finding(FindingKind.UNLIKELY, s.text) for s in suspected if set(s.columns) <= _NEEDED_BY_NONE]
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
            "mapping": {name: spoken(made.source) for name, made in found.made.items()},
            CHANNELS: {name: made.to_json(native_rate(TimeSeries(time, time))) for name, made in found.made.items()},
            "resampled_hz": float(1 / np.median(np.diff(time))) if resampled else None,
            "native_hz": {m.name: m.rate for m in found.made.values() if m.rate is not None},
            **({CONTRADICTIONS: [c.to_json() for c in log.contradictions]} if log.contradictions else {}),
            **log.detail,
            **log.marks.to_json(),
            **({PARAMETERS: dict(log.parameters)} if log.parameters else {}),
        },
    )
    segment = _segment(log, chosen, rate)
    return Flight.build(path.stem, time, columns, segment=segment, provenance=provenance, notes=notes)


def read_logs(path: Path, given: Map | None = None) -> list[tuple[Log, Map]]:
    """The records of a file, each with its mapping. Raises ImportDataError for a file that cannot be read."""
    suffix = path.suffix.lower()
    if suffix in TABLES:
        return _read_tables(path, given)
    if suffix in BAGS:
        log, made = _bag(path)
        return [(log, given.over(made) if given else made)]
    if suffix not in LOGS:
        return [_read_with_package(path, given)]
    readers: dict[str, Callable[[Path], list[Log]]] = {"px4": _ulog, "ardupilot": _dataflash, "mavlink": _tlog}
    name = LOGS[suffix]
    base = built_in_map(name)
    chosen = given.over(base) if given else base
    logs = [boot for log in readers[name](path) for boot in by_boot(log)]
    return [(EVIDENCE[log.kind](log), chosen) for log in logs]


def _read_with_package(path: Path, given: Map | None) -> tuple[Log, Map]:
    """A file of a kind that an installed package reads: entry point group `sideslip.importers`, named by the suffix."""
    packages = entry_points(group=ENTRY_POINTS)
    found = next((p for p in packages if p.name == path.suffix.lower().removeprefix(".")), None)
    if found is None:
        known = (*TABLES, *LOGS, *BAGS, *(f".{p.name}" for p in packages))
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
    from groundstation.importers.quaternion import with_quaternion

    layout = given.file if given else FileFormat()
    if path.suffix.lower() == ".mat":
        from groundstation.importers.formats.matlab import read_variables, tables_of
        from groundstation.importers.formats.matlab_topics import topics_of

        variables, left_out = read_variables(path)
        topics = topics_of(variables) if layout == FileFormat() and (given is None or given.time is None) else None
        if topics is not None:
            log, base = topics
            return [(EVIDENCE.get(log.kind, _as_it_is)(log), given.over(base) if given else base)]
        tables = tables_of(path, variables, left_out, layout)
    else:
        tables = [read_table(path, layout, given.time if given else None)]
    records = []
    for table in tables:
        guessed, notes = header_map(table, given.columns if given else ())
        chosen = given.over(guessed) if given else guessed
        log, chosen = with_quaternion(table_log(path, table, chosen.time), chosen)
        records.append((replace(log, notes=(*log.notes, *notes)), chosen))
    return records


def _as_it_is(log: Log) -> Log:
    return log


def _ulog(path: Path) -> list[Log]:
    from groundstation.importers.formats.ulog import read_ulog

    return [read_ulog(path)]


def _dataflash(path: Path) -> list[Log]:
    from groundstation.importers.formats.dataflash import read_dataflash

    return [read_dataflash(path)]


def _bag(path: Path) -> tuple[Log, Map]:
    from groundstation.importers.formats.bags import OURS, mcap_profile
    from groundstation.importers.ros import read_ros

    if path.suffix.lower() == ".mcap" and mcap_profile(path) == OURS:
        raise ImportDataError(
            f"{path}: written by this program: a flight is taken as it is, a raw recording by 'sideslip calibrate'"
        )
    return read_ros(path)


def _tlog(path: Path) -> list[Log]:
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


def _topics(log: Log) -> list[str]:
    return sorted({name.split(".")[0] for name in log.series})


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
