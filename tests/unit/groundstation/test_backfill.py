"""Backfill ends with exactly the aircraft's scans, through losses and interruptions, and proves it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daq.contract.channels import CHANNELS, GROUP_NAMES
from daq.contract.recordings.reading import join
from daq.contract.recordings.segments import read_segments
from daq.contract.scan import GroupStatus, Scan, SensorState, encode_scan
from daq.telemetry.backfill import FRAGMENT_BYTES, MAX_FRAGMENTS, MAX_WANTED, ScanStore, pack_scans
from daq.telemetry.config import DownlinkConfig
from groundstation.receiver.backfill import group_numbers, unpack_scans
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.storage.session_log import RecordKind, SessionLog
from tests.support.link_rig import Rig, quiet_scan, random_scan


def lossy(share: float, seed: int):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(seed)
    return lambda data: data[: int(rng.integers(len(data)))] if rng.random() < share else data


def fly(rig: Rig, scans: int, seed: int = 1) -> None:
    rng = np.random.default_rng(seed)
    rig.fly(scans, lambda n: quiet_scan(n, rng, time_ns=rig.clock.monotonic_ns()))


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_recording_after_backfill_equals_the_aircraft_s_bit_for_bit(tmp_path: Path, share: float) -> None:
    rig = Rig(tmp_path, down=lossy(share, 1), up=lossy(share, 2), ground=LinkConfig(ports=("memory",), backfill="all"))
    fly(rig, 600)
    rig.link.event(rig.logger.mark_event("event switch", "switch"))
    rig.rest(300, until=lambda: rig.ground.backfill_agreed(1))
    assert rig.ground.backfill_agreed(1)
    (path,) = rig.ground.write_recordings()
    recording = join(path, read_segments(path))
    assert [e.data for e in recording.entries if e.topic == "/scan"] == [encode_scan(s) for s in rig.scans.values()]
    assert recording.damages == ()
    assert (recording.info.source, recording.info.role) == ("simulated", "received")
    assert recording.info.details == {"static.t1": "27504"}
    assert recording.info.config_text == "x=1"
    assert [e.text for e in recording.events] == ["event switch"]
    assert rig.ground.summary()["backfilled"] == 600
    rig.close()


def test_facts_of_a_sensor_that_joins_late_come_down(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rng = np.random.default_rng(7)

    def scan(number: int) -> Scan:
        made = quiet_scan(number, rng, time_ns=rig.clock.monotonic_ns())
        state = SensorState.OK if "pitot.chip" in rig.facts else SensorState.ABSENT
        return replace(made, groups={**made.groups, "pitot": GroupStatus(state, 0)})

    rig.fly(200, scan)
    (recorder,) = rig.ground.session_recorders().values()
    assert recorder.info().details == {"static.t1": "27504"}
    rig.facts |= {"pitot.chip": "SDP33", "pitot.scale_pa": "0.05"}
    rig.fly(300, scan)
    assert recorder.info().details == {"static.t1": "27504", "pitot.chip": "SDP33", "pitot.scale_pa": "0.05"}
    rig.close()


def test_lost_scans_are_fetched_in_flight_and_nothing_else(tmp_path: Path) -> None:
    rig = Rig(tmp_path, down=lossy(0.1, 3), ground=LinkConfig(ports=("memory",), backfill="lost"))
    fly(rig, 2000)
    rig.rest(30)
    (books,) = rig.ground.accounting()
    assert books.lost_count > 50
    assert books.missing == []
    assert books.backfilled == books.lost_count
    (path,) = rig.ground.write_recordings()
    recording = join(path, read_segments(path))
    assert recording.numbers == sorted(rig.link.downlink.sent)
    rig.close()


def test_backfill_does_not_slow_the_scans_down(tmp_path: Path) -> None:
    narrow = DownlinkConfig()
    rig = Rig(tmp_path, down=lossy(0.05, 3), aircraft=narrow, ground=LinkConfig(ports=("memory",), backfill="all"))
    fly(rig, 1200)
    assert len(rig.link.downlink.sent) >= 60 * 11.5 - 2
    assert rig.link.downlink.send_queue.scans_dropped == 0
    rig.close()


def test_interrupted_backfill_goes_on_where_it_was(tmp_path: Path) -> None:
    config = LinkConfig(ports=("memory",), backfill="off")
    slow = DownlinkConfig(budget_bytes_per_s=4000)
    rig = Rig(tmp_path, ground=config, aircraft=slow)
    fly(rig, 600)
    rig.ground.set_backfill("all")
    rig.rest(8)
    (recorder,) = rig.ground.session_recorders().values()
    held = len(recorder.journal.complete)
    assert 50 < held < 600
    rig.ground.close()
    again = Rig.__new__(Rig)
    again.__dict__.update(rig.__dict__)
    from groundstation.receiver.receive import Receiver

    again.ground = Receiver(config, {"memory": rig._ground_end}, rig.clock, folder=tmp_path)
    again.rest(7)
    again.ground.set_backfill("all")
    sent_before = rig.link.downlink.send_queue.bytes_sent
    again.rest(300, until=lambda: again.ground.backfill_agreed(1))
    assert again.ground.backfill_agreed(1)
    (recorder,) = again.ground.session_recorders().values()
    assert list(recorder.journal.scans()) == [encode_scan(s) for s in rig.scans.values()]
    assert rig.link.downlink.send_queue.bytes_sent - sent_before < (600 - held) * 400 + 20_000
    again.close()


def test_a_ground_station_started_again_counts_what_it_had_as_received(tmp_path: Path) -> None:
    from groundstation.receiver.receive import Receiver

    config = LinkConfig(ports=("memory",), backfill="lost")
    rig = Rig(tmp_path, ground=config)
    fly(rig, 300)
    before = set(rig.link.downlink.sent)
    rig.ground.close()  # stands for kill -9: the journal is on disk either way
    rig.look = list  # type: ignore[method-assign,assignment]  # nobody listens
    fly(rig, 200, seed=2)
    missed = set(rig.link.downlink.sent) - before
    rig._ground_end.read(1 << 20)
    rig.ground = Receiver(config, {"memory": rig._ground_end}, rig.clock, folder=tmp_path)
    rig.look = rig.ground.poll  # type: ignore[method-assign]
    fly(rig, 300, seed=3)
    rig.rest(30)
    (books,) = rig.ground.accounting()
    assert {n for a, b in books.lost for n in range(a, b + 1)} == missed
    assert books.sent == len(rig.link.downlink.sent) == books.received + books.lost_count
    assert (books.missing, books.backfilled) == ([], len(missed))
    rig.close()


def test_scans_given_up_by_the_aircraft_are_said_to_be_missing(tmp_path: Path) -> None:
    tight = DownlinkConfig(budget_bytes_per_s=20_000, backfill_memory_mb=0.02)
    rig = Rig(tmp_path, aircraft=tight, ground=LinkConfig(ports=("memory",), backfill="off"))
    fly(rig, 1500)
    rig.ground.set_backfill("all")
    rig.rest(120)
    assert not rig.ground.backfill_agreed(1)
    (recorder,) = rig.ground.session_recorders().values()
    assert 0 < len(recorder.journal.complete) < 1500
    rig.close()


def test_the_largest_possible_answer_fits_its_fragments() -> None:
    values = {c.name: int(c.limits()[0] if c.raw_type[0] == "i" else c.limits()[1]) for c in CHANNELS}
    groups = {g: GroupStatus(SensorState.OFF, -(2**31)) for g in GROUP_NAMES}
    big = encode_scan(Scan(2**32 - 1, 2**64 - 1, 2**64 - 1, 2**32 - 1, 2**32 - 1, groups, values))
    rows = MAX_WANTED * (len(big) + 4)
    assert rows + rows // 1000 + 64 <= MAX_FRAGMENTS * FRAGMENT_BYTES  # zlib adds 5 bytes to 16 KB of noise


def test_store_gives_back_what_it_was_given() -> None:
    rng = np.random.default_rng(6)
    store = ScanStore(10**9)
    scans = [random_scan(n, rng) for n in range(300) if n % 7]
    for s in scans:
        store.add(s)
    assert all(store.get(s.number) == encode_scan(s) for s in reversed(scans))
    assert store.get(7) is None
    assert store.get(10**6) is None
    last, count, _ = store.summary(200)
    assert last <= 200
    assert count == sum(s.number <= last for s in scans)
    packed = pack_scans([encode_scan(s) for s in scans[:5]])
    assert unpack_scans(packed) == [encode_scan(s) for s in scans[:5]]
    assert unpack_scans(packed[:-20]) != unpack_scans(packed)
    assert unpack_scans(b"nonsense") == []


def test_requests_cover_the_numbers_exactly() -> None:
    rng = np.random.default_rng(7)
    numbers = sorted(set(rng.integers(0, 5000, 700).tolist()))
    made = group_numbers(numbers, 10_000)
    assert [f + i for f, mask in made for i in range(64) if mask >> i & 1] == numbers
    assert all(mask.bit_count() <= MAX_WANTED for _, mask in made)


@pytest.mark.parametrize("cut", [1, 9, 40])
def test_journal_survives_a_torn_end(tmp_path: Path, cut: int) -> None:
    rng = np.random.default_rng(3)
    path = tmp_path / "j"
    journal = SessionLog(path)
    scans = [random_scan(n, rng) for n in range(10)]
    for s in scans:
        journal.add_complete(encode_scan(s))
    journal.add(RecordKind.LINK, b"{}")
    journal.close()
    data = path.read_bytes()
    path.write_bytes(data[: -cut - 20])
    again = SessionLog(path)
    held = list(again.scans())
    assert held == [encode_scan(s) for s in scans[: len(held)]]
    assert len(held) >= 9
    again.add_complete(encode_scan(scans[9]))
    assert list(again.scans()) == [encode_scan(s) for s in scans]
    again.close()


def test_damage_in_a_journal_costs_the_records_it_hits(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    path = tmp_path / "j"
    journal = SessionLog(path)
    scans = [random_scan(n, rng) for n in range(40)]
    for s in scans:
        journal.add_complete(encode_scan(s))
    journal.close()
    data = path.read_bytes()
    for at in rng.integers(4, len(data) - 30, 25):
        path.write_bytes(data[:at] + bytes(20) + data[at + 25 :])  # some bytes zero, some gone
        again = SessionLog(path)
        held = list(again.scans())
        again.close()
        assert 38 <= len(held) < 40
        assert set(held) <= {encode_scan(s) for s in scans}


def test_a_completed_scan_replaces_what_was_received(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    journal = SessionLog(tmp_path / "j")
    early, late, full = (random_scan(7, rng) for _ in range(3))
    other = random_scan(3, rng)
    for received in (early, other, late):
        journal.add_received(received)
    assert list(journal.scans()) == [encode_scan(other), encode_scan(late)]
    journal.add_complete(encode_scan(full))
    journal.add_received(early)
    assert list(journal.scans()) == [encode_scan(other), encode_scan(full)]
    assert list(journal.scans(complete_only=True)) == [encode_scan(full)]
    journal.close()
