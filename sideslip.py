"""The one command line: a thin table of verbs, each importing only what it needs when it is called.

Exit status: 0 done; 1 done, but the answer is a failed check; 2 unusable input, said in one line on standard error;
130 interrupted, after files are closed.
"""

import importlib
import json
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daq.contract.errors import UserError

if TYPE_CHECKING:
    from firmware_sim.flight import SimulatedFlight
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
    "info": Verb("sideslip", "info", "What is in a recording, flight or telemetry log."),
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
    except OSError as error:
        if error.filename is None:  # not about a file that somebody named: a mistake of ours, to be seen whole
            raise
        where = error.filename2 or error.filename
        click.echo(f"sideslip: {where}: cannot be read or written ({error.strerror}); choose another place", err=True)
        sys.exit(2)
    sys.exit(status if isinstance(status, int) else 0)


@click.command(epilog="Example: sideslip info recordings/cdfp_ld1_raw.mcap --json info.json")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write the same as JSON.")
@click.pass_context
def info(ctx: click.Context, file: Path, json_path: Path | None) -> int:
    """What is in FILE: a raw recording, the directory of its segments, a flight, or a .tlog."""
    if file.suffix not in (".tlog", ".csv", ".parquet"):
        from daq.commands import info as recording_info

        ctx.invoke(recording_info, recording=file, json_path=json_path)
        return 0
    if file.suffix == ".tlog":
        from groundstation.tlog import info_tlog

        found = info_tlog(file)
    else:
        found = _flight_info(file)
    _write_json(json_path, found)
    click.echo(f"{file}: {found['kind']}, {found['source']}, {found['scans']} scans in {found['duration_s']:.2f} s, "
               f"{found['rate_hz']:.2f} Hz")  # fmt: skip
    for channel in found["channels"]:
        click.echo(f"  {channel['name']:<24} {channel['unit'] or '-':<6} {channel['samples']:>8} samples")
    return 0


