"""A card that fills up or is taken away, as the operating system really does it: a small tmpfs."""

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from daq.clock import SimulatedClock
from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import read_recording
from daq.contract.recordings.segments import read_parts
from daq.contract.scan import encode_scan
from daq.recorder.config import RecorderConfig
from daq.recorder.recorder import Recorder
from tests.unit.daq.synthetic import PERIOD_NS, make_info, make_scan

SIZE_KB = 400


@pytest.fixture
def small_card(tmp_path: Path) -> Iterator[Path]:
    """A file system of 400 KB."""
    if os.geteuid() != 0:
        pytest.skip("mounting a tmpfs needs root")
    card = tmp_path / "card"
    card.mkdir()
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={SIZE_KB}k", "none", str(card)], check=False, capture_output=True
    )
    if done.returncode:
        pytest.skip(f"mounting a tmpfs is not permitted here: {done.stderr.decode().strip()}")
    yield card
    subprocess.run(["umount", "-l", str(card)], check=False, capture_output=True)


def feed(recorder: Recorder, clock: SimulatedClock, scans: range) -> None:
    for n in scans:
        clock.sleep_until(n * PERIOD_NS)
        assert recorder.scan(make_scan(n))


def started(clock: SimulatedClock, *directories: Path) -> Recorder:
    recorder = Recorder(RecorderConfig(directories=directories), make_info(), clock)
    clock.follow(recorder.busy)
    recorder.start()
    return recorder


def found(*directories: Path) -> dict[int, bytes]:
    """Scans in the files of these directories, each of them unaltered."""
    scans: dict[int, bytes] = {}
    for directory in directories:
        for path in directory.glob("*.mcap"):
            scans |= {e.sequence: e.data for part in read_parts(path) for e in part.entries if e.topic == "/scan"}
    assert all(data == encode_scan(make_scan(n)) for n, data in scans.items())
    return scans


def test_full_card_goes_on_in_the_next_directory(small_card: Path, tmp_path: Path) -> None:
    spare = tmp_path / "spare"
    clock = SimulatedClock()
    recorder = started(clock, small_card, spare)
    feed(recorder, clock, range(1500))
    books = recorder.close()
    assert (books.written, books.dropped, books.lost) == (1500, 0, 0)
    assert books.closes
    assert sorted(found(small_card, spare)) == list(range(1500))
    assert len(found(small_card)) > 500


def test_full_card_with_space_made_later(small_card: Path) -> None:
    (small_card / "ballast.bin").write_bytes(bytes(250 * 1024))
    clock = SimulatedClock()
    recorder = started(clock, small_card)
    feed(recorder, clock, range(600))
    # room for all of it once more: on a busy machine the card may have confirmed nothing of the first file
    subprocess.run(["mount", "-o", "remount,size=900k", str(small_card)], check=True, capture_output=True)
    feed(recorder, clock, range(600, 700))
    books = recorder.close()
    assert (books.written, books.dropped, books.lost) == (700, 0, 0)
    assert sorted(found(small_card)) == list(range(700))
    result = verify(small_card)
    assert result.ok, result.text
    assert any("No space left" in line.message for line in read_recording(small_card, salvage=True).log)


def test_card_unmounted_under_an_open_file(small_card: Path) -> None:
    """Writes to a file of a file system that was unmounted succeed and go nowhere: it must be noticed all the same."""
    clock = SimulatedClock()
    recorder = started(clock, small_card)
    feed(recorder, clock, range(100))
    subprocess.run(["umount", "-l", str(small_card)], check=True, capture_output=True)
    feed(recorder, clock, range(100, 300))
    books = recorder.close()
    assert books.closes
    assert books.write_errors == 1
    assert set(found(small_card)) >= set(range(100, 300)), "from the last sync on, everything is where it can be found"
