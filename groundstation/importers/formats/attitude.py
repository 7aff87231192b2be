"""Euler angles of a foreign log's quaternion."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from groundstation.importers.series import TimeSeries

Array = NDArray[np.float64]


def euler_from_quaternion(w: Array, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Roll, pitch and yaw [rad] of the body from the quaternion NED to body, scalar first."""
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


QUATERNIONS = (
    tuple(f"q[{i}]" for i in range(4)), ("q0", "q1", "q2", "q3"), ("qw", "qx", "qy", "qz"), ("q_w", "q_x", "q_y", "q_z"),
    tuple(f"quaternion_{i}" for i in range(4)), ("quat_w", "quat_x", "quat_y", "quat_z"),
)  # fmt: skip
"""What the elements are called, scalar first, NED to body, behind the name of a topic if there is one."""
_UNIT = 0.05
"""By which the length of a quaternion of an attitude may differ from 1."""


def with_attitudes(series: Mapping[str, TimeSeries]) -> dict[str, TimeSeries]:
    """The series with `roll`, `pitch` and `yaw` [rad] beside each quaternion of attitude in them."""
    out = dict(series)
    for head in dict.fromkeys(n.rpartition(".")[0] for n in series):
        lead = f"{head}." if head else ""
        for names in QUATERNIONS:
            parts = [series[lead + n] for n in names if lead + n in series]
            if len(parts) < 4 or len({s.time.size for s in parts}) > 1:
                continue
            length = np.sqrt(sum((s.values**2 for s in parts), np.zeros(parts[0].time.size)))
            if not abs(float(np.nanmedian(length)) - 1.0) < _UNIT:
                continue
            angles = euler_from_quaternion(*(s.values / np.where(length > 0, length, np.nan) for s in parts))
            made = zip(("roll", "pitch", "yaw"), angles, strict=True)
            out |= {lead + n: TimeSeries(parts[0].time, a) for n, a in made if lead + n not in out}
    return out
