"""MCAP files and ROS 2 bags of other programs, written by rosbags: an implementation that has nothing to do with the reader."""

import contextlib
import json
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from groundstation.importers.about import is_foreign_log, log_info
from groundstation.importers.errors import ImportDataError
from groundstation.importers.formats import bags
from groundstation.importers.formats.bag_decoders import LONGEST_DEFINITION
from groundstation.importers.formats.bags import is_bag, read_bag
from groundstation.importers.run import import_data
from tests.unit.groundstation.importers.bag_writer import (
    PX4,
    START,
    attitude,
    quaternion,
    rates,
    ros_messages,
    write_bag,
)


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_standard_messages_come_in_our_axes(tmp_path: Path, plugin: StoragePlugin) -> None:
    bag = write_bag(tmp_path / "bag", plugin, ros_messages())
    assert is_bag(bag)
    flight = import_data(bag)
    at = flight.time - flight.time[0]
    inner = slice(2, -2)
    expected = np.array([attitude(t) for t in at]).T
    for name, values in zip(("phi", "theta", "psi"), expected, strict=True):
        np.testing.assert_allclose(flight[name][inner], values[inner], atol=2e-4)
    for name, values in zip("pqr", np.array([rates(t) for t in at]).T, strict=True):
        np.testing.assert_allclose(flight[name][inner], values[inner], atol=2e-4)
    assert np.nanmedian(flight["az"]) == pytest.approx(-9.3, abs=0.5)
    np.testing.assert_allclose(flight["vn"][inner], 18.0)
    np.testing.assert_allclose(flight["ve"][inner], 7.0)
    np.testing.assert_allclose(flight["vd"][inner], -0.5)
    assert flight.channels["phi"]["kind"] == "computed"
    assert flight.channels["p"]["kind"] == "measured"
    assert any("axes turned from x forward, y left, z up" in n.text for n in flight.notes)


def test_a_bag_whose_name_an_address_would_read_otherwise(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3, ros_messages())
    odd = bag.rename(tmp_path / "flight 100%25?mode=x#2.db3")
    assert len(import_data(odd).time) > 100


def test_a_bag_whose_damage_sqlite_quotes_in_bytes_that_are_no_text(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3, ros_messages())
    spoilt = tmp_path / "spoilt.db3"
    spoilt.write_bytes(bag.read_bytes().replace(b"CREATE TABLE topics", b"CREATE TABL\xcf topics"))
    assert spoilt.read_bytes() != bag.read_bytes()
    with pytest.raises(ImportDataError, match=r"spoilt\.db3: damaged SQLite bag"):
        import_data(spoilt)


COMPUTED = {
    "a generated column": "create table messages(id integer, topic_id integer, timestamp integer,"
    " data blob generated always as (zeroblob(900000000)) virtual)",
    "a view": "create view messages as with recursive c(x) as (select 1 union all select x + 1 from c)"
    " select 1 as topic_id, x as timestamp, x'00' as data from c",
}


@pytest.mark.parametrize("how", COMPUTED)
def test_a_bag_whose_messages_are_computed_is_refused(how: str, tmp_path: Path) -> None:
    bag = tmp_path / "endless.db3"
    with contextlib.closing(sqlite3.connect(bag)) as file:
        file.execute("create table topics(id integer, name text, type text)")
        file.execute("insert into topics values(1, '/imu', 'sensor_msgs/msg/Imu')")
        file.execute(COMPUTED[how])
        if "table messages" in COMPUTED[how]:
            file.execute("insert into messages(id, topic_id, timestamp) values(1, 1, 1)")
        file.commit()
    with pytest.raises(ImportDataError, match=r"endless\.db3: (its messages are computed|an SQLite file, but no)"):
        import_data(bag)


def mcap_of(path: Path, data: bytes, definition: str, compression: CompressionType, copies: int = 2) -> Path:
    """An MCAP file of one topic, all in one chunk."""
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=1 << 40, compression=compression)
        writer.start(profile="ros2")
        schema = writer.register_schema("a/msg/B", "ros2msg", definition.encode())
        channel = writer.register_channel("/imu", "cdr", schema)
        for n in range(copies):
            writer.add_message(channel, n * 10**7, data, n * 10**7, n)
        writer.finish()
    return path


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_chunk_is_unpacked_within_a_bound(
    compression: CompressionType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bags, "LARGEST_RECORD", 1 << 16)
    path = mcap_of(tmp_path / "b.mcap", bytes(40_000), "float64 x\n", compression)
    assert path.stat().st_size < 1 << 12
    with pytest.raises(ImportDataError, match="at most 65536 are read"):
        import_data(path)
    monkeypatch.setattr(bags, "LARGEST_RECORD", 1 << 17)
    assert read_bag([path]).topics["/imu"].time == [0.0, 0.01]


