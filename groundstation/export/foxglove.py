"""A flight as an MCAP file that Foxglove draws without a plug-in, and that `read_flight` still reads.

Beside the flight's own samples (`/flight`, every column a plottable scalar) it holds `foxglove.LocationFix` for the map,
`foxglove.FrameTransform` for the 3D panel and `foxglove.Log` for the events, all stamped in UTC where the flight knows
it. Frames follow REP 103, which the 3D panel expects: `world` is east, north, up from the first fix; `aircraft` is x
forward, y left, z up. Rerun's importer makes nothing but one value of each sample of `/flight`; so that it plots, too, the
columns are there once more as ROS 2 `JointState`, under `/scalars`, grouped as in the live view.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from daq.contract.constants import EARTH_RADIUS
from daq.contract.durable import whole
from groundstation.export import joint_state as js
from groundstation.export.timescale import stamps_ns
from groundstation.flight import Array, Flight
from groundstation.flight.writing import Encoded, open_flight_writer


def write_foxglove(flight: Flight, path: Path) -> None:
    """Write the file; topics without values (no GPS, no attitude) are absent."""
    stamps = stamps_ns(flight)
    with whole(path) as new, open_flight_writer(flight, new, stamps) as add:
        for topic, stamp, message in sorted(_messages(flight, stamps), key=lambda row: row[1]):
            add(topic, stamp, message)


def _messages(flight: Flight, stamps: NDArray[np.int64]) -> Iterator[tuple[str, int, Any]]:
    yield from _fixes(flight, stamps)
    yield from _poses(flight, stamps)
    yield from _events(flight, stamps)
    yield from _scalars(flight, stamps)


def _scalars(flight: Flight, stamps: NDArray[np.int64]) -> Iterator[tuple[str, int, Encoded]]:
    """The columns drawn together in one message, at each sample that has a value of one of them."""
    groups: dict[str, list[str]] = {}
    for name in flight.columns:
        if flight.measured(name):
            known = COLUMN_BY_NAME.get(name)
            groups.setdefault(known.entity if known else "/others", []).append(name)
    for entity, names in groups.items():
        units = [COLUMN_BY_NAME[n].unit if n in COLUMN_BY_NAME else "" for n in names]
        joints = js.JointStates([f"{n} [{u}]" if u not in ("", "1") else n for n, u in zip(names, units, strict=True)])
        table = np.column_stack([flight[n] for n in names])
        for i in np.flatnonzero(np.isfinite(table).any(axis=1)):
            data = joints.encode(int(stamps[i]), table[i].tolist())
            made = Encoded(data, js.SCHEMA, js.SCHEMA_ENCODING, js.DEFINITION, js.MESSAGE_ENCODING)
            yield f"/scalars{entity}", int(stamps[i]), made


def _fixes(flight: Flight, stamps: NDArray[np.int64]) -> Iterator[tuple[str, int, Any]]:
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

    if not (flight.measured("latitude") and flight.measured("longitude")):
        return
    height = _height(flight)
    for i in np.flatnonzero(np.isfinite(flight["latitude"]) & np.isfinite(flight["longitude"])):
        fix = LocationFix(frame_id="gnss", latitude=flight["latitude"][i], longitude=flight["longitude"][i])
        if np.isfinite(height[i]):
            fix.altitude = height[i]
        yield "/gnss/fix", int(stamps[i]), _stamped(fix, int(stamps[i]))


def _poses(flight: Flight, stamps: NDArray[np.int64]) -> Iterator[tuple[str, int, Any]]:
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

    if not all(flight.measured(name) for name in ("phi", "theta", "psi")):
        return
    place = local_position(flight)
    turn = quaternion_flu_to_enu(flight["phi"], flight["theta"], flight["psi"])
    for i in np.flatnonzero(np.isfinite(turn).all(axis=1) & np.isfinite(place).all(axis=1)):
        pose = FrameTransform(parent_frame_id="world", child_frame_id="aircraft")
        pose.translation.x, pose.translation.y, pose.translation.z = place[i].tolist()
        pose.rotation.w, pose.rotation.x, pose.rotation.y, pose.rotation.z = turn[i].tolist()
        yield "/tf", int(stamps[i]), _stamped(pose, int(stamps[i]))


def _events(flight: Flight, stamps: NDArray[np.int64]) -> Iterator[tuple[str, int, Any]]:
    from foxglove_schemas_protobuf.Log_pb2 import Log

    shift = int(stamps[0]) - round(float(flight.time[0]) * 1e9)
    for event in flight.provenance.detail.get("events", []):
        stamp = max(0, round(float(event["time"]) * 1e9) + shift)
        yield "/events", stamp, _stamped(Log(level=Log.INFO, name=event["origin"], message=event["text"]), stamp)
    for note in flight.notes:
        yield (
            "/events",
            int(stamps[0]),
            _stamped(Log(level=Log.WARNING, name="flight", message=note.text), int(stamps[0])),
        )


def _stamped(message: Any, stamp: int) -> Any:
    message.timestamp.FromNanoseconds(stamp)
    return message


def _height(flight: Flight) -> Array:
    source = next((name for name in ("altitude_gnss", "altitude") if flight.measured(name)), None)
    return flight[source] if source else np.full(len(flight), np.nan)


def local_position(flight: Flight) -> Array:
    """(N, 3) east, north, up of the first fix [m], held between fixes; zeros where the flight has no position."""
    if not (flight.measured("latitude") and flight.measured("longitude")):
        return np.zeros((len(flight), 3))
    latitude, longitude = np.radians(_held(flight["latitude"])), np.radians(_held(flight["longitude"]))
    height = _height(flight)
    up = _held(height) if np.isfinite(height).any() else np.zeros(len(flight))
    east = (longitude - longitude[0]) * np.cos(latitude[0]) * EARTH_RADIUS
    north = (latitude - latitude[0]) * EARTH_RADIUS
    return np.column_stack([east, north, up - up[0]])


def _held(values: Array) -> Array:
    """The last finite value before each sample; the first finite one before that."""
    known = np.flatnonzero(np.isfinite(values))
    at = np.maximum(np.searchsorted(known, np.arange(values.size), side="right") - 1, 0)
    return values[known[at]]


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
