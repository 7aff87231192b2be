"""An aircraft in a process of its own, in step with a ground station in this one: neither's memory hides the other's."""

import hashlib
import multiprocessing
import resource
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

from daq.clock import SimulatedClock
from daq.contract.recordings.reading import read_recording
from daq.contract.scan import Scan
from daq.telemetry.config import DownlinkConfig
from daq.telemetry.link import radio_link
from daq.transport.ports import memory_pair
from tests.support.link_rig import PERIOD_NS, START_UTC_NS, FakeLogger

_SCAN, _REST, _TELL, _END = b"S", b"R", b"T", b"E"


def resident_mb() -> float:
    """Memory of this process now [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def numbered(scan: Scan, number: int, now_ns: int) -> Scan:
    """A recorded scan at another place in another flight."""
    return replace(scan, number=number, time_monotonic_ns=now_ns, time_utc_ns=START_UTC_NS + now_ns)


def _fly(connection: Connection, recording: Path, config: DownlinkConfig) -> None:
    source = read_recording(recording)
    pool = list(source.scans())
    clock, logger = SimulatedClock(START_UTC_NS), FakeLogger()
    ours, air = memory_pair()
    link = radio_link(config, ours, clock, papers=lambda: source.info, boot=7)
    number = 0
    while (order := connection.recv_bytes())[:1] != _END:
        if order == _TELL:
            sent = link.downlink.sent
            digest = hashlib.sha256(b"".join(n.to_bytes(4, "little") for n in sent)).hexdigest()
            connection.send((len(sent), digest, resident_mb()))
            continue
        air.write(order[1:])
        clock.advance(PERIOD_NS)
        now = clock.monotonic_ns()
        if order[:1] == _SCAN:
            link.offer(numbered(pool[number % len(pool)], number, now))
            number += 1
            link.service(now)
            link.uplink.service(now, logger)
        else:
            link.idle(now)
        connection.send_bytes(air.read(1 << 20))
    link.close()


class AircraftProcess:
    """Flies a recording over and over. Each step is one scan period on both clocks."""

    def __init__(self, recording: Path, config: DownlinkConfig) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_fly, args=(theirs, recording, config), daemon=True)
        self._process.start()
        theirs.close()

    def step(self, uplink: bytes, *, scan: bool = True) -> bytes:
        """One period with a scan, or without; takes what came up and returns what comes down."""
        self._connection.send_bytes((_SCAN if scan else _REST) + uplink)
        return self._connection.recv_bytes()

    def tell(self) -> tuple[int, str, float]:
        """Scans sent, SHA-256 of their numbers, and memory [MB]."""
        self._connection.send_bytes(_TELL)
        sent, digest, memory = self._connection.recv()
        return int(sent), str(digest), float(memory)

    def close(self) -> None:
        """Land for good."""
        self._connection.send_bytes(_END)
        self._process.join()
        self._connection.close()
        self._process.close()
