"""Bags as other programs write them: folders, parts, packed messages, ROS 1, PX4's bridge, messages of a person's own."""

import contextlib
import json
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from groundstation.flight import FlightError, read_flight
from groundstation.flight.marks import marks_of
from groundstation.importers.about import is_foreign_log, log_info
from groundstation.importers.draft import draft_map
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats.ros1_messages import ros1_decoder
from groundstation.importers.run import import_data
from tests.unit.groundstation.importers.bag_writer import (
    PX4,
    START,
    STORE,
    attitude,
    rates,
    ros_messages,
    write_bag,
)


def test_a_bags_folder_is_read_whole_and_its_parts_are_one_record(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    messages = ros_messages()
    parts = [
        [m for m in messages if (m[2] - START) // 2 == n] for n in range(11)
    ]  # ten seconds and more: _10 is behind _9
    for n, part in enumerate(p for p in parts if p):
        made = write_bag(tmp_path / f"part_{n}", StoragePlugin.SQLITE3, part)
        folder.mkdir(exist_ok=True)
        made.rename(folder / f"flight_{n}.db3")
    files = sorted(folder.iterdir(), key=lambda p: int(p.stem.rpartition("_")[2]))
    assert is_foreign_log(folder)
    for source in (folder, files):
        flight = import_data(source)
        assert len(flight) == 400
        assert np.all(flight.segment == 0)
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  relative_file_paths:\n"
        + "".join(f"  - {p.name}\n" for p in files)
        + "  version: 5\n"
    )
    assert log_info(folder)["duration_s"] == pytest.approx(19.95, abs=0.1)
    empty = tmp_path / "packed"
    empty.mkdir()
    (empty / "flight_0.db3.zstd").write_bytes(b"")
    with pytest.raises(
        ImportDataError, match=r"without the files of a bag .*; its files are packed: 'zstd -d .*flight_0"
    ):
        import_data(empty)


def test_messages_packed_one_by_one_are_read(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3, ros_messages())
    with contextlib.closing(sqlite3.connect(bag)) as file:
        rows = file.execute("select id, data from messages").fetchall()
        packer = zstandard.ZstdCompressor()
        file.executemany("update messages set data = ? where id = ?", [(packer.compress(d), i) for i, d in rows])
        file.commit()
    assert import_data(bag).measured("p")


def test_modes_and_messages_of_mavros_are_marks(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    state, text = "mavros_msgs/msg/State", "mavros_msgs/msg/StatusText"
    store.register(get_types_from_msg("std_msgs/Header header\nbool armed\nstring mode\n", state))
    store.register(get_types_from_msg("std_msgs/Header header\nuint8 severity\nstring text\n", text))
    t = store.types
    stamp, header = t["builtin_interfaces/msg/Time"], t["std_msgs/msg/Header"]
    messages = ros_messages()
    for second in range(20):
        head = header(stamp(int(START) + second, 0), "")
        messages.append((
            "/mavros/state", state, START + second, t[state](head, second > 4, "FBWA" if second < 9 else "MANUAL")
        ))  # fmt: skip
    messages.append(
        ("/mavros/statustext/recv", text, START + 3, t[text](header(stamp(int(START) + 3, 0), ""), 4, "calm"))
    )
    flight = import_data(write_bag(tmp_path / "bag", StoragePlugin.MCAP, sorted(messages, key=lambda m: m[2]), store))
    marks = marks_of(flight)
    assert [(m.name, m.start - START) for m in marks.modes] == [("FBWA", 0.0), ("MANUAL", 9.0)]
    assert [(m.text, m.time - START) for m in marks.events] == [("disarmed", 0.0), ("armed", 5.0)]
    assert [m.text for m in marks.messages] == ["calm"]


def test_a_topic_of_px4_is_called_as_its_own_and_a_status_names_modes(tmp_path: Path) -> None:
    """/fmu/out/vehicle_gps_position carries SensorGps; a version at the end of a topic's name is none of it."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    gps, status, imu = (f"px4_msgs/msg/{n}" for n in ("SensorGps", "VehicleStatus", "SensorCombined"))
    store.register(get_types_from_msg("uint64 timestamp\nfloat32 vel_n_m_s\nfloat32 vel_e_m_s\nuint8 fix_type\n", gps))
    store.register(get_types_from_msg("uint64 timestamp\nuint8 arming_state\nuint8 nav_state\n", status))
    store.register(get_types_from_msg(PX4[imu], imu))
    t, messages = store.types, []
    for k in range(200):
        at = 50.0 + 0.05 * k
        us = round(1e6 * at)
        vector = np.array([0.1, 0.0, -9.8], np.float32)
        messages.append(("/uav/fmu/out/sensor_combined", imu, START + at, t[imu](us, 0.01 * vector, vector)))
        messages.append(("/uav/fmu/out/vehicle_gps_position", gps, START + at, t[gps](us, 11.0, -3.0, 3)))
        messages.append(("/uav/fmu/out/vehicle_status_v1", status, START + at, t[status](us, 2, 0 if k > 99 else 2)))
    flight = import_data(write_bag(tmp_path / "bag", StoragePlugin.MCAP, messages, store))
    assert flight.channels["vn"]["from"] == "vehicle_gps_position.vel_n_m_s"
    np.testing.assert_allclose(flight["ve"][1:-1], -3.0)
    assert [m.name for m in marks_of(flight).modes] == ["POSCTL", "MANUAL"]


def test_messages_of_ros_1_in_mcap(tmp_path: Path) -> None:
    """As `mcap convert` makes of a ROS 1 bag; serialised by rosbags."""
    one, path = get_typestore(Stores.ROS1_NOETIC), tmp_path / "old.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros1")
        channels: dict[str, int] = {}
        for topic, kind, time, message in ros_messages():
            if topic not in channels:
                text = one.generate_msgdef(kind, ros_version=1)[0]
                schema = writer.register_schema(kind.replace("/msg/", "/"), "ros1msg", text.encode())
                channels[topic] = writer.register_channel(topic, "ros1", schema)
            values = {n: getattr(message, n) for n in message.__dataclass_fields__ if n != "__msgtype__"}
            stamp = one.types["builtin_interfaces/msg/Time"](message.header.stamp.sec, message.header.stamp.nanosec)
            values["header"] = one.types["std_msgs/msg/Header"](7, stamp, "base_link")
            data = bytes(one.serialize_ros1(one.types[kind](**values), kind))
            writer.add_message(channels[topic], round(1e9 * time), data, round(1e9 * time))
        writer.finish()
    flight = import_data(path)
    at = flight.time - flight.time[0]
    np.testing.assert_allclose(flight["theta"][2:-2], [attitude(t)[1] for t in at[2:-2]], atol=2e-4)
    np.testing.assert_allclose(flight["vn"][2:-2], 18.0)
    assert flight["p_static"][100] == pytest.approx(95_100.0, abs=1.0)


def test_definitions_of_ros_1_that_are_none() -> None:
    assert ros1_decoder("a/B", "byte K=1\nuint8[2] n  # two\nstring s\n")(b"\1\2\1\0\0\0x") == {"n": (1, 2), "s": "x"}
    with pytest.raises(ValueError, match="no definition of c/D"):
        ros1_decoder("a/B", "c/D x\n")
    endless = "B/E[999] x\n=====\nMSG: B/E\nB/F[999] y\n=====\nMSG: B/F\nB/G[999] z\n=====\nMSG: B/G\n"
    with pytest.raises(ValueError, match="messages within one"):
        ros1_decoder("B/B", endless)(bytes(1000))
    with pytest.raises(ValueError, match="4294967295 elements in 0 bytes"):
        ros1_decoder("a/B", "float64[] x\n")(b"\xff\xff\xff\xff")


def test_a_definition_in_another_language_of_a_standard_message_and_of_one_of_ones_own(tmp_path: Path) -> None:
    def written(kind: str, name: str) -> Path:
        path = tmp_path / name
        imu = [m for m in ros_messages() if m[1].endswith("Imu")]
        with path.open("wb") as file:
            writer = McapWriter(file)
            writer.start(profile="ros2")
            channel = writer.register_channel("/imu", "cdr", writer.register_schema(kind, "ros2idl", b"module a {};"))
            for _, own, time, message in imu:
                writer.add_message(
                    channel, round(1e9 * time), bytes(STORE.serialize_cdr(message, own)), round(1e9 * time)
                )
            writer.finish()
        return path

    assert import_data(written("sensor_msgs/msg/Imu", "standard.mcap")).measured("p")
    with pytest.raises(ImportDataError, match=r"/imu: cdr with ros2idl schema is not read; .*rosbags-convert"):
        import_data(written("own_msgs/msg/Imu", "own.mcap"))


def test_a_bag_is_no_flight_and_other_files_name_the_way_out(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.MCAP, ros_messages())
    with pytest.raises(FlightError, match="a bag of another program; 'sideslip import"):
        read_flight(bag)
    for name, words in {
        "a.bag": "a ROS 1 bag; 'rosbags-convert",
        "b.xlsx": "an Excel workbook; save",
        "c.csv.gz": "gunzip",
    }.items():
        (tmp_path / name).write_bytes(b"x")
        with pytest.raises(ImportDataError, match=words):
            import_data(tmp_path / name)


def test_a_draft_knows_fields_of_a_persons_own_messages(tmp_path: Path) -> None:
    path = tmp_path / "own.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        channel = writer.register_channel("/state", "json", writer.register_schema("State", "jsonschema", b"{}"))
        for k in range(300):
            at = 0.02 * k
            row = dict(zip(("roll", "pitch", "yaw", "p", "q", "r"), (*attitude(at), *rates(at)), strict=True))
            stamp = round(1e9 * (START + at))
            writer.add_message(channel, stamp, json.dumps({**row, "note": 1.0}).encode(), stamp)
        writer.finish()
    text = draft_map([path])
    assert 'phi = { column = "/state.roll", unit = "rad" }' in text
    assert 'p = { column = "/state.p", unit = "rad/s" }      # by its name;' in text
    assert "# /state.note: UNKNOWN" in text


def test_topics_of_ones_own_stand_beside_those_of_px4_on_its_clock(tmp_path: Path) -> None:
    """A vane on the companion computer, stamped by ROS' clock, whose zero is not PX4's."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    imu, vane = "px4_msgs/msg/SensorCombined", "geometry_msgs/msg/Vector3Stamped"
    store.register(get_types_from_msg(PX4[imu], imu))
    t = store.types
    stamp, header, vector = (
        t[n] for n in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "geometry_msgs/msg/Vector3")
    )
    messages = []
    for k in range(400):
        at = 50.0 + 0.05 * k
        force = np.array([0.1, 0.0, -9.8], np.float32)
        messages.append(
            ("/fmu/out/sensor_combined", imu, START + at + 0.002, t[imu](round(1e6 * at), 0.01 * force, force))
        )
        now = START + at
        head = header(stamp(int(now), round(1e9 * (now % 1))), "vane")
        messages.append(("/airdata/vane", vane, now + 0.004, t[vane](head, vector(0.1 * np.sin(at), 0.0, 0.0))))
    bag, mapping = write_bag(tmp_path / "bag", StoragePlugin.MCAP, messages, store), tmp_path / "map.toml"
    mapping.write_text('format = 1\n[columns]\nbeta = { column = "/airdata/vane.vector.x", unit = "rad" }\n')
    flight = import_data(bag, mapping)
    assert flight.time[0] == pytest.approx(50.0, abs=0.06)
    inner = slice(3, -3)
    np.testing.assert_allclose(flight["beta"][inner], 0.1 * np.sin(flight.time[inner]), atol=1e-3)
    assert "/airdata/vane.vector.x: UNKNOWN" in draft_map([bag])
