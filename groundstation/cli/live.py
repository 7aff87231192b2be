"""Command line of the ground station: `sideslip ground` and `sideslip view`."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daq.contract.errors import UserError
from daq.contract.options import aircraft_option, json_option, model_option
from daq.contract.outputs import tried_file, tried_folder

if TYPE_CHECKING:
    from groundstation.cli.data import Services
    from groundstation.identification.aircraft import AircraftSource
    from groundstation.live.config import GroundConfig
    from groundstation.live.handover import Handover
    from groundstation.live.replay import Replay
    from groundstation.live.station import Station
    from groundstation.viewer.session import SessionViews

POLL_S = 0.02
Say = Callable[[str], None]
VIEW = click.Choice(["web", "native", "none"])
_VIEW_HELP = "Show it in the browser, in rerun's own window, or not at all."


@click.command(epilog="Example: sideslip ground ground.toml --view web --json session.json")
@click.argument("config", type=click.Path(path_type=Path), required=False)
@click.option("--replay", type=click.Path(path_type=Path), help="Play a .tlog or a recording instead of listening.")
@click.option("--speed", default="1", show_default=True, help="Of the replay: recorded seconds a second, or max.")
@click.option("--view", "window", type=VIEW, default="none", show_default=True, help=_VIEW_HELP)
@click.option(
    "--layout",
    type=click.Choice(["full", "light"]),
    help="Of the view: light for a browser that lags  [default: full].",
)
@aircraft_option("Name or file, for live identification", "the one the recording names")
@click.option("--watch", "watched", is_flag=True, help="Say when the aircraft no longer flies as its file believes.")
@model_option(
    "MODEL.toml that --watch holds against flight, in place of the aircraft's beliefs.",
    None,
    click.Path(path_type=Path),
)
@click.option("--estimate", "with_estimate", is_flag=True, help="Estimate parameters from the finished flight.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    callback=tried_folder,
    help="Folder of this session, instead of the configured.",
)
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
    from groundstation.live.replay import Replay, parse_speed, replay_into

    settings = configured(config, layout, aircraft, watched, model)
    with (
        _terminal_may_go(),
        _session(settings, out, replay is not None) as (folder, say),
        _views(settings, window, say) as views,
    ):
        player = Replay()
        source = None if services is None else services.aircraft
        station = _station(settings, folder, views, player if replay is not None else None, replay, source, say)
        say(
            f"session {folder}; {'replaying ' + str(replay) if replay else 'listening on ' + ', '.join(settings.link.ports)}"
        )
        interrupted = False
        try:
            with _terminated_is_interrupt():
                if replay is not None:
                    replay_into(station, player, replay, parse_speed(speed))
                else:
                    _listen(station, settings, duration, views, say)
        except KeyboardInterrupt:
            interrupted = True
        finally:
            station.close()
        handed = _finish(station, settings, folder, say)
        whole = _conclude(station, handed, json_path, settings.identification.model, say)
        if with_estimate and services is not None:
            _estimate(handed, settings, folder, say, services, show=views is not None)
        if replay is not None and views is not None and duration is None and not interrupted:
            say("the replay is over; Ctrl-C ends the view")
            _hold(views)
    return 130 if interrupted else 0 if whole else 1


@contextmanager
def _terminal_may_go() -> Iterator[None]:
    """A terminal that closes, or a connection to it that breaks, does not end a session: SIGTERM or a typed `quit` does."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)


@contextmanager
def _session(settings: "GroundConfig", out: Path | None, replayed: bool) -> Iterator[tuple[Path, Say]]:
    """The session's folder, held against other ground stations, and where its lines go: standard output, as long as there is
    one, and `ground.log` in the folder. replayed: then it must not hold a session already."""
    from daq.contract.durable import FolderInUseError, folder_of_ones_own
    from groundstation.live.config import GroundConfigError
    from groundstation.live.console import spoken

    wanted = out or _session_folder(settings)
    dated = out is None and settings.output.dated
    old = sorted([*wanted.glob("*.tlog"), *wanted.glob("*.journal")]) if replayed else []
    if old:
        raise GroundConfigError(f"{wanted} holds a session already ({old[0].name}); give another folder with --out")
    for folder in [wanted, *(wanted.with_name(f"{wanted.name}_{n}") for n in range(2, 100) if dated)]:
        with ExitStack() as held:
            try:
                held.enter_context(folder_of_ones_own(folder, "ground"))
            except FolderInUseError:
                continue
            yield folder, held.enter_context(spoken(folder))
            return
    raise GroundConfigError(f"{wanted}: another ground station writes there; give this one another folder with --out")


