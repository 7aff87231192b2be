"""A flight as an MCAP file that Foxglove draws without a plug-in, and that `read_flight` still reads.

Beside the flight's own samples (`/flight`, every column a plottable scalar) it holds `foxglove.LocationFix` for the map,
`foxglove.FrameTransform` for the 3D panel and `foxglove.Log` for the events, all stamped in UTC where the flight knows
it. Frames follow REP 103, which the 3D panel expects: `world` is east, north, up from the first fix; `aircraft` is x
forward, y left, z up. For rerun, whose importer does not plot `/flight`, the columns are there once more as ROS 2 `JointState`,
under `/scalars`, grouped as in the live view.
"""

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.constants import EARTH_RADIUS
from daq.utilities.durable import whole
from groundstation.export.tracks import height_above_sea, stamps_ns
from groundstation.flight import Array, Flight
from groundstation.flight.marks import EVENTS, rows_of
from groundstation.flight.writing import Encoded, open_flight_writer


def write_foxglove(flight: Flight, path: Path) -> None:
    """Write the file; topics without values (no GPS, no attitude) are absent."""
    stamps = stamps_ns(flight)
    with whole(path) as new, open_flight_writer(flight, new, stamps) as add:
        messages = [m for messages_of in (_fixes, _poses, _events, _scalars) for m in messages_of(flight, stamps)]
        for topic, stamp, message in sorted(messages, key=lambda row: row[1]):
            add(topic, stamp, message)


def _scalars(flight: Flight, stamps: NDArray[np.int64]) -> Iterator[tuple[str, int, Encoded]]:
    """Messages with the columns that are drawn together, at each sample in which one of them has a value."""
    groups: dict[str, list[str]] = {}
    for name in flight.columns:
        if flight.measured(name):
            column = COLUMN_BY_NAME.get(name)
            groups.setdefault(column.entity if column else "/others", []).append(name)
    for entity, names in groups.items():
        units = [COLUMN_BY_NAME[n].unit if n in COLUMN_BY_NAME else "" for n in names]
        joints = JointStates([f"{n} [{u}]" if u not in ("", "1") else n for n, u in zip(names, units, strict=True)])
        table = np.column_stack([flight[n] for n in names])
        for i in np.flatnonzero(np.isfinite(table).any(axis=1)):
            data = joints.encode(int(stamps[i]), table[i].tolist())
            message = Encoded(data, SCHEMA, SCHEMA_ENCODING, DEFINITION, MESSAGE_ENCODING)
            yield f"/scalars{entity}", int(stamps[i]), message


def _fixes(flight: Flight, stamps: NDArray[np.int64]) -> Iterator[tuple[str, int, Any]]:
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

    if not (flight.measured("latitude") and flight.measured("longitude")):
        return
    height = height_above_sea(flight)
    for i in np.flatnonzero(np.isfinite(flight["latitude"]) & np.isfinite(flight["longitude"])):
        fix = LocationFix(frame_id="gnss", latitude=flight["latitude"][i], longitude=flight["longitude"][i])
        if np.isfinite(height[i]):
            fix.altitude = height[i]
        yield "/gnss/fix", int(stamps[i]), _stamped(fix, int(stamps[i]))


def _poses(flight: Flight, stamps: NDArray[np.int64]) -> Iterator[tuple[str, int, Any]]:
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

    if not all(flight.measured(name) for name in ("phi", "theta", "psi")):
        return
    position = local_position(flight)
    rotation = quaternion_flu_to_enu(flight["phi"], flight["theta"], flight["psi"])
    for i in np.flatnonzero(np.isfinite(rotation).all(axis=1) & np.isfinite(position).all(axis=1)):
        pose = FrameTransform(parent_frame_id="world", child_frame_id="aircraft")
        pose.translation.x, pose.translation.y, pose.translation.z = position[i].tolist()
        pose.rotation.w, pose.rotation.x, pose.rotation.y, pose.rotation.z = rotation[i].tolist()
        yield "/tf", int(stamps[i]), _stamped(pose, int(stamps[i]))


