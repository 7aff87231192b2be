"""A simulated flight in a process of its own, to be killed: writes the number of scans taken to standard output."""

import os
import sys
from pathlib import Path

from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario


def main(folder: Path, speed: float, seed: int) -> None:
    flight = prepare_flight(load_scenario("nominal"), folder, seed=seed, speed=speed)

    def tell(now_ns: int) -> None:
        os.write(1, f"{len(flight.scan_times)}\n".encode())

    flight.each_scan = tell
    flight.run()


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