def test_messages_and_definitions_have_a_length(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fields = "\n".join(f"float64 field_{n}" for n in range(LONGEST_DEFINITION // 10))
    with pytest.raises(ImportDataError, match=f"at most {LONGEST_DEFINITION} are read"):
        import_data(mcap_of(tmp_path / "d.mcap", bytes(64), fields, CompressionType.NONE))
    monkeypatch.setattr(bags, "LONGEST_MESSAGE", 1000)
    with pytest.raises(ImportDataError, match="/imu: messages of 1001 bytes; at most 1000 are read"):
        import_data(mcap_of(tmp_path / "m.mcap", bytes(1001), "float64 x\n", CompressionType.NONE))


def test_messages_of_px4_go_by_the_names_of_its_own_log(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in PX4.items():
        store.register(get_types_from_msg(text, name))
    messages = []
    for k in range(300):
        at = 100.0 + 0.04 * k
        phi, theta, psi = attitude(at)
        imu = store.types["px4_msgs/msg/SensorCombined"](
            round(1e6 * at), np.array(rates(at), np.float32), np.array([0.1, 0.0, -9.8], np.float32)
        )
        q = store.types["px4_msgs/msg/VehicleAttitude"](
            round(1e6 * at), np.array(quaternion(phi, theta, psi), np.float32)
        )
        messages += [("/fmu/out/sensor_combined", "px4_msgs/msg/SensorCombined", START + at, imu)]
        messages += [("/fmu/out/vehicle_attitude", "px4_msgs/msg/VehicleAttitude", START + at, q)]
    flight = import_data(write_bag(tmp_path / "bag", StoragePlugin.MCAP, messages, store))
    assert flight.time[0] == pytest.approx(100.0, abs=0.05)  # the sender's own clock
    np.testing.assert_allclose(flight["theta"][2:-2], [attitude(t)[1] for t in flight.time[2:-2]], atol=1e-3)
    assert flight.channels["phi"]["from"] == "vehicle_attitude.roll"


def test_an_old_bag_without_definitions_and_json_in_mcap(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3, ros_messages())
    with sqlite3.connect(bag) as file:
        file.execute("drop table if exists message_definitions")
        file.execute("insert into topics (id, name, type, serialization_format, offered_qos_profiles, type_description_hash) "
                     "values (99, '/own', 'own_msgs/msg/Thing', 'cdr', '', '')")  # fmt: skip
    flight = import_data(bag)
    assert flight.measured("p")
    assert any("/own (own_msgs/msg/Thing: this bag carries no definitions" in n.text for n in flight.notes)


def test_json_and_a_map(tmp_path: Path) -> None:
    from mcap.writer import Writer as McapWriter

    path, mapping = tmp_path / "own.mcap", tmp_path / "map.toml"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        schema = writer.register_schema("own.State", "jsonschema", b"{}")
        channel = writer.register_channel("/state", "json", schema)
        for k in range(100):
            stamp = round(1e9 * (START + 0.02 * k))
            writer.add_message(
                channel, stamp, json.dumps({"roll": 10.0 * np.sin(0.02 * k), "gyro": [0.1, 0.2, 0.3]}).encode(), stamp
            )
        writer.finish()
    mapping.write_text(
        'format = 1\n[columns]\nphi = { column = "/state.roll", unit = "deg" }\n'
        'p = { column = "/state.gyro[0]", unit = "rad/s" }\n'
    )
    flight = import_data(path, mapping, accept_implausible=True)
    np.testing.assert_allclose(flight["phi"], np.radians(10.0 * np.sin(flight.time - flight.time[0])), atol=1e-3)
    with pytest.raises(ImportDataError, match=r"nothing in it is known|none of the expected"):
        import_data(path)


def test_a_cut_bag_keeps_its_whole_messages_and_noise_is_a_sentence(tmp_path: Path) -> None:
    from mcap.reader import make_reader
    from mcap.writer import Writer as McapWriter

    bag, short = write_bag(tmp_path / "bag", StoragePlugin.MCAP, ros_messages()), tmp_path / "short.mcap"
    with bag.open("rb") as file, short.open("wb") as other:  # the same in small chunks
        writer = McapWriter(other, chunk_size=4000)
        writer.start()
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id]
                )
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    data = short.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(0.5 * len(data))])
    flight = import_data(cut)
    assert 100 < len(flight) < 380
    assert any("cut off or damaged" in n.text for n in flight.notes)
    (tmp_path / "noise.mcap").write_bytes(np.random.default_rng(2).bytes(5000))
    (tmp_path / "noise.db3").write_bytes(b"SQLite format 3\0" + np.random.default_rng(3).bytes(5000))
    for name in ("noise.mcap", "noise.db3"):
        with pytest.raises(ImportDataError, match=r"noise\.(mcap|db3): "):
            import_data(tmp_path / name)


def test_info_knows_a_bag(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", StoragePlugin.MCAP, ros_messages())
    assert is_foreign_log(bag)
    found = log_info(bag)
    assert found["kind"] == "bag"
    assert found["duration_s"] == pytest.approx(19.95, abs=0.1)
    assert "/mavros/imu/data.angular_velocity.x" in {c["name"] for c in found["channels"]}
