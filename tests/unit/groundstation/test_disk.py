"""The ground station's disk: full, gone and back, nearly full; the sums say what is on it."""

import errno
import math
import os
import shutil
from pathlib import Path

import pytest

from daq.contract.recordings.reading import read_recording
from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder, frames_of
from daq.utilities.rotating_log import RotatingLog
from groundstation.live.watches import FREE_MB, MINUTES_LEFT, FreeSpace
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.storage.lasting_log import LastingLog
from groundstation.receiver.tlog import TlogWriter, read_tlog
from tests.support.link_rig import START_UTC_NS, Rig
from tests.unit.groundstation.test_receive import LISTEN, fly


class Full:
    """A file on a disk that takes so many bytes and no more, until there is room."""

    def __init__(self, file: object, room: int) -> None:
        self._file, self.room = file, room

    def write(self, data: bytes) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken = min(self.room, len(data))
        self.room -= taken
        return int(self._file.write(data[:taken]))  # type: ignore[attr-defined]

    def __getattr__(self, name: str) -> object:
        return getattr(self._file, name)


def test_a_record_that_went_half_onto_a_full_disk_is_finished_when_there_is_room(tmp_path: Path) -> None:
    log = LastingLog(tmp_path / "x.log")
    full = log._file = Full(log._file, 7)  # type: ignore[assignment]
    assert log.append(b"first")
    log.flush()
    log.append(b"second")
    for _ in range(3):
        with pytest.raises(OSError, match="No space"):
            log.flush()
    log.append(b"third")
    full.room = 10**6
    log.close()
    assert (tmp_path / "x.log").read_bytes() == b"firstsecondthird"


def test_what_waits_for_a_disk_is_bounded_and_what_is_refused_is_counted(tmp_path: Path) -> None:
    log = LastingLog(tmp_path / "x.log", most_waiting=10)
    log._file = Full(log._file, 0)  # type: ignore[assignment]
    assert log.append(b"12345678")
    assert not log.append(b"12345678")
    assert log.refused == 8
    with pytest.raises(OSError, match="No space"):
        log.close()


def test_a_file_that_is_gone_is_begun_anew_with_what_it_held(tmp_path: Path) -> None:
    log = LastingLog(tmp_path / "deep" / "x.log")
    log.append(b"old")
    log.flush()
    shutil.rmtree(tmp_path / "deep")
    log.append(b"new")
    assert not log.look_after()
    log.close()
    assert (tmp_path / "deep" / "x.log").read_bytes() == b"oldnew"


def test_scans_that_come_while_the_disk_is_full_are_in_the_recording_when_it_has_room(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ground=LISTEN)
    fly(rig, 40)
    (recorder,) = rig.ground.session_recorders().values()
    full = recorder.journal.file._file = Full(recorder.journal.file._file, 100)  # type: ignore[assignment]
    fly(rig, 60, seed=2)
    here = rig.ground.summary()
    assert here["scans_not_on_disk"] > 10
    assert here["scans_on_disk"] + here["scans_not_on_disk"] == here["scans_received"]
    assert "recording" in rig.ground.port_faults
    full.room = 10**9
    fly(rig, 40, seed=3)
    rig.close()
    summary = rig.ground.summary()
    assert summary["scans_not_on_disk"] == 0
    assert len(read_recording(Path(summary["flight"])).numbers) == summary["scans_received"]


def test_sums_of_a_disk_that_stays_full_say_what_is_on_it(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ground=LISTEN)
    fly(rig, 40)
    (recorder,) = rig.ground.session_recorders().values()
    recorder.journal.file._file = Full(recorder.journal.file._file, 0)  # type: ignore[assignment]
    fly(rig, 60, seed=2)
    rig.close()
    summary = rig.ground.summary()
    assert summary["scans_not_on_disk"] > 10
    assert len(read_recording(Path(summary["flight"])).numbers) == summary["scans_on_disk"]


def test_a_folder_that_is_lost_is_filled_again_from_the_aircraft(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    rig = Rig(folder, ground=LinkConfig(ports=("memory",), backfill="lost"))
    fly(rig, 60)
    (recorder,) = rig.ground.session_recorders().values()
    blank = os.open(
        tmp_path / "blank", os.O_RDWR | os.O_CREAT
    )  # as an old disk that is gone: nothing can be read of it
    os.dup2(blank, recorder.journal.file.descriptor())
    os.close(blank)
    shutil.rmtree(folder)
    gone = len(rig.ground.accounting()[0].session.name) and rig.ground.summary()["scans_received"]
    fly(rig, 400, seed=2)
    rig.close()
    summary = rig.ground.summary()
    assert gone > 20
    assert summary["scans_not_on_disk"] == 0
    assert len(read_recording(Path(summary["flight"])).numbers) >= summary["scans_received"]


def test_minutes_left_follow_from_the_pace_of_the_last_minute() -> None:
    space = FreeSpace()
    for second in range(31):
        space.update(float(second), 1_200_000_000 - second * 1_000_000)
    assert space.minutes == pytest.approx(1_170 / 60)
    assert space.values == {FREE_MB: pytest.approx(1170.0), MINUTES_LEFT: pytest.approx(19.5)}
    assert space.words == "1170 MB free, 20 min at the present rate"
    for second in range(31, 120):
        space.update(float(second), 1_170_000_000)
    assert space.minutes == math.inf


def test_a_log_begins_a_new_file_when_it_is_long_and_keeps_the_last_ones(tmp_path: Path) -> None:
    with RotatingLog(tmp_path / "ground.log", largest=100, files=3) as log:
        for n in range(60):
            log.write(f"line {n:03d}\n".encode())
    assert sorted(p.name for p in tmp_path.iterdir()) == ["ground.log", "ground.log.1", "ground.log.2"]
    words = "".join((tmp_path / n).read_text() for n in ("ground.log.2", "ground.log.1", "ground.log"))
    assert words.splitlines() == [f"line {n:03d}" for n in range(60 - len(words.splitlines()), 60)]
    assert max(p.stat().st_size for p in tmp_path.iterdir()) <= 100


def test_a_long_telemetry_log_goes_on_in_the_next_file_and_a_new_session_in_the_last(tmp_path: Path) -> None:
    encoder, sent = FrameEncoder(1, 1), []
    for _ in range(2):
        writer = TlogWriter(tmp_path / "telemetry.tlog", largest=4000)
        for number in range(300):
            sent.append(encoder.message("STATUSTEXT", severity=6, text=f"line {number}"))
            (frame,) = frames_of(FrameDecoder().feed(sent[-1]))
            writer.write(frame, START_UTC_NS + number)
            if number % 10 == 0:
                writer.look_after()
        writer.close()
    logs = [tmp_path / "telemetry.tlog", *(tmp_path / f"telemetry_{n}.tlog" for n in range(1, 20))]
    logs = [log for log in logs if log.exists()]
    assert len(logs) == len(list(tmp_path.iterdir())) >= 5
    assert all(log.stat().st_size < 5000 for log in logs)
    assert [data for log in logs for _, data in read_tlog(log)] == sent
