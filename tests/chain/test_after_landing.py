"""A simulated flight ends soon after it has landed, whatever keeps the ground from what is still on board."""

import errno
import os
import time
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
    assert flown.summary["scans_on_disk"] == flown.summary["scans_received"]  # what came before the landing


def test_nobody_who_answers_after_landing_is_told_and_waited_for_no_longer(tmp_path: Path) -> None:
    lost = [{"kind": "radio_lost", "start_s": 3.0, "stop_s": 1e5}]
    scenario = Scenario.model_validate({"title": "short", "flight": {"duration_s": 4.0}, "faults": lost})
    begun = time.monotonic()
    flown = fly_scenario(scenario, tmp_path / "flown", seed=11, speed=2.0)
    assert time.monotonic() - begun < 30.0  # two simulated minutes of radio, which at this speed would be one
    assert not flown.agreed
    assert [line for line in flown.lines if line.startswith("backfill given up: nobody answered for 60 s")]
