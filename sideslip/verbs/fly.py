"""The verb `fly`: a scenario on the simulated aircraft, with a simulated radio link or with the radio on a real port."""

import signal
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daq.utilities.errors import UserError
from daq.utilities.options import flag_option, json_option, path_option, seed_option
from daq.utilities.outputs import tried_folder, write_json
from sideslip.chain import ChainFlight, fly_scenario

if TYPE_CHECKING:
    from firmware_sim.runs.flight import SimulatedFlightRun
    from firmware_sim.world.scenario import Scenario
    from groundstation.viewer.live import LiveView


@click.command(epilog="Example: sideslip fly nominal --out flights/first --seed 7")
@click.argument("scenario", required=False)
@path_option("-o", "--out", "--output", text="Folder for the flight [default: flights/SCENARIO].", tried=tried_folder)
@click.option("--speed", default="max", show_default=True, help="Simulated seconds a second, or max.")
@seed_option("Of everything random [default: the scenario's].", None)
@flag_option("--live", text="Show the flight live in the browser; implies --speed 1 unless given.")
@click.option(
    "--port",
    help="Put the radio on a real port (udp:HOST:PORT, tcpin:PORT, serial:DEVICE:BAUD) for any MAVLink ground station, "
    "in place of the one built in; at the pace of the clock unless --speed is given.",
)
@flag_option("--no-backfill", text="Keep what the radio delivered; fetch nothing after landing.")
@click.option(
    "--manoeuvre",
    type=click.Path(path_type=Path, dir_okay=False),
    help="A file of 'sideslip design', flown by the onboard sequencer; on a scenario without one the pilot arms it in the air.",
)
@click.option(
    "--config",
    "config_file",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    help="The logger's configuration [default: the CDFP's, every sensor its own].",
)
@click.option(
    "--calibration", help="Folder of calibration files, or a built-in set, that the recording carries [cdfp]."
)
@json_option("Write the ground station's counters as JSON.")
@flag_option("--list", "show_list", text="List the built-in scenarios.")
def fly(
    scenario: str | None,
    out: Path | None,
    speed: str,
    seed: int | None,
    live: bool,
    port: str | None,
    no_backfill: bool,
    manoeuvre: Path | None,
    config_file: Path | None,
    calibration: str | None,
    json_path: Path | None,
    show_list: bool,
) -> int:
    """Fly SCENARIO (a TOML file or a built-in name) on the simulated aircraft, or run one of the calibration benches."""
    from firmware_sim.runs.bench_recordings import bench_titles
    from firmware_sim.world.scenario import built_in_scenarios, load_scenario
    from sideslip.verbs.delivery import Progress

    if show_list:
        for name, title in {**built_in_scenarios(), **bench_titles()}.items():
            click.echo(f"{name:<24}{title}")
        return 0
    if scenario is None:
        raise UserError("fly: name a scenario, or give --list to see the built-in ones")
    if scenario in bench_titles():
        return _record_bench(scenario, out or Path("flights") / scenario, 1 if seed is None else seed)
    loaded_scenario = load_scenario(scenario)
    if manoeuvre is not None:
        loaded_scenario = _with_manoeuvre(loaded_scenario, manoeuvre)
    folder = out or Path("flights") / loaded_scenario.name
    pace = _pace(speed, live or port is not None)
    logger_files = {"config_file": config_file, "calibration": _calibration_folder(calibration)}
    if port is not None:
        return _fly_over_port(loaded_scenario, folder, port, seed, pace, **logger_files)
    view = _LivePage() if live else None
    try:
        with Progress(f"flying {loaded_scenario.name}") as bar:
            chain_flight = fly_scenario(
                loaded_scenario,
                folder,
                seed=seed,
                speed=pace,
                backfill=not no_backfill,
                live=view.make if view else None,
                progress=bar,
                **logger_files,
            )
    finally:
        if view is not None:
            view.close()
    _print_flight(chain_flight, compared=not no_backfill)
    if json_path is not None:
        write_json(chain_flight.summary, json_path)
    return 0


def _record_bench(name: str, folder: Path, seed: int) -> int:
    """Record one of the calibration benches."""
    from firmware_sim.runs.bench_recordings import record_bench
    from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY

    bench = record_bench(name, folder, seed=seed, calibration=NOMINAL_DIRECTORY / "cdfp")
    click.echo(f"bench recording {bench.flight.recordings[0].parent}, plan {bench.plan}; fit it with 'sideslip bench'")
    return 0


