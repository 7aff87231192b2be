"""Command line of the data side: `sideslip calibrate`, `bench` and `import`."""

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daq.contract import outputs
from daq.contract.durable import write_text
from daq.contract.errors import UserError
from daq.contract.options import aircraft_option, json_option
from daq.contract.outputs import tried_file, tried_folder

if TYPE_CHECKING:
    from groundstation.cli.services import Services
    from groundstation.flight import Flight


_JSON = json_option("Write the same as JSON.", "report")


def write_json(report: Path | None, content: Any) -> None:
    """Write what was asked for as JSON; None: not asked for."""
    if report is not None:
        outputs.write_json(content, report)


def _say(flight: "Flight", output: Path, report: Path | None) -> None:
    for line in written_lines(flight, str(output)):
        click.echo(line)
    write_json(report, written_content(flight, str(output)))


def written_lines(flight: "Flight", output: str) -> Iterator[str]:
    """What a person reads of a flight that was made: how much, and what to know of it."""
    from groundstation.flight.contradictions import contradictions

    rate = 1 / flight.sample_interval
    channels = flight.channels
    measured = sum(
        flight.measured(c) and channels.get(c, {}).get("kind", "measured") == "measured" for c in flight.known_columns
    )
    yield (
        f"{output}: {len(flight)} samples, {flight.time[-1] - flight.time[0]:.1f} s at {rate:.1f} Hz, "
        f"{len(flight.segments)} segment{'s' if len(flight.segments) > 1 else ''}, {measured} columns measured"
    )
    yield from (f"  note: {note}" for note in flight.notes)
    for one in contradictions(flight):
        yield f"  contradiction: {one.text}{f' (moves {one.moves})' if one.moves else ''}"


def written_content(flight: "Flight", output: str) -> dict[str, Any]:
    """The same as `calibrate --json` and `import --json` have it."""
    from groundstation.flight.contradictions import contradictions

    return {
        "flight": output,
        "samples": len(flight),
        "duration_s": float(flight.time[-1] - flight.time[0]),
        "rate_hz": 1 / flight.sample_interval,
        "segments": len(flight.segments),
        "columns": [c for c in flight.columns if flight.measured(c)],
        "notes": [note.text for note in flight.notes],
        "channels": flight.channels,
        "contradictions": [one.to_json() for one in contradictions(flight)],
        "provenance": {
            "source": flight.provenance.source,
            "sha256": flight.provenance.sha256,
            **flight.provenance.detail,
        },
    }


def _write(flight: "Flight", output: Path, split: bool, report: Path | None) -> None:
    """Write the flight and say so; with `split`, each stretch without gap to a file of its own, OUTPUT_1, OUTPUT_2, ..."""
    from groundstation.flight import write_flight

    if not split or len(flight.segments) < 2:
        write_flight(flight, output)
        _say(flight, output, report)
        return
    for number, rows in enumerate(flight.segments, start=1):
        target = output.with_stem(f"{output.stem}_{number}")
        if rows.stop - rows.start < 2:
            click.echo(f"{target}: not written: a single sample between two gaps")
            continue
        part = flight.part(rows, f"{flight.name}_{number}")
        write_flight(part, target)
        _say(part, target, report and report.with_stem(f"{report.stem}_{number}"))


_OUTPUT_HELP = "Flight to write: .mcap, .csv or .parquet."
_OUTPUT = click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    callback=tried_file,
    help=_OUTPUT_HELP,
)
_SPLIT = click.option("--split", is_flag=True, help="Write each stretch without a gap in time to a file of its own.")


@click.command()
@click.argument("raw", type=click.Path(path_type=Path))
@_OUTPUT
@click.option(
    "--calibration",
    type=click.Path(path_type=Path),
    help="Directory of calibration files, or 'cdfp'; instead of the embedded set.",
)
@click.option(
    "--align/--no-align",
    default=None,
    help="Bring all sensors to one time base [default: where scans have neighbours].",
)
@click.option("--salvage", is_flag=True, help="Use what is intact of a damaged recording.")
@_SPLIT
@_JSON
def calibrate(
    raw: Path,
    output: Path,
    calibration: Path | None,
    align: bool | None,
    salvage: bool,
    split: bool,
    report: Path | None,
) -> None:
    """Turn the counts of a raw recording RAW into a flight in SI units.

    RAW is a recording or the directory of its segments. Doing it again gives the same bits.

    Example: sideslip calibrate recordings/nominal -o nominal.mcap
    """
    from groundstation.calibration.recording import calibrate_recording
    from groundstation.importers.endings import FOREIGN

    if raw.suffix.lower() in FOREIGN and raw.is_file():
        raise UserError(
            f"{raw}: not a raw recording of counts; a log of another program becomes a flight with 'sideslip import'"
        )
    _write(calibrate_recording(raw, calibration, align=align, salvage=salvage), output, split, report)


