"""One simulated flight through the real logger, a simulated radio and the real ground station."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from firmware_sim.world.scenario import Scenario
    from groundstation.live.station import Station
    from groundstation.receiver.receive import Receiver
    from groundstation.viewer.live import LiveView

ACCOUNTING_S = 60.0  # of simulated time, at most, until the aircraft has reported of every scan whether it was sent
SILENT_S = 60.0  # of simulated time without a message, after which backfill is given up: requests repeat in seconds
BACKFILL_S = 3600.0  # of simulated time, at most, for backfill


@dataclass(frozen=True)
class ChainFlight:
    """The result of one simulated flight. onboard, ground: flight files from the recording on board and the received one, None
    where nothing was received; truth: CSV without sensor errors; summary: as `ground --json`; agreed: whether backfill made both
    recordings hold the same scans; lines: to print; sequencer: time [s] and text of each transition."""

    onboard: Path
    ground: Path | None
    truth: Path
    summary: dict[str, Any]
    agreed: bool
    lines: list[str]
    sequencer: tuple[tuple[float, str], ...] = ()


def fly_scenario(
    scenario: "Scenario",
    folder: Path,
    *,
    seed: int | None = None,
    speed: float | None = None,
    backfill: bool = True,
    config_file: Path | None = None,
    calibration: Path | None = None,
    live: "Callable[[int], LiveView] | None" = None,
    tell: Callable[..., None] = lambda *words_and_share: None,
) -> ChainFlight:
    """Fly one scenario through the real logger, a simulated radio and the real ground station.

    folder: to write in. seed: of the scenario by default. speed: of simulated over real time until landing; None, and after
    landing, as fast as possible. backfill: whether lost scans are fetched. config_file: of the logger, calibration: folder of its
    set; by default those of the CDFP. live: system id -> view of that aircraft. tell: takes the fraction flown, later a text.
    """
    from firmware_sim.runs.flight import CONFIG_FILE, prepare_flight
    from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY
    from groundstation.live.config import CalibrationConfig, GroundConfig
    from groundstation.live.station import Station
    from groundstation.receiver.ports import LinkConfig
    from groundstation.receiver.receive import Receiver
    from sideslip.live_aircraft import live_aircraft

    config = GroundConfig(link=LinkConfig(ports=(), backfill="lost" if backfill else "off"))
    if calibration is not None:
        config = config.model_copy(update={"calibration": CalibrationConfig(directory=str(calibration))})
    config_file, calibration = (
        config_file or CONFIG_FILE,
        calibration or NOMINAL_DIRECTORY / config.calibration.directory,
    )
    with prepare_flight(
        scenario, folder, seed=seed, speed=speed, config_file=config_file, calibration=calibration
    ) as flight:
        ground_folder = folder / "ground"
        ground_folder.mkdir(parents=True, exist_ok=True)
        receiver = Receiver(config.link, {"radio": flight.radio.ground}, flight.clock, folder=ground_folder)
        station = Station(config, receiver, flight.clock, ground_folder, make_view=live, aircraft=live_aircraft)
        start_ns = flight.clock.monotonic_ns()

        def in_step(now_ns: int) -> None:
            station.step()
            tell((now_ns - start_ns) * 1e-9 / flight.duration_s)

        def after_landing(now_ns: int) -> None:
            station.step()

        def file_failed() -> bool:
            """Whether a file cannot be written: it would not recover in simulated time, and scans would be fetched for ever."""
            return any(not what.startswith("radio") for what in receiver.port_faults)

        def agreed() -> bool:
            return all(receiver.backfill_agreed(s) for s in receiver.systems)

        def silent() -> bool:
            return flight.clock.monotonic_ns() - receiver.heard_ns > SILENT_S * 1e9

        flight.each_scan = in_step
        files = flight.run()
        flight.clock.unpaced()
        flight.each_scan = after_landing
        backfill_agreed = False
        if receiver.systems:
            flight.serve(
                lambda: file_failed() or not any(a.unknown for a in receiver.accounting()), limit_s=ACCOUNTING_S
            )
        if backfill and receiver.systems:
            tell("landed; fetching what the radio lost")
            receiver.set_backfill("all")
            flight.serve(lambda: file_failed() or agreed() or silent(), limit_s=BACKFILL_S)
            backfill_agreed = agreed()
        station.close()
        summary = receiver.summary()
    onboard = _onboard_flight(folder)
    origin = "telemetry and backfill" if backfill_agreed else "telemetry"
    ground, lines = _received_flight(ground_folder, receiver, station, origin)
    if ground is not None:
        summary["flight"] = str(ground)
    if backfill and receiver.systems and silent():
        lines.append(
            f"backfill given up: nobody answered for {SILENT_S:g} s; what is missing is in the recording on board"
        )
    sequencer = _sequencer_events(folder / "onboard") if scenario.sequencer is not None else ()
    return ChainFlight(onboard, ground, files.truth, summary, backfill_agreed, lines, sequencer)


def fly_onboard(scenario: "Scenario", folder: Path, *, seed: int | None = None) -> Path:
    """Fly one scenario of the CDFP through the real logger, without a ground station; returns the flight file."""
    from firmware_sim.runs.flight import CONFIG_FILE, prepare_flight
    from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY

    calibration = NOMINAL_DIRECTORY / "cdfp"
    with prepare_flight(scenario, folder, seed=seed, config_file=CONFIG_FILE, calibration=calibration) as flight:
        flight.run()
    return _onboard_flight(folder)


def _onboard_flight(folder: Path) -> Path:
    """Calibrate the recording on board; returns the flight file."""
    from groundstation.calibration.recording import calibrate_recording
    from groundstation.flight import write_flight

    write_flight(calibrate_recording(folder / "onboard", salvage=True), folder / "flight.mcap")
    return folder / "flight.mcap"


def _received_flight(
    folder: Path, receiver: "Receiver", station: "Station", origin: str
) -> tuple[Path | None, list[str]]:
    """The flight file from the largest recording of the ground station, and lines to print; None where it received nothing.
    origin: of the data, for the provenance."""
    from groundstation.live.handover import hand_over

    recordings = sorted(folder.glob("aircraft*.mcap"), key=lambda p: p.stat().st_size)
    if not recordings:
        return None, []
    session = next((s for s, r in receiver.session_recorders().items() if r.path == recordings[-1]), None)
    identified = None if session is None else station.identifications.result(session)
    handover = hand_over(recordings[-1], folder, origin=origin, identified=identified)
    return handover.path, handover.lines()


def _sequencer_events(onboard: Path) -> tuple[tuple[float, str], ...]:
    """Time [s] and text of the sequencer's events in a recording."""
    from daq.contract.recordings.reading import read_recording

    events = read_recording(onboard, salvage=True).events
    return tuple((e.time_monotonic_ns * 1e-9, e.text) for e in events if e.origin == "sequencer")
