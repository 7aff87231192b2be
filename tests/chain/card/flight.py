"""The real logger on a simulated aircraft, recording onto a card that may lose its power: in step, so that it can be repeated.

The scans come through sampler, drivers and bus as in flight. Simulated time stands still while the recorder's threads work
and goes on while they wait for the card, whose every operation takes as long as the card is said to be slow: what is lost
at a given instant depends on nothing else.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from daq.acquisition.sampler import UnfinishedScan
from daq.assembly import Assembly, HardwareEdge, assemble
from daq.clock import NS, SimulatedClock
from daq.contract.recordings.messages import Statistics
from daq.contract.scan import Scan, encode_scan
from daq.recorder.storage import RealFile, RealStorage, StorageFile
from daq.transport.ports import memory_pair
from firmware_sim.hardware.faults import FaultSet
from firmware_sim.hardware.sensing.sensor_models import SensorModels
from firmware_sim.hardware.serial import SimulatedSerial
from firmware_sim.runs.flight import CONFIG_FILE, START_UTC_NS, build_aircraft, logger_config
from firmware_sim.world.scenario import load_scenario
from tests.unit.daq.rig import Frozen

_SETTLING_S = 30.0


@dataclass(frozen=True, slots=True)
class Slowness:
    """How long the card takes, in the flight's time. sync_s: every sync, before what it moves at `bytes_per_s`."""

    operation_s: float = 0.002
    sync_s: float = 0.0
    bytes_per_s: float = 5e6


SOUND = Slowness()
SLOW = Slowness(sync_s=0.2)
"""A bad SD card: 5 MB/s, and 200 ms of housekeeping at every sync."""


class PacedStorage(RealStorage):
    """Real files whose operations take the flight's time. asleep: whether a thread waits for the card just now."""

    def __init__(
        self, clock: SimulatedClock, slowness: Slowness, make: Callable[[Path], StorageFile] = RealFile
    ) -> None:
        self.slowness = slowness
        self._make = make
        self.syncs_s: list[float] = []
        self._clock = clock
        self._until: dict[int, int] = {}

    def create(self, path: Path) -> StorageFile:
        self.take(self.slowness.operation_s)
        return _PacedFile(self, self._make(path))

    def take(self, seconds: float) -> None:
        """Let so much time pass."""
        until = self._clock.monotonic_ns() + round(seconds * NS)
        key = threading.get_ident()
        self._until[key] = until
        self._clock.sleep_until(until)
        del self._until[key]

    @property
    def asleep(self) -> bool:
        """Whether an operation is under way that lasts beyond now."""
        now = self._clock.monotonic_ns()
        return any(until > now for until in list(self._until.values()))


class _PacedFile:
    def __init__(self, storage: PacedStorage, file: StorageFile) -> None:
        self._storage = storage
        self._file = file
        self._synced = 0

    def write(self, data: bytes) -> int:
        return self._file.write(data)

    def tell(self) -> int:
        return self._file.tell()

    def flush(self) -> None:
        self._file.flush()

    def sync(self) -> None:
        size, slowness = self._file.tell() - self._synced, self._storage.slowness
        seconds = slowness.operation_s + slowness.sync_s + size / slowness.bytes_per_s
        self._storage.take(seconds)
        self._storage.syncs_s.append(seconds)
        self._synced += size
        self._file.sync()

    def close(self) -> None:
        self._file.close()


class CardFlight:
    """One session. truth: every scan taken, as encoded, by its number. key: with a signed radio link; `ground` is its end. make:
    opens a file on the card, for other ways to write than the logger's.
    """

    def __init__(
        self,
        folder: Path,
        *,
        slowness: Slowness = SOUND,
        recorder: dict[str, object] | None = None,
        key: Path | None = None,
        make: Callable[[Path], StorageFile] = RealFile,
    ) -> None:
        self.truth: dict[int, bytes] = {}
        self.clock = SimulatedClock(START_UTC_NS)
        self.storage = PacedStorage(self.clock, slowness, make)
        downlink = None if key is None else {"key_file": str(key)}
        scenario = load_scenario("quiet").altered(logger={"recorder": recorder or {}, "downlink": downlink})
        config, text = logger_config(scenario, folder, CONFIG_FILE, None)
        air, self.ground = memory_pair()
        aircraft = build_aircraft(Frozen(), SensorModels(), FaultSet((), 0, 1), self.clock, 1)
        gnss = SimulatedSerial(aircraft.gnss, self.clock.monotonic_ns)
        edge = HardwareEdge(self.clock, aircraft.bus, gnss, "simulated", storage=self.storage, radio=air)
        self.assembly: Assembly = assemble(config, text, edge)
        self.directory = config.recorder.directories[0] / self.assembly.session
        self._keep_truth()
        self._due: list[tuple[int, Callable[[int], None]]] = []
        self.clock.on_advance(self._at)

    def _keep_truth(self) -> None:
        sampler = self.assembly.sampler
        finish, take = sampler.finish, sampler.take
        self.taken = 0

        def taken(number: int, deadline_ns: int) -> UnfinishedScan:
            self.taken = number + 1
            return take(number, deadline_ns)

        def finished(unfinished: UnfinishedScan) -> Scan:
            scan = finish(unfinished)
            self.truth[scan.number] = encode_scan(scan)
            return scan

        sampler.take, sampler.finish = taken, finished  # type: ignore[method-assign]  # the logger holds this object

    def at(self, seconds: float, do: Callable[[int], None]) -> None:
        """Do something at an instant of the flight; it is given how many scans have been taken by then."""
        self._due.append((round(seconds * NS), do))
        self._due.sort(key=lambda pair: pair[0])

    def _at(self, now_ns: int) -> None:
        self._settle()
        while self._due and self._due[0][0] <= now_ns:
            self._due.pop(0)[1](self.taken)

    def _settle(self) -> None:
        """Wait until the recorder's threads have nothing to do at this instant, or wait for the card."""
        deadline = time.monotonic() + _SETTLING_S
        while self.assembly.recorder.at_work() and not self.storage.asleep:
            assert time.monotonic() < deadline, "the recorder does not come to rest"
            time.sleep(0.0002)

    def fly(self, seconds: float) -> Statistics:
        """Fly to the end and close the recording in order."""
        end_ns = round(seconds * NS)
        try:
            return self.assembly.logger.run(lambda: self.clock.monotonic_ns() >= end_ns)
        finally:
            if self.assembly.link is not None:
                self.assembly.link.close()