@click.command("import")
@click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="DATA...")
@click.option("-o", "--output", type=click.Path(path_type=Path), callback=tried_file, help=_OUTPUT_HELP)
@click.option(
    "--map",
    "mapping",
    type=click.Path(path_type=Path),
    help="Mapping file: columns, units, signs, time; or the name of an example, such as ardupilot-elevon.",
)
@aircraft_option("Built-in aircraft or an AIRCRAFT.toml that the flight is of and carries", "")
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
@_SPLIT
@_JSON
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
    """Turn somebody else's DATA into a flight: CSV, Parquet, MATLAB, PX4 ULog, ArduPilot .bin or MAVLink .tlog.

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
            said = f"a CSV cannot carry its aircraft: give --aircraft {aircraft} to each verb, or import to .mcap or .parquet"
            flight = flight.with_notes(said)
    _write(flight, output, split, report)


def _write_draft(data: tuple[Path, ...], output: Path) -> None:
    """Write a drafted mapping and say what in it is not known."""
    from daq.contract.durable import write_text
    from groundstation.importers.draft import draft_map

    text = draft_map(data)
    write_text(output, text)
    unknown = [line for line in text.splitlines() if "UNKNOWN" in line or "CHECK" in line][1:]
    click.echo(f"{output}: a drafted mapping; {len(unknown)} lines in it need a person (UNKNOWN, CHECK)")


def _advise(
    services: "Services", data: tuple[Path, ...], mapping: Path | None, rate: float | None, report: Path | None
) -> None:
    """Print what can be done with a log, and its servo outputs; report: a JSON to write."""
    from groundstation.importers.about import servo_outputs
    from groundstation.importers.run import import_data

    flight = import_data(data, mapping, rate_hz=rate, accept_implausible=True)
    found = services.recipe(flight)
    for line in found.lines():
        click.echo(line)
    outputs = [o for path in data for o in servo_outputs(path)]
    for output in outputs:
        click.echo(f"servo output {output.line()}")
    if outputs and not any(flight.measured(c) for c in ("delta_e", "delta_a", "delta_r")):
        click.echo(
            "which surface each servo moves, with trim and travel, goes into a mapping: see the example maps in docs/import.md"
        )
    stated = ({ending.lower(): value for ending, value in o.parameters.items()} for o in outputs)
    servos = [
        {"name": o.name, "low": o.low, "high": o.high, "usual": o.median, **more}
        for o, more in zip(outputs, stated, strict=True)
    ]
    write_json(report, {**found.to_json(), "servo_outputs": servos})


@click.command()
@click.argument("raw", type=click.Path(path_type=Path))
@click.option("--plan", type=click.Path(path_type=Path), required=True, help="Bench plan: what was set, and when.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    callback=tried_folder,
    help="Directory for the calibration files.",
)
@click.option(
    "--calibration", type=click.Path(path_type=Path), help="Set to refine, or 'cdfp'; instead of the embedded one."
)
@click.option("--date", "day", type=click.DateTime(["%Y-%m-%d"]), help="Date, where the recording carries none.")
@_JSON
def bench(
    raw: Path, plan: Path, output: Path, calibration: Path | None, day: datetime | None, report: Path | None
) -> None:
    """Fit calibration files from the bench recording RAW and write them, with the rest of the set, to a directory.

    Example: sideslip bench bench/vanes --plan bench/vanes.toml -o calibration/
    """
    from daq.contract.recordings.reading import read_recording
    from groundstation.calibration.bench_work.bench import fit_bench, fitted_set
    from groundstation.calibration.bench_work.plan import load_plan
    from groundstation.calibration.recording import embedded_calibration
    from groundstation.calibration.schema import load_calibration

    chosen = load_plan(plan)
    base = load_calibration(calibration) if calibration else embedded_calibration(read_recording(raw))
    fits = fit_bench(raw, chosen, base, today=day.date() if day else None)
    output.mkdir(parents=True, exist_ok=True)
    for name, text in fitted_set(base, fits).texts.items():
        write_text(output / name, text)
    for fit in fits:
        click.echo(fit.text)
    click.echo(f"{output}: {len(fits)} of {len(base.instruments)} calibration files fitted, the others taken over")
    write_json(
        report,
        [
            {"text": fit.text, **fit.instrument.model_dump(mode="json", exclude_none=True, exclude_defaults=True)}
            for fit in fits
        ],
    )
