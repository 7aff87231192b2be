"""The verb `export`: flights, recordings and models for other programs."""

from pathlib import Path

import click

from daq.contract.outputs import check_file, check_folder, tried_file, tried_folder

_MODELS = (".toml", ".json")
_JSBSIM = "jsbsim:"


@click.command(epilog="Example: sideslip export ld4.mcap -o ld4.parquet")
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help="Its ending chooses the format; of --to gazebo a folder, whose name is the model's.",
)
@click.option(
    "--to",
    "target",
    type=click.Choice(["ardupilot", "gazebo", "neutral", "jsbsim", "model"]),
    help="ardupilot: a linear model or aircraft file as a .json that ArduPilot's SITL flies. gazebo: as a folder for Gazebo"
    " with PX4. neutral: any model as JSON for a simulator of one's own. All are proved on the spot. jsbsim: write a model found"
    " on a JSBSim aircraft back into the aircraft, and prove it by flying both. model: write a"
    " JSBSim aircraft as MODEL.toml (FILE is jsbsim:NAME or jsbsim:FOLDER, for which this is the default).",
)
@click.option(
    "--out", type=click.Path(path_type=Path), callback=tried_folder, help="Of --to jsbsim: the folder to write into."
)
@click.option(
    "--aircraft-from", help="Of --to jsbsim: jsbsim:NAME or jsbsim:FOLDER  [default: what the model was found on]."
)
@click.option("--rate", default=120.0, show_default=True, help="Of --to jsbsim: JSBSim's steps per second.")
@click.option(
    "--aircraft",
    help="Of --to ardupilot, gazebo, neutral: aircraft with what the model lacks (beliefs, throws, thrust).",
)
@click.option(
    "--throw",
    "throws",
    multiple=True,
    metavar="SURFACE=ANGLE",
    help="Of the same: deflection at full stick, delta_e=25deg (rad without deg); may be repeated.",
)
@click.option("--thrust", type=float, help="Of the same: static thrust [N]; 0 for a glider.")
@click.option("--alpha-stall", type=float, help="Of --to ardupilot, gazebo: angle of attack of the stall [rad].")
@click.option("--force", is_flag=True, help="Of --to ardupilot, gazebo, neutral: replace files that exist.")
@click.option("--prove", is_flag=True, help="Of the same: write nothing, hold the output that exists against FILE.")
@click.option(
    "--json",
    "json_path",
    type=click.Path(path_type=Path),
    callback=tried_file,
    help="Of the same: write the proof as JSON.",
)
@click.option("--units-row", is_flag=True, help="CSV: a second line with the units.")
@click.option("--raw", is_flag=True, help="Of a raw recording: counts as recorded, not calibrated columns.")
@click.option(
    "--calibration", type=click.Path(path_type=Path), help="Directory of calibration files instead of the embedded set."
)
def export(
    file: Path,
    output: Path | None,
    target: str | None,
    out: Path | None,
    aircraft_from: str | None,
    rate: float,
    aircraft: str | None,
    throws: tuple[str, ...],
    thrust: float | None,
    alpha_stall: float | None,
    force: bool,
    prove: bool,
    json_path: Path | None,
    units_row: bool,
    raw: bool,
    calibration: Path | None,
) -> int:
    """Write FILE for other programs.

    A flight or recording: .csv .parquet .mat .kml .gpx .rrd .mcap (the last draws in Foxglove). A model .toml or what
    estimate --json wrote: .json .tex .csv. Units travel along. A model or an
    aircraft file for the simulators of autopilots: --to ardupilot, gazebo, neutral. A model
    found with --simulation jsbsim:NAME: --to jsbsim --out DIR. The other way, a JSBSim aircraft as a model in our own
    text, where that is exact: jsbsim:NAME -o MODEL.toml.
    """
    if target == "gazebo":
        check_folder("--output", output)
    else:
        check_file("--output", output)
    if target in ("ardupilot", "gazebo", "neutral"):
        from estimation.commands.to_simulator import to_simulator

        if output is None or out is not None or aircraft_from is not None:
            raise click.UsageError(f"--to {target} writes one place: give -o, neither --out nor --aircraft-from")
        return to_simulator(target, file, output, aircraft=aircraft, throws=throws, thrust=thrust, stall=alpha_stall,
                            force=force, prove=prove, json_path=json_path)  # fmt: skip
    if aircraft or throws or thrust is not None or alpha_stall is not None or force or prove or json_path:
        raise click.UsageError(
            "--aircraft, --throw, --thrust, --alpha-stall, --force, --prove and --json belong to --to ardupilot, gazebo,"
            " neutral"
        )
    if target == "model" or (target is None and str(file).startswith(_JSBSIM)):
        return _from_jsbsim(str(file), output, out)
    if target is not None:
        return _to_jsbsim(file, output, out, aircraft_from, rate)
    if out is not None or aircraft_from is not None:
        raise click.UsageError("--out and --aircraft-from belong to --to jsbsim")
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output'")
    if file.suffix.lower() in _MODELS:
        from estimation.report.model_export import export_model

        export_model(file, output)
        click.echo(f"{output}: written")
        return 0
    from groundstation.export.run import export_file

    done = export_file(file, output, units_row=units_row, raw=raw, calibration=calibration)
    click.echo(f"{done.path}: written")
    for note in done.notes:
        click.echo(f"  note: {note}")
    return 0


def _to_jsbsim(file: Path, output: Path | None, out: Path | None, aircraft_from: str | None, rate: float) -> int:
    """Write and prove an aircraft; 1 where it does not fly like the model."""
    from estimation.simulation.exporting import export_to_jsbsim

    if out is None or output is not None:
        raise click.UsageError("--to jsbsim writes a folder: give --out DIR, and no --output")
    done = export_to_jsbsim(file, aircraft_from, out, rate)
    click.echo(f"{done.exported.file}: written")
    click.echo(f"  added: {', '.join(done.exported.terms) or 'nothing'}")
    for what in done.exported.left_out:
        click.echo(f"  left out: {what}")
    click.echo(f"  {'output':<8}{'rms':>11}{'allowed':>11}{'by steps':>11}")
    for name, rms in done.proof.rms.items():
        click.echo(f"  {name:<8}{rms:>11.3g}{done.proof.allowed[name]:>11.3g}{done.proof.steps[name]:>11.3g}")
    click.echo(done.sentence())
    click.echo(done.of_the_steps())
    return 1 if done.proof.failed else 0


def _from_jsbsim(spec: str, output: Path | None, out: Path | None) -> int:
    """Write an aircraft of JSBSim as a model file."""
    from estimation.simulation.importing import import_from_jsbsim

    if not spec.startswith(_JSBSIM):
        raise click.UsageError("--to model takes a JSBSim aircraft: jsbsim:NAME or jsbsim:FOLDER for FILE")
    if out is not None or output is None or output.suffix.lower() != ".toml":
        raise click.UsageError("a JSBSim aircraft becomes one file: give -o MODEL.toml")
    done = import_from_jsbsim(spec, output)
    click.echo(f"{output}: written")
    for line in (*done.imported.sentences(), *done.notes):
        click.echo(f"  {line}")
    click.echo(done.sentence())
    return 0
