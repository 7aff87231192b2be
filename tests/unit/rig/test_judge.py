"""The judge of a card, given sessions of which everything is known: it must find what is wrong, and nothing else."""

import struct
from dataclasses import replace
from pathlib import Path

import pytest

from daq.contract.recordings.reading import read_recording
from tests.chain.card.flight import CardFlight
from tests.rig.cuts import Cut, table_of
from tests.rig.judge import Session, judge, sessions

_BURST = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "imu_temperature")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of two seconds that ended in order."""
    flight = CardFlight(tmp_path_factory.mktemp("card"))
    flight.fly(2.0)
    return flight.directory


def bursts(session: Path) -> list[bytes]:
    """What the IMU gave away for each scan, in order."""
    scans = read_recording(session).scans()
    return [struct.pack(">7h", *(int(s.values[c]) for c in _BURST)) for s in scans if "accel_x" in s.values]


def timed(found: list[bytes]) -> dict[bytes, float]:
    return {b: 0.05 * i for i, b in enumerate(found)}


def test_a_sound_session_is_found_sound(session: Path) -> None:
    found = judge(session, timed(bursts(session)), 2.0)
    assert found.ok
    assert (found.wrong, found.readings_lost, found.missing) == ((), 0, 0)
    assert found.scans == len(bursts(session)) > 20
    assert found.last_s == pytest.approx(0.05 * (found.scans - 1))


def test_bursts_after_the_last_scan_are_lost(session: Path) -> None:
    readings = timed(bursts(session)) | {bytes(14): 50.0, b"\1" * 14: 51.0, b"\2" * 14: 99.0}
    found = judge(session, readings, 60.0)
    assert found.readings_lost == 2  # the third came after the end
    assert any("2 readings are lost" in w for w in found.wrong)  # for this session says that it is sound


def test_what_another_session_read_is_not_lost_by_this_one(session: Path) -> None:
    readings = timed(bursts(session)) | {bytes(14): 50.0, b"\1" * 14: 51.0}
    found = judge(session, readings, None)
    assert (found.wrong, found.readings_lost) == ((), 0)


def test_a_scan_that_was_never_read_is_found(session: Path) -> None:
    readings = timed(bursts(session)[:-1])
    (wrong,) = judge(session, readings, 2.0).wrong
    assert "was never read from the IMU like that" in wrong


def test_a_scan_whose_imu_was_still_under_way_is_no_error(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = read_recording(session, salvage=True)
    scans = [
        replace(s, groups={g: v for g, v in s.groups.items() if g != "imu"}) if k == 5 else s
        for k, s in enumerate(recording.scans())
    ]
    monkeypatch.setattr(type(recording), "scans", lambda _: iter(scans))
    found = judge(session, timed(bursts(session)), 2.0)
    assert (found.wrong, found.readings_lost) == ((), 0)


def test_scans_in_another_order_are_found(session: Path) -> None:
    first, second, *rest = bursts(session)
    readings = timed([second, first, *rest])
    assert any("older than the one before" in w for w in judge(session, readings, 2.0).wrong)


def test_a_torn_session_is_not_sound_and_is_recovered(session: Path, tmp_path: Path) -> None:
    torn = tmp_path / "recordings" / session.name
    torn.mkdir(parents=True)
    (file,) = session.glob("*.mcap")
    data = file.read_bytes()
    (torn / file.name).write_bytes(data[: len(data) * 2 // 3])
    found = judge(torn, timed(bursts(session)), 2.0)
    assert not found.ok
    assert found.wrong == ()
    assert 0 < found.scans < len(bursts(session)) == found.scans + found.readings_lost
    assert sessions(tmp_path)[session.name] != sessions(session.parents[1]).get(session.name)


def test_an_empty_session_is_no_error(tmp_path: Path) -> None:
    (folder := tmp_path / "nothing").mkdir()
    assert judge(folder, {}, 0.0).wrong == ()


def test_the_table_counts_cuts_by_what_they_left() -> None:
    left = Session("a", False, "", 40, 0, 9.25, 3, ())
    cuts = [Cut(False, 80.0, 10.0, left, ()), Cut(True, 12.0, 10.0, None, ()), Cut(False, 90.0, 10.5, left, ("x",))]
    table = table_of(cuts)
    assert "| cuts | 3, of them 1 while starting |" in table
    assert "| with something wrong | 1 |" in table
    assert "1.25 s, 1.25 s" in table
    assert "3, 3" in table
