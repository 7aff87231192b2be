"""The logger as the service runs it, on a replayed bus and GPS port, until SIGTERM; prints its books as one JSON line.

Arguments: configuration, recorded answers, for how many seconds GPS fixes come; then, if the radio is to be a real port, its
description (`udpin:14550`), and how long a bus transfer takes [us]. Who measures looks from outside.
"""

import json
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from daq.acquisition.health import HealthSummary
from daq.acquisition.sampler import Sampler
from daq.assembly import HardwareEdge
from daq.clock import RealClock
from daq.config import load_config
from daq.contract.recordings.messages import Statistics
from daq.sensors.open import ReopeningBus
from daq.sensors.transfers import prepared
from daq.service.run import run_until_signal
from daq.telemetry.link import open_port
from daq.transport.ports import BytePort, memory_pair
from tests.benchmarks.replayed_bus import AnsweringKernel, ReplayedBus, ReplayedReceiver, TimedBus

_EMPTY_RADIO_S = 10.0


class SmbusFile(ReopeningBus):
    """The logger's own bus, opened upon an answering kernel."""

    def __init__(self, kernel: AnsweringKernel) -> None:
        self._kernel = kernel
        super().__init__("/dev/i2c-replayed", 10, RealClock())

    def _open(self) -> Any:
        return prepared(self._kernel.open())


def describe(books: Statistics) -> Iterator[tuple[str, float, float]]:
    """(name, median, 99th percentile) [us] of each histogram with counts, as upper edges of their bins."""
    edges = np.array([*books.edges_us, books.edges_us[-1]], float)
    for name in ("lateness", "interval_error", "scan_duration", "write_latency", "sync_latency"):
        counts = getattr(books, name)
        if sum(counts):
            reached = np.cumsum(counts)
            p50, p99 = edges[np.searchsorted(reached, reached[-1] * np.array([0.5, 0.99]))]
            yield name, float(p50), float(p99)


def main(config_path: Path, answers: Path, seconds: float, radio: str = "", transfer_us: float = 0.0) -> None:
    """Run the logger and print how it went."""
    config, text = load_config(config_path)
    memory, ground = memory_pair()
    air: BytePort = open_port(radio) if radio else memory
    bus = TimedBus(answers, transfer_us * 1e-6) if transfer_us else ReplayedBus(answers)
    set_up = Sampler.start

    def start(sampler: Sampler) -> HealthSummary:
        summary = set_up(sampler)
        bus.scans_begin()
        return summary

    Sampler.start = start  # type: ignore[method-assign]
    over = threading.Event()

    def listen() -> None:
        while not over.wait(_EMPTY_RADIO_S):
            ground.read()

    listener = threading.Thread(target=listen, name="listener")
    listener.start()
    sensors = bus if transfer_us else SmbusFile(AnsweringKernel(bus))
    edge = HardwareEdge(RealClock(), sensors, ReplayedReceiver(answers, seconds), "simulated", radio=air)
    outcome = run_until_signal(config, text, edge, [])
    air.close()
    over.set()
    listener.join()
    books = outcome.statistics
    result = {
        "directory": str(outcome.directory),
        "slots": books.slots,
        "written": books.written,
        "missed": books.missed,
        "closes": books.closes,
        "later_than_5_ms": books.late_scans,
        "timing_us": {name: {"p50": p50, "p99": p99} for name, p50, p99 in describe(books)},
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]), *sys.argv[4:5], *map(float, sys.argv[5:6]))
