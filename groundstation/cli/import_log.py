"""Command line of `sideslip import`."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from daq.utilities.durable import write_text
from daq.utilities.options import aircraft_option
from daq.utilities.outputs import tried_file
from groundstation.cli.data import JSON_OPTION, OUTPUT_HELP, SPLIT_OPTION, write_and_report, write_json

if TYPE_CHECKING:
    from groundstation.cli.services import Services


@click.command("import")
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="DATA...")
@click.option("-o", "--output", "--out", type=click.Path(path_type=Path), callback=tried_file, help=OUTPUT_HELP)
@click.option(
    "--map",
    "mapping",
    type=click.Path(path_type=Path),
    help="Mapping file: columns, units, signs, time; or the name of an example, such as ardupilot-elevon.",
)
@aircraft_option("Built-in aircraft or an AIRCRAFT.toml that goes into the flight", "")
@click.option("--rate", type=click.FloatRange(min=0, min_open=True, max=1000), help="Resample to so many Hz.")
@click.option("--accept-implausible", is_flag=True, help="Import values that look like another unit, with a note.")
@click.option(
    "--recipe",
    "advised",
    is_flag=True,
    help="Write no flight: say which models and methods the log is good for, and what one more sensor would add.",
)
@click.option(
    "--draft-map",
    "drafted",
    is_flag=True,
    help="Write no flight, but a mapping file to OUTPUT: columns, units, signs and servos proposed, each with its evidence.",
)
@SPLIT_OPTION
@JSON_OPTION
@click.pass_obj
def import_(
    services: "Services | None",
    data: tuple[Path, ...],
    output: Path | None,
    mapping: Path | None,
    aircraft: str | None,
    rate: float | None,
    accept_implausible: bool,
    advised: bool,
    drafted: bool,
    split: bool,
    report: Path | None,
) -> None:
    """Turn DATA of another program into a flight: CSV, Parquet, MATLAB, PX4 ULog, ArduPilot .bin or MAVLink .tlog.

    Several files are records in a row, and become segments of one flight.

    Example: sideslip import log.csv --map log_map.toml -o flight.mcap
    """
    from groundstation.importers.run import import_data

    if advised and output is not None:
        raise click.UsageError("--recipe writes no flight: leave out one of --recipe and -o")
    if advised:
        assert services is not None  # the command line has them
        _advise(services, data, mapping, rate, report)
        return
    if drafted:
        if output is None or output.suffix.lower() != ".toml":
            raise click.UsageError("--draft-map writes a mapping: give -o MAP.toml, and no --recipe")
        _write_draft(data, output)
        return
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output'")
    flight = import_data(data, mapping, rate_hz=rate, accept_implausible=accept_implausible)
    if aircraft is not None:
        from groundstation.importers.records import with_aircraft

        flight = with_aircraft(flight, aircraft)
        if output.suffix.lower() == ".csv":
            note = f"a CSV cannot carry its aircraft: give --aircraft {aircraft} to each verb, or import to .mcap or .parquet"
            flight = flight.with_notes(note)
    write_and_report(flight, output, split, report)


def _write_draft(data: tuple[Path, ...], output: Path) -> None:
    """Write a drafted mapping and print how many of its lines a person has to complete or check."""
    from groundstation.importers.draft import draft_map

    text = draft_map(data)
    write_text(output, text)
    unknown = [line for line in text.splitlines() if "UNKNOWN" in line or "CHECK" in line][1:]
    click.echo(f"{output}: a drafted mapping; {len(unknown)} lines in it need a person (UNKNOWN, CHECK)")


def _advise(
    services: "Services", data: tuple[Path, ...], mapping: Path | None, rate: float | None, report: Path | None
) -> None:
    """Print which models and methods a log is good for, and its servo outputs. report: the same as JSON."""
    from groundstation.importers.about import servo_outputs
    from groundstation.importers.run import import_data

    flight = import_data(data, mapping, rate_hz=rate, accept_implausible=True)
    advice = services.recipe(flight)
    for line in advice.lines():
        click.echo(line)
    outputs = [o for path in data for o in servo_outputs(path)]
    for output in outputs:
        click.echo(f"servo output {output.line()}")
    if outputs and not any(flight.measured(c) for c in ("delta_e", "delta_a", "delta_r")):
        click.echo(
            "which surface each servo moves, with trim and travel, goes into a mapping: see the example maps in docs/import.md"
        )
    parameters = ({ending.lower(): value for ending, value in o.parameters.items()} for o in outputs)
    servos = [
        {"name": o.name, "low": o.low, "high": o.high, "usual": o.median, **stated_parameters}
        for o, stated_parameters in zip(outputs, parameters, strict=True)
    ]
    write_json(report, {**advice.to_json(), "servo_outputs": servos})
