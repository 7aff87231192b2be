"""`sideslip frequency`: the response of an output to a control over frequency, with its error, a fit, and handling qualities."""

import math
from pathlib import Path
from typing import Any

import click

from daq.utilities.options import (
    aircraft_option,
    figure_option,
    flag_option,
    flights_argument,
    json_option,
    report_option,
    segments_option,
)

EXAMPLE = "Example: sideslip frequency sweep.mcap --input delta_a --output p --fit -o roll.png"


@click.command(epilog=EXAMPLE)
@flights_argument()
@click.option("--input", "control", required=True, help="Column that was moved: delta_e, delta_a, delta_r, cmd_a ...")
@click.option("--output", required=True, help="Column that answers: p, q, r, beta, ay ...")
@click.option(
    "--with",
    "with_",
    help="Comma-separated inputs whose share is removed; none: remove nothing  [default: all other surfaces that moved].",
)
@flag_option("--fit", text="Fit a transfer function with delay, and print what it means.")
@click.option(
    "--form",
    help="Fit this form: roll, dutch-roll, short-period, or orders like 1/2  "
    "[default of --fit: what fits input and output].",
)
@click.option("--band", help="Frequencies from,to [Hz]  [default: what windows and samples allow].")
@click.option("--points", default=60, show_default=True, help="Frequencies, evenly in their logarithm.")
@click.option("--windows", help="Comma-separated window lengths [s]  [default: five of them].")
@segments_option()
@click.option("--class", "kind", default="", help="Class of a piloted aircraft for levels: I, II, III or IV.")
@click.option("--category", default="B", show_default=True, help="Category of the flight phase for levels: A, B or C.")
@aircraft_option("Whose mass decides whether levels apply")
@json_option("Write everything as JSON.")
@report_option("Write an HTML page with tables.")
@figure_option("Write the Bode figure (.png .svg .pdf).", "-o")
def frequency(
    flights: tuple[Path, ...],
    control: str,
    output: str,
    band: str | None,
    windows: str | None,
    json_path: Path | None,
    report_folder: Path | None,
    figure_path: Path | None,
    **options: Any,
) -> int:
    """Frequency response of --output to --input over one FLIGHT or several (.mcap, .csv or .parquet)."""
    from estimation.answers import responses
    from sideslip.verbs.delivery import deliver

    lengths = _numbers("--windows", windows) or ()
    answer = responses.frequency(flights, control, output, band=_band(band), windows=lengths, **options)
    return deliver(answer, json_path, figure_path, report_folder)


def _band(text: str | None) -> tuple[float, float] | None:
    """Two frequencies [Hz] of --band; None where it is not given. Raises EstimationError."""
    from estimation.errors import EstimationError

    numbers = _numbers("--band", text)
    if numbers is None:
        return None
    if len(numbers) != 2:
        raise EstimationError(f"--band {text}: give two frequencies in Hz, like 0.1,3")
    return numbers[0], numbers[1]


def _numbers(option: str, text: str | None) -> tuple[float, ...] | None:
    """Comma-separated numbers of an option; None where it is not given. Raises EstimationError."""
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
