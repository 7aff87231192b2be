"""The verb `analyse`: from logs to one page; stages are stored, so that a rerun repeats only what has changed."""

from pathlib import Path

import click

from daq.utilities.options import aircraft_option, flights_argument, json_option, path_option
from daq.utilities.outputs import tried_folder

EXAMPLE = "Example: sideslip analyse log.bin --map surfaces.toml --aircraft plane.toml -o analysis"
_PATH = click.Path(path_type=Path)


@click.command(epilog=EXAMPLE)
@flights_argument("logs", "LOG...")
@aircraft_option("Built-in aircraft or an AIRCRAFT.toml; without one: what the logs alone allow", "")
@path_option("--map", "mapping", text="Mapping file, as of 'sideslip import'.")
@path_option("--holdout", text="A log used in no fit; may be repeated.", multiple=True, metavar="LOG")
@json_option()
@path_option(
    "-o", "--output", "--out", text="Folder for index.html, answer.json and stages.", tried=tried_folder, required=True
)
def analyse(
    logs: tuple[Path, ...],
    aircraft: str | None,
    mapping: Path | None,
    holdout: tuple[Path, ...],
    output: Path,
    json_path: Path | None,
) -> int:
    """From LOGs to an answer: import, contradictions, stretches, air data, the richest model, estimate, gap and one page."""
    from sideslip import analysis
    from sideslip.verbs.delivery import Progress, deliver

    with Progress("analysing") as progress:
        answer = analysis.analyse(logs, aircraft, mapping, holdout, output, progress)
    stages = f"done in this run: {', '.join(answer.repeated)}" if answer.repeated else "nothing had changed"
    return deliver(answer, json_path, written=[f"page: {output / 'index.html'} ({stages})"])
