"""How fast a simulated flight flies: world, instruments, chips, bus, sampler, recorder and downlink together."""

import time
from pathlib import Path

import pytest

from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario
from tests.benchmarks.conftest import Against


@pytest.mark.benchmark
def test_a_minute_of_flight(tmp_path: Path, against_reference: Against) -> None:
    scenario = load_scenario("rich").altered(flight={"duration_s": 60.0})
    start = time.process_time()
    with prepare_flight(scenario, tmp_path) as prepared:
        files = prepared.run()
    seconds = time.process_time() - start
    statistics = files.statistics
    print(f"\n60 s of flight in {seconds:.1f} s, {statistics.written} scans, {60.0 / seconds:.0f} times real time")
    assert (statistics.missed, statistics.dropped, statistics.lost) == (0, 0, 0)
    assert statistics.written > 1180  # of 1200: the sensors start in the first half second
    against_reference("a minute of simulated flight", seconds, 600.0)  # 430 on 2026-11-28
