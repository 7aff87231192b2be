"""How fast a simulated flight flies: world, instruments, chips, bus, sampler, recorder and downlink together."""

import time
from pathlib import Path

import pytest

from firmware_sim.runs.flight import simulate_flight
from firmware_sim.world.scenario import load_scenario
from tests.benchmarks.conftest import Against


@pytest.mark.benchmark
def test_a_minute_of_flight(tmp_path: Path, against_reference: Against) -> None:
    scenario = load_scenario("rich").altered(flight={"duration_s": 60.0})
    start = time.process_time()
    files = simulate_flight(scenario, tmp_path)
    seconds = time.process_time() - start
    books = files.books
    print(f"\n60 s of flight in {seconds:.1f} s, {books.written} scans, {60.0 / seconds:.0f} times real time")
    assert (books.missed, books.dropped, books.lost) == (0, 0, 0)
    assert books.written > 1180  # of 1200: the sensors start in the first half second
    against_reference("a minute of simulated flight", seconds, 600.0)  # 430 on 2026-11-28
