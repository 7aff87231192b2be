"""`sideslip check`: data compatibility (flight-path reconstruction) and data quality."""

from pathlib import Path
from typing import Any

import click

from daq.utilities.options import (
    aircraft_option,
    align_option,
    figure_option,
    flag_option,
    flights_argument,
    json_option,
    path_option,
    report_option,
    segments_option,
)
from daq.utilities.outputs import tried_folder

EXAMPLE = (
    "Example: sideslip check ld1.mcap ld2.mcap --factors +K_alpha,dalpha --figure compatibility.png --json check.json"
)


@click.command(epilog=EXAMPLE)
@flights_argument()
@click.option(
    "--factors",
    help="Factors to estimate, comma-separated; with a leading + they "
    "are added to the standard ones (dax day daz dp dq dr K_beta dbeta). Also K_alpha dalpha K_V dV dphi dtheta, "
    "x_imu y_imu z_imu, x_vane y_vane z_vane, delays tau_beta tau_alpha tau_V tau_phi tau_theta tau_psi.",
)
@aircraft_option(
    "Built-in aircraft or an AIRCRAFT.toml: its derivatives predict what the flight can tell",
    "the one each flight carries or names; without one nothing is predicted",
)
@flag_option("--joint", text="Also one set of factors shared by all flights.")
@flag_option("--keep-held", text="Take the repeated values of slow and stuck sensors for measurements.")
@segments_option()
@align_option("In the report, lay further flights on the first in time")
@json_option()
@figure_option("Write measured and reconstructed motion.")
@report_option("Write an HTML report: factors beside published ones, motion, quality.")
@path_option("--write", "folder", text="Write corrected flights here.", tried=tried_folder)
def check(
    flights: tuple[Path, ...],
    json_path: Path | None,
    figure_path: Path | None,
    report_folder: Path | None,
    folder: Path | None,
    **options: Any,
) -> int:
    """Check that accelerations, rates, attitude and air data of each FLIGHT tell the same story."""
    from estimation.answers import checks
    from groundstation.flight import write_flight
    from sideslip.verbs.delivery import Progress, deliver

    with Progress("checking") as progress:
        answer = checks.check(flights, progress=progress, **options)
    file_lines = []
    if folder is not None:
        for flight in answer.corrected():
            target = folder / f"{flight.name}.mcap"
            write_flight(flight, target)
            file_lines.append(f"corrected flight: {target}")
    return deliver(answer, json_path, figure_path, report_folder, written=file_lines)
