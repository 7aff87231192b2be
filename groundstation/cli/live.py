"""Command line of the ground station: `sideslip ground`."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daq.utilities.errors import UserError
from daq.utilities.options import aircraft_option, json_option, model_option, path_option
from daq.utilities.outputs import tried_folder
from daq.utilities.utc_stamps import name_stamp
from groundstation.cli.view import LAYOUT, VIEW, VIEW_HELP, terminated_is_interrupt

if TYPE_CHECKING:
    from daq.identification.regression import AircraftSource
    from groundstation.cli.services import Services
    from groundstation.live.config import GroundConfig
    from groundstation.live.handover import Handover
    from groundstation.live.replay import Replay
    from groundstation.live.station import Station
    from groundstation.viewer.session import SessionViews

POLL_S = 0.02  # between two steps of the station
Say = Callable[[str], None]


@click.command(epilog="Example: sideslip ground ground.toml --view web --json session.json")
@click.argument("config", type=click.Path(path_type=Path), required=False)
@click.option("--replay", type=click.Path(path_type=Path), help="Play a .tlog or a recording instead of listening.")
@click.option("--speed", default="1", show_default=True, help="Of the replay: recorded seconds a second, or max.")
@click.option("--view", "window", type=VIEW, default="none", show_default=True, help=VIEW_HELP)
@click.option(
    "--layout",
    type=LAYOUT,
    help="Of the view: light for a browser that lags, phone for a narrow screen  [default: full].",
)
@aircraft_option("Name or file, for live identification", "the one the recording names")
@click.option("--watch", "watched", is_flag=True, help="Say when the aircraft no longer flies as its file believes.")
@model_option(
    "What is identified live: lateral, longitudinal, six-dof or MODEL.toml; --watch holds a lateral file against flight.",
    None,
    click.Path(path_type=Path),
)
@click.option("--estimate", "with_estimate", is_flag=True, help="Estimate parameters from the finished flight.")
@path_option("-o", "--out", "--output", text="Folder of this session, instead of the configured.", tried=tried_folder)
@json_option("Write the counters of the session as JSON.")
@click.option("--duration", type=float, help="End after this many seconds.")
@click.pass_obj
def ground(
    services: "Services | None",
    config: Path | None,
    replay: Path | None,
    speed: str,
    window: str,
    layout: str | None,
    aircraft: str | None,
    watched: bool,
    model: Path | None,
    with_estimate: bool,
    out: Path | None,
    json_path: Path | None,
    duration: float | None,
) -> int:
    """Receive, decode, calibrate, show live, record, watch limits, and hand finished flights over.

    CONFIG is a TOML file (see docs/ground.md); without one the usual ports are listened to: UDP 14550 of this computer, and
    telemetry radios on USB at 57600 baud. Ctrl-C ends the session and writes the flight. While it runs, typed words
    command the aircraft: help lists them.
    """
    from groundstation.live.config import configured
    from groundstation.live.handover import hand_over_sessions
    from groundstation.live.replay import Replay, parse_speed, replay_into

    pace = parse_speed(speed) if replay is not None else None
    settings = configured(config, layout, aircraft, watched, model)
    with (
        _ignore_hangup(),
        _session(settings, out, replay is not None) as (folder, say),
        _views(settings, window, say) as views,
    ):
        player = Replay()
        station = _station(
            settings, folder, views, player, replay, None if services is None else services.aircraft, say
        )
        say(
            f"session {folder}; {'replaying ' + str(replay) if replay else 'listening on ' + ', '.join(settings.link.ports)}"
        )
        interrupted = False
        try:
            with terminated_is_interrupt():
                if replay is not None:
                    replay_into(station, player, replay, pace)
                else:
                    _listen(station, settings, duration, views, say)
        except KeyboardInterrupt:
            interrupted = True
        finally:
            station.close()
        handovers = hand_over_sessions(station, folder, say)
        all_on_disk = _conclude(station, handovers, json_path, settings.identification.model, say)
        if with_estimate and services is not None:
            _estimate(handovers, settings, folder, say, services, show=views is not None)
        if replay is not None and views is not None and duration is None and not interrupted:
            say("the replay is over; Ctrl-C ends the view")
            _keep_open(views)
    return 130 if interrupted else 0 if all_on_disk else 1


@contextmanager
def _ignore_hangup() -> Iterator[None]:
    """Keep a session running when its terminal closes or the connection to it breaks: SIGTERM or a typed `quit` ends it."""
    hangup = getattr(signal, "SIGHUP", None)  # Windows has none
    if hangup is None:
        yield
        return
    handler = signal.signal(hangup, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(hangup, handler)


@contextmanager
def _session(settings: "GroundConfig", out: Path | None, replayed: bool) -> Iterator[tuple[Path, Say]]:
    """The session's folder, locked against other ground stations, and a function that prints a line (see `open_output`).

    replayed: the folder must not hold a session already. Raises GroundConfigError where the folder cannot be used.
    """
    from daq.utilities.durable import FolderInUseError, folder_of_ones_own
    from groundstation.live.config import GroundConfigError
    from groundstation.live.console import open_output

    dated = out is None and settings.output.dated
    base = settings.output.directory
    folder_name = out or (base / name_stamp(time.time()) if dated else base)
    previous = sorted([*folder_name.glob("*.tlog"), *folder_name.glob("*.journal")]) if replayed else []
    if previous:
        raise GroundConfigError(
            f"{folder_name} holds a session already ({previous[0].name}); give another folder with --out"
        )
    for folder in [folder_name, *(folder_name.with_name(f"{folder_name.name}_{n}") for n in range(2, 100) if dated)]:
        created = not folder.exists()
        with ExitStack() as lock:
            try:
                lock.enter_context(folder_of_ones_own(folder, "ground"))
            except FolderInUseError:
                continue
            try:
                yield folder, lock.enter_context(open_output(folder))
            finally:
                lock.close()
                if created:
                    _remove_unused(folder)
            return
    raise GroundConfigError(
        f"{folder_name}: another ground station writes there; give this one another folder with --out"
    )


def _remove_unused(folder: Path) -> None:
    """Delete the folder of a session that never began, because a port was wrong or in use."""
    with suppress(OSError):
        files = [*folder.iterdir()]
        if not any(f.is_dir() or f.stat().st_size for f in files):
            for file in files:
                file.unlink()
            folder.rmdir()


def _conclude(station: "Station", handovers: list["Handover"], json_path: Path | None, model: str, say: Say) -> bool:
    """Print the session's result and write its counters; gives whether every received scan is on the disk.

    model: the model that the gap monitor compared with the flight, or "".
    """
    from groundstation.cli.data import write_json
    from groundstation.identification.history import alarmed

    for flight in handovers:
        for line in flight.lines():
            say(line)
        if alarmed(flight.flight.provenance.detail):
            option = f" --model {model}" if model else ""
            say(f"  the gap monitor gave alarms; next: sideslip gap {flight.manoeuvres_path or flight.path}{option}")
    summary = station.receiver.summary()
    summary["flight"] = str(handovers[0].path) if handovers else None
    summary["flights"] = [str(h.path) for h in handovers]
    write_json(json_path, summary)
    lost_count = sum(b - a + 1 for a, b in summary["scans_lost"])
    say(
        f"{summary['frames_received']} frames, {summary['scans_received']} scans received, {lost_count} lost, "
        f"{summary['backfilled']} backfilled, {summary['unsigned_rejected']} refused, {summary['scans_on_disk']} on disk"
    )
    if handovers:
        say(f"next: sideslip check {handovers[0].path}")
    missing = summary["scans_not_on_disk"]
    if missing:
        say(f"{missing} scans came down and are not on the disk; fetch them from the aircraft, which recorded them")
    return not missing


def _keep_open(views: "SessionViews") -> None:
    """Keep the views until Ctrl-C."""
    try:
        with terminated_is_interrupt():
            while True:
                views.tend()
                time.sleep(0.1)
    except KeyboardInterrupt:
        return


def _station(
    settings: "GroundConfig",
    folder: Path,
    views: "SessionViews | None",
    player: "Replay",
    replay: Path | None,
    source: "AircraftSource | None",
    say: Say,
) -> "Station":
    """The station on the configured ports, or on the player's where the file `replay` is played."""
    from groundstation.live.config import GroundConfigError
    from groundstation.live.station import Station
    from groundstation.receiver.receive import Receiver
    from groundstation.receiver.timeline import GroundClock, SystemClock

    clock: GroundClock
    if replay is None:
        if not settings.link.ports:
            raise GroundConfigError("[link] ports is empty: there is nothing to listen to; name a port")
        clock = SystemClock()
        receiver = Receiver.open(settings.link, clock, folder=folder)
    else:
        clock = player.clock
        quiet = settings.link.model_copy(update={"ports": (), "transmit": False, "backfill": "off"})
        # a raw recording does not come over a link: there is nothing to record of it
        folder_of_log = folder if replay.suffix == ".tlog" else None
        receiver = Receiver(quiet, {"replay": player.port}, clock, folder=folder_of_log)
    make_view = None if views is None else views.make
    return Station(settings, receiver, clock, folder, make_view=make_view, echo=say, aircraft=source)


