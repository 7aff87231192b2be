"""How fast a simulated flight flies: world, instruments, chips, bus, sampler, recorder and downlink together."""

import time
from pathlib import Path

import pytest

from firmware_sim.runs.flight import simulate_flight
from firmware_sim.world.scenario import load_scenario


@pytest.mark.benchmark
def test_a_minute_of_flight(tmp_path: Path) -> None:
    scenario = load_scenario("rich").altered(flight={"duration_s": 60.0})
    start = time.perf_counter()
    files = simulate_flight(scenario, tmp_path)
    seconds = time.perf_counter() - start
    print(f"\n60 s of flight in {seconds:.1f} s, {files.books.written} scans, {60.0 / seconds:.0f} times real time")
    assert files.books.written > 1190
