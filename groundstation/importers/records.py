"""Records of a flight: a log split where the autopilot was booted again, tables of one flight joined on time, and consecutive
records as one flight.

ulog2csv writes LOG_TOPIC_INSTANCE.csv with a column `timestamp` [us]; rosbag and other loggers write a table for each sensor. Two
tables are of one flight where they cover the same time and give different flight columns.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from daq.utilities.input_files import parse_toml, read_bytes, read_text
from groundstation.flight import AIRCRAFT_FILE, Flight
from groundstation.flight.arrays import Array
from groundstation.flight.contradictions import CONTRADICTIONS
from groundstation.flight.findings import Finding
from groundstation.flight.flight import CHANNELS
from groundstation.flight.marks import joined_marks, marks_of
from groundstation.importers.attitude import with_attitudes
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.tables import RECORD, read_table, table_log
from groundstation.importers.mapping import ColumnSource, FileFormat, Map, Time, built_in_map
from groundstation.importers.series import CLOCK_BACK_S, MESSAGE, RECORD_GAP, Log, TimeSeries

LEAST_OVERLAP = 0.5  # of two tables' times, over the shorter one, for both to be of one flight
SPIKE_STEPS, SHORTEST_STEP = 100.0, 1e-3
"""A last step of more than SPIKE_STEPS median steps leads to a damaged time; a median step is at least SHORTEST_STEP [s]."""
_STAMP = b"timestamp,"  # first bytes of a table of ulog2csv


# ------------------------------------------------------------------------------------------------------------------- boots


def by_boot(log: Log) -> list[Log]:
    """A log for each boot, in the order of the file; the log itself where its clock never goes back.

    Messages that were not written in every boot cannot be assigned to one; they are left out, with a note.
    """
    clocks = {id(s.time): s.time for s in log.series.values()}
    runs = {key: _clock_runs(time) for key, time in clocks.items()}
    count = max((len(r) for r in runs.values()), default=1)
    if count < 2:
        return [log]
    partial = {n.split(".")[0] for n, s in log.series.items() if len(runs[id(s.time)]) != count}
    excluded = f"messages that were not written in each of {count} boots are left out: {', '.join(sorted(partial))}"
    boots = []
    for number in range(count):
        times = {key: clocks[key][parts[number]] for key, parts in runs.items() if len(parts) == count}
        series = {
            n: TimeSeries(times[id(s.time)], s.values[runs[id(s.time)][number]])
            for n, s in log.series.items()
            if id(s.time) in times
        }
        note = f"boot {number + 1} of {count} in this log: imported as a separate record"
        notes = (note, excluded) if partial else (note,)
        boots.append(replace(log, series=series, notes=(*(log.notes if number == 0 else ()), *notes)))
    return boots


def _clock_runs(time: Array) -> list[slice]:
    """Ranges of rows between a clock's steps back; one range where the clock only steps back from single damaged times."""
    with np.errstate(invalid="ignore"):
        falls = np.flatnonzero(np.diff(time) < -CLOCK_BACK_S) + 1
    runs = [slice(a, b) for a, b in pairwise([0, *falls.tolist(), time.size])]
    damaged = any(
        following.stop - following.start < 2 or _ends_in_spike(time[previous]) for previous, following in pairwise(runs)
    )
    return [slice(0, time.size)] if damaged else runs


def _ends_in_spike(time: Array) -> bool:
    """Whether the last time is far above the one before it."""
    steps = np.diff(time)
    return steps.size < 2 or bool(steps[-1] > SPIKE_STEPS * max(float(np.median(steps)), SHORTEST_STEP))


# ------------------------------------------------------------------------------------------------------ a file for each topic


