"""Command line of the ground station: `sideslip ground` and `sideslip view`."""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from groundstation.config import GroundConfig
    from groundstation.handover import Handover
    from groundstation.replay import Replay
    from groundstation.station import Station
    from groundstation.viewer.live import LiveView

POLL_S = 0.02
VIEW = click.Choice(["web", "native", "none"])
_VIEW_HELP = "Show it in the browser, in rerun's own window, or not at all."


@click.command(epilog="Example: sideslip ground ground.toml --view web --json session.json")
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--replay", type=click.Path(path_type=Path), help="Play a .tlog or a recording instead of listening.")
@click.option("--speed", default="1", show_default=True, help="Of the replay: recorded seconds a second, or max.")
@click.option("--view", "window", type=VIEW, default="none", show_default=True, help=_VIEW_HELP)
@click.option("--estimate", "with_estimate", is_flag=True, help="Estimate parameters from the finished flight.")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Folder of this session, instead of the configured."
)
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write the counters of the session as JSON.")
@click.option("--duration", type=float, help="End after this many seconds.")
def ground(
    config: Path,
    replay: Path | None,
    speed: str,
    window: str,
    with_estimate: bool,
    out: Path | None,
    json_path: Path | None,
    duration: float | None,
) -> int:
    """Receive, decode, calibrate, show live, record, watch limits, and hand finished flights over.

    CONFIG is a TOML file (see docs/ground.md). Ctrl-C ends the session and writes the flight.
    """
    from groundstation.commands_data import write_json
    from groundstation.config import load_ground_config
    from groundstation.replay import Replay, parse_speed, replay_into

    settings = load_ground_config(config)
    folder = out or _session_folder(settings)
    with _views(settings, window) as make_view:
        source = Replay()
        station = _station(settings, folder, source if replay is not None else None, make_view)
        click.echo(
            f"session {folder}; {'replaying ' + str(replay) if replay else 'listening on ' + ', '.join(settings.link.ports)}"
        )
        interrupted = False
        try:
            with _terminated_is_interrupt():
                if replay is not None:
                    replay_into(station, source, replay, parse_speed(speed))
                else:
                    _listen(station, settings, duration)
        except KeyboardInterrupt:
            interrupted = True
        station.close()
        summary = station.receiver.summary()
        handed = _finish(station, settings, folder)
    for flight in handed:
        for line in flight.lines():
            click.echo(line)
    summary["flight"] = str(handed[0].path) if handed else None
    summary["flights"] = [str(h.path) for h in handed]
    write_json(json_path, summary)
    lost = sum(b - a + 1 for a, b in summary["scans_lost"])
    click.echo(f"{summary['frames_received']} frames, {summary['scans_received']} scans received, {lost} lost, "
               f"{summary['backfilled']} backfilled, {summary['unsigned_rejected']} refused")  # fmt: skip
    if with_estimate:
        _estimate(handed, settings, folder)
    return 130 if interrupted else 0


def _session_folder(settings: "GroundConfig") -> Path:
    base = settings.output.directory
    return base / time.strftime("%Y%m%dT%H%M%SZ", time.gmtime()) if settings.output.dated else base


@contextmanager
def _terminated_is_interrupt() -> Iterator[None]:
    """SIGTERM and SIGINT end a session alike: files are closed and the flight is written.

    SIGINT too is asked for, because a shell's background job starts with it ignored.
    """

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _station(settings: "GroundConfig", folder: Path, replay: "Replay | None", make_view: Any) -> "Station":
    from groundstation.receive import Receiver
    from groundstation.station import Station
    from groundstation.timeline import SystemClock

    folder.mkdir(parents=True, exist_ok=True)
    if replay is not None:
        quiet = settings.link.model_copy(update={"ports": (), "transmit": False, "backfill": "off"})
        receiver = Receiver(quiet, {"replay": replay.port}, replay.clock, folder=folder)
        return Station(settings, receiver, replay.clock, folder, make_view=make_view, echo=click.echo)
    system = SystemClock()
    receiver = Receiver.open(settings.link, system, folder=folder)
    return Station(settings, receiver, system, folder, make_view=make_view, echo=click.echo)


@contextmanager
def _views(settings: "GroundConfig", window: str) -> Iterator[Any]:
    """Makes the view of each aircraft on ports one after the other, and closes them all."""
    if window == "none":
        yield None
        return
    from groundstation.viewer.live import LiveView, ViewOptions
    from groundstation.viewer.window import NativeWindow, WebPage

    opened: list[LiveView] = []
    windows: list[WebPage | NativeWindow] = []

    def make(system: int) -> "LiveView":
        n = len(opened)
        options = ViewOptions(settings.view.layout, settings.view.port + n, settings.view.memory_limit)
        view = LiveView(f"aircraft{system}", options)
        opened.append(view)
        if window == "web":
            page = WebPage(view.url, settings.view.web_port + n)
            windows.append(page)
            click.echo(f"aircraft {system}: {page.url}")
        else:
            windows.append(NativeWindow(view.url))
        return view

    try:
        yield make
    finally:
        for view in opened:
            view.close()
        for shown in windows:
            shown.close()


