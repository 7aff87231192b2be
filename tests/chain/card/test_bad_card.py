"""A card that stalls, fails and fills up under the recorder, as the operating system shows it: nothing is lost, nothing waits."""

import errno
import time
from collections.abc import Callable
from pathlib import Path

from daq.clock import SimulatedClock
from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import read_recording
from daq.contract.scan import encode_scan
from daq.recorder.config import RecorderConfig
from daq.recorder.recorder import Recorder
from tests.chain.card.forgetting import CUTS
from tests.chain.card.mounted import MountedCard
from tests.chain.card.troubles import Troubles
from tests.unit.daq.synthetic import PERIOD_NS, make_info, make_scan


def started(clock: SimulatedClock, directory: Path, *, follow: bool = True) -> Recorder:
    recorder = Recorder(RecorderConfig(directories=(directory,)), make_info(), clock)
    if follow:
        clock.follow(recorder.busy)
    recorder.start()
    return recorder


def feed(recorder: Recorder, clock: SimulatedClock, scans: range) -> None:
    for n in scans:
        clock.sleep_until(n * PERIOD_NS)
        assert recorder.scan(make_scan(n))


def assert_complete(directory: Path, scans: range) -> None:
    recording = read_recording(directory, salvage=True)
    assert recording.numbers == list(scans)
    assert all(e.data == encode_scan(make_scan(e.sequence)) for e in recording.entries if e.topic == "/scan")


def until(so: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 30.0
    while not so():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_scans_go_on_while_a_sync_does_not_end(card: MountedCard) -> None:
    """The sync ends only after all scans have been taken: if they waited for it, this test would never end."""
    clock = SimulatedClock()
    recorder = started(clock, card.path, follow=False)
    with card.stalled() as waiting:
        until(lambda: waiting() == 1)
        feed(recorder, clock, range(400))
        assert waiting() == 1
    books = recorder.close()
    assert (books.written, books.dropped, books.lost, books.missed) == (400, 0, 0, 0)
    assert_complete(card.path, range(400))


def test_what_a_failed_sync_lost_is_on_the_card_all_the_same(card: MountedCard) -> None:
    """The system forgets pages whose writing failed; the recorder does not."""
    clock = SimulatedClock()
    recorder = started(clock, card.path)
    feed(recorder, clock, range(100))
    card.trouble(Troubles(fails={"sync": errno.EIO}))
    feed(recorder, clock, range(100, 160))
    until(lambda: recorder.statistics().write_errors > 0)
    card.trouble(Troubles())
    feed(recorder, clock, range(160, 300))
    books = recorder.close()
    card.cut(CUTS[0])
    assert (books.written, books.dropped, books.lost) == (300, 0, 0)
    assert_complete(card.path, range(300))
    assert verify(card.path).ok, verify(card.path).text


def test_a_card_that_takes_writes_but_no_sync_is_not_flooded_with_files(card: MountedCard) -> None:
    """Every new file would fail as fast as it is made: there are pauses, longer and longer, and no scan is lost by them."""
    clock = SimulatedClock()
    recorder = started(clock, card.path, follow=False)
    card.trouble(Troubles(fails={"sync": errno.EIO}))
    for n in range(1000):
        clock.sleep_until(n * PERIOD_NS)
        assert recorder.scan(make_scan(n))
        time.sleep(0.0005)
    assert len(list(card.path.glob("*.mcap"))) < 15, "in 50 s"
    card.trouble(Troubles())
    books = recorder.close()
    assert (books.written, books.dropped, books.lost) == (1000, 0, 0)
    card.cut(CUTS[0])
    assert_complete(card.path, range(1000))


def test_a_full_card_takes_no_scan_that_was_safe(card: MountedCard) -> None:
    clock = SimulatedClock()
    recorder = started(clock, card.path)
    feed(recorder, clock, range(100))
    card.room(1)
    feed(recorder, clock, range(100, 400))
    until(lambda: recorder.statistics().write_errors > 0)
    card.room(None)
    feed(recorder, clock, range(400, 500))
    books = recorder.close()
    assert (books.written, books.dropped, books.lost) == (500, 0, 0)
    card.cut(CUTS[0])
    assert_complete(card.path, range(500))
    assert verify(card.path).ok, verify(card.path).text
