"""Hours of a ground station in minutes: simulated time, real files; what its memory does after a warm-up."""

import resource
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daq.telemetry.config import DownlinkConfig
from groundstation.live.config import GroundConfig
from groundstation.live.station import Station
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.timeline import NS
from sideslip.live_aircraft import live_aircraft
from tests.support.link_rig import Rig, quiet_scan

STEP_NS = NS // 20
WARM_S = 600.0


@dataclass(frozen=True)
class Soak:
    """seconds: flown, simulated. grown: resident memory at the end less that after the warm-up [bytes]. scans: received; lost:
    sent and not received. open_files: at the end, more than after the warm-up."""

    seconds: float
    grown: int
    scans: int
    lost: int
    open_files: int
    trouble: dict[str, str]


def soak(seconds: float, seed: int = 1) -> Soak:
    """An aircraft that stands, taxies and talks, received for so long."""
    with tempfile.TemporaryDirectory() as folder:
        little = DownlinkConfig(
            budget_bytes_per_s=20_000, backfill_memory_mb=1
        )  # the aircraft's end is in this process too
        rig = Rig(Path(folder), ground=LinkConfig(ports=("memory",)), aircraft=little)
        config = GroundConfig.model_validate({"identification": {"aircraft": "cdfp"}})
        station = Station(config, rig.ground, rig.clock, Path(folder), aircraft=live_aircraft)
        warm = files = 0
        for _ in _flown(rig, station, min(WARM_S, seconds / 4), seed, 0):
            pass
        warm, files = resident(), open_files()
        for _ in _flown(rig, station, seconds, seed + 1, round(min(WARM_S, seconds / 4) * 20)):
            pass
        grown, opened = resident() - warm, open_files() - files
        station.close()
        summary = rig.ground.summary()
        lost = sum(b - a + 1 for a, b in summary["scans_lost"])
        return Soak(seconds, grown, summary["scans_received"], lost, opened, rig.ground.port_faults)


def _flown(rig: Rig, station: Station, seconds: float, seed: int, first: int) -> Iterator[None]:
    rng = np.random.default_rng(seed)
    for n in range(first, first + round(seconds * 20)):
        rig.clock.advance(STEP_NS)
        now = rig.clock.monotonic_ns()
        rig.link.offer(quiet_scan(n, rng, time_ns=now, speed_mm_s=1000 * (n // 200 % 20)))
        rig.link.service(now)
        rig._ground.write(rig._air.read(1 << 20))
        station.step()
        rig._air.write(rig._ground.read(1 << 20))
        rig.link.uplink.service(now, rig.logger)
        yield


def resident() -> int:
    """Bytes of this process that are in memory now."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def open_files() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())
