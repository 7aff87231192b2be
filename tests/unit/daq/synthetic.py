"""Made-up scans, and a storage that fails on demand: what the tests of recording share."""

import errno
from collections.abc import Callable
from pathlib import Path

import numpy as np

from daq.clock import NS, Clock
from daq.contract.channels import CHANNELS, GROUP_NAMES
from daq.contract.recordings.messages import EventMessage, LogLevel, LogLine, Statistics
from daq.contract.recordings.recording import RecordingInfo, RecordingWriter, scan_entry
from daq.contract.scan import GroupStatus, Scan, SensorState
from daq.recorder.storage import RealStorage, StorageFile

PERIOD_NS = NS // 20
START_UTC_NS = 1_790_000_000 * NS


def make_scan(number: int, *, period_ns: int = PERIOD_NS) -> Scan:
    """A scan whose every value follows from its number, like noise: no two scans are alike."""
    rng = np.random.default_rng(number)
    draws = rng.random(len(CHANNELS))
    values = {
        c.name: int(c.limits()[0] + u * (c.limits()[1] - c.limits()[0])) for c, u in zip(CHANNELS, draws, strict=True)
    }
    time = number * period_ns
    groups = {g: GroupStatus(SensorState.OK, 100 * i) for i, g in enumerate(GROUP_NAMES)}
    return Scan(number, time, START_UTC_NS + time, 30, number % 7, groups, values)


def make_info(session: str = "s1", **changes: object) -> RecordingInfo:
    """Identity of a made-up session."""
    attachments = {"config.toml": b"[scan]\nrate_hz = 20\n", "calibration/pitot.toml": b"slope = 1.0\n"}
    return RecordingInfo(session=session, source="simulated", aircraft="cdfp", attachments=attachments, **changes)  # type: ignore[arg-type]


class FaultyFile:
    """A file that asks its storage before every operation."""

    def __init__(self, storage: "FaultyStorage", file: StorageFile) -> None:
        self._storage = storage
        self._file = file

    def write(self, data: bytes) -> int:
        self._storage.before("write", len(data))
        return self._file.write(data)

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        self._file.flush()

    def sync(self) -> None:
        self._storage.before("sync", 0)
        self._file.sync()

    def close(self) -> None:
        self._file.close()


class FaultyStorage(RealStorage):
    """Real files; `fault(operation, size)` may raise OSError, or sleep on a clock, before each operation."""

    def __init__(self, fault: Callable[[str, int], None]) -> None:
        self.before = fault
        self.created: list[Path] = []

    def create(self, path: Path) -> StorageFile:
        self.before("create", 0)
        self.created.append(path)
        return FaultyFile(self, super().create(path))


def failing_between(clock: Clock, start_s: float, end_s: float, number: int = errno.EIO) -> Callable[[str, int], None]:
    """A fault: every operation fails with `number` from start to end of the clock."""

    def fault(operation: str, size: int) -> None:
        if start_s <= clock.monotonic_ns() / NS < end_s:
            raise OSError(number, errno.errorcode[number])

    return fault


SCANS = 240
PER_CHUNK = 10


def write_recording(path: Path, *, compress: bool = False, scans: int = SCANS) -> None:
    """A small recording as the recorder would leave it."""
    with path.open("wb") as stream:
        writer = RecordingWriter(stream, make_info(), compress=compress)
        for n in range(scans):
            writer.write(scan_entry(make_scan(n)))
            if n % PER_CHUNK == PER_CHUNK - 1:
                writer.flush()
        end = scans * PERIOD_NS
        writer.write_message(EventMessage(end, 0, scans - 1, "switch", "end of run"))
        writer.write_message(LogLine(end, 0, LogLevel.INFO, "logger", "recording ends"))
        writer.write_message(Statistics(end, 0, "s1", 0, 0, scans, scans, final=True))
        writer.finish()