def topics_of_px4(paths: Sequence[Path]) -> Log | None:
    """The PX4 log whose topics ulog2csv wrote as these files, one for each; None for other files."""
    if not paths or any(p.suffix.lower() != ".csv" or not p.is_file() for p in paths):
        return None
    if not all(read_bytes(p, error=ImportDataError).startswith(_STAMP) for p in paths):
        return None
    topics = [_px4_topic(p.stem) for p in paths]
    if topics == [p.stem for p in paths]:
        return None
    series: dict[str, TimeSeries] = {}
    notes: list[str] = []
    time = Time(column="timestamp", unit="us")
    for path, topic in zip(paths, topics, strict=True):
        log = table_log(path, read_table(path, FileFormat(), time), time)
        columns = {n: s for n, s in log.series.items() if n != RECORD}
        series |= with_attitudes(
            {f"{topic}.{n}": TimeSeries(s.time + log.origin, s.values) for n, s in columns.items()}
        )
        notes += log.notes
    return Log("ulog", series, notes=(*notes, f"{len(paths)} topics of one PX4 log, joined on time"))


def _px4_topic(stem: str) -> str:
    """Topic of a file by its name, `vehicle_attitude` or `vehicle_attitude[1]`; the name itself for a topic in no mapping."""
    names = {name.split(".")[0] for name in built_in_map("px4").source_columns}
    names |= {"actuator_outputs", "actuator_servos"}
    fitting = [t for t in names if re.search(rf"(^|_){t}_\d{{1,2}}$", stem)]
    if not fitting:
        return stem
    topic, instance = max(fitting, key=len), stem.rsplit("_", 1)[1]
    return topic if instance == "0" else f"{topic}[{instance}]"


def joined_topics(tables: Sequence[tuple[Path, Log, Map]]) -> tuple[Log, Map] | None:
    """Tables of one flight as one log with its mapping; None where they are separate records. tables: path, log and mapping."""
    if len(tables) < 2 or any(not log.common or RECORD in log.series or not log.series for _, log, _ in tables):
        return None
    start = min(log.origin for _, log, _ in tables)
    times = [next(iter(log.series.values())).time + (log.origin - start) for _, log, _ in tables]
    columns = [_flight_columns(log, mapping) for _, log, mapping in tables]
    # topics of a bag have one clock and are no consecutive records, even where they give the same columns
    are_topics = all(MESSAGE in log.detail for _, log, _ in tables)
    if not all(columns) or (not are_topics and sum(map(len, columns)) > len(set().union(*columns))):
        return None
    if not all(_overlap(a, b) for a, b in combinations(times, 2)):
        return None
    series: dict[str, TimeSeries] = {}
    units: dict[str, str] = {}
    kinds: dict[str, str] = {}
    sources: dict[str, tuple[ColumnSource, ...]] = {}
    measured: set[str] = set()  # flight columns of the tables so far
    for (path, log, mapping), time, names in zip(tables, times, columns, strict=True):
        labels = {n: (n if n not in series else f"{path.stem}.{n}") for n in log.series}
        series |= {label: TimeSeries(time, log.series[n].values) for n, label in labels.items()}
        units |= {label: log.units[n] for n, label in labels.items() if n in log.units}
        kinds |= {labels.get(n, n): kind for n, kind in log.kinds.items()}
        new = {n: s for n, s in mapping.columns.items() if n not in sources or (n in names and n not in measured)}
        sources |= {n: tuple(_relabelled(source, labels) for source in s) for n, s in new.items()}
        measured |= names
        mapped = mapping.source_columns
        unmapped = [label for n, label in labels.items() if n not in mapped]
        sources |= {re.sub(r"\W+", "_", label): (ColumnSource(column=label, unit="1"),) for label in unmapped}
    notes = [n for _, log, _ in tables for n in log.notes]
    text = f"{len(tables)} files that cover the same time and hold different columns: joined on time as one flight"
    _, first, mapping = tables[0]
    log = replace(first, series=series, units=units, kinds=kinds, common=False, notes=(*notes, text), origin=start)
    return log, mapping.model_copy(update={"columns": sources, "segment": None, "segment_rows": ()})


def _relabelled(source: ColumnSource, labels: Mapping[str, str]) -> ColumnSource:
    """A source with the labels of its columns in the joined log; an expression is not changed."""
    terms = tuple(t.model_copy(update={"column": labels.get(t.column, t.column)}) for t in source.terms)
    return source.model_copy(update={"column": labels.get(source.column or "", source.column), "terms": terms})


