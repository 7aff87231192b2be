"""The one command line: a thin table of verbs, each importing only what it needs when it is called.

Exit status: 0 done; 1 done, but the answer is a failed check; 2 unusable input, said in one line on standard error;
130 interrupted, after files are closed.
"""

import importlib
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daq.contract.errors import UserError

if TYPE_CHECKING:
    from firmware_sim.scenario import Scenario
    from groundstation.viewer.live import LiveView


@dataclass(frozen=True, slots=True)
class Verb:
    """Where a verb lives, and the line `sideslip --help` shows for it."""

    module: str
    attribute: str
    summary: str


VERBS: dict[str, Verb] = {
    "demo": Verb("sideslip", "demo", "The whole chain in one go, on a simulated aircraft."),
    "fly": Verb("sideslip", "fly", "One simulated flight through the real logger, radio link and ground station."),
    "record": Verb("daq.commands", "record", "The onboard logger, on hardware."),
    "preflight": Verb("daq.commands", "preflight", "The logger's go/no-go table."),
    "info": Verb("daq.commands", "info", "What is in a recording."),
    "verify": Verb("daq.commands", "verify", "Integrity and scan accounting of a recording."),
    "recover": Verb("daq.commands", "recover", "Salvage a damaged recording."),
    "ground": Verb("groundstation.commands", "ground", "Receive, decode, calibrate, view live, record, hand over."),
    "view": Verb("groundstation.commands", "view", "Any recording or flight in rerun."),
    "calibrate": Verb("groundstation.commands_data", "calibrate", "Counts to SI: a raw recording to a flight."),
    "bench": Verb("groundstation.commands_data", "bench", "Fit calibration curves from bench recordings."),
    "import": Verb("groundstation.commands_data", "import_", "CSV, Parquet, ULog or MAVLink log to a flight."),
    "check": Verb("estimation.commands.check", "check", "Data compatibility and data quality."),
    "estimate": Verb("estimation.commands.estimate", "estimate", "Aerodynamic parameters with bounds."),
    "match": Verb("estimation.commands.match", "match", "Proof of match on flights not used for the estimate."),
    "gap": Verb("estimation.commands.gap", "gap", "Find, name and close the gap between model and flight."),
}


