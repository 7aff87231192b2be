"""Hours of telemetry at any speed with a live view, its viewer killed and stopped on the way: is everything received
kept, is reception ever delayed, and does memory stay flat?

Run: python -m tests.studies.link_endurance [HOURS] [--trace]. The last result is kept in docs/link.md.
"""

import hashlib
import os
import signal
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from daq.clock import SimulatedClock
from daq.contract.recordings.reading import join
from daq.contract.recordings.segments import read_segments
from daq.telemetry.config import DownlinkConfig
from daq.transport.ports import memory_pair
from groundstation.live.config import GroundConfig
from groundstation.live.station import Station
from groundstation.receiver import events as ev
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.receive import Receiver
from groundstation.receiver.tlog import read_tlog
from groundstation.viewer.live import LiveView, ViewOptions, free_port
from groundstation.viewer.window import NativeWindow
from tests.support.aircraft_process import AircraftProcess, resident_mb
from tests.support.link_rig import PERIOD_NS, START_UTC_NS
from tests.support.paths import ROOT

RECORDING = ROOT / "recordings" / "cdfp_ld4_raw.mcap"
SCANS_PER_HOUR = 72_000
DAMAGED = 0.05
PACE = 35.0  # about so many times faster than it really goes


class Viewers:
    """rerun's viewer, a real process drawing without a display; killed, stopped and started again."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._window = NativeWindow(url, headless=True)
        self.killed = 0

    def kill_and_restart(self) -> None:
        """kill -9, and a new one."""
        os.kill(self._window.pid, signal.SIGKILL)
        self._window.wait()
        self.killed += 1
        self._window = NativeWindow(self._url, headless=True)

    @contextmanager
    def hanging(self) -> Iterator[None]:
        """A viewer that is there and takes nothing."""
        os.kill(self._window.pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(self._window.pid, signal.SIGCONT)

    def latest_s(self) -> float:
        """Flight time up to which the viewer has data [s]; NaN when it does not answer."""
        from rerun.experimental import ViewerClient

        with suppress(Exception):  # an experimental interface; that it answers at all is the finding
            client: Any = ViewerClient.connect(self._window.control)
            ends = [-1.0, 0.0]
            while ends[-1] > ends[-2] and len(ends) < 200:
                for _ in range(3):
                    client.take_screenshot()  # it takes data in while it draws
                lines = [t for r in client.get_state().recordings for t in r.timelines if t.name == "flight_time"]
                ends.append(max(float(t.end) * 1e-9 for t in lines))
            return ends[-1]
        return float("nan")

    def close(self) -> None:
        """End the viewer."""
        self._window.close()


@dataclass
class Reception:
    """A ground station with a live view, an aircraft, and a bad radio between them."""

    folder: Path
    steps_s: list[float] = field(default_factory=list)  # how long each call of the station took
    scans: int = 0
    digest: Any = field(default_factory=hashlib.sha256)

    def __post_init__(self) -> None:
        self.clock = SimulatedClock(START_UTC_NS)
        self.ground, self._far = memory_pair()
        self._loss = np.random.default_rng(2)
        config = GroundConfig(link=LinkConfig(ports=("memory",), backfill="lost"))
        self.receiver = Receiver(config.link, {"memory": self.ground}, self.clock, folder=self.folder)
        self.view = LiveView("endurance", ViewOptions(layout="light", port=free_port(), tick_s=1.0 / PACE))
        self.station = Station(config, self.receiver, self.clock, self.folder, make_view=lambda _: self.view)
        self.aircraft = AircraftProcess(RECORDING, DownlinkConfig(budget_bytes_per_s=2500))

    def fly(self, scans: int, *, scan: bool = True) -> None:
        """So many periods; with `scan` false the aircraft has landed."""
        for _ in range(scans):
            self.clock.advance(PERIOD_NS)
            data = self.aircraft.step(self._far.read(1 << 20), scan=scan)
            if data and self._loss.random() < DAMAGED:
                data = data[:30] + data[31:]
            self.digest.update(data)
            self._far.write(data)
            begun = time.perf_counter()
            happened = self.station.step()
            self.steps_s.append(time.perf_counter() - begun)
            self.scans += sum(isinstance(e, ev.ScanReceived) for e in happened)

    def slowest_ms(self) -> tuple[float, float]:
        """Longest call of the station, and its 99.9th percentile, since the last look [ms]."""
        found = np.array(self.steps_s)
        self.steps_s.clear()
        return float(found.max() * 1e3), float(np.quantile(found, 0.999) * 1e3)

    def check(self) -> str:
        """At the end: the books against the aircraft's own, the recording and the log against what came. A sentence."""
        sent, digest, _ = self.aircraft.tell()
        (books,) = self.receiver.accounting()
        assert (books.sent, books.received + books.lost_count) == (sent, sent), books
        assert books.missing == [], books.missing[:3]
        self.station.close()
        (path,) = self.folder.glob("aircraft*.mcap")
        numbers = join(path, read_segments(path)).numbers
        assert hashlib.sha256(b"".join(n.to_bytes(4, "little") for n in numbers)).hexdigest() == digest
        logged = hashlib.sha256(b"".join(data for _, data in read_tlog(self.folder / "telemetry.tlog")))
        assert logged.digest() == self.digest.digest(), "the telemetry log differs from what was received"
        return f"sent {sent} = received {books.received} + lost {books.lost_count}, all fetched; log and recording complete"

    def close(self) -> None:
        """Close everything."""
        self.aircraft.close()
        self.station.close()
        self.view.close()


def top(before: tracemalloc.Snapshot, count: int = 12) -> None:
    """Where this process's Python memory has grown since `before`."""
    for line in tracemalloc.take_snapshot().compare_to(before, "lineno")[:count]:
        print("   ", line)


def main(hours: float, trace: bool) -> None:
    with tempfile.TemporaryDirectory() as folder:
        reception = Reception(Path(folder))
        viewers = Viewers(reception.view.url)
        quarter = SCANS_PER_HOUR // 4
        begun = time.perf_counter()
        snapshot: tracemalloc.Snapshot | None = None
        print("hours   sent   received  ground MB  aircraft MB  slowest ms  99.9 % ms  pictures dropped  viewer")
        for i in range(1, round(hours * 4) + 1):
            what = ""
            if i % 2 == 0 and viewers.killed < 3:
                reception.fly(quarter // 2)
                viewers.kill_and_restart()
                reception.fly(quarter - quarter // 2)
                what = "killed, restarted"
            elif i % 4 == 3:
                with viewers.hanging():
                    reception.fly(quarter)
                what = "hung"
            else:
                reception.fly(quarter)
            sent, _, theirs = reception.aircraft.tell()
            worst, most = reception.slowest_ms()
            behind = i * 900 - viewers.latest_s()
            print(
                f"{i / 4:5.2f} {sent:7d} {reception.scans:9d} {resident_mb():10.0f} {theirs:12.0f} {worst:11.1f} "
                f"{most:10.2f} {reception.view.dropped:17d}  {what} ({behind:.0f} s behind)",
                flush=True,
            )
            if trace and i == 2:
                tracemalloc.start()
                snapshot = tracemalloc.take_snapshot()
        reception.fly(1200, scan=False)
        print(reception.check())
        print(f"viewer killed {viewers.killed} times; whole run {time.perf_counter() - begun:.0f} s")
        if snapshot is not None:
            top(snapshot)
        viewers.close()
        reception.close()


if __name__ == "__main__":
    arguments = [a for a in sys.argv[1:] if a != "--trace"]
    main(float(arguments[0]) if arguments else 2.0, "--trace" in sys.argv)
