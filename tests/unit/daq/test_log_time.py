"""Recordings lie beside other logs: log times are UTC once anything knows it, never jump within a file, and read the same."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from daq.clock import NS, SimulatedClock
from daq.contract.recordings.accounting import verify
from daq.contract.recordings.messages import EventMessage, LogLevel
from daq.contract.recordings.reading import read_recording
from daq.contract.recordings.recording import LogTime, RecordingWriter, scan_entry
from daq.contract.recordings.recovery import recover
from daq.contract.scan import Scan, encode_scan
from daq.recorder.config import RecorderConfig
from daq.recorder.recorder import Recorder
from tests.unit.daq.synthetic import PERIOD_NS, make_info, make_scan

UTC_NS = 1_795_000_000 * NS
"""UTC at monotonic zero, by GPS."""
SCANS, KNOWN_FROM = 200, 60


def scan_of(number: int, utc_ns: int = 0) -> Scan:
    """A scan that knows UTC (at monotonic zero), or does not."""
    made = make_scan(number)
    return replace(
        made, time_utc_ns=made.time_monotonic_ns + utc_ns if utc_ns else 0, utc_accuracy_ns=30 if utc_ns else 0
    )


def record(folder: Path, system_utc_ns: int, gps: Any, scans: int = SCANS) -> list[Path]:
    """A session whose system clock stands so at monotonic zero; gps: UTC at monotonic zero by a scan's number, 0 unknown."""
    clock = SimulatedClock(system_utc_ns)
    recorder = Recorder(RecorderConfig(directories=(folder,), segment_s=1000, flush_s=0.5), make_info(), clock)
    clock.follow(recorder.busy)
    recorder.start()
    recorder.log(LogLevel.INFO, "logger", "recording begins")
    for n in range(scans):
        clock.sleep_until(n * PERIOD_NS)
        recorder.scan(scan_of(n, gps(n)))
    recorder.message(EventMessage(scans * PERIOD_NS, 0, scans - 1, "switch", "mark"))
    recorder.close()
    return sorted(folder.glob("*.mcap"))


def filed(path: Path) -> list[tuple[str, int, int]]:
    """Topic, number and log time of each message, in order in the file, as the stock reader gives them."""
    with path.open("rb") as stream:
        found = make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        return [(c.topic, m.sequence, m.log_time) for _, c, m in found]


def assert_steady(path: Path) -> int:
    """Log times of scans never jump: they are the monotonic clock and one offset, which is returned."""
    scans = [(n, at) for topic, n, at in filed(path) if topic == "/scan"]
    assert all(b[1] - a[1] == (b[0] - a[0]) * PERIOD_NS for a, b in pairwise(scans))
    return scans[0][1] - make_scan(scans[0][0]).time_monotonic_ns


def assert_whole(folder: Path) -> None:
    recording = read_recording(folder)
    assert recording.numbers == list(range(SCANS))
    assert [s.time_monotonic_ns for s in recording.scans()] == [make_scan(n).time_monotonic_ns for n in range(SCANS)]
    assert recording.log[0].message == "recording begins"
    assert recording.events[-1].text == "mark"
    assert all(e.log_time_ns < 1000 * NS for e in recording.entries), "on the monotonic clock, whatever the file has"
    assert verify(folder).ok


def test_a_clock_never_set_is_monotonic_until_gps_knows_and_utc_in_the_next_file(tmp_path: Path) -> None:
    paths = record(tmp_path, 0, lambda n: UTC_NS if n >= KNOWN_FROM else 0)
    assert [assert_steady(p) for p in paths] == [0, UTC_NS]
    assert filed(paths[1])[0][:2] == ("/scan", KNOWN_FROM)
    assert_whole(tmp_path)


@pytest.mark.parametrize("off_ns", [0, 40_000_000, -90_000_000])
def test_a_clock_that_was_set_files_all_under_utc_in_one_file(tmp_path: Path, off_ns: int) -> None:
    paths = record(tmp_path, UTC_NS + off_ns, lambda n: UTC_NS if n >= KNOWN_FROM else 0)
    assert [assert_steady(p) for p in paths] == [UTC_NS + off_ns]
    assert all(at >= UTC_NS - NS for _, _, at in filed(paths[0])), "log lines and statistics too"
    assert_whole(tmp_path)


