"""Scans of an aircraft that stands still, under faults: the real sampler over the simulated bus, as fast as it goes."""

from collections.abc import Iterable
from types import SimpleNamespace

from daq.acquisition.sampler import Sampler
from daq.clock import SimulatedClock
from daq.contract.scan import Scan, SensorState
from daq.sensors.config import SensorsConfig
from firmware_sim.hardware.faults import FaultSet, parse_faults
from firmware_sim.hardware.sensing.sensor_models import SensorModels
from firmware_sim.hardware.serial import SimulatedSerial
from firmware_sim.runs.flight import START_UTC_NS, SimulatedHardware, build_aircraft
from tests.unit.daq.cdfp_fit import cdfp_sensors
from tests.unit.firmware_sim.hardware import Still

ON_BUS = ("imu", "mag", "analog_a", "analog_b", "analog_c", "pitot", "static", "thrust", "capture")


def standing(
    *lines: dict[str, object],
    duration_s: float = 6.0,
    truth: SimpleNamespace | None = None,
    models: SensorModels | None = None,
    config: SensorsConfig | None = None,
    rate_hz: float = 20.0,
    seed: int = 1,
) -> tuple[list[Scan], SimulatedHardware, Sampler]:
    """Scans of `duration_s` from power-up, the aircraft they were made on, and the sampler."""
    clock = SimulatedClock(START_UTC_NS)
    faults = FaultSet(parse_faults(lines, "test"), 0, seed)
    sensors = config or cdfp_sensors()
    aircraft = build_aircraft(Still(truth), models or SensorModels(), faults, clock, seed, sensors)
    gnss = SimulatedSerial(aircraft.gnss, clock.monotonic_ns)
    sampler = Sampler(sensors, aircraft.bus, gnss, clock, rate_hz=rate_hz)
    sampler.start()
    start, period = clock.monotonic_ns(), round(1e9 / rate_hz)
    scans = []
    while clock.monotonic_ns() < duration_s * 1e9:
        deadline = start + (len(scans) + 1) * period
        clock.sleep_until(deadline)
        scans.append(sampler.finish(sampler.take(len(scans), deadline)))
    return scans, aircraft, sampler


def states(scans: Iterable[Scan], group: str) -> list[SensorState]:
    """The state of a group in each scan that has it."""
    return [scan.groups[group].state for scan in scans if group in scan.groups]


def between(scans: Iterable[Scan], start_s: float, stop_s: float) -> list[Scan]:
    """Scans that began within a time window [s]."""
    return [scan for scan in scans if start_s <= scan.time < stop_s]


def all_well(scans: Iterable[Scan], *, but: tuple[str, ...] = ()) -> bool:
    """Whether all groups on the bus, apart from some, are ok in all these scans."""
    return all(scan.groups[group].state is SensorState.OK for scan in scans for group in ON_BUS if group not in but)
