"""A logger over a week of simulated time, a scan every four seconds: what its memory, its files and its counts do.

Run: python -m tests.torture.week [DAYS]. The last result is kept in docs/threat-model.md."""

import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from daq.acquisition.sampler import UnfinishedScan
from daq.acquisition.supervisor import GroupOutcome
from daq.clock import NS, SimulatedClock
from daq.contract.recordings.reading import read_recording
from daq.contract.scan import SensorState
from daq.logger import Logger
from daq.recorder.config import RecorderConfig
from daq.recorder.counts import LoopTiming
from daq.recorder.recorder import Recorder
from tests.torture.soak import open_files, resident
from tests.unit.daq.synthetic import START_UTC_NS, make_info
from tests.unit.daq.test_logger import FakeSampler

DAY_S = 86_400
RATE_HZ = 0.25
WARM = 0.1  # of the time


class WeekSampler(FakeSampler):
    """Remembers nothing of what it gave; looks at this process's memory a hundred times."""

    def __init__(self, clock: SimulatedClock, scans: int) -> None:
        super().__init__(clock)
        self.memory: list[int] = []
        self._every = max(1, scans // 100)

    def take(self, number: int, deadline_ns: int) -> UnfinishedScan:
        if number % self._every == 0:
            self.memory.append(resident())
        now = self._clock.monotonic_ns()
        self._clock.sleep_until(now + 2_000_000)
        outcomes = {"imu": GroupOutcome(SensorState.OK, values={"accel_x": number % 100})}
        return UnfinishedScan(number, now, START_UTC_NS + now, 30, (now - deadline_ns) // 1000, outcomes)


@dataclass(frozen=True)
class Week:
    """Counts of scans; files on the card; grown: resident bytes since the warm-up; open_files: as many more."""

    scans: int
    missed: int
    dropped: int
    on_card: int
    files: int
    grown: int
    open_files: int


def week(days: float, folder: Path) -> Week:
    """Log for so long onto a folder, in segments of the default two minutes, then read all of it again."""
    clock = SimulatedClock(START_UTC_NS)
    sampler = WeekSampler(clock, round(days * DAY_S * RATE_HZ))
    config, timing = RecorderConfig(directories=(folder,), sync=False), LoopTiming()
    recorder = Recorder(config, make_info("week", scan_rate_hz=RATE_HZ), clock, folder="week", timing=timing)
    clock.follow(recorder.busy)
    logger = Logger(RATE_HZ, clock, sampler, recorder, None, timing=timing)
    before = open_files()
    books = logger.run(lambda: clock.monotonic_ns() >= days * DAY_S * NS)
    grown = sampler.memory[-1] - sampler.memory[round(WARM * len(sampler.memory))]
    opened = open_files() - before
    files = sorted((folder / "week").iterdir())
    on_card = sum(len(read_recording(path, salvage=True).numbers) for path in files)
    return Week(books.written, books.missed, books.dropped, on_card, len(files), grown, opened)


def main() -> int:
    days = float(sys.argv[1]) if len(sys.argv) > 1 else 7.0
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        end = week(days, Path(folder))
    print(f"{days:g} days: {end}, grown {end.grown / 1e6:+.1f} MB")
    return 1 if end.missed or end.dropped or end.on_card != end.scans or end.open_files > 0 else 0


if __name__ == "__main__":
    sys.exit(main())