def _conclude(station: "Station", handed: list["Handover"], json_path: Path | None, model: str, say: Say) -> bool:
    """Say what the session has left, and write its counters; whether the disk has all that came down.

    model: that the gap monitor held against flight, or "".
    """
    from groundstation.cli.data import write_json
    from groundstation.identification.history import alarmed

    for flight in handed:
        for line in flight.lines():
            say(line)
        if alarmed(flight.flight.provenance.detail):
            held = f" --model {model}" if model else ""
            say(f"  the gap monitor gave alarms; next: sideslip gap {flight.manoeuvres_path or flight.path}{held}")
    summary = station.receiver.summary()
    summary["flight"] = str(handed[0].path) if handed else None
    summary["flights"] = [str(h.path) for h in handed]
    write_json(json_path, summary)
    lost = sum(b - a + 1 for a, b in summary["scans_lost"])
    say(
        f"{summary['frames_received']} frames, {summary['scans_received']} scans received, {lost} lost, "
        f"{summary['backfilled']} backfilled, {summary['unsigned_rejected']} refused, {summary['scans_on_disk']} on disk"
    )
    gone = summary["scans_not_on_disk"]
    if gone:
        say(f"{gone} scans came down and are not on the disk; fetch them from the aircraft, which recorded them")
    return not gone


def _hold(views: "SessionViews") -> None:
    """Keep the views until somebody has seen enough."""
    try:
        with _terminated_is_interrupt():
            while True:
                views.tend()
                time.sleep(0.1)
    except KeyboardInterrupt:
        return


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


def _station(
    settings: "GroundConfig",
    folder: Path,
    views: "SessionViews | None",
    replay: "Replay | None",
    played: Path | None,
    source: "AircraftSource | None",
    say: Say,
) -> "Station":
    from groundstation.live.config import GroundConfigError
    from groundstation.live.station import Station
    from groundstation.receiver.receive import Receiver
    from groundstation.receiver.timeline import SystemClock

    make_view = None if views is None else views.make
    if replay is None and not settings.link.ports:
        raise GroundConfigError("[link] ports is empty: there is nothing to listen to; name a port")
    if replay is not None:
        quiet = settings.link.model_copy(update={"ports": (), "transmit": False, "backfill": "off"})
        # A recording does not come over a link: there is nothing to keep of it.
        kept = folder if played is not None and played.suffix == ".tlog" else None
        receiver = Receiver(quiet, {"replay": replay.port}, replay.clock, folder=kept)
        return Station(settings, receiver, replay.clock, folder, make_view=make_view, echo=say, aircraft=source)
    system = SystemClock()
    receiver = Receiver.open(settings.link, system, folder=folder)
    return Station(settings, receiver, system, folder, make_view=make_view, echo=say, aircraft=source)


@contextmanager
def _views(settings: "GroundConfig", window: str, say: Say) -> "Iterator[SessionViews | None]":
    """The views of the session, closed at its end; None without any."""
    if window == "none":
        yield None
        return
    from groundstation.viewer.session import SessionViews

    views = SessionViews(settings.view, "web" if window == "web" else "native", say)
    try:
        yield views
    finally:
        views.close()


def _listen(
    station: "Station", settings: "GroundConfig", duration: float | None, views: "SessionViews | None", say: Say
) -> None:
    """Until Ctrl-C, `quit` or the duration is over; after a landing, missing scans are fetched as long as allowed."""
    from groundstation.live.console import Console, Lines

    begun = time.monotonic()
    fetching: dict[int, float] = {}
    console = Console(station, Lines.of_standard_input(), say)
    while console.poll() and (duration is None or time.monotonic() - begun < duration):
        station.step()
        if views is not None:
            views.tend()
        while station.landed:
            system = station.landed.pop()
            if settings.link.backfill != "off" and settings.link.transmit:
                station.receiver.set_backfill("all", system)
                fetching[system] = time.monotonic()
                say(f"aircraft {system} has landed: fetching what is missing")
        for system, since in list(fetching.items()):
            if station.receiver.backfill_agreed(system):
                del fetching[system]
            elif time.monotonic() - since > settings.handover.backfill_limit_s:
                say(f"aircraft {system}: backfill not complete within the limit; the flight keeps its gaps")
                del fetching[system]
        time.sleep(POLL_S)