def test_a_clock_that_was_set_wrongly_is_corrected_once(tmp_path: Path) -> None:
    """GPS that wanders afterwards, or jumps by a leap second, begins no more files."""
    hour = 3600 * NS
    paths = record(tmp_path, UTC_NS - hour, lambda n: UTC_NS + (n % 3) * NS if n >= KNOWN_FROM else 0)
    assert [assert_steady(p) for p in paths] == [UTC_NS - hour, UTC_NS]
    assert_whole(tmp_path)


def test_without_any_utc_all_is_monotonic_in_one_file(tmp_path: Path) -> None:
    paths = record(tmp_path, 0, lambda n: 0)
    assert [assert_steady(p) for p in paths] == [0]
    assert_whole(tmp_path)


@pytest.mark.parametrize("utc_ns", [5 * NS, 2**63])
def test_an_impossible_time_of_a_receiver_changes_nothing(tmp_path: Path, utc_ns: int) -> None:
    paths = record(tmp_path, UTC_NS, lambda n: utc_ns)
    assert [assert_steady(p) for p in paths] == [UTC_NS]
    assert_whole(tmp_path)


def test_later_segments_are_filed_under_what_gps_says(tmp_path: Path) -> None:
    clock = SimulatedClock(UTC_NS + 50_000_000)
    recorder = Recorder(RecorderConfig(directories=(tmp_path,), segment_s=5), make_info(), clock)
    clock.follow(recorder.busy)
    recorder.start()
    for n in range(300):
        clock.sleep_until(n * PERIOD_NS)
        recorder.scan(scan_of(n, UTC_NS if n >= KNOWN_FROM else 0))
    recorder.close()
    assert [assert_steady(p) for p in sorted(tmp_path.glob("*.mcap"))] == [UTC_NS + 50_000_000, UTC_NS, UTC_NS]
    assert read_recording(tmp_path).numbers == list(range(300))


def written(path: Path, log_time: LogTime, scans: range = range(SCANS)) -> None:
    with path.open("wb") as stream:
        writer = RecordingWriter(stream, make_info(), log_time=log_time)
        for n in scans:
            writer.write(scan_entry(scan_of(n, UTC_NS)))
            if n % 10 == 9:
                writer.flush()
        writer.finish()


def test_old_recordings_read_as_before_and_are_recovered_in_utc(tmp_path: Path) -> None:
    old = tmp_path / "old.mcap"
    written(old, LogTime())
    assert assert_steady(old) == 0
    assert read_recording(old).numbers == list(range(SCANS))
    recover(old, tmp_path / "out.mcap")
    assert assert_steady(tmp_path / "out.mcap") == UTC_NS
    before, after = (list(read_recording(p).scans()) for p in (old, tmp_path / "out.mcap"))
    assert before == after


def test_what_is_saved_from_a_torn_chunk_is_in_order_with_the_rest(tmp_path: Path) -> None:
    path = tmp_path / "s1_000.mcap"
    written(path, LogTime(UTC_NS, "GPS"))
    data = bytearray(path.read_bytes())
    at = data.find(encode_scan(scan_of(105, UTC_NS)))
    data[at - 3 :] = b""  # inside the eleventh chunk
    path.write_bytes(data)
    found = read_recording(path, salvage=True)
    assert found.numbers == list(range(105))
    assert [e.log_time_ns for e in found.entries] == [make_scan(n).time_monotonic_ns for n in range(105)]


def test_an_altered_statement_of_the_offset_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "s1_000.mcap"
    written(path, LogTime(UTC_NS, "GPS"))
    data = bytearray(path.read_bytes())
    at = data.index(str(UTC_NS).encode())
    data[at] ^= 1
    path.write_bytes(data)
    assert not verify(path).ok
    assert read_recording(path, salvage=True).numbers == list(range(SCANS))


def test_the_file_says_who_knew_the_time(tmp_path: Path) -> None:
    path = tmp_path / "s1_000.mcap"
    written(path, LogTime(UTC_NS, "GPS"))
    with path.open("rb") as stream:
        said = next(m.metadata for m in make_reader(stream).iter_metadata() if m.name == "sideslip.log_time")
    assert (said["utc_minus_monotonic_ns"], said["known_by"]) == (str(UTC_NS), "GPS")
