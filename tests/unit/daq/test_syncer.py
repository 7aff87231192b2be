"""The thread that waits for the card: what it may call safe."""

import errno
import io
import threading
from pathlib import Path
from typing import cast

from daq.clock import SimulatedClock
from daq.contract.recordings.recording import scan_entry
from daq.recorder.segment import OpenRecording, Syncer
from daq.recorder.storage import StorageFile
from tests.unit.daq.synthetic import make_info, make_scan


class ForgetfulFile(io.BytesIO):
    """A file whose first sync fails; the system has then forgotten what was to be written, and the next sync succeeds."""

    def __init__(self) -> None:
        super().__init__()
        self.syncs = 0

    def sync(self) -> None:
        self.syncs += 1
        if self.syncs == 1:
            raise OSError(errno.EIO, "Input/output error")


def test_a_sync_after_a_failed_one_confirms_nothing() -> None:
    failed: list[bool] = []
    failing = threading.Event()

    def on_failure(segment: OpenRecording, error: OSError, finished: bool) -> None:
        failed.append(finished)
        if not finished:
            segment.failure = error
        failing.set()

    syncer = Syncer(on_failure, SimulatedClock(), sync=True)
    syncer.start()
    file = cast(StorageFile, ForgetfulFile())
    segment = OpenRecording(Path("s1_000.mcap"), file, make_info(), compress=False, capacity=100)
    entries = [scan_entry(make_scan(n)) for n in range(10)]
    for entry in entries:
        segment.add(entry)
    segment.mark_flushed()
    syncer.request(segment)
    assert failing.wait(10.0)
    assert syncer.retire(segment).wait(10.0)
    syncer.stop()
    syncer.thread.join(10.0)
    assert failed == [False, True]
    assert segment.take_unconfirmed() == entries
