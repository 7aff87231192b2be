"""`sideslip design`: an input designed from a model, with the predicted motion and bounds."""

from pathlib import Path
from typing import Any

import click

from daq.utilities.options import (
    aircraft_option,
    figure_option,
    flag_option,
    json_option,
    model_option,
    path_option,
    report_option,
    seed_option,
)
from daq.utilities.outputs import tried_model

EXAMPLE = "Example: sideslip design --model lateral --aircraft cdfp --kind multisine --time 20 -o multisine.toml"


@click.command(epilog=EXAMPLE)
@model_option("Built-in name, MODEL.toml or module:Class.")
@path_option("--from", "estimate", text="What estimate --json wrote: its model, aircraft, values and noise.")
@aircraft_option(default="")
@click.option("--kind", default="optimal", show_default=True, help="doublet, 121, 3211, chirp, multisine or optimal.")
@click.option("--time", "duration", type=float, required=True, help="How long it takes [s].")
@path_option("--limits", text="What it may do (LIMITS.toml).")
@click.option("--separate", default="", help="Two effects of the gap catalogue, or parameters, to separate: A,B.")
@click.option(
    "--criterion", default="worst", show_default=True, help="Of kind optimal: worst, D, A, or the name of a parameter."
)
@click.option("--controls", default="", help="Comma-separated controls to move  [default: all of the model].")
@click.option("--band", default="0.1,1.5", show_default=True, help="Frequencies of chirps and multisines [Hz].")
@click.option("--speed", type=float, help="True airspeed [m/s]  [default: that of a lift coefficient of 0.3].")
@click.option("--density", default=1.17, show_default=True, help="Air density [kg/m3].")
@click.option("--rate", "rate_hz", default=20.0, show_default=True, help="Samples a second of the recording [Hz].")
@flag_option("--pilot-holds", "held", text="A pilot holds bank and pitch gently meanwhile.")
@seed_option("Of the search for phases.")
@path_option("-o", "--output", "--out", text="Manoeuvre file to write (.toml).", tried=tried_model, required=True)
@json_option("Write everything as JSON.")
@figure_option("Draw inputs, spectra, motion, bounds.")
@report_option("Write an HTML page.")
def design(
    output: Path,
    duration: float,
    band: str,
    json_path: Path | None,
    figure_path: Path | None,
    report_folder: Path | None,
    **options: Any,
) -> int:
    """Design the inputs of a manoeuvre of --time seconds, under limits, and predict the bounds that it brings."""
    from estimation.answers import designs
    from sideslip.verbs.delivery import deliver

    answer = designs.design(time=duration, band=_band(band), **options)
    return deliver(answer, json_path, figure_path, report_folder, written=[f"manoeuvre: {answer.save(output)}"])


def _band(text: str) -> tuple[float, float]:
    """Two frequencies [Hz] from `0.1,1.5`. Raises EstimationError."""
    from estimation.errors import EstimationError

    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise EstimationError(f"--band {text}: give two frequencies in Hz, like 0.1,1.5 (at most 25)") from None
    return low, high
