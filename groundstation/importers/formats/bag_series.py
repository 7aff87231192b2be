"""Messages of a bag as series: every number of every message, under the name of its topic and field."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np

from groundstation.importers.series import Array, TimeSeries

LONGEST = 32  # elements of an array that become series: 32 outputs of an autopilot; longer ones are images and clouds
DEEPEST = 8  # messages within messages
MOST = 2_000  # numbers of one message
STAMPS = (("header.stamp.sec", "header.stamp.nanosec"), ("timestamp.seconds", "timestamp.nanos"))
"""Seconds and nanoseconds of the sender's own stamp: of ROS, and of Foxglove's messages."""


@dataclass
class Topic:
    """name, and kind of its messages (`sensor_msgs/Imu`); time received [s], numbers and words of each."""

    name: str
    kind: str
    time: list[float] = field(default_factory=list)
    columns: dict[str, list[float]] = field(default_factory=dict)
    words: list[str] = field(default_factory=list)

    def add_message(self, time: float, row: Mapping[str, float], words: str = "") -> None:
        """Keep a message; NaN where it lacks a field that others have."""
        count = len(self.time)
        for name, value in row.items():
            column = self.columns.setdefault(name, [])
            column += [np.nan] * (count - len(column))
            column.append(value)
        self.time.append(time)
        self.words.append(words)

    def series(self, prefix: str, unit_of_stamp: float | None = None) -> dict[str, TimeSeries]:
        """Series by `prefix.field`, by the sender's stamp where it has one, else by the time received [s].

        unit_of_stamp: of a field `timestamp`, of kinds that have their own.
        """
        count = len(self.time)
        columns = {n: np.array([*v, *[np.nan] * (count - len(v))]) for n, v in self.columns.items()}
        time = self.stamps()
        if unit_of_stamp is not None and "timestamp" in columns:
            time = columns["timestamp"] * unit_of_stamp
        order = np.argsort(time, kind="stable")
        columns = {n: v for n, v in columns.items() if not n.startswith(("header.", "timestamp"))}
        return {f"{prefix}.{n}": TimeSeries(time[order], v[order]) for n, v in columns.items()}

    def stamps(self) -> Array:
        """Time [s] of each message (N,): the sender's own where each has one, else that of its arrival."""
        for seconds, nanoseconds in STAMPS:
            parts = [np.array(self.columns.get(n, ())) for n in (seconds, nanoseconds)]
            if all(p.size == len(self.time) for p in parts) and np.all(parts[0] + parts[1] > 0):
                return np.asarray(parts[0] + 1e-9 * parts[1])
        return np.array(self.time)


def numbers_of(message: Any) -> dict[str, float]:
    """Every number in a message, by the path of its fields: `linear_acceleration.x`, `channels[3]`."""
    return dict(islice(_walk("", message, DEEPEST), MOST))


def _walk(name: str, value: Any, depth: int) -> Iterator[tuple[str, float]]:
    if isinstance(value, bool | int | float | np.number):
        yield name, float(value)
    elif isinstance(value, str | bytes | None) or depth == 0:
        return
    elif isinstance(value, Mapping):
        for key, part in value.items():
            yield from _walk(f"{name}.{key}" if name else str(key), part, depth - 1)
    elif hasattr(value, "__len__") and hasattr(value, "__getitem__"):
        for i in range(min(len(value), LONGEST)) if len(value) <= LONGEST else ():
            yield from _walk(f"{name}[{i}]", value[i], depth - 1)
    else:
        for key in _fields(value):
            yield from _walk(f"{name}.{key}" if name else key, getattr(value, key), depth - 1)


def _fields(message: Any) -> list[str]:
    descriptor = getattr(message, "DESCRIPTOR", None)
    if descriptor is not None:  # protobuf
        return [f.name for f in descriptor.fields]
    slots = getattr(message, "__slots__", None) or getattr(message, "__dict__", {})
    return [n for n in slots if not n.startswith("_")]