def _write_json(path: Path | None, content: dict[str, Any]) -> None:
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _flight_info(file: Path) -> dict[str, Any]:
    import numpy as np

    from daq.contract.channels import COLUMN_BY_NAME
    from groundstation.flight import read_flight

    flight = read_flight(file)
    units = {n: c.unit for n, c in COLUMN_BY_NAME.items()}
    columns = [
        {"name": n, "unit": units.get(n, ""), "samples": int(np.isfinite(v).sum())} for n, v in flight.columns.items()
    ]
    return {
        "file": str(file),
        "kind": "flight",
        "source": flight.provenance.source,
        "aircraft": flight.provenance.aircraft,
        "duration_s": float(flight.time[-1] - flight.time[0]),
        "rate_hz": 1.0 / flight.sample_interval,
        "scans": len(flight),
        "first_scan": None,
        "last_scan": None,
        "channels": columns,
        "software": flight.provenance.software,
        "notes": list(flight.notes),
    }


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
    from groundstation.calibration.schema import NOMINAL_DIRECTORY
    from groundstation.config import GroundConfig
    from groundstation.flight import write_flight
    from groundstation.handover import hand_over
    from groundstation.link_config import LinkConfig
    from groundstation.receive import Receiver
    from groundstation.station import Station

    config = GroundConfig(link=LinkConfig(ports=(), backfill="lost" if backfill else "off"))
    calibration = NOMINAL_DIRECTORY / config.calibration.directory
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
        if receiver.systems:  # the radio stays on until the aircraft has told of every scan whether it was sent
            flight.serve(lambda: not any(a.unknown for a in receiver.accounting()), limit_s=60.0)
        if backfill and receiver.systems:
            receiver.set_backfill("all")
            agreed = flight.serve(lambda: all(receiver.backfill_agreed(s) for s in receiver.systems), limit_s=3600.0)
        station.close()
        summary = receiver.summary()
    flown = calibrate_recording(folder / "onboard", salvage=True)
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
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for the flight [default: flights/SCENARIO]."
)
@click.option("--speed", default="max", show_default=True, help="Simulated seconds a second, or max.")
@click.option("--seed", type=int, help="Of everything random [default: the scenario's].")
@click.option("--live", is_flag=True, help="Show the flight live in the browser; implies --speed 1 unless given.")
@click.option(
    "--port",
    help="Put the radio on a real port (udp:HOST:PORT, tcpin:PORT, serial:DEVICE:BAUD) for any MAVLink ground station, "
    "in place of the one built in; at the pace of the clock unless --speed is given.",
)
@click.option("--no-backfill", is_flag=True, help="Keep what the radio delivered; fetch nothing after landing.")
@click.option(
    "--json", "json_path", type=click.Path(path_type=Path), help="Write the ground station's counters as JSON."
)
@click.option("--list", "show_list", is_flag=True, help="List the built-in scenarios.")
def fly(
    scenario: str | None,
    out: Path | None,
    speed: str,
    seed: int | None,
    live: bool,
    port: str | None,
    no_backfill: bool,
    json_path: Path | None,
    show_list: bool,
) -> int:
    """Fly SCENARIO (a TOML file or a built-in name) on the simulated aircraft, or run one of the calibration benches."""
    from firmware_sim.bench import bench_titles, record_bench
    from firmware_sim.scenario import built_in_scenarios, load_scenario

    if show_list:
        for name, title in {**built_in_scenarios(), **bench_titles()}.items():
            click.echo(f"{name:<24}{title}")
        return 0
    if scenario is None:
        raise UserError("fly: name a scenario, or give --list to see the built-in ones")
    if scenario in bench_titles():
        from groundstation.calibration.schema import NOMINAL_DIRECTORY

        folder = out or Path("flights") / scenario
        made = record_bench(scenario, folder, seed=1 if seed is None else seed, calibration=NOMINAL_DIRECTORY / "cdfp")
        click.echo(
            f"bench recording {made.flight.recordings[0].parent}, plan {made.plan}; fit it with 'sideslip bench'"
        )
        return 0
    chosen = load_scenario(scenario)
    folder = out or Path("flights") / chosen.name
    pace = _pace(speed, live or port is not None)
    if port is not None:
        return _fly_over_port(chosen, folder, port, seed, pace)
    view = LiveFactory() if live else None
    try:
        with Bar(f"flying {chosen.name}") as bar:
            flown = fly_scenario(
                chosen,
                folder,
                seed=seed,
                speed=pace,
                backfill=not no_backfill,
                live=view.make if view else None,
                tell=bar,
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
    _write_json(json_path, s)
    return 0


RADIO_ON_S = 7 * 24 * 3600.0


def _fly_over_port(scenario: "Scenario", folder: Path, port: str, seed: int | None, pace: float | None) -> int:
    """Fly with the radio on a real port; after landing it stays on until Ctrl-C, for backfill and downloads."""
    from daq.link import open_port
    from firmware_sim.bridge import PortBridge
    from firmware_sim.flight import prepare_flight
    from groundstation.calibration.schema import NOMINAL_DIRECTORY

    opened = open_port(port)
    try:
        with prepare_flight(scenario, folder, seed=seed, speed=pace, calibration=NOMINAL_DIRECTORY / "cdfp") as flight:
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


def _serve_until_interrupted(flight: "SimulatedFlight") -> bool:
    """Leave the radio on until Ctrl-C, or for RADIO_ON_S; whether it was Ctrl-C.

    By a flag: an exception raised between any two instructions is lost where it meets a finaliser.
    """
    asked = threading.Event()
    before = signal.signal(signal.SIGINT, lambda number, frame: asked.set())
    try:
        return flight.serve(asked.is_set, limit_s=RADIO_ON_S)
    finally:
        signal.signal(signal.SIGINT, before)


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
        share = min(share, 1.0)
        if share < self._next:
            return
        if self._live:
            self._next = 2.0 if share >= 1.0 else share + 0.02
            full = round(30 * share)
            click.echo(f"\r{self._title:<30} [{'#' * full}{'.' * (30 - full)}]", nl=False, err=True)
        else:
            self._next = 2.0 if share >= 1.0 else 0.5 * (int(2 * share) + 1)
            click.echo(f"{self._title}: {100 * share:.0f} %", err=True)


# ------------------------------------------------------------------------------------------------------------ the demo

DEMO_FLIGHTS = ("cdfp_ld1", "cdfp_ld2", "cdfp_ld3", "cdfp_ld4")
DEMO_HIDDEN = ("Cn_da", 1.0)
DEMO_SEED = 20
DEMO_RADIO = {"drop": 0.05}


@click.command(epilog="Example: sideslip demo --out demo")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=Path("demo"), show_default=True)
def demo(out: Path) -> int:
    """Fly, record, downlink, calibrate, check, estimate, match, and close a gap: the whole chain on a simulated aircraft."""
    import shutil
    import time

    begun = time.monotonic()
    if out.exists() and any(out.iterdir()) and not (out / "demo.txt").is_file():
        raise UserError(f"{out} is not empty and not of an earlier demo; give --out another folder")
    shutil.rmtree(out, ignore_errors=True)
    report = out / "report"
    report.mkdir(parents=True)
    (out / "demo.txt").write_text("Written by sideslip demo; replaced by the next one.\n", encoding="utf-8")

    click.echo(
        "1  Four flights of the simulated aircraft: sensor bus, 20 Hz MCAP on board, 11.5 Hz MAVLink over a lossy radio\n"
    )
    flights = [_demo_flight(name, out) for name in DEMO_FLIGHTS]

    click.echo(
        "\n2  Do accelerations, rates, attitude and air data tell the same story? Instrument factors are found and taken out\n"
    )
    corrected = out / "corrected"
    _run("check", *flights, "--json", report / "check.json", "--report", report / "check", "--write", corrected)
    flights = [corrected / path.name for path in flights]

    click.echo(
        "\n3  Aerodynamic derivatives: maximum likelihood and Neural Gauss-Newton, joint over the four flights\n"
    )
    _run("estimate", *flights, "--method", "ml,ngn,ngn-improved", "--joint", "--brief",
         "--json", report / "estimate.json", "--report", report / "estimate", "--save-model", out / "model.toml")  # fmt: skip

    click.echo("\n4  Proof of match: the joint model predicts each flight, parameters frozen\n")
    _run(
        "match",
        out / "model.toml",
        *flights,
        "--free",
        "CY_0,Cl_0,Cn_0",
        "--json",
        report / "match.json",
        "--figure",
        report / "match.png",
    )

    click.echo("\n5  Four flights with something hidden in the aircraft; the gap workflow is not told what\n")
    train, holdout = _demo_hidden(out)
    _run("gap", *train, "--holdout", holdout, "--json", report / "gap.json", "--report", report / "gap")

    from estimation.report.front import write_front_page

    page = write_front_page(report)
    click.echo(f"\n{time.monotonic() - begun:.0f} s. Report: {page}")
    return 0


