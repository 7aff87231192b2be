"""One simulated flight through the real logger, a simulated radio and the real ground station."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from firmware_sim.runs.flight import SimulatedFlightRun
    from firmware_sim.world.scenario import Scenario
    from groundstation.live.station import Station
    from groundstation.receiver.receive import Receiver
    from groundstation.viewer.live import LiveView

SENT_REPORT_S = 60.0  # simulated time in which the aircraft reports for each scan whether it was sent
SILENT_S = 60.0  # simulated time without a frame after which backfill is given up; requests repeat every few seconds
BACKFILL_LIMIT_S = 3600.0  # simulated time of backfill at most


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
    progress: Callable[..., None] = lambda *words_and_share: None,
) -> ChainFlight:
    """Fly one scenario through the real logger, a simulated radio and the real ground station.

    folder: for all files. seed: by default the scenario's. speed: simulated over real time until landing; None, and after
    landing, as fast as possible. backfill: whether lost scans are fetched. config_file: of the logger, calibration: folder of its
    set; by default those of the CDFP. live: system id -> view of that aircraft. progress: called with the fraction flown, after
    landing with a text.
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

        def in_flight(now_ns: int) -> None:
            station.step()
            progress((now_ns - start_ns) * 1e-9 / flight.duration_s)

        def after_scans(now_ns: int) -> None:
            station.step()

        flight.each_scan = in_flight
        files = flight.run()
        flight.clock.unpaced()
        flight.each_scan = after_scans
        after_landing = _AfterLanding(flight, receiver)
        after_landing.wait_for_sent_report()
        if backfill and receiver.systems:
            progress("landed; fetching what the radio lost")
            after_landing.backfill()
        station.close()
        summary = receiver.summary()
    onboard = _onboard_flight(folder)
    origin = "telemetry and backfill" if after_landing.agreed else "telemetry"
    ground, lines = _received_flight(ground_folder, receiver, station, origin)
    if ground is not None:
        summary["flight"] = str(ground)
    if backfill and receiver.systems and after_landing.silent():
        lines.append(
            f"backfill given up: nobody answered for {SILENT_S:g} s; what is missing is in the recording on board"
        )
    sequencer = _sequencer_transitions(folder / "onboard") if scenario.sequencer is not None else ()
    return ChainFlight(onboard, ground, files.truth, summary, after_landing.agreed, lines, sequencer)


class _AfterLanding:
    """The radio after landing. agreed: whether backfill has ended with the same scans on board and on the ground."""

    def __init__(self, flight: "SimulatedFlightRun", receiver: "Receiver") -> None:
        self._flight, self._receiver = flight, receiver
        self.agreed = False

    def wait_for_sent_report(self) -> None:
        """Keep the radio on until the aircraft has reported for each scan whether it was sent."""
        if self._receiver.systems:
            self._flight.serve(lambda: self._files_fail() or not self._unreported(), limit_s=SENT_REPORT_S)

    def backfill(self) -> None:
        """Fetch every lost scan."""
        self._receiver.set_backfill("all")
        self._flight.serve(
            lambda: self._files_fail() or self._backfill_agreed() or self.silent(), limit_s=BACKFILL_LIMIT_S
        )
        self.agreed = self._backfill_agreed()

    def silent(self) -> bool:
        """Whether the aircraft has not been received for SILENT_S."""
        return self._flight.clock.monotonic_ns() - self._receiver.heard_ns > SILENT_S * 1e9

    def _unreported(self) -> bool:
        """Whether the aircraft has not yet reported for some scan whether it was sent."""
        return any(a.unknown for a in self._receiver.accounting())

    def _backfill_agreed(self) -> bool:
        return all(self._receiver.backfill_agreed(s) for s in self._receiver.systems)

    def _files_fail(self) -> bool:
        """Whether files cannot be written: in simulated time this would not end, and scans would be fetched again and again."""
        return any(not fault.startswith("radio") for fault in self._receiver.port_faults)


def fly_onboard(scenario: "Scenario", folder: Path, *, seed: int | None = None) -> Path:
    """Fly one scenario of the CDFP through the real logger, without a ground station; returns the flight's file."""
    from firmware_sim.runs.flight import CONFIG_FILE, prepare_flight
    from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY

    calibration = NOMINAL_DIRECTORY / "cdfp"
    with prepare_flight(scenario, folder, seed=seed, config_file=CONFIG_FILE, calibration=calibration) as flight:
        flight.run()
    return _onboard_flight(folder)


def _onboard_flight(folder: Path) -> Path:
    """Calibrate the recording on board; returns the flight's file."""
    from groundstation.calibration.recording import calibrate_recording
    from groundstation.flight import write_flight

    write_flight(calibrate_recording(folder / "onboard", salvage=True), folder / "flight.mcap")
    return folder / "flight.mcap"


def _received_flight(
    folder: Path, receiver: "Receiver", station: "Station", origin: str
) -> tuple[Path | None, list[str]]:
    """The flight from the longest received recording, and lines on it; None and no lines where nothing was received."""
    from groundstation.live.handover import hand_over

    recordings = sorted(folder.glob("aircraft*.mcap"), key=lambda p: p.stat().st_size)
    if not recordings:
        return None, []
    session = next((s for s, r in receiver.session_recorders().items() if r.path == recordings[-1]), None)
    identified = None if session is None else station.identifications.result(session)
    handover = hand_over(recordings[-1], folder, origin=origin, identified=identified)
    return handover.path, handover.lines()


def _sequencer_transitions(onboard: Path) -> tuple[tuple[float, str], ...]:
    """Time [s] and text of each transition of the sequencer, from the recording on board."""
    from daq.contract.recordings.reading import read_recording

    events = read_recording(onboard, salvage=True).events
    return tuple((e.time_monotonic_ns * 1e-9, e.text) for e in events if e.origin == "sequencer")
