"""Clocks of the ground computer that jump by years, and a computer that was suspended: reception goes on, nothing is lost."""

from pathlib import Path

import numpy as np
import pytest

from daq.clock import NS, SimulatedClock
from groundstation.live.config import GroundConfig
from groundstation.live.station import Station
from groundstation.receiver.ports import LinkConfig
from groundstation.receiver.receive import Receiver
from groundstation.receiver.tlog import read_tlog
from tests.support.link_rig import START_UTC_NS, Rig, quiet_scan

YEAR_NS = 31_557_600 * NS
STEP_NS = NS // 20


class OwnClock:
    """The ground computer's: behind the aircraft's by what it slept [ns], its UTC off by so much [ns]."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock, self.slept, self.off = clock, 0, 0

    def monotonic_ns(self) -> int:
        return self._clock.monotonic_ns() - self.slept

    def utc_ns(self) -> int:
        return self._clock.utc_ns() + self.off

    def sleep_until(self, monotonic_ns: int) -> None:
        self._clock.sleep_until(monotonic_ns + self.slept)


class Pair:
    """An aircraft and a ground station with a clock of its own."""

    def __init__(self, folder: Path) -> None:
        self.rig = Rig(None)
        self.clock, self.rng, self.sent = OwnClock(self.rig.clock), np.random.default_rng(17), 0
        self.rig.ground.close()
        config = LinkConfig(ports=("memory",), backfill="all")
        self.rig.ground = Receiver(config, {"memory": self.rig._ground_end}, self.clock, folder=folder)
        self.station = Station(GroundConfig(), self.rig.ground, self.clock, folder)

    def fly(self, seconds: float, *, asleep: bool = False) -> None:
        for _ in range(round(seconds * 20)):
            rig = self.rig
            rig.clock.advance(STEP_NS)
            now = rig.clock.monotonic_ns()
            rig.link.offer(quiet_scan(self.sent, self.rng, time_ns=now))
            self.sent += 1
            rig.link.service(now)
            data = rig._air.read(1 << 20)
            if asleep:  # its socket's buffer is full after moments
                self.clock.slept += STEP_NS
                continue
            rig._ground.write(data)
            self.station.step()
            rig._air.write(rig._ground.read(1 << 20))
            rig.link.uplink.service(now, rig.logger)

    def settle(self) -> dict[str, object]:
        """Until air and ground agree, and the end."""
        for _ in range(300):
            if self.rig.ground.backfill_agreed(1):
                break
            self.fly(1.0)
        self.station.close()
        return self.rig.ground.summary()


@pytest.fixture
def pair(tmp_path: Path) -> Pair:
    return Pair(tmp_path)


@pytest.mark.parametrize("off_ns", [-START_UTC_NS, -30 * YEAR_NS, 12 * YEAR_NS, 100 * YEAR_NS])
def test_a_clock_that_jumps_by_years_loses_nothing(off_ns: int, pair: Pair, tmp_path: Path) -> None:
    pair.fly(6.0)
    pair.clock.off = off_ns
    pair.fly(6.0)
    pair.clock.off = 0  # set right again
    pair.fly(6.0)
    summary = pair.settle()
    assert summary["scans_lost"] == []
    assert summary["scans_received"] == summary["scans_on_disk"] == pair.sent
    assert (summary["quarantined"], pair.rig.ground.port_faults) == ({}, {})
    (telemetry,) = tmp_path.glob("*.tlog")
    assert sum(1 for _ in read_tlog(telemetry)) > pair.sent


def test_a_computer_that_was_suspended_goes_on_and_fetches_what_it_slept_through(pair: Pair) -> None:
    pair.fly(10.0)
    pair.fly(60.0, asleep=True)
    pair.clock.off = 0
    pair.fly(10.0)
    received = int(str(pair.rig.ground.summary()["scans_received"]))
    assert received > 300
    summary = pair.settle()
    assert summary["scans_received"] == summary["scans_on_disk"] == pair.sent
    assert (summary["quarantined"], pair.rig.ground.port_faults) == ({}, {})