def _listen(station: "Station", settings: "GroundConfig", duration: float | None) -> None:
    """Until Ctrl-C or the duration is over; after a landing, missing scans are fetched as long as allowed."""
    begun = time.monotonic()
    fetching: dict[int, float] = {}
    while duration is None or time.monotonic() - begun < duration:
        station.step()
        while station.landed:
            system = station.landed.pop()
            if settings.link.backfill != "off" and settings.link.transmit:
                station.receiver.set_backfill("all", system)
                fetching[system] = time.monotonic()
                click.echo(f"aircraft {system} has landed: fetching what is missing")
        for system, since in list(fetching.items()):
            if station.receiver.backfill_agreed(system):
                click.echo(f"aircraft {system}: air and ground agree")
                del fetching[system]
            elif time.monotonic() - since > settings.handover.backfill_limit_s:
                click.echo(f"aircraft {system}: backfill not complete within the limit; the flight keeps its gaps")
                del fetching[system]
        time.sleep(POLL_S)


def _finish(station: "Station", settings: "GroundConfig", folder: Path) -> list["Handover"]:
    """Hand over every session that holds a flight."""
    from groundstation.handover import HandoverError, hand_over, onboard_recording

    handed = []
    if station.replayed is not None:
        handed.append(hand_over(station.replayed, folder, origin=f"replay of {station.replayed}"))
    sessions = [(s, r) for s, r in station.receiver.session_recorders().items() if r.path.is_file()]
    sessions.sort(key=lambda pair: pair[1].path.stat().st_size, reverse=True)
    for number, (session, recorder) in enumerate(sessions):
        name = "flight" if number == 0 and not handed else f"flight_{session.name}"
        onboard = onboard_recording(settings.handover.onboard, recorder.info().session)
        source, origin = (
            (recorder.path, "telemetry and backfill") if onboard is None else (onboard, "the onboard recording")
        )
        try:
            handed.append(
                hand_over(source, folder, origin=origin, fallback_calibration=settings.calibration.directory, name=name)
            )
        except HandoverError as error:
            click.echo(f"{session.name}: {error}")
    return handed


def _estimate(handed: list["Handover"], settings: "GroundConfig", folder: Path) -> None:
    """Run `sideslip estimate` on the flights in a process of its own, so that nothing of it lives on the ground station."""
    flights = [str(h.manoeuvres_path or h.path) for h in handed]
    if not flights:
        click.echo("nothing to estimate from: no flight was handed over")
        return
    report = folder / "report"
    command = [sys.executable, "-m", "sideslip", "estimate", *flights, "--report", str(report)]
    command += ["--model", settings.handover.model, "--method", settings.handover.methods]
    done = subprocess.run(command, check=False)
    if done.returncode not in (0, 1):
        click.echo(f"the estimate could not be made (status {done.returncode})")


@click.command(epilog="Example: sideslip view flights/first/flight.mcap")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--view", "window", type=VIEW, default="web", show_default=True, help=_VIEW_HELP)
@click.option("--layout", type=click.Choice(["full", "light"]), default="full", show_default=True)
@click.option("--rrd", type=click.Path(path_type=Path), help="Write the rerun recording here and keep it.")
@click.option(
    "--calibration", type=click.Path(path_type=Path), help="For a raw recording: calibration in place of its own."
)
@click.option("--web-port", type=int, default=9090, show_default=True)
@click.option("--duration", type=float, help="Close after this many seconds.")
def view(
    file: Path,
    window: str,
    layout: str,
    rrd: Path | None,
    calibration: Path | None,
    web_port: int,
    duration: float | None,
) -> int:
    """Show any recording or flight FILE (.mcap raw or calibrated, .csv, .parquet, .rrd) in rerun."""
    import tempfile

    from groundstation.viewer.recorded import as_rrd
    from groundstation.viewer.window import NativeWindow, WebPage

    with tempfile.TemporaryDirectory() as scratch:
        shown = as_rrd(file, rrd or Path(scratch) / "view.rrd", "light" if layout == "light" else "full", calibration)
        if rrd is not None:
            click.echo(f"rerun recording: {shown}")
        if window == "none":
            return 0
        opened = NativeWindow(shown) if window == "native" else WebPage(shown, web_port)
        try:
            if isinstance(opened, WebPage):
                click.echo(f"{opened.url}\nCtrl-C ends the page")
                opened.wait(duration)
            else:
                opened.wait(duration)
        except KeyboardInterrupt:
            pass
        finally:
            opened.close()
    return 0
