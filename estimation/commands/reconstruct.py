"""`sideslip reconstruct`: air data of an aircraft without vanes, with stated uncertainty."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from estimation.compatibility.air_data import AirData

EXAMPLE = "Example: sideslip reconstruct log.mcap -o flight.mcap && sideslip estimate flight.mcap --model lateral"


@click.command(epilog=EXAMPLE)
@click.argument("flight", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True, help="Flight to write: .mcap, .csv or .parquet."
)
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write wind and uncertainties as JSON.")
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
def reconstruct(
    flight: Path, output: Path, json_path: Path | None, trim_sideslip: float, attitude_error: float
) -> None:
    """Add airspeed, angle of attack, sideslip and wind to a FLIGHT without vanes, from GNSS velocity, IMU and pitot."""
    from estimation.commands.outputs import check_outputs, write_json
    from estimation.compatibility.air_data import reconstruct_air, sentence, with_air
    from estimation.compatibility.air_filter import Assumptions
    from groundstation.flight import RECONSTRUCTED, read_flight, write_flight

    check_outputs(json=json_path, output=output)
    assumed = Assumptions(trim_sideslip=math.radians(trim_sideslip), attitude=math.radians(attitude_error))
    read = read_flight(flight)
    air = reconstruct_air(read, assumed)
    made = with_air(read, air)
    write_flight(made, output)
    click.echo(f"{output}: {sentence(air)}")
    for line in wind_lines(air):
        click.echo(line)
    for note in air.notes:
        click.echo(f"  note: {note}")
    kept = [n for n in ("alpha", "beta") if read.measured(n)]
    if kept:
        click.echo(f"  note: {' and '.join(kept)} measured by a vane: kept as measured")
    if json_path is not None:
        write_json(as_json(output, air, made.provenance.detail[RECONSTRUCTED]["columns"]), json_path)


def wind_lines(air: "AirData") -> list[str]:
    """Mean wind as a person says it."""
    north, east = air.wind[:2]
    speed, from_deg = math.hypot(north, east), math.degrees(math.atan2(-east, -north)) % 360.0
    std = float(max(air.wind_std[:2]))
    return [
        f"  wind {speed:.1f} m/s from {from_deg:.0f} deg (+- {std:.1f} m/s), gusts {air.gust:.2g} m/s; "
        f"airspeed from {air.airspeed}"
    ]


def as_json(output: Path, air: "AirData", columns: list[str]) -> dict[str, object]:
    """What was reconstructed and how sure, SI and radians."""
    return {
        "version": 1,
        "flight": str(output),
        "columns": columns,
        "airspeed_from": air.airspeed,
        "std": {n: air.typical(n) for n in air.std},
        "wind": {"ned": air.wind.tolist(), "std": air.wind_std.tolist(), "gust": air.gust},
        "scatter": dict(air.scatter),
        "notes": list(air.notes),
    }