@contextmanager
def _views(settings: "GroundConfig", window: str, say: Say) -> "Iterator[SessionViews | None]":
    """The views of the session, closed at its end; None without any."""
    if window == "none":
        if find_spec("rerun") is None:
            say("no picture: the package 'rerun' is not installed; pip install 'sideslip[ground]', then --view web")
        yield None
        return
    from groundstation.viewer.session import SessionViews

    views = SessionViews(settings.view, "web" if window == "web" else "native", say, settings.identification.model)
    try:
        yield views
    finally:
        views.close()


def _listen(
    station: "Station", settings: "GroundConfig", duration: float | None, views: "SessionViews | None", say: Say
) -> None:
    """Run the station until Ctrl-C, `quit` or the end of `duration` [s]; after a landing fetch missing scans for a limited
    time."""
    from groundstation.live.console import Console, Lines

    start_s = time.monotonic()
    fetching: dict[int, float] = {}
    console = Console(station, Lines.of_standard_input(), say)
    while console.poll() and (duration is None or time.monotonic() - start_s < duration):
        station.step()
        if views is not None:
            views.tend()
        while station.landed:
            system = station.landed.pop()
            if settings.link.backfill != "off" and settings.link.transmit:
                station.receiver.set_backfill("all", system)
                fetching[system] = time.monotonic()
                say(f"aircraft {system} has landed: fetching what is missing")
        for system, since_s in list(fetching.items()):
            if station.receiver.backfill_agreed(system):
                del fetching[system]
            elif time.monotonic() - since_s > settings.handover.backfill_limit_s:
                say(f"aircraft {system}: backfill not complete within the limit; the flight keeps its gaps")
                del fetching[system]
        time.sleep(POLL_S)


def _estimate(
    handovers: list["Handover"],
    settings: "GroundConfig",
    folder: Path,
    say: Say,
    services: "Services",
    *,
    show: bool,
) -> None:
    """Estimate from the flights, after the station is closed. show: open the report in the browser."""
    flights = [h.manoeuvres_path or h.path for h in handovers]
    if not flights:
        say("nothing to estimate from: no flight was handed over")
        return
    report = folder / "report"
    try:
        handover = settings.handover
        lines = services.estimate(flights, handover.model, handover.methods, settings.identification.aircraft, report)
    except UserError as error:  # the session succeeded: its flights are written
        say(f"the estimate could not be made: {error}")
        return
    for line in lines:
        say(line)
    if show:
        click.launch(str(report / "index.html"))
