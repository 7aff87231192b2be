"""`sideslip watch`: the gap monitor over a flight, when did the model stop describing the aircraft."""

from pathlib import Path

import click

EXAMPLE = "Example: sideslip watch flight.mcap --model ld4.toml --json watch.json"


@click.command(epilog=EXAMPLE)
@click.argument("flight", type=click.Path(path_type=Path), metavar="FLIGHT")
@click.option(
    "--model", default="lateral", show_default=True, help="Model of the lateral derivatives: name or MODEL.toml."
)
@click.option(
    "--aircraft", help="Built-in aircraft or an AIRCRAFT.toml  [default: the one the flight carries or names]."
)
@click.option("--segments", help="Use only these stretches: 2:12,15:25 [s].")
@click.option(
    "--rate",
    default=1.0,
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
@click.option("--seed", default=1, show_default=True, help="Of every random draw: same seed, same answer.")
@click.option(
    "--stretch", "stretch_path", type=click.Path(path_type=Path), help="Write the flight about its first alarm (.mcap)."
)
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write the answer as JSON.")
@click.option("--report", "report_folder", type=click.Path(path_type=Path), help="Write an HTML page.")
def watch(
    flight: Path,
    model: str,
    aircraft: str | None,
    segments: str | None,
    rate: float,
    hours: float,
    seed: int,
    stretch_path: Path | None,
    json_path: Path | None,
    report_folder: Path | None,
) -> int:
    """Watch FLIGHT with a model: alarms where its short predictions go wrong; exit status 1 when there was one."""
    from daq.contract.outputs import check_file
    from estimation.aircraft.of_flight import aircraft_of
    from estimation.commands.outputs import check_outputs, write_json
    from estimation.models.load import check_model, load_model
    from estimation.session.flights import select_segments
    from estimation.watch import answer, over_file
    from groundstation.flight import read_flight, write_flight

    check_outputs(json=json_path, report=report_folder)
    check_file("--stretch", stretch_path)
    check_model(model)
    read = select_segments(read_flight(flight), segments)
    craft = aircraft_of([read], aircraft)
    found = over_file.watch(load_model(model, craft), read, craft, seed=seed, hours=hours, rate=rate)
    for line in answer.lines(found):
        click.echo(line)
    if found.alarms and stretch_path is not None:
        write_flight(answer.stretch(found), stretch_path)
    command = answer.gap_command(stretch_path or flight, model, aircraft)
    if found.alarms:
        click.echo(f"next: {command}")
    if json_path is not None:
        write_json({**found.to_json(), "next": command if found.alarms else None}, json_path)
    if report_folder is not None:
        click.echo(f"report: {answer.write_watch_report(found, report_folder, command)}")
    return 1 if found.alarms else 0
