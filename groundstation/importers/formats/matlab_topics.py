"""MATLAB files with a log by topics, each with its own times.

Mission Planner converts a .bin to a matrix for each message, `ATT`, with the names of its columns, `ATT_label`. Other programs
write a struct for each topic that contains its time.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from groundstation.flight.arrays import Array
from groundstation.importers.attitude import with_attitudes
from groundstation.importers.formats.dataflash import TIME_UNITS, with_velocities
from groundstation.importers.formats.matlab import FEWEST_ROWS
from groundstation.importers.mapping import ColumnSource, Map, built_in_map
from groundstation.importers.series import Log, TimeSeries, instance_rows

_LABEL = "_label"
_PX4_TIME = {"timestamp": 1e-6}
_TIME_IN_SECONDS = {"time": 1.0, "t": 1.0, "Time": 1.0, "time_s": 1.0}


def topics_of(variables: object) -> tuple[Log, Map] | None:
    """The topics of a MATLAB file as one log, with the mapping of its kind; None for a file without topics."""
    if not isinstance(variables, Mapping):
        return None
    topics = _labelled_matrices(variables) or _structs(variables)
    if len(topics) < 2:
        return None
    for kind, times, base in (("dataflash", TIME_UNITS, "ardupilot"), ("ulog", _PX4_TIME, "px4")):
        series = _series(topics, times, by_instance=kind == "dataflash")
        if series:
            log = Log(kind, with_attitudes(series))
            return with_velocities(log), built_in_map(base)
    series = _series(topics, _TIME_IN_SECONDS, by_instance=False)
    lengths = {s.time.size for s in series.values()}
    if len(lengths) < 2:
        return None  # topics of one length are records, or parts of one: `matlab.tables_of`
    log = Log("table", series, notes=(f"{len(topics)} topics with times of their own, joined on time",))
    return log, _map_by_name(series)


def _labelled_matrices(variables: Mapping[str, Any]) -> dict[str, dict[str, Array]]:
    """Topic -> column -> values (n,), of matrices with labels."""
    topics = {}
    for name, table in variables.items():
        labels = variables.get(f"{name}{_LABEL}")
        if not isinstance(table, np.ndarray) or table.ndim != 2 or not isinstance(labels, list):
            continue
        words = [str(w).strip() for w in labels]
        if table.shape[1] == len(words) and table.shape[0] >= FEWEST_ROWS:
            topics[name] = {word: np.asarray(table[:, i], float) for i, word in enumerate(words)}
    return topics


def _structs(variables: Mapping[str, Any]) -> dict[str, dict[str, Array]]:
    """Topic -> column -> values (n,), of structs of vectors."""
    topics = {}
    for name, content in variables.items():
        if isinstance(content, Mapping):
            fields = {n: np.ravel(v).astype(float) for n, v in content.items() if isinstance(v, np.ndarray)}
            if fields and len({v.size for v in fields.values()}) == 1:
                topics[name] = fields
    return topics


def _series(
    topics: Mapping[str, Mapping[str, Array]], times: Mapping[str, float], *, by_instance: bool
) -> dict[str, TimeSeries]:
    """Series 'TOPIC.field' of the topics that have a time; further instances, by a field I, as 'TOPIC[1].field'. times: field of
    the time -> its unit [s]."""
    series: dict[str, TimeSeries] = {}
    for topic, fields in topics.items():
        stamp = next((t for t in times if t in fields), None)
        if stamp is None:
            continue
        time = fields[stamp] * times[stamp]
        number = fields["I"] if by_instance and "I" in fields else np.zeros(time.size)
        for instance, use in instance_rows(topic, number).items():
            series |= {f"{instance}.{n}": TimeSeries(time[use], v[use]) for n, v in fields.items() if n != stamp}
    return series


def _map_by_name(series: Mapping[str, TimeSeries]) -> Map:
    """A mapping of the fields that have names of flight columns, in SI."""
    columns: dict[str, tuple[ColumnSource, ...]] = {}
    for name in series:
        label = name.rpartition(".")[2]
        if label in COLUMN_BY_NAME and label not in columns:
            columns[label] = (ColumnSource(column=name, unit=COLUMN_BY_NAME[label].unit),)
    return Map(format=1, columns=columns)
