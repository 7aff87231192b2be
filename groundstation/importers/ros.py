"""Bags as logs: px4_msgs under the names of PX4's topics, standard messages in body axes x forward, y right, z down.

ROS and mavros have body axes x forward, y left, z up, and world axes east, north, up (REP 103, REP 105). So y and z change sign,
and attitude is converted from east-north-up to north-east-down.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from groundstation.flight.marks import Mark, Marks, mode_changes
from groundstation.importers.attitude import ANGLES, euler_from_quaternion, with_attitudes
from groundstation.importers.errors import ImportDataError
from groundstation.importers.evidence import EVIDENCE
from groundstation.importers.formats.bag_series import Topic
from groundstation.importers.formats.bags import WORDS, read_bag
from groundstation.importers.mapping import ColumnSource, Map, built_in_map
from groundstation.importers.modes import armings, mark_text, px4_marks
from groundstation.importers.series import MESSAGE, Log, TimeSeries

_PX4 = re.compile(r"px4_msgs/(\w+)")
_PX4_TOPIC = re.compile(r".*/fmu/(?:in|out)/(\w+?)(?:_v\d+)?")
"""A topic of PX4's bridge, named by its uORB topic; the kind of message may have another name (SensorGps in
vehicle_gps_position)."""
PX4_US = 1e-6  # [s] of PX4's time stamps
_SIDE = {"x": 1, "y": -1, "z": -1}  # ROS body axis -> its sign in x forward, y right, z down
_UNIT_TOLERANCE = 0.1  # of a quaternion's norm about 1, in at least one message
_ORIENTATIONS: Mapping[str, str] = {
    "geometry_msgs/PoseStamped": "pose.orientation",
    "geometry_msgs/PoseWithCovarianceStamped": "pose.pose.orientation",
    "nav_msgs/Odometry": "pose.pose.orientation",
    "geometry_msgs/QuaternionStamped": "quaternion",
}
"""Kind of message -> its field with an attitude."""
TURNED = "messages of ROS: axes turned from x forward, y left, z up to x forward, y right, z down (REP 103)"
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
"""Kind of message -> fields by which a table of such messages is recognised."""
_FIELD = "field."  # prefix of the names that `rostopic echo -p` writes


def read_ros(paths: Sequence[Path]) -> tuple[Log, Map]:
    """A bag, of one file or several, as a log, and the mapping for its kinds of messages. Raises ImportDataError for a bag
    without numbers."""
    bag = read_bag(paths)
    px4 = {n: t for n, t in bag.topics.items() if _PX4.fullmatch(t.kind)}
    if px4:
        px4_log = with_attitudes(_px4_series(px4)) | _other_series(px4.values(), bag.topics.values())
        log = Log("ulog", px4_log, notes=tuple(bag.notes), marks=px4_marks(px4_log))
        return EVIDENCE["ulog"](log), built_in_map("px4")
    series: dict[str, TimeSeries] = {}
    columns: dict[str, list[ColumnSource]] = {}
    kinds: dict[str, str] = {}
    rotated = False
    for topic in bag.topics.values():
        topic_series = topic.series(topic.name)
        rotated |= _add_columns(topic, topic_series, columns, kinds)
        series |= topic_series
    if not series:
        raise ImportDataError(f"{paths[0]}: no numbers in the messages of this bag")
    notes = [*bag.notes]
    if rotated:
        notes.append(TURNED)
    marks = _mavros_marks(bag.topics.values(), max(float(s.time[-1]) for s in series.values()))
    log = Log("bag", series, notes=tuple(notes), kinds=kinds, marks=marks)
    return log, Map(format=1, title="bag", columns={n: tuple(s) for n, s in columns.items()})


def _mavros_marks(topics: Iterable[Topic], end: float) -> Marks:
    """Modes and arming from mavros' State, texts from its StatusText. end: of the bag [s]."""
    marks = Marks()
    for topic in topics:
        if topic.kind not in WORDS:
            continue
        words = [mark_text(w) for w in topic.words]
        rows = sorted(zip(topic.stamps().tolist(), words, range(len(words)), strict=True))
        time = [t for t, _, _ in rows]
        if topic.kind.endswith("/State"):
            armed = topic.columns.get("armed", [0.0] * len(words))
            modes = mode_changes(time, (w for _, w, _ in rows), end)
            marks = replace(marks, modes=modes, events=armings(time, (armed[i] > 0 for _, _, i in rows)))
        else:
            marks = replace(marks, messages=tuple(Mark(t, w) for t, w, _ in rows))
    return marks


def of_topic_table(path: Path, log: Log, mapping: Map) -> tuple[Log, Map]:
    """The log and mapping of a table with the messages of one topic (bagpy, `rostopic echo -p`), with sources for flight columns
    that the mapping lacks; of any other table unchanged."""
    labels = {f"{path.stem}.{n.removeprefix(_FIELD)}": n for n in log.series}
    fields = {n.removeprefix(_FIELD) for n in log.series}
    kind = next((k for k, characteristic in _BY_FIELDS.items() if characteristic <= fields), None)
    if kind is None:
        return log, mapping
    series = {n: log.series[label] for n, label in labels.items()}
    columns: dict[str, list[ColumnSource]] = {}
    kinds: dict[str, str] = {}
    rotated = _add_columns(Topic(path.stem, kind), series, columns, kinds)
    sources = {
        column: tuple(s.model_copy(update={"column": labels.get(s.column or "", s.column)}) for s in alternatives)
        for column, alternatives in columns.items()
        if column not in mapping.columns
    }
    if not sources:
        return log, mapping
    log = replace(
        log,
        series={**log.series, **{n: s for n, s in series.items() if n not in labels}},
        kinds={**log.kinds, **{labels.get(n, n): k for n, k in kinds.items()}},
        detail={**log.detail, MESSAGE: kind},
    ).with_notes(f"{path.name} holds {kind}, by its columns", *([TURNED] if rotated else []))
    return log, mapping.model_copy(update={"columns": {**mapping.columns, **sources}})


