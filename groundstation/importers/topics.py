"""Files of one flight with a topic each: joined on time, not put in a row.

ulog2csv writes LOG_TOPIC_INSTANCE.csv with a column `timestamp` [us]; rosbag and loggers of one's own write a table for each
sensor. Two tables are of one flight where they cover the same time and give different flight columns.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq.contract.input_files import read_bytes
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.attitude import with_attitudes
from groundstation.importers.formats.tables import RECORD, read_table, table_log
from groundstation.importers.mapping import ColumnSource, FileFormat, Map, Time, built_in_map
from groundstation.importers.series import Array, Log, TimeSeries

TOGETHER = 0.5
"""Share of the shorter of two tables that the longer must cover for both to be of one flight."""
_STAMP = b"timestamp,"


def topics_of_px4(paths: Sequence[Path]) -> Log | None:
    """The topics that ulog2csv has written of one log, as the log itself; None where the files are others."""
    if not paths or any(p.suffix.lower() != ".csv" or not p.is_file() for p in paths):
        return None
    if not all(read_bytes(p, error=ImportDataError).startswith(_STAMP) for p in paths):
        return None
    names = [_topic(p.stem) for p in paths]
    if names == [p.stem for p in paths]:
        return None
    series: dict[str, TimeSeries] = {}
    notes: list[str] = []
    for path, name in zip(paths, names, strict=True):
        time = Time(column="timestamp", unit="us")
        log = table_log(path, read_table(path, FileFormat(), time), time)
        moved = {f"{name}.{n}": TimeSeries(s.time + log.origin, s.values) for n, s in log.series.items() if n != RECORD}
        series |= with_attitudes(moved)
        notes += log.notes
    return Log("ulog", series, notes=(*notes, f"{len(paths)} topics of one PX4 log, joined on time"))


def _topic(stem: str) -> str:
    """`vehicle_attitude` or `vehicle_attitude[1]` from the name of a file."""
    known = {t.column.split(".")[0] for m in built_in_map("px4").columns.values() for s in m for t in s.parts}
    known |= {"actuator_outputs", "actuator_servos"}
    fitting = [t for t in known if re.search(rf"(^|_){t}_\d{{1,2}}$", stem)]
    if not fitting:
        return stem  # a topic that no mapping of ours names
    topic, instance = max(fitting, key=len), stem.rsplit("_", 1)[1]
    return topic if instance == "0" else f"{topic}[{instance}]"


def joined_topics(found: Sequence[tuple[Path, Log, Map]]) -> tuple[Log, Map] | None:
    """Tables of one flight as one log, each with times of its own; None where they are records of their own."""
    if len(found) < 2 or any(not log.common or RECORD in log.series or not log.series for _, log, _ in found):
        return None
    start = min(log.origin for _, log, _ in found)
    times = [_time(log) + (log.origin - start) for _, log, _ in found]
    columns = [_given(log, chosen) for _, log, chosen in found]
    if any(len(c) == 0 for c in columns) or sum(map(len, columns)) > len(set().union(*columns)):
        return None
    if not all(_together(a, b) for i, a in enumerate(times) for b in times[i + 1 :]):
        return None
    series: dict[str, TimeSeries] = {}
    units: dict[str, str] = {}
    sources: dict[str, tuple[ColumnSource, ...]] = {}
    for (path, log, chosen), time in zip(found, times, strict=True):
        moved = {n: (n if n not in series else f"{path.stem}.{n}") for n in log.series}
        series |= {to: TimeSeries(time, log.series[n].values) for n, to in moved.items()}
        units |= {to: log.units[n] for n, to in moved.items() if n in log.units}
        mapped = {t.column for s in chosen.columns.values() for one in s for t in one.parts}
        sources |= {n: s for n, s in chosen.columns.items() if n not in sources or n in _given(log, chosen)}
        sources |= {
            re.sub(r"\W+", "_", to): (ColumnSource(column=to, unit="1"),) for n, to in moved.items() if n not in mapped
        }
    first = found[0]
    notes = [n for _, log, _ in found for n in log.notes]
    said = f"{len(found)} files that cover the same time and hold different columns: joined on time as one flight"
    log = replace(first[1], series=series, units=units, common=False, notes=(*notes, said), origin=start)
    return log, first[2].model_copy(update={"columns": sources, "segment": None, "segment_rows": ()})


def _time(log: Log) -> Array:
    return next(iter(log.series.values())).time


def _given(log: Log, chosen: Map) -> set[str]:
    """Flight columns that a table gives."""
    return {n for n, s in chosen.columns.items() if any(all(t.column in log.series for t in one.parts) for one in s)}


def _together(first: Array, second: Array) -> bool:
    (a, b), (c, d) = ((float(np.nanmin(t)), float(np.nanmax(t))) for t in (first, second))
    return min(b, d) - max(a, c) > TOGETHER * min(b - a, d - c)
