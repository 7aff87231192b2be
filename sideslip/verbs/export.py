"""The verb `export`: flights, recordings and models for other programs; models and aircraft for simulators."""

from pathlib import Path
from typing import Any

import click

from daq.utilities.options import flag_option, json_option, path_option
from daq.utilities.outputs import check_file, check_folder, tried_folder


@click.command(epilog="Example: sideslip export ld4.mcap -o ld4.parquet")
@click.argument("file", type=click.Path(path_type=Path))
@path_option(
    "-o", "--output", text="Its ending chooses the format; of --to gazebo a folder, whose name is the model's."
)
@click.option(
    "--to",
    "target",
    type=click.Choice(["ardupilot", "gazebo", "neutral", "jsbsim", "model"]),
    help="ardupilot: a linear model or aircraft file as a .json that ArduPilot's SITL flies. gazebo: as a folder for Gazebo"
    " with PX4. neutral: any model as JSON for a simulator of your own. All are proved on the spot. jsbsim: write a model found"
    " on a JSBSim aircraft back into the aircraft, and prove it by flying both. model: write a"
    " JSBSim aircraft as MODEL.toml (FILE is jsbsim:NAME or jsbsim:FOLDER, for which this is the default).",
)
@path_option("--out", text="For --to jsbsim: the folder to write into.", tried=tried_folder)
@click.option(
    "--aircraft-from", help="For --to jsbsim: jsbsim:NAME or jsbsim:FOLDER  [default: what the model was found on]."
)
@click.option("--rate", default=120.0, show_default=True, help="For --to jsbsim: JSBSim's steps per second.")
@click.option(
    "--aircraft",
    help="For --to ardupilot, gazebo, neutral: aircraft with what the model lacks (beliefs, throws, thrust).",
)
@click.option(
    "--throw",
    "throws",
    multiple=True,
    metavar="SURFACE=ANGLE",
    help="For the same: deflection at full stick, delta_e=25deg (rad without deg); may be repeated.",
)
@click.option("--thrust", type=float, help="For the same: static thrust [N]; 0 for a glider.")
@click.option("--alpha-stall", type=float, help="For --to ardupilot, gazebo: angle of attack of the stall [rad].")
@flag_option("--force", text="For --to ardupilot, gazebo, neutral: replace files that exist.")
@flag_option("--prove", text="For the same: write nothing, compare the existing output with FILE.")
@json_option("Write what was written, and the proof, as JSON.")
@flag_option("--units-row", text="CSV: a second line with the units.")
@flag_option("--raw", text="Of a raw recording: counts as recorded, not calibrated columns.")
@path_option("--calibration", text="Directory of calibration files instead of the embedded set.")
def export(json_path: Path | None, **options: Any) -> int:
    """Write FILE for other programs.

    A flight or recording: .csv .parquet .mat .kml .gpx .rrd .mcap (the last draws in Foxglove). A model .toml or what
    estimate --json wrote: .json .tex .csv. Units travel along. A model or an
    aircraft file for the simulators of autopilots: --to ardupilot, gazebo, neutral. A model
    found with --simulation jsbsim:NAME: --to jsbsim --out DIR. The other way, a JSBSim aircraft as a model in our own
    text, where that is exact: jsbsim:NAME -o MODEL.toml.
    """
    from sideslip.exports import export as write
    from sideslip.verbs.delivery import deliver

    if options["target"] == "gazebo":
        check_folder("--output", options["output"])
    else:
        check_file("--output", options["output"])
    return deliver(write(**options), json_path)
