"""`sideslip reconstruct`: air data of an aircraft without vanes, with stated uncertainty."""

from pathlib import Path
from typing import Any

import click

from daq.utilities.options import json_option, path_option, report_option
from daq.utilities.outputs import tried_file

EXAMPLE = "Example: sideslip reconstruct log.mcap -o flight.mcap && sideslip estimate flight.mcap --model lateral"


@click.command(epilog=EXAMPLE)
@click.argument("flight", type=click.Path(path_type=Path))
@path_option(
    "-o", "--output", "--out", text="Flight to write: .mcap, .csv or .parquet.", tried=tried_file, required=True
)
@json_option("Write wind and uncertainties as JSON.")
@report_option("Write an HTML page.")
@click.option(
    "--trim-sideslip",
    type=click.FloatRange(min=0.0, max=30.0),
    default=1.7,
    show_default=True,
    help="How far from zero the mean sideslip may be [deg], 1 sigma.",
)
@click.option(
    "--attitude-error",
    type=click.FloatRange(min=0.0, max=30.0),
    default=0.17,
    show_default=True,
    help="Least slow error of the attitude, mounting included [deg], 1 sigma.",
)
def reconstruct(json_path: Path | None, report_folder: Path | None, **options: Any) -> int:
    """Add airspeed, angle of attack, sideslip and wind to a FLIGHT without vanes, from GNSS velocity, IMU and pitot."""
    from estimation.answers import reconstruction
    from sideslip.verbs.delivery import deliver

    return deliver(reconstruction.reconstruct(**options), json_path, report_folder=report_folder)
