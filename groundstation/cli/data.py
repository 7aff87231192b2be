"""Command line of the data side: `sideslip calibrate` and `bench`, and what `import` shares with them."""

from collections.abc import Iterator
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daq.utilities import outputs
from daq.utilities.durable import write_text
from daq.utilities.errors import UserError
from daq.utilities.options import json_option, path_option
from daq.utilities.outputs import tried_file, tried_folder

if TYPE_CHECKING:
    from groundstation.flight import Flight

JSON_OPTION = json_option(name="report")


def write_json(report: Path | None, content: Any) -> None:
    """Write `content` as JSON to the file `report`, if there is one."""
    if report is not None:
        outputs.write_json(content, report)


def _print_flight(flight: "Flight", output: Path, report: Path | None) -> None:
    for line in written_lines(flight, str(output)):
        click.echo(line)
    write_json(report, written_content(flight, str(output)))


def written_lines(flight: "Flight", output: str) -> Iterator[str]:
    """Lines for a person on a flight that was made: its size, notes and contradictions."""
    from groundstation.flight.contradictions import contradictions

    rate = 1 / flight.sample_interval
    kinds = [flight.channels.get(c, {}).get("kind", "measured") for c in flight.known_columns if flight.measured(c)]
    counted = f"{kinds.count('measured')} columns measured"
    if computed := kinds.count("computed"):
        counted += f", {computed} computed"
    yield (
        f"{output}: {len(flight)} samples, {flight.time[-1] - flight.time[0]:.1f} s at {rate:.1f} Hz, "
        f"{len(flight.segments)} segment{'s' if len(flight.segments) > 1 else ''}, {counted}"
    )
    yield from (f"  note: {note}" for note in flight.notes)
    for contradiction in contradictions(flight):
        yield f"  contradiction: {contradiction.text}{f' (moves {contradiction.moves})' if contradiction.moves else ''}"


def written_content(flight: "Flight", output: str) -> dict[str, Any]:
    """The same for `calibrate --json` and `import --json`."""
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
        "contradictions": [contradiction.to_json() for contradiction in contradictions(flight)],
        "provenance": {
            "source": flight.provenance.source,
            "sha256": flight.provenance.sha256,
            **flight.provenance.detail,
        },
    }


def write_and_report(flight: "Flight", output: Path, split: bool, report: Path | None) -> None:
    """Write the flight and report it; with `split`, each stretch without a gap to a file of its own, OUTPUT_1, OUTPUT_2, ..."""
    from groundstation.flight import write_flight

    if not split or len(flight.segments) < 2:
        write_flight(flight, output)
        _print_flight(flight, output, report)
        return
    for number, rows in enumerate(flight.segments, start=1):
        target = output.with_stem(f"{output.stem}_{number}")
        if rows.stop - rows.start < 2:
            click.echo(f"{target}: not written: a single sample between two gaps")
            continue
        part = flight.part(rows, f"{flight.name}_{number}")
        write_flight(part, target)
        _print_flight(part, target, report and report.with_stem(f"{report.stem}_{number}"))


OUTPUT_HELP = "Flight to write: .mcap, .csv or .parquet."
_OUTPUT = click.option(
    "-o",
    "--output",
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    callback=tried_file,
    help=OUTPUT_HELP,
)
SPLIT_OPTION = click.option(
    "--split", is_flag=True, help="Write each stretch without a gap in time to a file of its own."
)


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
@SPLIT_OPTION
@JSON_OPTION
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
    write_and_report(calibrate_recording(raw, calibration, align=align, salvage=salvage), output, split, report)


@click.command()
@click.argument("raw", type=click.Path(path_type=Path))
@click.option("--plan", type=click.Path(path_type=Path), required=True, help="Bench plan: what was set, and when.")
@path_option("-o", "--output", "--out", text="Directory for the calibration files.", tried=tried_folder, required=True)
@click.option(
    "--calibration", type=click.Path(path_type=Path), help="Set to refine, or 'cdfp'; instead of the embedded one."
)
@click.option("--date", "day", type=click.DateTime(["%Y-%m-%d"]), help="Date, where the recording carries none.")
@JSON_OPTION
def bench(
    raw: Path, plan: Path, output: Path, calibration: Path | None, day: datetime | None, report: Path | None
) -> None:
    """Fit calibration files from the bench recording RAW and write them, with the rest of the set, to a directory.

    Example: sideslip bench bench/vanes --plan bench/vanes.toml -o calibration/
    """
    content, sentences = fit_and_write(raw, plan, output, calibration, day.date() if day else None)
    for sentence in sentences:
        click.echo(sentence)
    write_json(report, content)


def fit_and_write(
    raw: Path, plan: Path, output: Path, calibration: Path | None, day: date | None
) -> tuple[list[dict[str, Any]], tuple[str, ...]]:
    """Write the fitted set to the folder `output`; gives the content of --json and the lines to print."""
    from daq.contract.recordings.reading import read_recording
    from groundstation.calibration.bench import fit_bench, fitted_set
    from groundstation.calibration.bench_plan import load_plan
    from groundstation.calibration.calibration_set import load_calibration
    from groundstation.calibration.recording import embedded_calibration

    bench_plan = load_plan(plan)
    base = load_calibration(calibration) if calibration else embedded_calibration(read_recording(raw))
    fits = fit_bench(raw, bench_plan, base, today=day)
    output.mkdir(parents=True, exist_ok=True)
    for name, text in fitted_set(base, fits).texts.items():
        write_text(output / name, text)
    content = [
        {"text": fit.text, **fit.instrument.model_dump(mode="json", exclude_none=True, exclude_defaults=True)}
        for fit in fits
    ]
    counts = f"{output}: {len(fits)} of {len(base.instruments)} calibration files fitted, the others taken over"
    return content, (*(fit.text for fit in fits), counts)
