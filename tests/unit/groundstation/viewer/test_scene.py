"""What the viewer receives, read back through rerun's own reader: entity paths, values, states, events."""

import math
import threading
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from daq.contract.channels import COLUMNS, GROUP_NAMES
from groundstation.flight import Flight
from groundstation.viewer import entities as e
from groundstation.viewer.entities import LinkSample
from groundstation.viewer.live import LiveView, ViewerError, ViewOptions, free_port, port_is_free
from groundstation.viewer.recorded import write_rrd
from groundstation.viewer.scene import Scene, quaternion_xyzw

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")  # the live file is written without, on purpose


def flight(rng: np.random.Generator, n: int = 100) -> Flight:
    columns = {c.name: rng.uniform(0.0, 0.1, n) for c in COLUMNS}
    columns["latitude"], columns["longitude"] = 48 + 1e-5 * np.arange(n), 11 + 0.0 * np.arange(n)
    columns["beta_model"] = columns["beta"] + 0.01
    return Flight.build("f", np.arange(n) * 0.05, columns)


def scalars(path: Path, entity: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times [s] and the table of scalars of one entity."""
    from rerun.chunk import RrdReader

    times, rows = [], []
    for chunk in RrdReader(str(path)).stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if "Scalars:scalars" in batch.schema.names:
            times += [t.value * 1e-9 for t in batch.column(batch.schema.names.index(e.TIMELINE))]
            rows += batch.column(batch.schema.names.index("Scalars:scalars")).to_pylist()
    return np.array(times), np.array(rows)


def poses(path: Path, entity: str, part: str = "quaternion") -> NDArray[np.float64]:
    """Quaternions x, y, z, w, or translations, of an entity in order of time."""
    from rerun.chunk import RrdReader

    found = []
    for chunk in RrdReader(str(path)).stream().filter(content=entity):
        batch = chunk.to_record_batch()
        name = f"Transform3D:{part}"
        if name in batch.schema.names and e.TIMELINE in batch.schema.names:
            times = [t.value for t in batch.column(batch.schema.names.index(e.TIMELINE))]
            values = batch.column(batch.schema.names.index(name)).to_pylist()
            found += [(t, v[0]) for t, v in zip(times, values, strict=True) if v]
    return np.array([v for _, v in sorted(found)])


def entity_paths(path: Path) -> set[str]:
    from rerun.chunk import RrdReader

    return {chunk.entity_path for chunk in RrdReader(str(path)).stream()}


def test_every_column_of_the_table_has_an_entity_and_a_label() -> None:
    groups = e.series_groups()
    assert sorted(c for g in groups for c in g.columns) == sorted(c.name for c in COLUMNS)
    for group in groups:
        assert len(group.labels) == len(group.columns) == group.colors.size


def test_angles_are_shown_in_degrees() -> None:
    group = next(g for g in e.series_groups(["p", "q", "r"]) if g.entity == "/rates")
    assert group.labels == ("p [deg/s]", "q [deg/s]", "r [deg/s]")
    assert group.shown(np.array([math.pi, 0.0, 0.0]))[0] == pytest.approx(180.0)


def test_recorded_flight_arrives_with_its_values(tmp_path: Path, rng: np.random.Generator) -> None:
    f = flight(rng)
    write_rrd(f, tmp_path / "f.rrd", states={"imu": [(0.0, "ok"), (2.0, "absent")]}, events=[(1.0, "mark", "INFO")])
    times, rates = scalars(tmp_path / "f.rrd", "/rates")
    order = np.argsort(times)
    np.testing.assert_allclose(times[order], f.time, atol=1e-9)
    np.testing.assert_allclose(rates[order], np.degrees(np.column_stack([f["p"], f["q"], f["r"]])))
    _, model = scalars(tmp_path / "f.rrd", "/model/airdata/angles")
    np.testing.assert_allclose(np.sort(model[:, 0]), np.sort(np.degrees(f["beta_model"])))
    paths = entity_paths(tmp_path / "f.rrd")
    assert {c.entity for c in COLUMNS} <= paths
    np.testing.assert_allclose(
        poses(tmp_path / "f.rrd", e.AIRCRAFT),
        [quaternion_xyzw(*row) for row in zip(f["phi"], f["theta"], f["psi"], strict=True)],
        atol=1e-6,
    )
    np.testing.assert_allclose(
        poses(tmp_path / "f.rrd", e.CHASED),
        [quaternion_xyzw(phi, theta, 0.0) for phi, theta in zip(f["phi"], f["theta"], strict=True)],
        atol=1e-6,
    )
    places = poses(tmp_path / "f.rrd", e.AIRCRAFT, "translation")
    np.testing.assert_allclose(places[:, 0], np.radians(1e-5 * np.arange(len(f))) * 6_371_000.0, atol=1e-3)
    np.testing.assert_allclose(places[:, 2], -f["altitude_gnss"], atol=1e-5)
    assert {e.AIRCRAFT, f"{e.AIRCRAFT}/airframe", e.TRACK, e.MAP_POSITION, e.EVENTS, "/health/imu"} <= paths


def test_live_samples_arrive_and_health_lanes_exist(tmp_path: Path) -> None:
    view = LiveView("t", ViewOptions(layout="light", serve=False, rrd=tmp_path / "l.rrd"))
    for i in range(50):
        view.sample(i * 0.1, {"p": 0.01 * i, "q": 0.0, "r": 0.0})
    view.states(1.0, dict.fromkeys(GROUP_NAMES, "ok"))
    view.link(1.0, LinkSample(loss_percent=5.0, rate_hz=11.5))
    view.event(2.0, "airspeed: active", "ERROR")
    view.close()
    assert view.dropped == 0
    _, rates = scalars(tmp_path / "l.rrd", "/rates")
    np.testing.assert_allclose(np.sort(rates[:, 0]), np.degrees(0.01 * np.arange(50)))
    _, loss = scalars(tmp_path / "l.rrd", e.LINK_LOSS)
    assert loss.ravel().tolist() == [5.0]
    assert {f"/health/{g}" for g in GROUP_NAMES} <= entity_paths(tmp_path / "l.rrd")


def test_texts_reach_the_viewer_without_letters_it_cannot_draw(rng: np.random.Generator, tmp_path: Path) -> None:
    """The native viewer ends at the first letter that its font lacks, whoever sent it."""
    from rerun.chunk import RrdReader

    said = "test point 3: δ ≠ 5°, 飛行 \u2588"
    write_rrd(flight(rng), tmp_path / "f.rrd", events=[(1.0, said, "INFO")], status=f"# {said}")
    found = []
    for chunk in RrdReader(str(tmp_path / "f.rrd")).stream():
        if chunk.entity_path not in (e.EVENTS, e.STATUS):
            continue
        batch = chunk.to_record_batch()
        for name in ("TextLog:text", "TextDocument:text"):
            if name in batch.schema.names:
                found += [v[0] for v in batch.column(batch.schema.names.index(name)).to_pylist() if v]
    assert sorted(found) == ["# test point 3: δ ≠ 5°, ?? ?", "test point 3: δ ≠ 5°, ?? ?"]


def test_a_slow_viewer_drops_the_oldest_pictures_and_never_blocks(tmp_path: Path) -> None:
    view = LiveView("t", ViewOptions(serve=False, rrd=tmp_path / "l.rrd"))
    gate, reached = threading.Event(), threading.Event()

    def hang(scene: Scene) -> None:
        reached.set()
        gate.wait(30.0)

    view._put(hang)  # stands for a viewer that does not answer
    assert reached.wait(10.0)
    for i in range(1000):
        view.sample(float(i), {"V": float(i)})
    assert view.dropped == 400
    gate.set()
    view.close()
    _, speed = scalars(tmp_path / "l.rrd", "/airdata/speed")
    assert np.sort(speed[:, 0]).tolist() == [float(i) for i in range(400, 1000)]


def test_busy_port_is_one_sentence() -> None:
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert not port_is_free(port)
        with pytest.raises(ViewerError, match=f"{port} is in use"):
            LiveView("t", ViewOptions(port=port))


def test_server_listens_on_loopback_only(tmp_path: Path) -> None:
    port = free_port()
    view = LiveView("t", ViewOptions(port=port))
    try:
        listening = [row.split() for row in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        local = [row[1] for row in listening if row[3] == "0A" and row[1].endswith(f":{port:04X}")]
        assert local == [f"0100007F:{port:04X}"]
    finally:
        view.close()


def test_quaternion_turns_body_x_to_the_heading() -> None:
    x, y, z, w = quaternion_xyzw(0.0, 0.0, math.pi / 2)
    north = 1 - 2 * (y * y + z * z)
    east = 2 * (x * y + w * z)
    assert (north, east) == pytest.approx((0.0, 1.0), abs=1e-12)
    x, y, z, w = quaternion_xyzw(0.0, 0.3, 0.0)
    assert 2 * (x * z - w * y) == pytest.approx(
        -math.sin(0.3)
    )  # nose up: body x points up, so its down part is negative