def _run(verb: str, *arguments: object) -> None:
    """Run a verb as a person would, in this process. A failed check (status 1) is part of the story."""
    text = [verb, *(str(a) for a in arguments)]
    click.echo(f"$ sideslip {' '.join(text)}\n")
    status = cli.main(args=text, prog_name="sideslip", standalone_mode=False)
    if status not in (0, 1, None):
        raise UserError(f"demo: sideslip {verb} ended with status {status}")


def _demo_flight(name: str, out: Path) -> Path:
    from firmware_sim.scenario import load_scenario

    scenario = load_scenario(name).altered(radio=DEMO_RADIO)
    with Bar(f"flying {name}") as bar:
        flown = fly_scenario(scenario, out / name, tell=bar)
    s = flown.summary
    lost = sum(b - a + 1 for a, b in s["scans_lost"])
    agree = "air and ground agree" if flown.agreed else "air and ground DO NOT agree"
    click.echo(f"{name}: {s['scans_received']} scans came down, {lost} lost on the radio; after backfill {agree}")
    return _named(flown.onboard, out, name)


def _named(flight: Path, out: Path, name: str) -> Path:
    """The flight under a name of its own in one folder, where a person looks for it."""
    import shutil

    target = out / "flights" / f"{name}.mcap"
    target.parent.mkdir(exist_ok=True)
    shutil.copyfile(flight, target)
    return target


def _demo_hidden(out: Path) -> tuple[list[Path], Path]:
    """Three flights to learn from and one to hold out, all of one aircraft with one hidden effect."""
    from firmware_sim.campaign import Campaign

    paths = []
    for number, (scenario, seed) in enumerate(Campaign(hidden=(DEMO_HIDDEN,), seed=DEMO_SEED).scenarios()):
        with Bar(f"flying hidden_{number}") as bar:
            flown = fly_scenario(scenario, out / f"hidden_{number}", seed=seed, backfill=False, tell=bar)
        paths.append(_named(flown.onboard, out, f"hidden_{number}"))
    return paths[:-1], paths[-1]


if __name__ == "__main__":
    main()
