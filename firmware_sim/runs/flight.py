"""A complete simulated flight: simulated world, instruments, chips and radio with the real logger.

Sampler, logger, recorder and downlink are the real ones; they get a simulated bus, serial port, card, clock and radio. The ground
end of the radio is available to the caller, who may connect a ground station to it.
"""

import datetime as dt
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from daq.acquisition.sampler import UnfinishedScan
from daq.actuation.servos import plan_of
from daq.assembly import Assembly, HardwareEdge, assemble
from daq.clock import SimulatedClock
from daq.config import LoggerConfig, parse_config
from daq.contract.manoeuvre import load_manoeuvre
from daq.contract.recordings.messages import Statistics
from daq.sensors.bus import SerialPortCalls
from daq.sensors.config import SensorsConfig
from daq.utilities.durable import write_text
from estimation.aircraft import built_in_aircraft, load_aircraft
from firmware_sim.hardware.autopilot_cockpit import AutopilotCockpit
from firmware_sim.hardware.autopilots.servo_reports import Autopilot
from firmware_sim.hardware.board import (
    ONLY_WITH_SEQUENCER,
    BoardWiring,
    addressed,
    build_board,
    laboratory_chips,
    sites,
)
from firmware_sim.hardware.bus import SimulatedBus
from firmware_sim.hardware.card import SimulatedCard
from firmware_sim.hardware.cockpit import Cockpit, CockpitTable, Monostable
from firmware_sim.hardware.faults import FaultEvents, FaultSet, parse_faults
from firmware_sim.hardware.radio import RadioModel, SimulatedRadioLink
from firmware_sim.hardware.registers.sbus import SbusReceiver
from firmware_sim.hardware.sensing.aircraft_instruments import calibration_of, placed
from firmware_sim.hardware.sensing.gnss import GnssReceiver
from firmware_sim.hardware.sensing.instruments import Instruments, TruthSource
from firmware_sim.hardware.sensing.sensor_models import SensorModels, parse_sensors
from firmware_sim.hardware.sensing.truth_log import TruthFile
from firmware_sim.hardware.serial import PseudoTerminal, SimulatedSerial, Talker
from firmware_sim.tables import ScenarioError, checked, merged, toml_text
from firmware_sim.world.scenario import Scenario
from firmware_sim.world.world import World

START_UTC_NS = int(dt.datetime(2026, 6, 1, 6, 30, tzinfo=dt.UTC).timestamp()) * 1_000_000_000
"""UTC at which every simulated flight begins, so that the same seed gives the same recording."""

SERVE_STEP_NS = 50_000_000  # of the clock between two turns of the radio after landing

CONFIG_FILE = Path(__file__).parents[2] / "daq" / "configs" / "cdfp.toml"
SEQUENCER_FILE = CONFIG_FILE.with_name("cdfp_sequencer.toml")
"""Configuration of a sequencer, merged into that of scenarios with a table [sequencer]."""
ARDUPILOT_FILE = CONFIG_FILE.with_name("cdfp_sequencer_ardupilot.toml")
"""The same for a sequencer that moves the servos through an ArduPlane."""
LOOP_HZ = 100.0  # SCHED_LOOP_RATE of an autopilot that is a sensor
AUTOPILOT_ON_NS = 10_000_000_000  # before the recording begins: time to start up
MANOEUVRE_FILE = Path(__file__).parents[1] / "scenarios" / "manoeuvres" / "lateral_3211.toml"
"""The manoeuvre of a sequencer unless the configuration or `sideslip fly --manoeuvre` names another."""


USUAL_SENSORS = SensorsConfig()


@dataclass(frozen=True, slots=True)
class SimulatedHardware:
    """The simulated hardware under the logger."""

    clock: SimulatedClock
    instruments: Instruments
    faults: FaultSet
    bus: SimulatedBus
    gnss: GnssReceiver
    autopilot: Autopilot
    events: FaultEvents

    def newest_pulse(self) -> int | None:
        """Time [ns] of the latest pulse on the pulse-per-second line of the GPS, as the kernel reports it."""
        return self.gnss.newest_pulse(self.clock.monotonic_ns())


