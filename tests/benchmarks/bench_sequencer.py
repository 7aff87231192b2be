"""What the onboard sequencer costs: regularity of its 50 Hz output on the simulated bus, and CPU beside that of the scan.

Both come from one simulated flight. Times of output are the simulated clock's, moved on by bus transfers and conversions;
CPU is this process's, with the simulated bus in both parts, and given as a ratio only. Run by `make bench`.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.contract.recordings.reading import read_recording
from daq.contract.sequencing import State
from firmware_sim.runs.flight import prepare_flight
from firmware_sim.world.scenario import load_scenario

DRIVER = 0x41


@pytest.mark.benchmark
def test_output_and_cost(tmp_path: Path) -> None:
    spent = {"scan": 0.0, "sequencer": 0.0}
    writes: list[int] = []
    with prepare_flight(load_scenario("sequencer"), tmp_path) as flight:
        bus, clock, made = flight.aircraft.bus, flight.clock, flight.assembly
        assert made.actuation is not None
        _time(made.sampler, "take", spent, "scan")
        _time(made.sampler, "finish", spent, "scan")
        _time(made.actuation, "frame", spent, "sequencer")
        plain = bus.write_i2c_block_data

        def noted(address: int, register: int, data: Any, force: bool | None = None) -> None:
            plain(address, register, data, force)
            if address == DRIVER:
                writes.append(clock.monotonic_ns())

        bus.write_i2c_block_data = noted  # type: ignore[method-assign]
        flight.run()
    frames = [f.time_monotonic_ns for f in read_recording(tmp_path / "onboard").sequencer if f.state == State.RUNNING]
    inside = np.array([w for w in writes if frames[0] <= w <= frames[-1]])
    off = (np.diff(inside) - 20e6) / 20e6
    print(f"\n{len(inside)} outputs at 50 Hz, intervals off by (share of the period):")
    print(f"rms {np.std(off):.4f}, 99 % within {np.percentile(np.abs(off), 99):.4f}, worst {np.max(np.abs(off)):.4f}")
    print(f"CPU of the sequencer: {spent['sequencer'] / spent['scan']:.2f} of that of the scan it goes by")
    assert np.max(np.abs(off)) < 0.5


def _time(owner: object, name: str, spent: dict[str, float], what: str) -> None:
    plain: Callable[..., Any] = getattr(owner, name)

    def timed(*arguments: Any, **named: Any) -> Any:
        began = time.process_time()
        try:
            return plain(*arguments, **named)
        finally:
            spent[what] += time.process_time() - began

    setattr(owner, name, timed)
