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

TELLS_S = 60.0  # of the radio's time within which the aircraft tells of every scan whether it was sent
SILENT_S = 60.0
"""Of the radio's time without a word from the aircraft, after which nobody is taken to answer: requests repeat in seconds."""


@dataclass(frozen=True)
class ChainFlight:
    """What one simulated flight has left. summary: as `ground --json`; agreed: air and ground hold the same scans.

    sequencer: time [s] and words of each of its transitions.
    """

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

    config_file: of the logger, calibration: set it carries; those of the CDFP by default. speed: until it has landed; what
    comes down afterwards, by a radio as slow, does so as fast as it goes.
    tell: told the share of the flight that has been flown, then what else is done. live: makes the view of an aircraft.
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

        def no_room() -> bool:
            """Files that fail go on failing in simulated time: scans would be fetched again and again."""
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
        if receiver.systems:  # the radio stays on until the aircraft has told of every scan whether it was sent
            flight.serve(lambda: no_room() or not any(a.unknown for a in receiver.accounting()), limit_s=TELLS_S)
        if backfill and receiver.systems:
            tell("landed; fetching what the radio lost")
            receiver.set_backfill("all")
            flight.serve(lambda: no_room() or agreed() or silent(), limit_s=3600.0)
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
    sequencer = _sequencer_words(folder / "onboard") if scenario.sequencer is not None else ()
    return ChainFlight(onboard, ground, files.truth, summary, backfill_agreed, lines, sequencer)


def fly_onboard(scenario: "Scenario", folder: Path, *, seed: int | None = None) -> Path:
    """Fly one scenario of the CDFP through the real logger alone, with nobody at the ground; the flight's file."""
    from firmware_sim.runs.flight import CONFIG_FILE, prepare_flight
    from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY

    calibration = NOMINAL_DIRECTORY / "cdfp"
    with prepare_flight(scenario, folder, seed=seed, config_file=CONFIG_FILE, calibration=calibration) as flight:
        flight.run()
    return _onboard_flight(folder)


def _onboard_flight(folder: Path) -> Path:
    """What was recorded on board, calibrated; the flight's file."""
    from groundstation.calibration.recording import calibrate_recording
    from groundstation.flight import write_flight

    write_flight(calibrate_recording(folder / "onboard", salvage=True), folder / "flight.mcap")
    return folder / "flight.mcap"


def _received_flight(
    folder: Path, receiver: "Receiver", station: "Station", origin: str
) -> tuple[Path | None, list[str]]:
    """The flight as the ground has it, from its longest recording, and what is said of it; nothing where it received none."""
    from groundstation.live.handover import hand_over

    recordings = sorted(folder.glob("aircraft*.mcap"), key=lambda p: p.stat().st_size)
    if not recordings:
        return None, []
    session = next((s for s, r in receiver.session_recorders().items() if r.path == recordings[-1]), None)
    identified = None if session is None else station.identifications.result(session)
    handover = hand_over(recordings[-1], folder, origin=origin, identified=identified)
    return handover.path, handover.lines()


def _sequencer_words(onboard: Path) -> tuple[tuple[float, str], ...]:
    from daq.contract.recordings.reading import read_recording

    events = read_recording(onboard, salvage=True).events
    return tuple((e.time_monotonic_ns * 1e-9, e.text) for e in events if e.origin == "sequencer")