def _print_flight(flight: ChainFlight, *, compared: bool) -> None:
    """Print messages and counters of a flight. compared: scans on board and on the ground were compared, by backfill."""
    for line in flight.lines:
        click.echo(line)
    for time_s, words in flight.sequencer:
        click.echo(f"{time_s:8.2f} s  {words}")
    s = flight.summary
    lost_scans = sum(b - a + 1 for a, b in s["scans_lost"])
    click.echo(
        f"radio: {s['scans_received']} scans received, {lost_scans} lost, {s['backfilled']} fetched after landing"
    )
    click.echo(f"air and ground agree: {'yes' if flight.agreed else 'no' if compared else 'not compared'}")
    click.echo(f"onboard flight: {flight.onboard}")


def _calibration_folder(calibration: str | None) -> Path | None:
    """A folder of calibration files, or a built-in set by its name. Raises CalibrationError where there is neither."""
    if calibration is None:
        return None
    from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY, load_calibration

    load_calibration(calibration)
    folder = Path(calibration)
    return folder if folder.is_dir() else NOMINAL_DIRECTORY / calibration


def _with_manoeuvre(scenario: "Scenario", path: Path) -> "Scenario":
    """The scenario with a sequencer that flies a manoeuvre file. Raises ManoeuvreError for one that cannot be flown."""
    from daq.contract.manoeuvre import load_manoeuvre
    from firmware_sim.hardware.cockpit import switch_for

    loaded_manoeuvre = load_manoeuvre(path)
    logger = dict(scenario.logger)
    logger["sequencer"] = {**logger.get("sequencer", {}), "manoeuvre": str(path.resolve())}
    changes: dict[str, Any] = {"logger": logger}
    if scenario.sequencer is None:
        changes["sequencer"] = {"switch": switch_for(scenario, loaded_manoeuvre.duration_s)}
        changes["flight"] = {"manoeuvres": "none"}
        changes["manoeuvre"] = ()
    return scenario.altered(**changes)


RADIO_ON_S = 7 * 24 * 3600.0  # after landing: in effect until Ctrl-C


def _fly_over_port(
    scenario: "Scenario",
    folder: Path,
    port: str,
    seed: int | None,
    pace: float | None,
    *,
    config_file: Path | None = None,
    calibration: Path | None = None,
) -> int:
    """Fly with the radio on a real port; after landing it stays on until Ctrl-C, for backfill and downloads."""
    from daq.telemetry.link import open_port
    from firmware_sim.hardware.bridge import PortBridge
    from firmware_sim.runs.flight import CONFIG_FILE, prepare_flight
    from groundstation.calibration.calibration_set import NOMINAL_DIRECTORY

    opened = open_port(port)
    config_file, calibration = config_file or CONFIG_FILE, calibration or NOMINAL_DIRECTORY / "cdfp"
    try:
        with prepare_flight(
            scenario, folder, seed=seed, speed=pace, config_file=config_file, calibration=calibration
        ) as flight:
            flight.each_scan = PortBridge(flight.radio.ground, opened).pump
            click.echo(f"flying {scenario.name} for {flight.duration_s:g} s, radio on {port}")
            files = flight.run()
            click.echo(f"landed; recording {files.recordings[0]}; the radio stays on until Ctrl-C")
            interrupted = _serve_until_interrupted(flight)
    finally:
        opened.close()
    if interrupted:
        raise KeyboardInterrupt
    return 0


def _serve_until_interrupted(flight: "SimulatedFlightRun") -> bool:
    """Leave the radio on until Ctrl-C, or for RADIO_ON_S; gives whether it was Ctrl-C.

    The handler sets a flag: an exception from a handler is lost where it meets a finaliser.
    """
    interrupted = threading.Event()
    old_handler = signal.signal(signal.SIGINT, lambda number, frame: interrupted.set())
    try:
        return flight.serve(interrupted.is_set, limit_s=RADIO_ON_S)
    finally:
        signal.signal(signal.SIGINT, old_handler)


def _pace(speed: str, live: bool) -> float | None:
    """Simulated seconds a second from --speed; None for as fast as possible. live: max means real time."""
    if speed == "max":
        return 1.0 if live else None
    try:
        pace = float(speed)
    except ValueError:
        pace = 0.0
    if not pace > 0:
        raise UserError(f"--speed {speed}: give a positive number of simulated seconds a second, or max")
    return pace


class _LivePage:
    """The live view of a simulated flight, and its web page."""

    def __init__(self) -> None:
        from groundstation.viewer.live import LiveView, ViewOptions, free_port
        from groundstation.viewer.window import WebPage

        self._view = LiveView("flight", ViewOptions(port=free_port()))
        self._page = WebPage(self._view.url, free_port())
        click.echo(f"live view: {self._page.url}")

    def make(self, system: int) -> "LiveView":
        """The view: only one aircraft flies."""
        return self._view

    def close(self) -> None:
        self._view.close()
        self._page.close()