def _flight_columns(log: Log, mapping: Map) -> set[str]:
    """The flight columns that a table contains by its mapping."""
    return {n for n, s in mapping.columns.items() if any(all(t.column in log.series for t in x.parts) for x in s)}


def _overlap(first: Array, second: Array) -> bool:
    """Whether two times (n,) [s] overlap by LEAST_OVERLAP of the shorter."""
    (a, b), (c, d) = ((float(np.nanmin(t)), float(np.nanmax(t))) for t in (first, second))
    return min(b, d) - max(a, c) > LEAST_OVERLAP * min(b - a, d - c)


# ---------------------------------------------------------------------------------------------------------- flights in a row


def joined_flights(flights: Sequence[Flight]) -> Flight:
    """Consecutive records as one flight, each with its own segments. A record that begins before the end of the last one is
    shifted in time, with a note. A column that a record lacks is NaN there."""
    if len(flights) == 1:
        return flights[0]
    times, segments, marks = [], [], []
    shifted = first_segment = 0
    end = -np.inf
    for flight in flights:
        time = flight.time
        if time[0] <= end:
            time, shifted = time - time[0] + end + RECORD_GAP, shifted + 1
        times.append(time)
        marks.append(marks_of(flight).moved(float(time[0] - flight.time[0])))
        segments.append(flight.segment + first_segment)
        end, first_segment = float(time[-1]), int(segments[-1][-1]) + 1
    names = list(dict.fromkeys(n for f in flights for n in f.columns))
    columns = {n: np.concatenate([f.columns[n] if n in f else np.full(len(f), np.nan) for f in flights]) for n in names}
    notes: list[Finding | str] = [n for f in flights for n in f.notes]
    notes.append(f"{len(flights)} records in a row, each with its own segments")
    if shifted:
        notes.append(f"{shifted} of them begin before the end of the previous one: moved to {RECORD_GAP:g} s after it")
    provenance = flights[0].provenance
    files = {f.provenance.path: f.provenance.sha256 for f in flights}
    detail = {
        **_joined_detail(flights),
        **joined_marks(marks).to_json(),
        **({"files": files} if len(files) > 1 else {}),
    }
    return Flight.build(
        flights[0].name,
        np.concatenate(times),
        columns,
        segment=np.concatenate(segments),
        provenance=replace(provenance, detail=detail),
        notes=notes,
    )


def _joined_detail(flights: Sequence[Flight]) -> dict[str, Any]:
    """The first record's detail, with the origins of columns that only later records have, and the contradictions of all between
    other quantities."""
    joined = dict(flights[0].provenance.detail)
    for detail in (f.provenance.detail for f in flights[1:]):
        for key in ("mapping", CHANNELS, "native_hz"):
            joined[key] = {**detail.get(key, {}), **joined.get(key, {})}
        earlier = joined.get(CONTRADICTIONS, [])
        sides = [c["between"] for c in earlier]
        further = [c for c in detail.get(CONTRADICTIONS, ()) if c["between"] not in sides]
        if further:
            joined[CONTRADICTIONS] = [*earlier, *further]
    return joined


def with_aircraft(flight: Flight, aircraft: str) -> Flight:
    """The flight with the name of a built-in aircraft, or with an embedded aircraft file, where `aircraft` is the path of one.
    Raises ImportDataError for a file that is not TOML."""
    if not aircraft.endswith(".toml"):
        return replace(flight, provenance=replace(flight.provenance, aircraft=aircraft))
    text = read_text(Path(aircraft), "aircraft file", ImportDataError)
    name = str(parse_toml(text, aircraft, ImportDataError).get("name") or Path(aircraft).stem)
    detail = MappingProxyType({**flight.provenance.detail, AIRCRAFT_FILE: text})
    return replace(flight, provenance=replace(flight.provenance, aircraft=name, detail=detail))