def build_aircraft(
    source: TruthSource,
    models: SensorModels,
    faults: FaultSet,
    clock: SimulatedClock,
    seed: int,
    sensors: SensorsConfig = USUAL_SENSORS,
    cockpit: Cockpit | AutopilotCockpit | None = None,
) -> SimulatedHardware:
    """Instruments, chips, bus and GPS of an aircraft that moves as `source` says, time zero being the clock's now.

    sensors: which chips are fitted; installed packages may have simulated ones of a laboratory's own.
    """
    origin = clock.monotonic_ns()
    instruments = Instruments(source, models, seed, origin)
    board = build_board(BoardWiring(instruments, faults.bend, faults.quiet, cockpit, sensors=sensors))
    faults.addresses = sites(sensors)
    chips, laboratory = addressed(board, faults.addresses), laboratory_chips(sensors.extra, instruments)
    for address in laboratory.keys() & chips.keys():
        raise ScenarioError(
            f"sensors.extra: address 0x{address:02x} is taken by a chip of the aircraft; choose another"
        )
    bus = SimulatedBus(clock, {**chips, **laboratory}, instruments.models.bus, faults.disturb)
    gnss = GnssReceiver(instruments, clock.utc_ns(), faults.gnss_corrupt)
    autopilot = Autopilot(instruments)
    autopilot.start_utc_ns = clock.utc_ns()
    events = FaultEvents(faults, {**board, "gnss": gnss, "autopilot": autopilot}, clock.step_utc, origin)
    events.at(origin)
    if events.any_left:
        clock.on_advance(events.at)
    return SimulatedHardware(clock, instruments, faults, bus, gnss, autopilot, events)


@dataclass(frozen=True, slots=True)
class FlightFiles:
    """The files of a simulated flight, and the recorder's statistics."""

    folder: Path
    recordings: tuple[Path, ...]
    truth: Path
    scenario: Path
    statistics: Statistics


@dataclass
class SimulatedFlightRun:
    """A prepared flight: `run` flies it, `serve` continues the radio after landing, `close` releases everything.

    radio: both ends of the link; a ground station reads and writes `radio.ground`. each_scan: called before every scan
    with monotonic time [ns], in the flight's thread: the place to run a ground station in step. cancelled: set it to end
    early. A context manager that closes.
    """

    scenario: Scenario
    folder: Path
    config: LoggerConfig
    clock: SimulatedClock
    aircraft: SimulatedHardware
    radio: SimulatedRadioLink
    assembly: Assembly
    truth: TruthFile
    duration_s: float
    each_scan: Callable[[int], None] = field(default=lambda now_ns: None)
    cancelled: bool = False
    scan_times: list[float] = field(default_factory=list)
    closers: list[Callable[[], None]] = field(default_factory=list)
    cockpit: Cockpit | AutopilotCockpit | None = None

    def run(self) -> FlightFiles:
        """Fly to the end, or until `cancelled`, and write the files beside the recording."""
        self.clock.drive()
        end_ns = self.clock.monotonic_ns() + round(self.duration_s * 1e9)

        def stop() -> bool:
            now_ns = self.clock.monotonic_ns()
            self.each_scan(now_ns)
            return self.cancelled or now_ns >= end_ns

        statistics = self.assembly.logger.run(stop)
        self.truth.close()
        scenario = self.folder / "scenario.toml"
        table = self.scenario.model_dump(exclude_defaults=True, mode="json")
        table.setdefault("flight", {})["seed"] = self.scenario.flight.seed
        write_text(scenario, toml_text(table))
        recordings = tuple(sorted((self.folder / "onboard").glob("*.mcap")))
        return FlightFiles(self.folder, recordings, self.truth.path, scenario, statistics)

    def serve(self, until: Callable[[], bool], limit_s: float = 600.0) -> bool:
        """After landing: no scans, but the radio goes on (backfill, log download) until `until()`; False at the limit."""
        link, logger = self.assembly.link, self.assembly.logger
        end_ns = self.clock.monotonic_ns() + round(limit_s * 1e9)
        while not until():
            now_ns = self.clock.monotonic_ns()
            if now_ns >= end_ns:
                return False
            if link is not None:
                link.service(now_ns)
                link.uplink.service(now_ns, logger)
            self.each_scan(now_ns)
            self.clock.advance(SERVE_STEP_NS)
        return True

    def close(self) -> None:
        """Close all ports and files."""
        if self.assembly.link is not None:
            self.assembly.link.close()
        self.truth.close()
        for close in self.closers:
            close()
        self.closers.clear()

    def __enter__(self) -> "SimulatedFlightRun":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def note_scans(self) -> None:
        """From now on write the truth of every scan, recorded or not, and append its time to `scan_times`."""

        def note(taken: UnfinishedScan) -> None:
            time = taken.time_monotonic_ns * 1e-9
            self.scan_times.append(time)
            self.truth.write(time)

        self.assembly.sampler.on_taken = note


