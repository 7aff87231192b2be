"""Bags as logs: px4_msgs under the names of PX4's own topics, the standard messages in body axes x forward, y right, z down.

ROS turns x forward, y left, z up, and world axes east, north, up (REP 103, REP 105); mavros follows. So y and z change sign, and
attitude is turned from east-north-up to north-east-down.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from groundstation.importers.attitude import ANGLES, euler_from_quaternion, with_attitudes
from groundstation.importers.errors import ImportDataError
from groundstation.importers.evidence import EVIDENCE
from groundstation.importers.formats.bag_series import Topic
from groundstation.importers.formats.bags import read_bag
from groundstation.importers.mapping import ColumnSource, Map, built_in_map
from groundstation.importers.series import MESSAGE, Log, TimeSeries

_PX4 = re.compile(r"px4_msgs/msg/(\w+)")
PX4_US = 1e-6
_SIDE = {"x": 1, "y": -1, "z": -1}  # sign of a body axis of ROS in ours
TURNED = "messages of ROS: axes turned from x forward, y left, z up and east, north, up to ours (REP 103)"
_BY_FIELDS: Mapping[str, frozenset[str]] = {
    "sensor_msgs/msg/Imu": frozenset({"angular_velocity.x", "linear_acceleration.x"}),
    "geometry_msgs/msg/TwistStamped": frozenset({"twist.linear.x", "twist.linear.z"}),
    "geometry_msgs/msg/PoseStamped": frozenset({"pose.orientation.w", "pose.position.z"}),
    "geometry_msgs/msg/QuaternionStamped": frozenset({"quaternion.w", "quaternion.z"}),
    "sensor_msgs/msg/NavSatFix": frozenset({"latitude", "longitude", "altitude", "status.status"}),
    "sensor_msgs/msg/FluidPressure": frozenset({"fluid_pressure", "variance"}),
    "sensor_msgs/msg/Temperature": frozenset({"temperature", "variance"}),
    "mavros_msgs/msg/VfrHud": frozenset({"airspeed", "groundspeed", "throttle", "climb"}),
}
"""Kind of message -> fields by which a table of it is known."""
_FIELD = "field."  # what `rostopic echo -p` writes before the name of each


def read_ros(path: Path) -> tuple[Log, Map]:
    """A bag as a log with the mapping that its kinds of messages make. Raises ImportDataError where nothing can be read."""
    bag = read_bag(path)
    px4 = {n: t for n, t in bag.topics.items() if _PX4.fullmatch(t.kind)}
    if px4:
        log = Log("ulog", with_attitudes(_px4_series(px4)), notes=tuple(bag.notes))
        return EVIDENCE["ulog"](log), built_in_map("px4")
    series: dict[str, TimeSeries] = {}
    columns: dict[str, list[ColumnSource]] = {}
    kinds: dict[str, str] = {}
    rotated = False
    for topic in bag.topics.values():
        topic_series = topic.series(topic.name)
        rotated |= _standard(topic, topic_series, columns, kinds)
        series |= topic_series
    if not series:
        raise ImportDataError(f"{path}: no numbers in the messages of this bag")
    notes = [*bag.notes]
    if rotated:
        notes.append(TURNED)
    log = Log("bag", series, notes=tuple(notes), kinds=kinds)
    return log, Map(format=1, title="bag", columns={n: tuple(s) for n, s in columns.items()})


def of_topic_table(path: Path, log: Log, mapping: Map) -> tuple[Log, Map]:
    """A table that holds the messages of one topic (bagpy, `rostopic echo -p`), with the mapping that its kind of message makes
    of the columns that no other gives; any other table as it is."""
    labels = {f"{path.stem}.{n.removeprefix(_FIELD)}": n for n in log.series}
    fields = {n.removeprefix(_FIELD) for n in log.series}
    kind = next((k for k, needed in _BY_FIELDS.items() if needed <= fields), None)
    if kind is None:
        return log, mapping
    made = {n: log.series[label] for n, label in labels.items()}
    columns: dict[str, list[ColumnSource]] = {}
    kinds: dict[str, str] = {}
    rotated = _standard(Topic(path.stem, kind), made, columns, kinds)
    sources = {
        column: tuple(s.model_copy(update={"column": labels.get(s.column or "", s.column)}) for s in alternatives)
        for column, alternatives in columns.items()
        if column not in mapping.columns
    }
    if not sources:
        return log, mapping
    log = replace(
        log,
        series={**log.series, **{n: s for n, s in made.items() if n not in labels}},
        kinds={**log.kinds, **{labels.get(n, n): k for n, k in kinds.items()}},
        detail={**log.detail, MESSAGE: kind},
    ).with_notes(f"{path.name} holds {kind}, by its columns", *([TURNED] if rotated else []))
    return log, mapping.model_copy(update={"columns": {**mapping.columns, **sources}})


def _px4_series(topics: dict[str, Topic]) -> dict[str, TimeSeries]:
    """Series under the names of uORB topics; a second topic of one kind is instance 1."""
    series: dict[str, TimeSeries] = {}
    counts: dict[str, int] = {}
    for topic in topics.values():
        match = _PX4.fullmatch(topic.kind)
        name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", match[1]).lower() if match else topic.name
        number = counts.get(name, 0)
        counts[name] = number + 1
        series |= topic.series(f"{name}[{number}]" if number else name, PX4_US)
    return series


def _standard(
    topic: Topic, made: dict[str, TimeSeries], columns: dict[str, list[ColumnSource]], kinds: dict[str, str]
) -> bool:
    """Flight columns of a standard message; whether axes were turned. made: series of the topic, to which attitude is added."""
    name = topic.name

    def give(column: str, field: str, unit: str, sign: int = 1) -> None:
        if f"{name}.{field}" in made:
            source = {"column": f"{name}.{field}", "unit": unit, "sign": sign}
            columns.setdefault(column, []).append(ColumnSource.model_validate(source))

    match topic.kind.split("/")[-1], topic.kind.split("/")[0]:
        case "Imu", "sensor_msgs":
            for rate, force, axis in zip("pqr", ("ax", "ay", "az"), "xyz", strict=True):
                give(rate, f"angular_velocity.{axis}", "rad/s", _SIDE[axis])
                give(force, f"linear_acceleration.{axis}", "m/s2", _SIDE[axis])
            _attitude(name, "orientation", made, columns, kinds)
            return True
        case "TwistStamped", "geometry_msgs" if "body" not in name:
            give("vn", "twist.linear.y", "m/s")
            give("ve", "twist.linear.x", "m/s")
            give("vd", "twist.linear.z", "m/s", -1)
            return True
        case "PoseStamped", "geometry_msgs":
            _attitude(name, "pose.orientation", made, columns, kinds)
            return True
        case "QuaternionStamped", "geometry_msgs":
            _attitude(name, "quaternion", made, columns, kinds)
            return True
        case "NavSatFix", _:
            for column, unit in (("latitude", "deg"), ("longitude", "deg"), ("altitude", "m")):
                give("altitude_gnss" if column == "altitude" else column, column, unit)
        case "FluidPressure", _:
            give("p_dynamic" if re.search(r"diff|dyn|pitot", name) else "p_static", "fluid_pressure", "Pa")
        case "Temperature", _:
            give("temperature", "temperature", "degC")
            kinds[f"{name}.temperature"] = "assumed"
        case "VfrHud", _:
            give("V_cas", "airspeed", "m/s")
    return False


def _attitude(
    name: str, field: str, made: dict[str, TimeSeries], columns: dict[str, list[ColumnSource]], kinds: dict[str, str]
) -> None:
    """Angles of a quaternion from east-north-up and x forward, y left, z up, to ours, as series of the topic."""
    names = [f"{name}.{field}.{axis}" for axis in "wxyz"]
    if not all(n in made for n in names):
        return
    parts = [made[n] for n in names]
    q = np.array([p.values for p in parts])
    size = np.sqrt(np.sum(q**2, axis=0))
    if not np.any(np.isfinite(size) & (np.abs(size - 1.0) < 0.1)):
        return  # an IMU without attitude leaves it at zero
    angles = euler_from_quaternion(*q)
    angles |= {"pitch": -angles["pitch"], "yaw": (np.pi / 2 - angles["yaw"] + np.pi) % (2 * np.pi) - np.pi}
    for column, label in ANGLES.items():
        made[f"{name}.{label}"] = TimeSeries(parts[0].time, np.asarray(angles[label]))
        kinds[f"{name}.{label}"] = "computed"
        columns.setdefault(column, []).append(ColumnSource(column=f"{name}.{label}", unit="rad"))
