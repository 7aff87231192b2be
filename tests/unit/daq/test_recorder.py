"""The recorder under good and bad conditions: every scan is in a file or in the books."""

import errno
import threading
from pathlib import Path

import pytest

from daq.clock import NS, SimulatedClock
from daq.contract.recordings.accounting import verify
from daq.contract.recordings.messages import EventMessage, LogLevel, Statistics
from daq.contract.recordings.reading import read_recording
from daq.contract.scan import encode_scan
from daq.recorder.config import RecorderConfig
from daq.recorder.recorder import Recorder
from daq.recorder.storage import RealStorage, Storage
from tests.unit.daq.synthetic import PERIOD_NS, FaultyStorage, failing_between, make_info, make_scan


def record(
    clock: SimulatedClock, scans: range, config: RecorderConfig, storage: Storage | None = None
) -> tuple[Recorder, Statistics]:
    """Run a recorder over `scans` in simulated time."""
    recorder = Recorder(config, make_info(), clock, storage=storage)
    clock.follow(recorder.busy)
    recorder.start()
    for n in scans:
        clock.sleep_until(n * PERIOD_NS)
        recorder.scan(make_scan(n))
    return recorder, recorder.close()


def assert_complete(path: Path, scans: range) -> None:
    """The recording holds exactly these scans, byte for byte."""
    recording = read_recording(path, salvage=True)
    assert recording.numbers == list(scans)
    got = {e.sequence: e.data for e in recording.entries if e.topic == "/scan"}
    assert all(got[n] == encode_scan(make_scan(n)) for n in scans)


def test_records_everything_and_closes_the_books(tmp_path: Path) -> None:
    _, books = record(SimulatedClock(), range(400), RecorderConfig(directories=(tmp_path,)))
    assert (books.written, books.dropped, books.lost, books.missed, books.pending) == (400, 0, 0, 0, 0)
    assert books.closes
    assert_complete(tmp_path, range(400))
    result = verify(tmp_path)
    assert result.ok, result.text
    assert (result.scans, result.written, result.dropped, result.missing) == (400, 400, 0, ())


def test_every_segment_stands_alone(tmp_path: Path) -> None:
    config = RecorderConfig(directories=(tmp_path,), segment_s=5)
    record(SimulatedClock(), range(600), config)
    paths = sorted(tmp_path.glob("*.mcap"))
    assert len(paths) == 6
    for i, path in enumerate(paths):
        recording = read_recording(path)
        assert recording.info.segment == i
        assert recording.info.source == "simulated"
        assert recording.info.config_text.startswith("[scan]")
        assert recording.info.calibration == {"pitot.toml": b"slope = 1.0\n"}
        assert recording.numbers == list(range(100 * i, 100 * i + 100))
        assert verify(path).ok
    assert_complete(tmp_path, range(600))
    assert verify(tmp_path).ok


def test_skipped_slots_are_counted_as_missed(tmp_path: Path) -> None:
    clock = SimulatedClock()
    recorder = Recorder(RecorderConfig(directories=(tmp_path,)), make_info(), clock)
    recorder.start()
    for n in (0, 1, 5, 6, 9):
        recorder.scan(make_scan(n))
    books = recorder.close()
    assert (books.missed, books.absent) == (5, ((2, 4), (7, 8)))
    result = verify(tmp_path)
    assert result.ok, result.text
    assert result.missing == ((2, 4), (7, 8))
    assert result.scans + 5 == result.slots == 10


def test_a_stall_of_thirty_seconds_costs_nothing(tmp_path: Path) -> None:
    clock = SimulatedClock()

    def stall(operation: str, size: int) -> None:
        if 10 <= clock.monotonic_ns() / NS < 40:
            clock.sleep_until(40 * NS)

    _, books = record(clock, range(1000), RecorderConfig(directories=(tmp_path,)), FaultyStorage(stall))
    assert (books.written, books.dropped, books.lost) == (1000, 0, 0)
    assert books.queue_high_water > 500
    assert_complete(tmp_path, range(1000))
    assert verify(tmp_path).ok


def test_a_stall_longer_than_the_queue_drops_and_says_which(tmp_path: Path) -> None:
    clock = SimulatedClock()

    def stall(operation: str, size: int) -> None:
        if 10 <= clock.monotonic_ns() / NS < 40:
            clock.sleep_until(40 * NS)

    config = RecorderConfig(directories=(tmp_path,), queue_s=10)
    _, books = record(clock, range(1000), config, FaultyStorage(stall))
    assert books.dropped > 350
    assert books.closes
    result = verify(tmp_path)
    assert result.ok, result.text
    assert result.dropped == books.dropped == sum(b - a + 1 for a, b in result.missing)
    assert result.scans == books.written


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC, errno.EROFS])
def test_a_card_that_fails_for_a_while_costs_nothing(tmp_path: Path, number: int) -> None:
    clock = SimulatedClock()
    storage = FaultyStorage(failing_between(clock, 12.0, 31.0, number))
    _, books = record(clock, range(1000), RecorderConfig(directories=(tmp_path,)), storage)
    assert (books.written, books.dropped, books.lost) == (1000, 0, 0)
    assert books.write_errors >= 1
    assert_complete(tmp_path, range(1000))
    result = verify(tmp_path)
    assert result.ok, result.text
    assert [p.name for p in result.given_up] == ["s1_000.mcap"]
    assert read_recording(tmp_path).numbers == list(range(1000)), "nothing is lost: no damage to the reader either"
    lines = [line for line in read_recording(tmp_path, salvage=True).log if line.level is LogLevel.ERROR]
    assert any("given up" in line.message for line in lines)