def prepare_flight(
    scenario: Scenario,
    folder: Path,
    *,
    seed: int | None = None,
    speed: float | None = None,
    config_file: Path = CONFIG_FILE,
    calibration: Path | None = None,
    source: TruthSource | None = None,
    duration_s: float | None = None,
    gnss_port: Literal["memory", "pty"] = "memory",
) -> SimulatedFlightRun:
    """Prepare a flight; `run` of the result flies it.

    seed: of everything random; the scenario's by default. speed: simulated seconds a second, None as fast as it goes.
    config_file: the logger's configuration, of which `[logger]` of the scenario replaces keys. calibration: directory
    embedded in the recording. source: truth in place of the scenario's flight (a calibration bench). gnss_port: the GPS on
    a serial port in memory, or on a real pseudo-terminal opened by pyserial.
    Raises ScenarioError for a mistake in the scenario's tables, ConfigError for one in the configuration, ManoeuvreError
    for a manoeuvre that this aircraft must not fly.
    """
    if seed is not None:
        scenario = scenario.altered(flight={"seed": seed})
    seed = scenario.flight.seed
    craft = load_aircraft(scenario.flight.aircraft)
    models = parse_sensors(merged(placed(craft), scenario.sensors), scenario.name)
    faults = FaultSet(parse_faults(scenario.faults, scenario.name), 0, seed)
    radio_model = checked(RadioModel, scenario.radio, scenario.name, "radio")
    config, text = logger_config(scenario, folder, config_file, calibration)
    if config.sequencer is not None:
        plan_of(load_manoeuvre(config.sequencer.manoeuvre), config.sequencer)  # before any file is made
    _refuse_old_recordings(folder)
    if calibration is not None:
        placed_set = calibration_of(craft, calibration, folder)
        if placed_set != calibration:
            config, text = logger_config(scenario, folder, config_file, placed_set)
    clock = SimulatedClock(START_UTC_NS, speed=speed)
    cockpit = _cockpit(scenario, clock)
    world = TruthFile(source or World(scenario, seed, cockpit), folder / "truth.csv")
    aircraft = build_aircraft(world, models, faults, clock, seed, config.sensors, cockpit)
    if config.sensors.autopilot is not None:  # set up as docs/build.md asks for it
        aircraft.autopilot.connect(config.sensors.autopilot.baud, LOOP_HZ)
    radio = SimulatedRadioLink(radio_model, clock.monotonic_ns, seed, faults.radio_lost)
    gnss, closers = _gnss_port(aircraft, gnss_port)
    edge = _hardware_edge(config, aircraft, gnss, radio, cockpit)
    session = f"{scenario.name}_{seed}"
    assembly = assemble(config, text, edge, session=session, folder="", boot=1 + seed % 255)
    assembly.recorder.detail({"simulation.scenario": scenario.name, "simulation.seed": str(seed)})
    clock.follow(assembly.recorder.busy)
    if assembly.link is not None:
        backfill = assembly.link.backfill
        clock.follow(lambda: backfill.preparing)
    flight = SimulatedFlightRun(
        scenario=scenario,
        folder=folder,
        config=config,
        clock=clock,
        aircraft=aircraft,
        radio=radio,
        assembly=assembly,
        truth=world,
        duration_s=scenario.total_s if duration_s is None else duration_s,
        closers=closers,
        cockpit=cockpit,
    )
    flight.note_scans()
    return flight


def _hardware_edge(
    config: LoggerConfig,
    aircraft: SimulatedHardware,
    gnss: SerialPortCalls,
    radio: SimulatedRadioLink,
    cockpit: Cockpit | AutopilotCockpit | None,
) -> HardwareEdge:
    """What the logger sees of the simulated hardware."""
    clock = aircraft.clock
    return HardwareEdge(
        clock,
        aircraft.bus,
        gnss,
        "simulated",
        autopilot=_line(config.sensors, aircraft),
        pulse=aircraft.newest_pulse if aircraft.instruments.models.gnss.pulse else None,
        radio=radio.air if config.downlink is not None else None,
        storage=SimulatedCard(aircraft.faults, clock),
        heartbeat=cockpit.monostable if isinstance(cockpit, Cockpit) else None,
        override=SimulatedSerial(cockpit.plane, clock.monotonic_ns) if isinstance(cockpit, AutopilotCockpit) else None,
    )


