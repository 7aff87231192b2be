"""Command line of the viewer: `sideslip view`, and what it shares with `sideslip ground`."""

import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daq.utilities.options import align_option
from daq.utilities.outputs import tried_file

if TYPE_CHECKING:
    from groundstation.viewer.blueprint import Layout

VIEW = click.Choice(["web", "native", "none"])
LAYOUT = click.Choice(["full", "light", "phone"])
VIEW_HELP = "Show it in the browser, in rerun's own window, or not at all."


@contextmanager
def terminated_is_interrupt() -> Iterator[None]:
    """Raise KeyboardInterrupt for SIGTERM as for SIGINT, so that files are closed and the flight is written.

    SIGINT is set too, because a shell starts background jobs with SIGINT ignored.
    """

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    previous = {number: signal.signal(number, interrupt) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@click.command(epilog="Example: sideslip view flights/first/flight.mcap")
@click.argument("file", type=click.Path(path_type=Path))
@click.argument("other", type=click.Path(path_type=Path), required=False)
@align_option("Lay the flight OTHER on FILE in time")
@click.option("--view", "window", type=VIEW, default="web", show_default=True, help=VIEW_HELP)
@click.option("--layout", type=LAYOUT, default="full", show_default=True)
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
    layout: "Layout",
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
    if save_blueprint is not None:
        blueprint.save_blueprint(save_blueprint, layout)
        click.echo(f"layout: {save_blueprint}")
    with ExitStack() as scratch:
        target = rrd or Path(scratch.enter_context(tempfile.TemporaryDirectory())) / "view.rrd"
        if other is not None and align is not None:
            path, summary = both_as_rrd(file, other, target, layout, align, calibration)
            click.echo(summary)
        else:
            path = as_rrd(file, target, layout, calibration)
        if rrd is not None:
            click.echo(f"rerun recording: {path}")
        if window == "none":
            return 0
        opened = NativeWindow(path) if window == "native" else WebPage(path, web_port)
        try:
            with terminated_is_interrupt():
                if isinstance(opened, WebPage):
                    click.echo(f"{opened.url}\nCtrl-C ends the page")
                opened.wait(duration)
        except KeyboardInterrupt:
            pass
        finally:
            opened.close()
    return 0
