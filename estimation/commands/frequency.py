"""`sideslip frequency`: the response of an output to a control over frequency, with its error, a fit, and what that says."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from estimation.frequency.handling import Craft
    from groundstation.flight import Flight

EXAMPLE = "Example: sideslip frequency sweep.mcap --input delta_a --output p --fit -o roll.png"


@click.command(epilog=EXAMPLE)
@click.argument("flights", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FLIGHT...")
@click.option("--input", "control", required=True, help="Column that was moved: delta_e, delta_a, delta_r, cmd_a ...")
@click.option("--output", required=True, help="Column that answers: p, q, r, beta, ay ...")
@click.option(
    "--with",
    "beside",
    help="Comma-separated inputs whose share is taken off; none for none  [default: all other surfaces that moved].",
)
@click.option("--fit", "fitted", is_flag=True, help="Fit a transfer function with delay, and tell what it says.")
@click.option(
    "--form",
    help="Fit this form: roll, dutch-roll, short-period, or orders like 1/2  "
    "[default of --fit: what fits input and output].",
)
@click.option("--band", help="Frequencies from,to [Hz]  [default: what windows and samples allow].")
@click.option("--points", default=60, show_default=True, help="Frequencies, evenly in their logarithm.")
@click.option("--windows", help="Comma-separated window lengths [s]  [default: five of them].")
@click.option("--segments", help="Use only these stretches: 2:12,15:25 [s].")
@click.option("--class", "kind", default="", help="Class of a piloted aircraft for levels: I, II, III or IV.")
@click.option("--category", default="B", show_default=True, help="Category of the flight phase for levels: A, B or C.")
@click.option(
    "--aircraft", help="Whose mass decides whether levels apply  [default: the one the flights carry or name]."
)
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write everything as JSON.")
@click.option("--report", "report_folder", type=click.Path(path_type=Path), help="Write an HTML page with tables.")
@click.option(
    "-o", "--figure", "figure_path", type=click.Path(path_type=Path), help="Write the Bode figure (.png .svg .pdf)."
)
def frequency(
    flights: tuple[Path, ...],
    control: str,
    output: str,
    beside: str | None,
    fitted: bool,
    form: str | None,
    band: str | None,
    points: int,
    windows: str | None,
    segments: str | None,
    kind: str,
    category: str,
    aircraft: str | None,
    json_path: Path | None,
    report_folder: Path | None,
    figure_path: Path | None,
) -> int:
    """Frequency response of --output to --input over one FLIGHT or several (.mcap, .csv or .parquet)."""
    from estimation.commands.outputs import check_outputs, write_json
    from estimation.frequency.answer import answer, lines
    from estimation.frequency.forms import form_for
    from estimation.frequency.handling import Craft
    from estimation.frequency.response import ResponseOptions, frequency_response
    from estimation.session.flights import select_segments, unique_names
    from groundstation.flight import read_flight

    check_outputs(json=json_path, figure=figure_path, report=report_folder)
    wanted = form or ("auto" if fitted else None)
    if wanted is not None:
        form_for(control, output, wanted)  # what is mistyped is said before a flight is read
    asked = Craft(kind, category)
    options = ResponseOptions(_names(beside), _two(band), points, _numbers("--windows", windows) or ())
    read = unique_names([select_segments(read_flight(path), segments) for path in flights])
    found = answer(frequency_response(read, control, output, options), wanted, _craft(asked, read, aircraft))
    if json_path is not None:
        write_json(found.to_json(), json_path)
    written = []
    if figure_path is not None:
        from estimation.frequency.figure import write_figure

        write_figure(found.response, found.fit, figure_path)
        written.append(f"figure: {figure_path}")
    if report_folder is not None:
        from estimation.frequency.page import write_frequency_report

        written.append(f"report: {write_frequency_report(found, read, report_folder)}")
    for line in (*lines(found), *written):
        click.echo(line)
    return 0


def _craft(asked: "Craft", flights: "Sequence[Flight]", aircraft: str | None) -> "Craft":
    """What is asked for, with the mass of the aircraft where it is known."""
    from dataclasses import replace

    from estimation.aircraft.of_flight import aircraft_of
    from estimation.errors import AircraftError

    try:
        return replace(asked, mass=aircraft_of(flights, aircraft).mass)
    except AircraftError:
        if aircraft is not None:
            raise
        return asked  # the response needs no aircraft


def _names(text: str | None) -> tuple[str, ...] | None:
    if text is None:
        return None
    return tuple(dict.fromkeys(n.strip() for n in text.split(",") if n.strip() and n.strip() != "none"))


def _two(text: str | None) -> tuple[float, float] | None:
    from estimation.errors import EstimationError

    numbers = _numbers("--band", text)
    if numbers is None:
        return None
    if len(numbers) != 2:
        raise EstimationError(f"--band {text}: give two frequencies in Hz, like 0.1,3")
    return numbers[0], numbers[1]


def _numbers(option: str, text: str | None) -> tuple[float, ...] | None:
    from estimation.errors import EstimationError

    if text is None:
        return None
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if not numbers or not all(math.isfinite(n) for n in numbers):
        raise EstimationError(f"{option} {text}: give numbers with commas between them")
    return numbers
