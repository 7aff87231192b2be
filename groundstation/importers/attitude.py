"""Euler angles of the quaternions in foreign logs, scalar first, from north-east-down to the body."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from groundstation.flight.arrays import Array
from groundstation.importers.mapping import ColumnSource, Map
from groundstation.importers.series import Log, TimeSeries

QUATERNIONS = (
    tuple(f"q[{i}]" for i in range(4)),
    *(("q0", "q1", "q2", "q3"), ("qw", "qx", "qy", "qz"), ("q_w", "q_x", "q_y", "q_z")),
    tuple(f"quaternion_{i}" for i in range(4)),
    ("quat_w", "quat_x", "quat_y", "quat_z"),
)
"""What the elements are called, scalar first, behind the name of a topic if there is one."""
ANGLES = {"phi": "roll", "theta": "pitch", "psi": "yaw"}
UNIT_TOLERANCE = 0.05  # by which the length of a quaternion of an attitude may differ from 1


def euler_from_quaternion(w: Array, x: Array, y: Array, z: Array) -> dict[str, Array]:
    """Roll, pitch and yaw [rad]. Written out: scipy's Rotation takes longer to load than a log takes to read."""
    return {
        "roll": np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        "pitch": np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0)),
        "yaw": np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    }


def with_attitudes(series: Mapping[str, TimeSeries]) -> dict[str, TimeSeries]:
    """The series with `roll`, `pitch` and `yaw` [rad] beside each quaternion of attitude in them."""
    extended = dict(series)
    for head in dict.fromkeys(n.rpartition(".")[0] for n in series):
        prefix = f"{head}." if head else ""
        for names in QUATERNIONS:
            parts = [series[prefix + n] for n in names if prefix + n in series]
            if len(parts) < 4 or len({s.time.size for s in parts}) > 1:
                continue
            length = np.sqrt(sum((s.values**2 for s in parts), np.zeros(parts[0].time.size)))
            if not abs(float(np.nanmedian(length)) - 1.0) < UNIT_TOLERANCE:
                continue
            angles = euler_from_quaternion(*(s.values / np.where(length > 0, length, np.nan) for s in parts))
            for name, angle in angles.items():
                extended.setdefault(prefix + name, TimeSeries(parts[0].time, angle))
    return extended


def with_quaternion(log: Log, mapping: Map) -> tuple[Log, Map]:
    """The table with phi, theta and psi of its quaternion, where it has one and nothing else gives them; said in a note."""
    if any(angle in mapping.columns for angle in ANGLES):
        return log, mapping
    extended = with_attitudes(log.series)
    new = [n for n in extended if n not in log.series]
    columns = {a: next((n for n in new if n.rpartition(".")[2] == word), "") for a, word in ANGLES.items()}
    if not all(columns.values()):
        return log, mapping
    sources = {a: (ColumnSource(column=n, unit="rad"),) for a, n in columns.items()}
    series = {n: s for n, s in extended.items() if n in log.series or n in columns.values()}
    kinds = {**log.kinds, **dict.fromkeys(columns.values(), "computed")}
    note = "phi, theta, psi are of the quaternion, taken as scalar first and from north-east-down to the body"
    log = replace(log, series=series, kinds=kinds).with_notes(note)
    return log, mapping.model_copy(update={"columns": {**mapping.columns, **sources}})
