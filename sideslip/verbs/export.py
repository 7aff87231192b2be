"""The verb `export`: flights, recordings and models for other programs; models and aircraft for simulators."""

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daq.utilities.options import flag_option, path_option
from daq.utilities.outputs import check_file, check_folder, tried_file, tried_folder
from estimation.errors import EstimationError

if TYPE_CHECKING:
    from estimation.simulation.autopilot.writing import ExportedSimulator

TARGETS = ("ardupilot", "gazebo", "neutral")
SURFACES = ("delta_e", "delta_a", "delta_r")
_ANGLE = re.compile(r"\s*([+-]?[0-9.]+(?:e[+-]?[0-9]+)?)\s*(deg|rad|)\s*\Z", re.IGNORECASE)
MOST = math.pi  # rad of deflection


def throws_of(words: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Surface -> least and greatest deflection [rad], of `delta_e=25deg` or `delta_e=-25deg:20deg`. Raises EstimationError."""
    throws = {}
    for word in words:
        name, sign, text = word.partition("=")
        ends = [_radians(part) for part in text.split(":")]
        if name not in SURFACES or not sign or len(ends) > 2 or None in ends:
            raise EstimationError(
                f"--throw {word}: write delta_e=25deg (delta_a, delta_r; rad without deg), or delta_e=-25deg:20deg where both"
                " ways differ"
            )
        angles = [a for a in ends if a is not None]
        low, high = (-angles[0], angles[0]) if len(angles) == 1 else angles
        if not -MOST <= low < 0.0 < high <= MOST:
            raise EstimationError(f"--throw {word}: a surface goes from below zero to above, 180 deg at most")
        throws[name] = (low, high)
    return throws


def _radians(text: str) -> float | None:
    match = _ANGLE.match(text)
    try:
        value = float(match[1]) if match else math.nan
    except ValueError:
        return None
    if not math.isfinite(value) or match is None:
        return None
    return math.radians(value) if match[2].lower() == "deg" else value


def to_simulator(
    target: str,
    file: Path,
    out: Path,
    *,
    aircraft: str | None,
    throws: Sequence[str],
    thrust: float | None,
    stall: float | None,
    force: bool,
    prove: bool,
    json_path: Path | None,
) -> int:
    """Write and prove; 1 where what was written is not the model."""
    from daq.utilities.outputs import write_json
    from estimation.simulation.autopilot import writing
    from estimation.simulation.autopilot.gathering import Stated

    for option, number in (("--thrust", thrust), ("--alpha-stall", stall)):
        if number is not None and not (math.isfinite(number) and number >= 0.0):
            raise EstimationError(f"{option} {number:g}: give a number, zero or above")
    does: dict[str, Callable[..., ExportedSimulator]] = {
        "ardupilot": writing.to_ardupilot,
        "gazebo": writing.to_gazebo,
        "neutral": writing.to_neutral,
    }
    request = writing.Request(Stated(aircraft, throws_of(throws), thrust), stall, force, prove)
    exported = does[target](file, out, request)
    for line in report_lines(exported):
        click.echo(line)
    if json_path is not None:
        write_json(json_of(target, file, exported), json_path)
    return 1 if exported.proof.failed else 0


def report_lines(exported: "ExportedSimulator") -> list[str]:
    proof = exported.proof
    lines = [f"{f}: written" for f in exported.files]
    lines.append(f"  {'axis':<8}{'deviation':>11}{'allowed':>11}")
    lines += [f"  {axis:<8}{value:>11.2g}{proof.limit:>11.2g}" for axis, value in proof.deviation.items()]
    lines += [f"  left out: {term.sentence()}" for term in proof.left_out]
    lines.append(proof.sentence())
    return [*lines, *exported.lines]


def json_of(target: str, file: Path, exported: "ExportedSimulator") -> dict[str, Any]:
    return {
        "version": 1, "from": str(file), "to": target, "files": [str(f) for f in exported.files],
        "proof": exported.proof.to_json(), "notes": list(exported.lines),
    }  # fmt: skip


_MODELS = (".toml", ".json")
_JSBSIM = "jsbsim:"


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
    " with PX4. neutral: any model as JSON for a simulator of one's own. All are proved on the spot. jsbsim: write a model found"
    " on a JSBSim aircraft back into the aircraft, and prove it by flying both. model: write a"
    " JSBSim aircraft as MODEL.toml (FILE is jsbsim:NAME or jsbsim:FOLDER, for which this is the default).",
)
@path_option("--out", text="Of --to jsbsim: the folder to write into.", tried=tried_folder)
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
@flag_option("--force", text="Of --to ardupilot, gazebo, neutral: replace files that exist.")
@flag_option("--prove", text="Of the same: write nothing, hold the output that exists against FILE.")
@path_option("--json", "json_path", text="Of the same: write the proof as JSON.", tried=tried_file)
@flag_option("--units-row", text="CSV: a second line with the units.")
@flag_option("--raw", text="Of a raw recording: counts as recorded, not calibrated columns.")
@path_option("--calibration", text="Directory of calibration files instead of the embedded set.")
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

    exported = export_file(file, output, units_row=units_row, raw=raw, calibration=calibration)
    click.echo(f"{exported.path}: written")
    for note in exported.notes:
        click.echo(f"  note: {note}")
    return 0


def _to_jsbsim(file: Path, output: Path | None, out: Path | None, aircraft_from: str | None, rate: float) -> int:
    """Write and prove an aircraft; 1 where it does not fly like the model."""
    from estimation.simulation.conversion import export_to_jsbsim

    if out is None or output is not None:
        raise click.UsageError("--to jsbsim writes a folder: give --out DIR, and no --output")
    proved_export = export_to_jsbsim(file, aircraft_from, out, rate)
    click.echo(f"{proved_export.exported.file}: written")
    click.echo(f"  added: {', '.join(proved_export.exported.terms) or 'nothing'}")
    for term in proved_export.exported.left_out:
        click.echo(f"  left out: {term}")
    click.echo(f"  {'output':<8}{'rms':>11}{'allowed':>11}{'by steps':>11}")
    for name, rms in proved_export.proof.rms.items():
        click.echo(
            f"  {name:<8}{rms:>11.3g}{proved_export.proof.allowed[name]:>11.3g}{proved_export.proof.steps[name]:>11.3g}"
        )
    click.echo(proved_export.sentence())
    click.echo(proved_export.of_the_steps())
    return 1 if proved_export.proof.failed else 0


def _from_jsbsim(spec: str, output: Path | None, out: Path | None) -> int:
    from estimation.simulation.conversion import import_from_jsbsim

    if not spec.startswith(_JSBSIM):
        raise click.UsageError("--to model takes a JSBSim aircraft: jsbsim:NAME or jsbsim:FOLDER for FILE")
    if out is not None or output is None or output.suffix.lower() != ".toml":
        raise click.UsageError("a JSBSim aircraft becomes one file: give -o MODEL.toml")
    proved_import = import_from_jsbsim(spec, output)
    click.echo(f"{output}: written")
    for line in (*proved_import.imported.sentences(), *proved_import.notes):
        click.echo(f"  {line}")
    click.echo(proved_import.sentence())
    return 0