def _cockpit(scenario: Scenario, clock: SimulatedClock) -> Cockpit | AutopilotCockpit | None:
    """The simulated pilot with his switch; None for a scenario without a sequencer."""
    if scenario.sequencer is None:
        lonely = [f["device"] for f in scenario.faults if f.get("device") in ONLY_WITH_SEQUENCER]
        if lonely:
            raise ScenarioError(
                f"scenario {scenario.name}: faults: {lonely[0]!r} is there only with a table [sequencer]"
            )
        return None
    table = checked(CockpitTable, scenario.sequencer, scenario.name, "sequencer")
    if table.autopilot is not None:
        return AutopilotCockpit(table, scenario.takeoff_s, clock.monotonic_ns() - AUTOPILOT_ON_NS)
    return Cockpit(table, Monostable(clock.monotonic_ns), scenario.takeoff_s)


def _gnss_port(
    aircraft: SimulatedHardware, kind: Literal["memory", "pty"]
) -> tuple[SerialPortCalls, list[Callable[[], None]]]:
    if kind == "memory":
        port = SimulatedSerial(aircraft.gnss, aircraft.clock.monotonic_ns)
        return port, [port.close]
    import serial

    terminal = PseudoTerminal(aircraft.gnss)
    device = serial.Serial(terminal.path, 115_200, timeout=0)
    aircraft.clock.on_advance(terminal.pump)
    return device, [device.close, terminal.close]


def _line(sensors: SensorsConfig, aircraft: SimulatedHardware) -> SimulatedSerial | None:
    """The port to an autopilot, or to a receiver's SBUS; None where the logger reads neither."""
    if sensors.autopilot_port is None:
        return None
    talker: Talker = aircraft.autopilot
    if sensors.has_sbus:
        pulses = aircraft.instruments.inputs(*(f"pwm_{i}" for i in range(1, 7)))
        talker = SbusReceiver(pulses, aircraft.clock.monotonic_ns())
    return SimulatedSerial(talker, aircraft.clock.monotonic_ns)


def logger_config(
    scenario: Scenario, folder: Path, config_file: Path, calibration: Path | None
) -> tuple[LoggerConfig, str]:
    """The logger's configuration for a simulated flight, and its text: the file with the scenario's `[logger]` in it.

    The text goes into the recording, so it has paths within the recording's folder, not those of this computer.
    """
    table = tomllib.loads(config_file.read_text(encoding="utf-8"))
    if scenario.sequencer is not None:
        sequencer_file = ARDUPILOT_FILE if scenario.sequencer.get("autopilot") else SEQUENCER_FILE
        table = merged(table, tomllib.loads(sequencer_file.read_text(encoding="utf-8")))
        table["sequencer"]["manoeuvre"] = str(MANOEUVRE_FILE)
    table = merged(table, scenario.logger)
    craft = load_aircraft(scenario.flight.aircraft)
    table.setdefault("aircraft", {})["name"] = craft.name
    table.pop("calibration", None)
    if table.get("downlink"):
        table["downlink"].pop("port", None)
    local_paths: dict[str, Any] = {"recorder": {"directories": [str((folder / "onboard").resolve())]}}
    recorded_paths: dict[str, Any] = {"recorder": {"directories": ["onboard"]}}
    if scenario.sequencer is not None:
        manoeuvre = Path(table["sequencer"]["manoeuvre"]).resolve()
        local_paths["sequencer"], recorded_paths["sequencer"] = (
            {"manoeuvre": str(manoeuvre)},
            {"manoeuvre": "manoeuvre.toml"},
        )
    if calibration is not None:
        local_paths["calibration"] = str(calibration.resolve())
        recorded_paths["calibration"] = calibration.name
    if craft.name not in built_in_aircraft():
        local_paths["aircraft"] = {"file": str(Path(scenario.flight.aircraft).resolve())}
        recorded_paths["aircraft"] = {"file": "aircraft.toml"}
    return parse_config(toml_text(merged(table, local_paths)), config_file), toml_text(merged(table, recorded_paths))


def _refuse_old_recordings(folder: Path) -> None:
    onboard = folder / "onboard"
    if any(onboard.glob("*.mcap")):
        raise ScenarioError(f"{onboard} already holds a recording; give --out another directory or remove it")
    onboard.mkdir(parents=True, exist_ok=True)