def test_a_failing_first_directory_is_replaced_by_the_second(tmp_path: Path) -> None:
    first, second = tmp_path / "card", tmp_path / "spare"
    clock = SimulatedClock()

    class CardGone(FaultyStorage):
        def create(self, path: Path):  # type: ignore[no-untyped-def]
            if path.is_relative_to(first) and clock.monotonic_ns() > 10 * NS:
                raise OSError(errno.ENOENT, "No such file or directory")
            return super().create(path)

    def fault(operation: str, size: int) -> None:
        if operation == "write" and storage.created[-1].is_relative_to(first) and clock.monotonic_ns() > 10 * NS:
            raise OSError(errno.EIO, "Input/output error")

    storage = CardGone(fault)
    _, books = record(clock, range(400), RecorderConfig(directories=(first, second)), storage)
    assert (books.written, books.dropped, books.lost) == (400, 0, 0)
    found = set(read_recording(first, salvage=True).numbers) | set(read_recording(second).numbers)
    assert found == set(range(400))


def test_what_the_card_never_confirmed_is_written_again(tmp_path: Path) -> None:
    """fdatasync reports that earlier writes did not reach the card: they must not be taken for recorded."""
    clock = SimulatedClock()
    synced_ns: list[int] = []

    def second_sync_fails(operation: str, size: int) -> None:
        if operation == "sync":
            synced_ns.append(clock.monotonic_ns())
            if len(synced_ns) == 2:
                raise OSError(errno.EIO, "Input/output error")

    _, books = record(clock, range(300), RecorderConfig(directories=(tmp_path,)), FaultyStorage(second_sync_fails))
    again = read_recording(tmp_path / "s1_001.mcap", salvage=True).numbers
    confirmed_at_most = synced_ns[0] // PERIOD_NS + 1
    assert again[0] <= confirmed_at_most, "what the first sync did not cover must be in the next file"
    assert (books.written, books.write_errors) == (300, 1)
    assert books.closes
    assert_complete(tmp_path, range(300))


def test_a_card_that_never_comes_back_is_counted_as_lost(tmp_path: Path) -> None:
    clock = SimulatedClock()
    storage = FaultyStorage(failing_between(clock, 10.0, 1e9))
    _, books = record(clock, range(400), RecorderConfig(directories=(tmp_path,)), storage)
    assert books.lost > 0
    assert books.closes
    kept = read_recording(tmp_path, salvage=True).numbers
    assert books.written == len([n for n in kept if n not in {m for a, b in books.absent for m in range(a, b + 1)}])


def test_oldest_recordings_are_removed_only_if_allowed(tmp_path: Path) -> None:
    class Small(RealStorage):
        def free_bytes(self, directory: Path) -> int:
            return 100_000 - sum(p.stat().st_size for p in directory.rglob("*.mcap"))

    old = tmp_path / "s0_000.mcap"
    for allowed in (False, True):
        old.write_bytes(bytes(90_000))
        config = RecorderConfig(directories=(tmp_path,), remove_oldest=allowed, keep_free_mb=0.05)
        recorder = Recorder(config, make_info(f"t{allowed}"), SimulatedClock(), storage=Small())
        recorder.start()
        recorder.scan(make_scan(0))
        recorder.close()
        assert old.exists() is not allowed
    assert any("removed to make room" in line.message for line in read_recording(tmp_path / "tTrue_000.mcap").log)


def test_events_details_and_log_lines_are_recorded(tmp_path: Path) -> None:
    clock = SimulatedClock()
    recorder = Recorder(RecorderConfig(directories=(tmp_path,), segment_s=5), make_info(), clock)
    clock.follow(recorder.busy)
    recorder.start()
    event = EventMessage(3 * NS, 0, 60, "switch", "manoeuvre begins")
    for n in range(200):
        clock.sleep_until(n * PERIOD_NS)
        recorder.scan(make_scan(n))
        if n == 60:
            recorder.message(event)
            recorder.log(LogLevel.WARNING, "imu", "spike")
            recorder.detail({"nvm bmp390": "00ff"})
    recorder.close()
    recording = read_recording(tmp_path)
    assert recording.events == (event,)
    assert [line.message for line in recording.log] == ["spike"]
    assert recording.info.details["nvm bmp390"] == "00ff"
    last = read_recording(tmp_path / "s1_001.mcap")
    assert last.info.details == {"nvm bmp390": "00ff"}, "a later segment repeats what was found earlier"


def test_an_existing_file_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "s1_000.mcap").write_bytes(b"precious")
    record(SimulatedClock(), range(20), RecorderConfig(directories=(tmp_path,)))
    assert (tmp_path / "s1_000.mcap").read_bytes() == b"precious"
    assert read_recording(tmp_path / "s1_001.mcap").numbers == list(range(20))


def test_the_file_is_there_before_the_first_scan(tmp_path: Path) -> None:
    recorder = Recorder(RecorderConfig(directories=(tmp_path,)), make_info(), SimulatedClock())
    recorder.detail({"nvm bmp390": "00ff"})
    recorder.start()
    while recorder.path is None:
        threading.Event().wait(0.001)
    info = read_recording(recorder.path, salvage=True).info
    assert (info.session, info.details) == ("s1", {"nvm bmp390": "00ff"})
    recorder.close()
