"""The verb `analyse`: from logs to one page, each stage kept so that a rerun does what has changed and no more."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daq.contract.options import aircraft_option
from daq.contract.outputs import tried_folder

if TYPE_CHECKING:
    from estimation.analysis.outcome import Analysis
    from estimation.analysis.stages import Stages
    from groundstation.flight import Flight

EXAMPLE = "Example: sideslip analyse log.bin --map surfaces.toml --aircraft plane.toml -o analysis"
_PATH = click.Path(path_type=Path)
READY = (".mcap",)
"""Endings of files that are flights as they stand, or bags of another program."""


@click.command(epilog=EXAMPLE)
@click.argument("logs", nargs=-1, required=True, type=_PATH, metavar="LOG...")
@aircraft_option("Built-in aircraft or an AIRCRAFT.toml; without one: what can be said all the same", "")
@click.option("--map", "mapping", type=_PATH, help="Mapping file, as of 'sideslip import'.")
@click.option(
    "--holdout", multiple=True, type=_PATH, metavar="LOG", help="A log kept out of every fit; may be repeated."
)
@click.option(
    "-o",
    "--output",
    type=_PATH,
    required=True,
    callback=tried_folder,
    help="Folder for index.html, answer.json and stages.",
)
def analyse(
    logs: tuple[Path, ...], aircraft: str | None, mapping: Path | None, holdout: tuple[Path, ...], output: Path
) -> int:
    """From LOGs to an answer: import, contradictions, stretches, air data, the richest model, estimate, gap and one page."""
    from estimation.commands.progress import Progress

    with Progress("analysing") as progress:
        answer = analysis(logs, aircraft, mapping, holdout, output, progress)
    for line in answer.lines():
        click.echo(line)
    done = ", ".join(answer.repeated)
    click.echo(
        f"page: {output / 'index.html'}" + (f" (done in this run: {done})" if done else " (nothing had changed)")
    )
    return 0 if answer.passed else 1


def analysis(
    logs: Sequence[str | Path],
    aircraft: str | None = None,
    mapping: Path | None = None,
    holdout: Sequence[str | Path] = (),
    output: Path = Path("analysis"),
    progress: Callable[[str, float], None] | None = None,
) -> "Analysis":
    """What the verb does; writes the folder `output`."""
    from estimation.analysis.run import Given, analyse_flights
    from estimation.analysis.stages import Stages, digest
    from estimation.report.markup.html import software
    from estimation.session.flights import unique_names

    tell = progress or (lambda what, share: None)
    stages = Stages(output, software())
    extra = [_content(mapping), aircraft, _content(Path(aircraft)) if aircraft and aircraft.endswith(".toml") else ""]
    imported = []
    for number, path in enumerate([*logs, *holdout]):
        tell(f"importing {Path(path).name}", 0.14 * number / (len(logs) + len(holdout)))
        imported.append(_imported(number, Path(path), mapping, aircraft, extra, stages))
    flights = unique_names([flight for flight, _, _ in imported])
    key = digest([k for _, k, _ in imported])
    given = Given(tuple(flights[: len(logs)]), tuple(flights[len(logs) :]), key, any(r for _, _, r in imported))
    return analyse_flights(given, aircraft, digest(extra[1:]), stages, tell)


def _content(path: Path | None) -> str:
    """What a small file says, for the key of a stage; its name where it is none (a built-in's)."""
    return path.read_bytes().decode("latin-1") if path is not None and path.is_file() else str(path)


def _imported(
    number: int, path: Path, mapping: Path | None, aircraft: str | None, extra: Sequence[str | None], stages: "Stages"
) -> "tuple[Flight, str, bool]":
    """The flight of a log, the key of its stage and whether it was imported in this run."""
    import hashlib
    from dataclasses import replace

    from daq.contract.input_files import check_file
    from groundstation.flight import read_flight, write_flight
    from groundstation.importers.errors import ImportDataError

    check_file(path, error=ImportDataError)
    target = stages.path(f"import_{number}.mcap")

    def work() -> dict[str, object]:
        flight = _read(path, mapping, aircraft)
        target.parent.mkdir(parents=True, exist_ok=True)
        write_flight(flight, target)
        return {"name": flight.name, "path": flight.provenance.path, "sha256": flight.provenance.sha256}

    with path.open("rb") as opened:
        sha = hashlib.file_digest(opened, "sha256").hexdigest()
    stage = stages.run(f"import_{number}", [sha, path.name, *extra], work, target)
    flight = read_flight(target)
    provenance = replace(flight.provenance, path=str(path), sha256=sha)
    return replace(flight, name=str(stage.content["name"]), provenance=provenance), stage.key, stage.repeated


def _read(path: Path, mapping: Path | None, aircraft: str | None) -> "Flight":
    """A flight as it stands, a raw recording calibrated, or somebody else's log imported."""
    from groundstation.importers.aircraft import with_aircraft
    from groundstation.importers.run import import_data

    if path.suffix.lower() in READY and mapping is None:
        from groundstation.export.run import open_flight

        flight = open_flight(path)
    else:
        flight = import_data(path, mapping)
    return flight if aircraft is None else with_aircraft(flight, aircraft)