class VerbTable(click.Group):
    """A click group whose commands are imported on use, so that `--help` and light verbs stay light."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All verbs, in the order of the table."""
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one verb."""
        verb = VERBS.get(cmd_name)
        if verb is None:
            return None
        try:
            command: click.Command = getattr(importlib.import_module(verb.module), verb.attribute)
        except ModuleNotFoundError as error:
            raise MissingPackageError(cmd_name, error.name or str(error)) from error
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list of verbs from the table, without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, verb.summary) for name, verb in VERBS.items()])


class MissingPackageError(UserError):
    """A package of an extra that was not installed."""

    def __init__(self, verb: str, package: str) -> None:
        super().__init__(
            f"sideslip {verb}: package {package!r} is not installed; pip install 'sideslip[ground,estimation]'"
        )


def software_version() -> str:
    """Version of the installed package, or 'unknown' when run from a bare tree."""
    try:
        return version("sideslip")
    except PackageNotFoundError:
        return "unknown"


@click.command(cls=VerbTable, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(software_version(), prog_name="sideslip")
def cli() -> None:
    """Airborne data acquisition and aircraft identification."""


def main(argv: list[str] | None = None) -> None:
    """Entry point; turns errors a person can act on into one line and an exit status."""
    # One process edge: everything below raises, only here is it turned into an exit status.
    try:
        status = cli.main(args=argv, prog_name="sideslip", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except UserError as error:
        click.echo(f"sideslip: {error}", err=True)
        sys.exit(2)
    except ModuleNotFoundError as error:
        click.echo(f"sideslip: {MissingPackageError((argv or sys.argv[1:] or ['?'])[0], error.name or '?')}", err=True)
        sys.exit(2)
    except (KeyboardInterrupt, click.Abort):
        click.echo("sideslip: interrupted; files are closed", err=True)
        sys.exit(130)
    except BrokenPipeError:
        sys.exit(0)
    sys.exit(status if isinstance(status, int) else 0)


# -------------------------------------------------------------------------------------------------- simulated flights


@dataclass(frozen=True)
class Flown:
    """What one simulated flight has left. summary: as `ground --json`; agreed: air and ground hold the same scans."""

    onboard: Path
    ground: Path | None
    truth: Path
    summary: dict[str, Any]
    agreed: bool
    lines: list[str]


def fly_scenario(
    scenario: "Scenario",
    folder: Path,
    *,
    seed: int | None = None,
    speed: float | None = None,
    backfill: bool = True,
    live: "Callable[[int], LiveView] | None" = None,
    tell: Callable[[float], None] = lambda share: None,
) -> Flown:
    """Fly one scenario through the real logger, a simulated radio and the real ground station.

    tell: told the share of the flight that has been flown. live: makes the view of an aircraft.
    """
    from firmware_sim.flight import prepare_flight
    from groundstation.calibration.recording import calibrate_recording
    from groundstation.calibration.schema import BUILT_IN_FOLDER
    from groundstation.config import GroundConfig
    from groundstation.flight import write_flight
    from groundstation.handover import hand_over
    from groundstation.link_config import LinkConfig
    from groundstation.receive import Receiver
    from groundstation.station import Station

    config = GroundConfig(link=LinkConfig(ports=(), backfill="lost"))
    calibration = BUILT_IN_FOLDER / config.calibration.directory
    with prepare_flight(scenario, folder, seed=seed, speed=speed, calibration=calibration) as flight:
        ground_folder = folder / "ground"
        ground_folder.mkdir(parents=True, exist_ok=True)
        receiver = Receiver(config.link, {"radio": flight.radio.ground}, flight.clock, folder=ground_folder)
        station = Station(config, receiver, flight.clock, ground_folder, make_view=live)
        start_ns = flight.clock.monotonic_ns()

        def in_step(now_ns: int) -> None:
            station.step()
            tell((now_ns - start_ns) * 1e-9 / flight.duration_s)

        flight.each_scan = in_step
        files = flight.run()
        agreed = False
        if backfill and receiver.systems:
            receiver.set_backfill("all")
            agreed = flight.serve(lambda: all(receiver.backfill_agreed(s) for s in receiver.systems), limit_s=3600.0)
        station.close()
        summary = receiver.summary()
    flown = calibrate_recording(folder / "onboard")
    write_flight(flown, folder / "flight.mcap")
    ground, lines = None, []
    recordings = sorted(ground_folder.glob("aircraft*.mcap"), key=lambda p: p.stat().st_size)
    if recordings:
        handed = hand_over(recordings[-1], ground_folder, origin="telemetry and backfill" if agreed else "telemetry")
        ground, lines = handed.path, handed.lines()
        summary["flight"] = str(ground)
    return Flown(folder / "flight.mcap", ground, files.truth, summary, agreed, lines)


@click.command(epilog="Example: sideslip fly nominal --out flights/first --seed 7")
@click.argument("scenario", required=False)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for the flight [default: flights/SCENARIO].")
@click.option("--speed", default="max", show_default=True, help="Simulated seconds a second, or max.")
@click.option("--seed", type=int, help="Of everything random [default: the scenario's].")
@click.option("--live", is_flag=True, help="Show the flight live in the browser; implies --speed 1 unless given.")
@click.option("--no-backfill", is_flag=True, help="Keep what the radio delivered; fetch nothing after landing.")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write the ground station's counters as JSON.")
@click.option("--list", "show_list", is_flag=True, help="List the built-in scenarios.")
def fly(
    scenario: str | None,
    out: Path | None,
    speed: str,
    seed: int | None,
    live: bool,
    no_backfill: bool,
    json_path: Path | None,
    show_list: bool,
) -> int:
    """Fly SCENARIO (a TOML file or a built-in name) on the simulated aircraft."""
    from firmware_sim.scenario import built_in_scenarios, load_scenario

    if show_list:
        for name, title in built_in_scenarios().items():
            click.echo(f"{name:<24}{title}")
        return 0
    if scenario is None:
        raise UserError("fly: name a scenario, or give --list to see the built-in ones")
    chosen = load_scenario(scenario)
    folder = out or Path("flights") / chosen.name
    pace = _pace(speed, live)
    view = LiveFactory() if live else None
    try:
        with Bar(f"flying {chosen.name}") as bar:
            flown = fly_scenario(
                chosen, folder, seed=seed, speed=pace, backfill=not no_backfill, live=view and view.make, tell=bar
            )
    finally:
        if view is not None:
            view.close()
    for line in flown.lines:
        click.echo(line)
    s = flown.summary
    lost = sum(b - a + 1 for a, b in s["scans_lost"])
    click.echo(f"radio: {s['scans_received']} scans received, {lost} lost, {s['backfilled']} fetched after landing")
    click.echo(f"air and ground agree: {'yes' if flown.agreed else 'no'}")
    click.echo(f"onboard flight: {flown.onboard}")
    if json_path is not None:
        json_path.write_text(json.dumps(s, indent=1) + "\n", encoding="utf-8")
    return 0


def _pace(speed: str, live: bool) -> float | None:
    if speed == "max":
        return 1.0 if live else None
    try:
        pace = float(speed)
    except ValueError:
        pace = 0.0
    if not pace > 0:
        raise UserError(f"--speed {speed}: give a positive number of simulated seconds a second, or max")
    return pace


class LiveFactory:
    """Live views of a simulated flight, one an aircraft, on one web page."""

    def __init__(self, layout: str = "full") -> None:
        from groundstation.viewer.live import LiveView, ViewOptions, free_port
        from groundstation.viewer.window import WebPage

        port = free_port()
        self._view = LiveView("flight", ViewOptions(layout="light" if layout == "light" else "full", port=port))
        self._page = WebPage(self._view.url, free_port())
        click.echo(f"live view: {self._page.url}")

    def make(self, system: int) -> "LiveView":
        """The view; one aircraft flies here."""
        return self._view

    def close(self) -> None:
        """End page and server."""
        self._view.close()
        self._page.close()


class Bar:
    """Progress on a terminal as a bar, in a log as plain lines at every quarter."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._live = sys.stderr.isatty()
        self._next = 0.0

    def __enter__(self) -> "Bar":
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            click.echo("\r" + " " * 72 + "\r", nl=False, err=True)

    def __call__(self, share: float) -> None:
        if share < self._next:
            return
        if self._live:
            self._next = share + 0.02
            full = min(30, round(30 * share))
            click.echo(f"\r{self._title:<30} [{'#' * full}{'.' * (30 - full)}]", nl=False, err=True)
        else:
            self._next = share + 0.25
            click.echo(f"{self._title}: {100 * min(share, 1.0):.0f} %", err=True)


if __name__ == "__main__":
    main()