def _events(flight: Flight, stamps: NDArray[np.int64]) -> Iterator[tuple[str, int, Any]]:
    from foxglove_schemas_protobuf.Log_pb2 import Log

    shift = int(stamps[0]) - round(float(flight.time[0]) * 1e9)
    for event in rows_of(flight.provenance.detail, EVENTS, ("time",), "text"):
        stamp = max(0, round(float(event["time"]) * 1e9) + shift)
        log = Log(level=Log.INFO, name=str(event.get("origin", "")), message=event["text"])
        yield "/events", stamp, _stamped(log, stamp)
    for note in flight.notes:
        stamp = int(stamps[0])
        yield "/events", stamp, _stamped(Log(level=Log.WARNING, name="flight", message=note.text), stamp)


def _stamped(message: Any, stamp: int) -> Any:
    message.timestamp.FromNanoseconds(stamp)
    return message


def local_position(flight: Flight) -> Array:
    """(N, 3) east, north, up of the first fix [m], held between fixes; zeros where the flight has no position."""
    if not (flight.measured("latitude") and flight.measured("longitude")):
        return np.zeros((len(flight), 3))
    latitude, longitude = np.radians(_hold_last(flight["latitude"])), np.radians(_hold_last(flight["longitude"]))
    height = height_above_sea(flight)
    up = _hold_last(height) if np.isfinite(height).any() else np.zeros(len(flight))
    east = (longitude - longitude[0]) * np.cos(latitude[0]) * EARTH_RADIUS
    north = (latitude - latitude[0]) * EARTH_RADIUS
    return np.column_stack([east, north, up - up[0]])


def _hold_last(values: Array) -> Array:
    """The last finite value before each sample; the first finite one before that."""
    finite = np.flatnonzero(np.isfinite(values))
    index = np.maximum(np.searchsorted(finite, np.arange(values.size), side="right") - 1, 0)
    return values[finite[index]]


def quaternion_flu_to_enu(phi: Array, theta: Array, psi: Array) -> Array:
    """(N, 4) w x y z that turns aircraft axes x forward, y left, z up into east, north, up; angles [rad].

    Body axes y right, z down follow from these by half a turn about x, north-east-down from east-north-up likewise by
    half a turn about (1, 1, 0): yaw becomes pi/2 - psi, pitch -theta, roll phi.
    """
    half_roll, half_pitch, half_yaw = 0.5 * phi, -0.5 * theta, 0.5 * (0.5 * np.pi - psi)
    cr, sr = np.cos(half_roll), np.sin(half_roll)
    cp, sp = np.cos(half_pitch), np.sin(half_pitch)
    cy, sy = np.cos(half_yaw), np.sin(half_yaw)
    return np.column_stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


SCHEMA = "sensor_msgs/msg/JointState"
SCHEMA_ENCODING, MESSAGE_ENCODING = "ros2msg", "cdr"
_RULE = "=" * 80
DEFINITION = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{_RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_HEAD = b"\x00\x01\x00\x00"  # of CDR: little-endian
_NS = 1_000_000_000


class JointStates:
    """Encodes JointState messages that all have the same names. Unknown values are NaN."""

    def __init__(self, names: Sequence[str]) -> None:
        body = bytearray(8) + _text("")  # the time goes into the first eight bytes
        _align(body, 4)
        body += struct.pack("<I", len(names))
        for name in names:
            _align(body, 4)
            body += _text(name)
        _align(body, 4)
        body += struct.pack("<I", len(names))
        _align(body, 8)
        self._before = bytes(body[8:])
        self._values = struct.Struct(f"<{len(names)}d")
        self._after = bytes(8)  # no velocities, no efforts

    def encode(self, stamp_ns: int, values: Sequence[float]) -> bytes:
        """The message of one instant; stamp_ns: UTC or monotonic, below 2^31 seconds."""
        time = struct.pack("<iI", *divmod(stamp_ns, _NS))
        return _HEAD + time + self._before + self._values.pack(*values) + self._after


def _align(body: bytearray, size: int) -> None:
    body += bytes(-len(body) % size)


def _text(words: str) -> bytes:
    """A string in CDR: its length with the final zero, then its bytes."""
    data = words.encode() + b"\0"
    return struct.pack("<I", len(data)) + data
