"""How fast the simulated aircraft alone flies: one flight step by step, and many side by side."""

import time

import pytest

from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.world import simulate_many, simulate_truth


@pytest.mark.benchmark
@pytest.mark.parametrize("flights", [1, 64, 256])
def test_flights_of_thirty_seconds(flights: int) -> None:
    scenario = load_scenario("rich")
    start = time.process_time()
    if flights == 1:
        flown = [simulate_truth(scenario, 1)]
    else:
        flown = simulate_many([scenario] * flights, range(flights))
    seconds = time.process_time() - start
    print(
        f"\n{flights} flights of 30 s in {seconds:.2f} s of processor time: {30.0 * flights / seconds:.0f} times real time"
    )
    assert all(len(f["time"]) == 601 for f in flown)
