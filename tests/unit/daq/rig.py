"""The sampler on the simulated aircraft's chips, held still in one moment of a flight.

Chips and drivers were written by different people from the same datasheets; where the two meet is what is tested.
"""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from daq.acquisition.sampler import EventMark, Sampler
from daq.clock import SimulatedClock
from daq.contract.scan import Scan, SensorState
from daq.sensors.config import SensorsConfig
from firmware_sim.hardware.bus import BusModel
from firmware_sim.hardware.faults import FaultSet, parse_faults
from firmware_sim.hardware.sensing.instruments import TruthSource
from firmware_sim.hardware.sensing.sensor_models import SensorModels
from firmware_sim.hardware.serial import SimulatedSerial
from firmware_sim.runs.flight import SimulatedHardware, build_aircraft
from firmware_sim.world.scenario import load_scenario
from firmware_sim.world.truth import Truth
from firmware_sim.world.world import World
from tests.unit.daq.cdfp_fit import cdfp_sensors

UTC0 = 1_795_000_000_000_000_000
AIRBORNE_S = 30.0


@cache
def moment() -> Truth:
    """The truth some time into the built-in nominal flight."""
    return World(load_scenario("nominal"), 1).advance(AIRBORNE_S)


class Frozen:
    """A truth source in which nothing moves but time."""

    def advance(self, to_time: float) -> Truth:
        return replace(moment(), time=to_time)


@dataclass
class Rig:
    """Sampler, clock and simulated hardware; `fly` makes scans on the deadlines of the rate."""

    sampler: Sampler
    clock: SimulatedClock
    aircraft: SimulatedHardware
    rate_hz: float
    events: list[EventMark]
    number: int = 0
    longest_ns: int = 0

    def fly(self, seconds: float) -> list[Scan]:
        period = round(1e9 / self.rate_hz)
        deadline = -(-self.clock.monotonic_ns() // period) * period
        scans = []
        for _ in range(round(seconds * self.rate_hz)):
            self.clock.sleep_until(deadline)
            begun = self.clock.monotonic_ns()
            scans.append(self.sampler.finish(self.sampler.take(self.number, deadline)))
            self.longest_ns = max(self.longest_ns, self.clock.monotonic_ns() - begun)
            self.number += 1
            deadline += period
        return scans


def rig(
    faults: tuple[dict[str, Any], ...] = (),
    *,
    rate_hz: float = 20.0,
    config: SensorsConfig | None = None,
    bus: BusModel | None = None,
    start: bool = True,
    source: TruthSource | None = None,
) -> Rig:
    """A rig; fault times count from its construction. `start` sets the sensors up first, which takes 0.6 s."""
    clock = SimulatedClock(UTC0, start_monotonic_ns=5_000_000_000)
    models = SensorModels() if bus is None else SensorModels(bus=bus)
    fault_set = FaultSet(parse_faults(faults, "test"), clock.monotonic_ns(), 1)
    aircraft = build_aircraft(source or Frozen(), models, fault_set, clock, 1)
    port = SimulatedSerial(aircraft.gnss, clock.monotonic_ns)
    events: list[EventMark] = []
    sampler = Sampler(config or cdfp_sensors(), aircraft.bus, port, clock, rate_hz=rate_hz, on_event=events.append)
    if start:
        sampler.start()
    return Rig(sampler, clock, aircraft, rate_hz, events)


def states(scans: list[Scan], group: str) -> list[SensorState]:
    """The group's state in each scan that has one."""
    return [s.groups[group].state for s in scans if group in s.groups]
