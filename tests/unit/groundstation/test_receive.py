"""Reception over a bad link: every sent scan is received or known to be lost, whatever happens in between."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from daq.clock import SimulatedClock
from daq.contract.link.scan_map import ScanMap
from daq.contract.recordings.reading import read_recording
from daq.transport.mavlink_codec import FrameEncoder
from daq.transport.ports import memory_pair
from groundstation.receiver import events as ev
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.receive import Receiver
from groundstation.receiver.tlog import TlogError, info_tlog, read_tlog
from tests.support.link_rig import START_UTC_NS, Rig, random_scan

LISTEN = LinkConfig(ports=("memory",), backfill="off")


def fly(rig: Rig, scans: int, seed: int = 1) -> None:
    rng = np.random.default_rng(seed)
    rig.fly(scans, lambda n: random_scan(n, rng, time_ns=rig.clock.monotonic_ns()))


def damager(kind: str, share: float, seed: int = 2) -> Callable[[bytes], bytes]:
    rng = np.random.default_rng(seed)

    def change(data: bytes) -> bytes:
        if rng.random() >= share:
            return data
        at = int(rng.integers(len(data)))
        if kind == "drop":
            return data[:at] + data[at + 1 :]
        if kind == "burst":
            return data[:at] + data[at + 40 :]
        if kind == "lost":
            return b""
        return data[:at] + bytes([data[at] ^ 16]) + data[at + 1 :]

    return change


@pytest.mark.parametrize("kind", ["flip", "drop", "burst", "lost"])
@pytest.mark.parametrize("share", [0.01, 0.1])
def test_sent_is_received_plus_lost_exactly(tmp_path: Path, kind: str, share: float) -> None:
    rig = Rig(tmp_path, down=damager(kind, share), ground=LISTEN)
    fly(rig, 1500)
    rig.rest(12)
    (books,) = rig.ground.accounting()
    sent = set(rig.link.downlink.sent)
    got = {e.scan.number for e in rig.received() if not e.late}
    lost = {n for a, b in books.lost for n in range(a, b + 1)}
    assert got | lost == sent
    assert not got & lost
    assert books.sent == len(sent) == books.received + books.lost_count
    assert books.unknown == []
    assert books.never_sent == 1500 - len(sent)
    assert lost
    rig.close()


def test_received_values_are_the_recorded_ones() -> None:
    rig = Rig(None)
    fly(rig, 200)
    for event in rig.received():
        original = rig.scans[event.scan.number]
        assert event.scan.time_monotonic_ns == original.time_monotonic_ns
        assert all(original.values[k] == v for k, v in event.scan.values.items())
        assert all(original.groups[k] == v for k, v in event.scan.groups.items())
    complete = [e for e in rig.received() if e.scan.time_utc_ns]
    assert len(complete) >= 9  # SCAN_SLOW once a second
    rig.close()


def test_outage_longer_than_the_sequence_counter(tmp_path: Path) -> None:
    gone = {"on": False}
    rig = Rig(tmp_path, down=lambda data: b"" if gone["on"] else data, ground=LISTEN)
    fly(rig, 400)
    gone["on"] = True
    fly(rig, 1500)
    gone["on"] = False
    fly(rig, 200)
    rig.rest(10)
    (books,) = rig.ground.accounting()
    assert books.sent == len(rig.link.downlink.sent) == books.received + books.lost_count
    assert books.lost_count > 800
    summary = rig.ground.summary()
    frames = rig.link.downlink.send_queue.frames_sent
    assert summary["frames_received"] + summary["frames_lost"] == pytest.approx(frames, abs=1)
    rig.close()


def test_duplicates_and_reordering_are_counted_and_harmless() -> None:
    rng = np.random.default_rng(4)
    held: list[bytes] = []

    def shuffle(data: bytes) -> bytes:
        if rng.random() < 0.1:
            return data + data
        if rng.random() < 0.1 and not held:
            held.append(data)
            return b""
        return data + (held.pop() if held else b"")

    rig = Rig(None, down=shuffle, ground=LISTEN)
    fly(rig, 1000)
    rig.rest(8)
    (books,) = rig.ground.accounting()
    assert books.lost == []
    assert books.received == len(rig.link.downlink.sent)
    numbers = [e.scan.number for e in rig.received()]
    assert len(set(numbers)) == books.received
    assert any(e.late for e in rig.received())
    summary = rig.ground.summary()
    assert summary["duplicates"] > 50
    assert summary["frames_lost"] == 0
    rig.close()


@pytest.mark.parametrize("boot", [8, 7], ids=["new boot id", "same boot id by chance"])
def test_restart_of_the_aircraft_begins_new_books(tmp_path: Path, boot: int) -> None:
    rig = Rig(tmp_path, ground=LISTEN)
    fly(rig, 300)
    rig.rest(4)
    rig.restart_aircraft(boot)
    fly(rig, 100, seed=9)
    rig.rest(4)
    first, second = rig.ground.accounting()
    assert (first.last, second.last) == (299, 99)
    assert first.lost == second.lost == []
    assert second.received == len(rig.link.downlink.sent)
    assert [e.previous for e in rig.events if isinstance(e, ev.Restarted)] == [None, first.session]
    assert rig.ground.summary()["frames_lost"] == 0
    paths = rig.ground.write_recordings()
    assert len(paths) == 2
    rig.close()


@pytest.mark.parametrize(
    ("kind", "autopilot", "is_aircraft"),
    [(1, 8, True), (1, 0, True), (2, 3, True), (6, 8, False), (30, 8, False), (18, 8, False)],
    ids=["the logger", "the logger of old", "a copter", "a ground station", "a camera", "an onboard computer"],
)
def test_an_aircraft_without_autopilot_is_heard_and_a_ground_station_is_none(
    tmp_path: Path, kind: int, autopilot: int, is_aircraft: bool
) -> None:
    ours, theirs = memory_pair()
    receiver = Receiver(LISTEN, {"memory": ours}, SimulatedClock(START_UTC_NS), folder=tmp_path)
    theirs.write(FrameEncoder(9, 1).message("HEARTBEAT", type=kind, autopilot=autopilot, mavlink_version=3))
    receiver.poll()
    assert receiver.systems == ([9] if is_aircraft else [])
    receiver.close()


def filed(path: Path) -> list[tuple[str, int]]:
    with path.open("rb") as stream:
        return [(c.topic, m.log_time) for _, c, m in make_reader(stream).iter_messages(log_time_order=False)]


def test_a_received_recording_is_filed_under_utc_from_its_first_scan(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ground=LISTEN)
    fly(rig, 100)
    rig.rest(12)
    (path,) = rig.ground.write_recordings()
    found = filed(path)
    assert {topic for topic, _ in found} >= {"/scan", "/link"}
    scans = read_recording(path).scans()
    for (_, at), scan in zip((row for row in found if row[0] == "/scan"), scans, strict=True):
        assert at == START_UTC_NS + scan.time_monotonic_ns
    assert all(START_UTC_NS <= at < START_UTC_NS + 60 * 10**9 for _, at in found)
    rig.close()


@pytest.mark.parametrize("utc_ns", [1, 2**63, 2**64 - 1])
def test_an_impossible_utc_of_an_aircraft_does_no_harm(tmp_path: Path, utc_ns: int) -> None:
    rng = np.random.default_rng(1)
    rig = Rig(tmp_path, ground=LISTEN)
    rig.fly(60, lambda n: replace(random_scan(n, rng, time_ns=rig.clock.monotonic_ns()), time_utc_ns=utc_ns))
    rig.rest(4)
    (path,) = rig.ground.write_recordings()
    assert all(at < 10**12 for _, at in filed(path)), "monotonic, as long as nothing credible is known"
    assert len(read_recording(path).numbers) == len(rig.received())
    rig.close()


def test_two_aircraft_stay_apart(tmp_path: Path) -> None:
    from daq.telemetry.config import DownlinkConfig

    one = Rig(tmp_path / "a", ground=LISTEN)
    two = Rig(tmp_path / "b", aircraft=DownlinkConfig(system_id=2, budget_bytes_per_s=20_000))
    both, feed = memory_pair()
    receiver = Receiver(LISTEN, {"memory": both}, one.clock, folder=tmp_path / "both")

    def tee(data: bytes) -> bytes:
        feed.write(data)
        return data

    one.down = two.down = tee
    heard: list[ev.Event] = []
    for seed in range(40):
        fly(one, 5, seed)
        fly(two, 5, seed + 100)
        heard += receiver.poll()
    assert receiver.systems == [1, 2]
    for rig, system in ((one, 1), (two, 2)):
        scans = [e.scan for e in heard if isinstance(e, ev.ScanReceived) and e.session.system == system]
        assert len(scans) == len(rig.link.downlink.sent)
        assert all(rig.scans[s.number].values["accel_x"] == s.values["accel_x"] for s in scans)
    receiver.close()
    one.close()
    two.close()


def test_clock_relation_and_latency() -> None:
    rig = Rig(None)
    fly(rig, 200)
    reports = [e for e in rig.events if isinstance(e, ev.LinkStatistics)]
    # Both ends share the simulated clock here, so the true offset is zero and half the round trip the bound.
    assert reports[-1].clock_offset_s is not None
    assert reports[-1].round_trip_s is not None
    assert abs(reports[-1].clock_offset_s) <= reports[-1].round_trip_s / 2 + 1e-9
    assert reports[-1].scan_rate_hz == pytest.approx(11.5, abs=1.0)
    rig.close()


def test_signal_strength_reaches_the_report() -> None:
    from daq.transport.mavlink_codec import FrameEncoder

    rig = Rig(None)
    fly(rig, 20)
    status = FrameEncoder(51, 68).message("RADIO_STATUS", rssi=190, remrssi=255, txbuf=77, noise=40, remnoise=41)
    rig._ground.write(status)
    fly(rig, 40)
    last = [e for e in rig.events if isinstance(e, ev.LinkStatistics)][-1]
    assert last.rssi_dbm == pytest.approx(-27.0)
    assert last.remote_rssi_dbm is None
    assert last.txbuf_percent == 77
    rig.close()


def test_every_byte_received_is_in_the_log_and_replays_to_the_same_scans(tmp_path: Path) -> None:
    kept = bytearray()
    change = damager("drop", 0.1)

    def tap(data: bytes) -> bytes:
        out = change(data)
        kept.extend(out)
        return out

    rig = Rig(tmp_path, down=tap, ground=LISTEN)
    fly(rig, 400)
    rig.close()
    records = list(read_tlog(tmp_path / "telemetry.tlog"))
    assert b"".join(data for _, data in records) == bytes(kept)
    ours, feed = memory_pair()
    replay = Receiver(LinkConfig(ports=("m",), transmit=False), {"m": ours}, rig.clock)
    again = []
    for _, data in records:
        feed.write(data)
        again += [e.scan for e in replay.poll() if isinstance(e, ev.ScanReceived)]
    assert again == [e.scan for e in rig.received()]
    replay.close()


def test_damaged_log_gives_what_is_sound(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ground=LISTEN)
    fly(rig, 100)
    rig.close()
    path = tmp_path / "telemetry.tlog"
    whole = [d for _, d in read_tlog(path)]
    data = bytearray(path.read_bytes())
    del data[3000:3010]
    path.write_bytes(data[:-5])
    part = [d for _, d in read_tlog(path)]
    assert len(whole) - 3 <= len(part) < len(whole)
    path.write_bytes(b"not a log at all, just some words")
    with pytest.raises(TlogError, match="not a MAVLink telemetry log"):
        list(read_tlog(path))


def test_info_of_a_log_counts_what_came(tmp_path: Path) -> None:
    rig = Rig(tmp_path, down=damager("drop", 0.05), ground=LISTEN)
    fly(rig, 300)
    rig.close()
    found = info_tlog(tmp_path / "telemetry.tlog")
    numbers = [e.scan.number for e in rig.received()]
    assert found["kind"] == "tlog"
    assert (found["scans"], found["first_scan"], found["last_scan"]) == (len(numbers), numbers[0], numbers[-1])
    assert {c["name"]: c["samples"] for c in found["channels"]}["accel_x"] == len(numbers)
    assert found["duration_s"] == pytest.approx(15, abs=0.6)


def test_stock_reader_reads_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from pymavlink import mavutil

    rig = Rig(tmp_path, down=damager("flip", 0.1), ground=LISTEN)
    fly(rig, 300)
    rig.close()
    monkeypatch.setenv("MAVLINK20", "1")
    log = mavutil.mavlink_connection(str(tmp_path / "telemetry.tlog"))
    kinds: dict[str, int] = {}
    while (message := log.recv_match()) is not None:
        kinds[message.get_type()] = kinds.get(message.get_type(), 0) + 1
    log.close()
    heard = sum(isinstance(e, ev.Heartbeat) for e in rig.events)
    assert kinds["HEARTBEAT"] == heard
    assert kinds["UNKNOWN_44100"] == len(rig.received())
    assert kinds.get("BAD_DATA", 0) == 0
    assert kinds["TUNNEL"] > 10


def test_hostile_input_never_raises(tmp_path: Path) -> None:
    from daq.transport.mavlink_codec import FrameEncoder, message_types

    rng = np.random.default_rng(8)
    rig = Rig(tmp_path)
    fly(rig, 20)
    encoder = FrameEncoder(1, 1)
    for made in message_types().values():
        for _ in range(20):
            payload = rng.integers(0, 256, made.codec.size, dtype=np.uint8).tobytes()
            frame = encoder.frame(made.msg_id, payload)
            rig._ground.write(frame)
            rig._air.write(FrameEncoder(255, 190).frame(made.msg_id, payload))
        rig._ground.write(rng.integers(0, 256, 300, dtype=np.uint8).tobytes())
        rig.rest(0.1)
    assert rig.ground.summary()["frames_received"] > 0
    rig.close()


def test_scan_map_ranges_match_a_set() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        numbers = set(rng.integers(0, 2000, rng.integers(0, 500)).tolist())
        made = ScanMap()
        assert all(made.add(n) for n in numbers)
        assert list(made) == sorted(numbers)
        assert len(made) == len(numbers)
        assert not any(made.add(n) for n in numbers)


def test_a_full_disk_does_not_end_reception(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from groundstation.receiver.storage.session_log import SessionLog
    from groundstation.receiver.tlog import TlogWriter

    rig = Rig(tmp_path, ground=LISTEN)
    fly(rig, 40)
    before = len(rig.received())

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(TlogWriter, "_append", full)
        patch.setattr(SessionLog, "add", full)
        fly(rig, 40, seed=2)
        assert rig.ground.port_faults == {
            "telemetry log": "No space left on device",
            "recording": "No space left on device",
        }
        assert len(rig.received()) > before + 20
    fly(rig, 40, seed=3)
    assert rig.ground.port_faults == {}
    rig.close()


def test_a_disk_that_is_full_at_the_end_is_told_and_the_scans_stay_in_the_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from groundstation.receiver.storage.recording import ReceivedWriter
    from groundstation.receiver.storage.session_log import SessionLog

    rig = Rig(tmp_path, ground=LISTEN)
    fly(rig, 60)
    received = len(rig.received())

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(ReceivedWriter, "finish", full)
        rig.close()
    (name,) = (n for n in rig.ground.port_faults if n.endswith(".mcap"))
    assert rig.ground.port_faults[name] == "No space left on device"
    assert {p.suffix for p in tmp_path.iterdir()} == {".journal", ".tlog"}
    journal = SessionLog(Path(name).with_suffix(".journal"))
    assert len(list(journal.scans())) == received
    journal.close()


def test_trouble_is_told_once_and_its_end_too(tmp_path: Path) -> None:
    class Loose:
        """A port whose plug is loose."""

        def __init__(self) -> None:
            self.out = False

        def read(self, limit: int = 65536) -> bytes:
            if self.out:
                raise OSError(5, "unplugged")
            return b""

        def write(self, data: bytes) -> int:
            return len(data)

        def close(self) -> None:
            pass

    rig = Rig(tmp_path, ground=LISTEN)
    port = Loose()
    receiver = Receiver(LISTEN, {"serial:x": port}, rig.clock)
    told: list[tuple[str, str | None]] = []
    for out in (False, True, True, True, False, False, True):
        port.out = out
        rig.clock.advance(10**9)
        told += [(e.what, e.words) for e in receiver.poll() if isinstance(e, ev.Trouble)]
    assert told == [("serial:x", "unplugged"), ("serial:x", None), ("serial:x", "unplugged")]
    receiver.close()
    rig.close()


def test_link_quality_of_a_received_recording_is_shown(tmp_path: Path) -> None:
    from groundstation.receiver.storage.recording import read_link

    rig = Rig(tmp_path, down=damager("lost", 0.1), ground=LISTEN)
    fly(rig, 300)
    reports = [e for e in rig.events if isinstance(e, ev.LinkStatistics)]
    rig.close()
    (path,) = tmp_path.glob("*.mcap")
    kept = read_link(path)
    assert [k["loss"] for k in kept] == [r.loss for r in reports][-len(kept) :]
    assert len(kept) >= 12
    assert any(k["loss"] > 0 for k in kept)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    assert read_link(path) == kept[: len(read_link(path))]