def _px4_series(topics: dict[str, Topic]) -> dict[str, TimeSeries]:
    """Series named by uORB topics; a second topic of one name is instance 1."""
    series: dict[str, TimeSeries] = {}
    counts: dict[str, int] = {}
    for topic in topics.values():
        by_topic, by_kind = _PX4_TOPIC.fullmatch(topic.name), topic.kind.rpartition("/")[2]
        name = by_topic[1] if by_topic else re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", by_kind).lower()
        number = counts.get(name, 0)
        counts[name] = number + 1
        series |= topic.series(f"{name}[{number}]" if number else name, PX4_US)
    return series


def _other_series(px4: Iterable[Topic], topics: Iterable[Topic]) -> dict[str, TimeSeries]:
    """Series of a bag's other topics on PX4's clock. The clocks' difference is the median of PX4's messages' time received less
    their time stamp."""
    stamped = [t for t in px4 if len(t.columns.get("timestamp", ())) == len(t.time)]
    if not stamped:
        return {}
    differences = [np.array(t.time) - PX4_US * np.array(t.columns["timestamp"]) for t in stamped]
    offset = float(np.median([np.median(difference) for difference in differences]))
    foreign = (t for t in topics if not _PX4.fullmatch(t.kind))
    return {n: replace(s, time=s.time - offset) for topic in foreign for n, s in topic.series(topic.name).items()}


def _add_columns(
    topic: Topic, series: dict[str, TimeSeries], columns: dict[str, list[ColumnSource]], kinds: dict[str, str]
) -> bool:
    """Add sources for the flight columns of a standard message to `columns`; returns whether its axes were converted.

    series: of the topic, to which the angles of an attitude are added; kinds: origin by series, added to as well.
    """
    name = topic.name

    def add_source(column: str, field: str, unit: str, sign: int = 1) -> None:
        if f"{name}.{field}" in series:
            source = {"column": f"{name}.{field}", "unit": unit, "sign": sign}
            columns.setdefault(column, []).append(ColumnSource.model_validate(source))

    match topic.kind.replace("/msg/", "/"):
        case "sensor_msgs/Imu":
            for rate, force, axis in zip("pqr", ("ax", "ay", "az"), "xyz", strict=True):
                add_source(rate, f"angular_velocity.{axis}", "rad/s", _SIDE[axis])
                add_source(force, f"linear_acceleration.{axis}", "m/s2", _SIDE[axis])
            _add_attitude(name, "orientation", series, columns, kinds)
            return True
        case "geometry_msgs/TwistStamped" | "geometry_msgs/TwistWithCovarianceStamped" as kind if "body" not in name:
            field = "twist.twist.linear" if "Covariance" in kind else "twist.linear"
            add_source("vn", f"{field}.y", "m/s")
            add_source("ve", f"{field}.x", "m/s")
            add_source("vd", f"{field}.z", "m/s", -1)
            return True
        case kind if kind in _ORIENTATIONS:
            _add_attitude(name, _ORIENTATIONS[kind], series, columns, kinds)
            return True
        case "sensor_msgs/MagneticField":
            for field, axis in zip(("mx", "my", "mz"), "xyz", strict=True):
                add_source(field, f"magnetic_field.{axis}", "T", _SIDE[axis])
            return True
        case "sensor_msgs/NavSatFix" | "foxglove.LocationFix":
            for column, unit in (("latitude", "deg"), ("longitude", "deg"), ("altitude", "m")):
                add_source("altitude_gnss" if column == "altitude" else column, column, unit)
        case "sensor_msgs/FluidPressure":
            add_source("p_dynamic" if re.search(r"diff|dyn|pitot", name) else "p_static", "fluid_pressure", "Pa")
        case "sensor_msgs/Temperature":
            add_source("temperature", "temperature", "degC")
            kinds[f"{name}.temperature"] = "assumed"
        case "mavros_msgs/VfrHud":
            add_source("V_cas", "airspeed", "m/s")
        case "mavros_msgs/RCOut":
            series |= {n: replace(s, command=True) for n, s in series.items()}
            kinds |= dict.fromkeys(series, "computed")
    return False


@np.errstate(all="ignore")  # for values of any size in a damaged message
def _add_attitude(
    name: str, field: str, series: dict[str, TimeSeries], columns: dict[str, list[ColumnSource]], kinds: dict[str, str]
) -> None:
    """Add roll, pitch and yaw [rad], north-east-down to body, from a topic's quaternion in ROS axes. field: of the quaternion."""
    names = [f"{name}.{field}.{axis}" for axis in "wxyz"]
    if not all(n in series for n in names):
        return
    parts = [series[n] for n in names]
    q = np.array([p.values for p in parts])
    norm = np.sqrt(np.sum(q**2, axis=0))
    if not np.any(np.isfinite(norm) & (np.abs(norm - 1.0) < _UNIT_TOLERANCE)):
        return  # an IMU without attitude leaves its quaternion at zero
    angles = euler_from_quaternion(*q)
    angles |= {"pitch": -angles["pitch"], "yaw": (np.pi / 2 - angles["yaw"] + np.pi) % (2 * np.pi) - np.pi}
    for column, label in ANGLES.items():
        series[f"{name}.{label}"] = TimeSeries(parts[0].time, np.asarray(angles[label]))
        kinds[f"{name}.{label}"] = "computed"
        columns.setdefault(column, []).append(ColumnSource(column=f"{name}.{label}", unit="rad"))
