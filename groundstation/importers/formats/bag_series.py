"""Messages of a bag as time series: every number of every message, named by topic and field."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np

from groundstation.importers.series import LONGEST_ARRAY, Array, TimeSeries

MOST_LEVELS = 8  # of nested messages
MOST_NUMBERS = 2_000  # of one message
STAMPS = (("header.stamp.sec", "header.stamp.nanosec"), ("timestamp.seconds", "timestamp.nanos"))
"""Fields with seconds and nanoseconds of the sender's time stamp, in ROS and in Foxglove's messages."""


@dataclass
class Topic:
    """The messages of one topic. kind: of the messages (`sensor_msgs/Imu`); time: received [s]; columns: field -> its numbers,
    none after the last message with that field; words: text of each message."""

    name: str
    kind: str
    time: list[float] = field(default_factory=list)
    columns: dict[str, list[float]] = field(default_factory=dict)
    words: list[str] = field(default_factory=list)

    def add_message(self, time: float, row: Mapping[str, float], words: str = "") -> None:
        """Add a message with its numbers `row` by field; a field that it lacks is NaN."""
        count = len(self.time)
        for name, value in row.items():
            column = self.columns.setdefault(name, [])
            column += [np.nan] * (count - len(column))
            column.append(value)
        self.time.append(time)
        self.words.append(words)

    def series(self, prefix: str, unit_of_stamp: float | None = None) -> dict[str, TimeSeries]:
        """Series by `prefix.field`, in order of time. unit_of_stamp: [s] of a field `timestamp` that is the time; else
        `stamps`."""
        count = len(self.time)
        columns = {n: np.array([*v, *[np.nan] * (count - len(v))]) for n, v in self.columns.items()}
        time = self.stamps()
        if unit_of_stamp is not None and "timestamp" in columns:
            time = columns["timestamp"] * unit_of_stamp
        order = np.argsort(time, kind="stable")
        columns = {n: v for n, v in columns.items() if not n.startswith(("header.", "timestamp"))}
        return {f"{prefix}.{n}": TimeSeries(time[order], v[order]) for n, v in columns.items()}

    def stamps(self) -> Array:
        """(N,) time [s] of each message: the sender's stamps where all messages have one, else the times received."""
        for seconds, nanoseconds in STAMPS:
            parts = [np.array(self.columns.get(n, ())) for n in (seconds, nanoseconds)]
            if all(p.size == len(self.time) for p in parts) and np.all(parts[0] + parts[1] > 0):
                return np.asarray(parts[0] + 1e-9 * parts[1])
        return np.array(self.time)


def numbers_of(message: Any) -> dict[str, float]:
    """Every number in a message by its path, `linear_acceleration.x` or `channels[3]`; at most MOST_NUMBERS."""
    return dict(islice(_walk("", message, MOST_LEVELS), MOST_NUMBERS))


def _walk(name: str, value: Any, depth: int) -> Iterator[tuple[str, float]]:
    """Path and value of each number in `value`, down to `depth` levels."""
    if isinstance(value, bool | int | float | np.number):
        yield name, float(value)
    elif isinstance(value, str | bytes | None) or depth == 0:
        return
    elif isinstance(value, Mapping):
        for key, part in value.items():
            yield from _walk(f"{name}.{key}" if name else str(key), part, depth - 1)
    elif hasattr(value, "__len__") and hasattr(value, "__getitem__"):
        for i in range(len(value)) if len(value) <= LONGEST_ARRAY else ():
            yield from _walk(f"{name}[{i}]", value[i], depth - 1)
    else:
        for key in _fields(value):
            yield from _walk(f"{name}.{key}" if name else key, getattr(value, key), depth - 1)


def _fields(message: Any) -> list[str]:
    """Names of the fields of a decoded message, of protobuf or ROS."""
    descriptor = getattr(message, "DESCRIPTOR", None)
    if descriptor is not None:  # protobuf
        return [f.name for f in descriptor.fields]
    slots = getattr(message, "__slots__", None) or getattr(message, "__dict__", {})
    return [n for n in slots if not n.startswith("_")]
