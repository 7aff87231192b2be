"""`sideslip watch`: the gap monitor over a flight: when a model stopped describing the aircraft."""

from pathlib import Path
from typing import Any

import click

from daq.identification.monitor import FALSE_ALARMS
from daq.utilities.options import (
    aircraft_option,
    json_option,
    model_option,
    path_option,
    report_option,
    seed_option,
    segments_option,
)
from daq.utilities.outputs import tried_file

EXAMPLE = "Example: sideslip watch flight.mcap --model ld4.toml --json watch.json"


@click.command(epilog=EXAMPLE)
@click.argument("flight", type=click.Path(path_type=Path), metavar="FLIGHT")
@model_option("Linear model of rolling and yawing, of the pitching plane, or of both: name or MODEL.toml.")
@aircraft_option(default="the one the flight carries or names")
@segments_option()
@click.option(
    "--rate",
    default=FALSE_ALARMS,
    show_default=True,
    type=click.FloatRange(0.01, 60.0),
    help="False alarms allowed in an hour of manoeuvring.",
)
@click.option(
    "--hours",
    default=2.5,
    show_default=True,
    type=click.FloatRange(1.0, 100.0),
    help="Of simulated manoeuvring from which thresholds come.",
)
@seed_option()
@path_option("--stretch", "stretch_path", text="Write the flight about its first alarm (.mcap).", tried=tried_file)
@json_option()
@report_option("Write an HTML page.")
def watch(
    flight: Path, stretch_path: Path | None, json_path: Path | None, report_folder: Path | None, **options: Any
) -> int:
    """Watch FLIGHT with a model: alarms where its short predictions go wrong; exit status 1 when there was one."""
    from estimation.answers import watching
    from sideslip.verbs.delivery import deliver

    answer = watching.watch(flight, **options)
    return deliver(answer if stretch_path is None else answer.cut(stretch_path), json_path, report_folder=report_folder)
