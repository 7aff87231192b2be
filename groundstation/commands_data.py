"""Command line of the data side: `sideslip calibrate`, `bench` and `import`."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from groundstation.flight import Flight


def _say(flight: "Flight", output: Path) -> None:
    rate = 1 / flight.sample_interval
    measured = sum(flight.measured(c) for c in flight.columns)
    click.echo(
        f"{output}: {len(flight)} samples, {flight.time[-1] - flight.time[0]:.1f} s at {rate:.1f} Hz, "
        f"{len(flight.segments)} segment{'s' if len(flight.segments) > 1 else ''}, {measured} columns measured"
    )
    for note in flight.notes:
        click.echo(f"  note: {note}")


@click.command()
@click.argument("raw", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True, help="Flight to write: .mcap, .csv or .parquet."
)
@click.option(
    "--calibration",
    type=click.Path(path_type=Path),
    help="Directory of calibration files, or 'cdfp'; instead of the embedded set.",
)
@click.option("--align/--no-align", default=None, help="Bring all sensors to one time base [default: when complete].")
@click.option("--salvage", is_flag=True, help="Use what is intact of a damaged recording.")
def calibrate(raw: Path, output: Path, calibration: Path | None, align: bool | None, salvage: bool) -> None:
    """Turn the counts of a raw recording RAW into a flight in SI units.

    RAW is a recording or the directory of its segments. Doing it again gives the same bits.

    Example: sideslip calibrate recordings/nominal -o nominal.mcap
    """
    from groundstation.calibration.recording import calibrate_recording
    from groundstation.flight import write_flight

    flight = calibrate_recording(raw, calibration, align=align, salvage=salvage)
    write_flight(flight, output)
    _say(flight, output)


@click.command("import")
@click.argument("data", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True, help="Flight to write: .mcap, .csv or .parquet."
)
@click.option("--map", "mapping", type=click.Path(path_type=Path), help="Mapping file: columns, units, signs, time.")
@click.option("--rate", type=click.FloatRange(min=0, min_open=True, max=1000), help="Resample to so many Hz.")
@click.option("--accept-implausible", is_flag=True, help="Import values that look like another unit, with a note.")
def import_(data: Path, output: Path, mapping: Path | None, rate: float | None, accept_implausible: bool) -> None:
    """Turn somebody else's DATA into a flight: CSV, Parquet, PX4 ULog, ArduPilot .bin or MAVLink .tlog.

    Example: sideslip import log.csv --map log_map.toml -o flight.mcap
    """
    from groundstation.flight import write_flight
    from groundstation.importers.run import import_data

    flight = import_data(data, mapping, rate_hz=rate, accept_implausible=accept_implausible)
    write_flight(flight, output)
    _say(flight, output)