def _finish(station: "Station", settings: "GroundConfig", folder: Path, say: Say) -> list["Handover"]:
    """Hand over every session that holds a flight."""
    from groundstation.live.handover import HandoverError, hand_over, onboard_recording

    handed = []
    if station.replayed is not None:
        identified = None if station.replayed_as is None else station.identifications.kept(station.replayed_as)
        handed.append(
            hand_over(station.replayed, folder, origin=f"replay of {station.replayed}", identified=identified)
        )
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
                hand_over(
                    source,
                    folder,
                    origin=origin,
                    fallback_calibration=settings.calibration.directory,
                    name=name,
                    identified=station.identifications.kept(session),
                )
            )
        except HandoverError as error:
            say(f"{session.name}: {error}")
        except OSError as error:
            say(f"{session.name}: the flight cannot be written ({error.strerror or error})")
        except Exception as error:  # noqa: BLE001  what a sender said must not keep the other flights from being written
            say(f"{session.name}: no flight can be made of it ({type(error).__name__}: {error}); its recording stays")
    if any(not r.path.is_file() for r in station.receiver.session_recorders().values() if r.has_scans):
        advice = f"sideslip ground CONFIG --replay {folder / 'telemetry.tlog'} --speed max --out ELSEWHERE"
        say(f"not everything received could be written as a recording; make room and play it again: {advice}")
    return handed


def _estimate(
    handed: list["Handover"],
    settings: "GroundConfig",
    folder: Path,
    say: Say,
    services: "Services",
    *,
    show: bool,
) -> None:
    """Estimate from the flights, after the station is closed. show: open the report, for somebody who has been watching."""
    flights = [h.manoeuvres_path or h.path for h in handed]
    if not flights:
        say("nothing to estimate from: no flight was handed over")
        return
    report = folder / "report"
    try:
        lines = services.estimate(flights, settings.handover.model, settings.handover.methods, report)
    except UserError as error:  # the session itself is sound, and its flights are written
        say(f"the estimate could not be made: {error}")
        return
    for line in lines:
        say(line)
    if show:
        click.launch(str(report / "index.html"))


@click.command(epilog="Example: sideslip view flights/first/flight.mcap")
@click.argument("file", type=click.Path(path_type=Path))
@click.argument("other", type=click.Path(path_type=Path), required=False)
@click.option(
    "--align",
    type=click.Choice(["auto", "correlation", "input", "event", "start"]),
    is_flag=False,
    flag_value="auto",
    help="Lay the flight OTHER on FILE in time: by likeness, by the first input, by an event that both have, or by their starts.",
)
@click.option("--view", "window", type=VIEW, default="web", show_default=True, help=_VIEW_HELP)
@click.option("--layout", type=click.Choice(["full", "light"]), default="full", show_default=True)
@click.option(
    "--rrd", type=click.Path(path_type=Path), callback=tried_file, help="Write the rerun recording here and keep it."
)
@click.option(
    "--calibration", type=click.Path(path_type=Path), help="For a raw recording: calibration in place of its own."
)
@click.option(
    "--save-blueprint", type=click.Path(path_type=Path), help="Write the layout as .rbl, for rerun's own use."
)
@click.option("--web-port", type=int, default=9090, show_default=True)
@click.option("--duration", type=float, help="Close after this many seconds.")
def view(
    file: Path,
    other: Path | None,
    align: str | None,
    window: str,
    layout: str,
    rrd: Path | None,
    calibration: Path | None,
    save_blueprint: Path | None,
    web_port: int,
    duration: float | None,
) -> int:
    """Show any recording or flight FILE (.mcap raw or calibrated, .csv, .parquet, .rrd) in rerun; with --align two."""
    import tempfile

    from groundstation.viewer import blueprint
    from groundstation.viewer.recorded import as_rrd, both_as_rrd
    from groundstation.viewer.window import NativeWindow, WebPage

    if (other is None) != (align is None):
        raise click.UsageError("two flights in one view: sideslip view A B --align")
    chosen: blueprint.Layout = "light" if layout == "light" else "full"
    if save_blueprint is not None:
        blueprint.save_blueprint(save_blueprint, chosen)
        click.echo(f"layout: {save_blueprint}")
    with ExitStack() as scratch:
        target = rrd or Path(scratch.enter_context(tempfile.TemporaryDirectory())) / "view.rrd"
        if other is not None and align is not None:
            shown, said = both_as_rrd(file, other, target, chosen, align, calibration)
            click.echo(said)
        else:
            shown = as_rrd(file, target, chosen, calibration)
        if rrd is not None:
            click.echo(f"rerun recording: {shown}")
        if window == "none":
            return 0
        opened = NativeWindow(shown) if window == "native" else WebPage(shown, web_port)
        try:
            with _terminated_is_interrupt():
                if isinstance(opened, WebPage):
                    click.echo(f"{opened.url}\nCtrl-C ends the page")
                opened.wait(duration)
        except KeyboardInterrupt:
            pass
        finally:
            opened.close()
    return 0
