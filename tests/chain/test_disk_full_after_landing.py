"""A simulated flight whose disk is full from the landing on ends, instead of fetching the same scans for a simulated hour."""

import errno
import os
from pathlib import Path

import pytest

from firmware_sim.runs.flight import SimulatedFlightRun
from firmware_sim.world.scenario import Scenario
from groundstation.receiver.storage.lasting_log import LastingLog
from sideslip.chain import fly_scenario


def test_a_disk_that_is_full_from_the_landing_on_ends_the_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    served: list[float] = []
    run, serve, flush = SimulatedFlightRun.run, SimulatedFlightRun.serve, LastingLog.flush
    landed = False

    def fly(flight: SimulatedFlightRun) -> object:
        nonlocal landed
        files = run(flight)
        landed = True
        return files

    def full(log: LastingLog) -> None:
        if landed and log._waiting:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        flush(log)

    def timed(flight: SimulatedFlightRun, *arguments: object, **named: object) -> bool:
        begun = flight.clock.monotonic_ns()
        done = serve(flight, *arguments, **named)  # type: ignore[arg-type]
        served.append((flight.clock.monotonic_ns() - begun) / 1e9)
        return done

    monkeypatch.setattr(SimulatedFlightRun, "run", fly)
    monkeypatch.setattr(SimulatedFlightRun, "serve", timed)
    monkeypatch.setattr(LastingLog, "flush", full)
    scenario = Scenario.model_validate({"title": "short", "flight": {"duration_s": 4.0}, "radio": {"drop": 0.4}})
    flown = fly_scenario(scenario, tmp_path / "flown", seed=11)
    assert sum(served) < 30.0
    assert not flown.agreed
    assert flown.summary["scans_not_on_disk"] > 0
