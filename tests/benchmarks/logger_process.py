"""The logger alone in a process, on a replayed bus, in real time: prints its CPU time and memory as JSON lines.

Arguments: configuration, recorded answers, seconds.
"""

import json
import os
import resource
import sys
from collections.abc import Callable
from pathlib import Path

from daq.assembly import Edge, assemble
from daq.clock import NS, RealClock
from daq.config import load_config
from daq.contract.ports import memory_pair
from daq.health import HealthSummary
from daq.service.realtime import GarbageDiscipline
from daq.timing import describe
from tests.benchmarks.replayed_bus import ReplayedBus


def resident_mb() -> float:
    """Resident memory of this process now [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def cpu_s() -> float:
    """CPU time of this process so far [s]."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def main(config_path: Path, answers: Path, seconds: float) -> None:
    config, text = load_config(config_path)
    clock = RealClock()
    air, ground = memory_pair()
    seen: list[tuple[float, float, float]] = []
    with GarbageDiscipline(enabled=True) as garbage:

        def every_second() -> None:
            garbage.collect()
            ground.read()
            seen.append((clock.monotonic_ns() / NS, cpu_s(), resident_mb()))

        bus = ReplayedBus(answers)
        edge = Edge(clock, bus, None, "simulated", radio=air)
        made = assemble(config, text, edge, session="bench", folder="", housekeeping=every_second)
        start = made.sampler.start

        def started() -> HealthSummary:
            summary = start()
            bus.scans_begin()
            return summary

        made.sampler.start = started  # type: ignore[method-assign]
        books = made.logger.run(_after(clock, seconds))
    first, last = seen[min(5, len(seen) - 1)], seen[-1]
    result = {
        "seconds": round(last[0] - first[0], 1),
        "cpu_percent": round(100 * (last[1] - first[1]) / (last[0] - first[0]), 2),
        "resident_mb": [round(s[2], 1) for s in (first, seen[len(seen) // 2], last)],
        "slots": books.slots,
        "written": books.written,
        "missed": books.missed,
        "late": books.late_scans,
        "health": made.sampler.health().words,
        "timing_us": {name: {"p50": p50, "p99": p99} for name, p50, p99 in describe(books)},
        "lateness_max_us": made.logger.timing.lateness.largest_us,
    }
    print(json.dumps(result))


def _after(clock: RealClock, seconds: float) -> Callable[[], bool]:
    end = clock.monotonic_ns() + round(seconds * NS)
    return lambda: clock.monotonic_ns() >= end


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]))
