"""`sideslip estimate`: aerodynamic parameters with bounds, beside prior beliefs."""

from pathlib import Path
from typing import Any

import click

from daq.utilities.options import (
    aircraft_option,
    figure_option,
    flag_option,
    flights_argument,
    histories_option,
    json_option,
    model_option,
    path_option,
    report_option,
    seed_option,
    segments_option,
    simulation_option,
)
from daq.utilities.outputs import tried_model
from estimation.estimators.estimator import Extra
from estimation.estimators.registry import estimator_names, listed_words

EXAMPLE = "Example: sideslip estimate ld1.mcap ld2.mcap --method ml,ngn --joint --report out/"


def _methods_with(extra: Extra) -> str:
    """The methods that support an extra, as text for the help."""
    return f"method{'s' if len(estimator_names(extra)) > 1 else ''} {listed_words(estimator_names(extra))}"


@click.command(epilog=EXAMPLE)
@flights_argument()
@click.option(
    "--method",
    "method",
    default=estimator_names()[0],
    show_default=True,
    metavar="NAMES",
    help=f"Comma-separated: {', '.join(estimator_names())}; module:NAME is an estimator of your own.",
)
@model_option()
@aircraft_option()
@simulation_option()
@flag_option("--joint", text="Also one estimate over all flights together.")
@click.option("--device", default="cpu", show_default=True, help="Where ngn trains its networks: cpu, cuda or auto.")
@segments_option()
@flag_option(
    "--each-segment",
    text="Take each segment as a flight of its own: estimates each, their scatter, --joint all of them.",
)
@flag_option(
    "--raw-inputs",
    text=f"Take measured inputs with their noise, as a plain output error does ({_methods_with(Extra.RAW_INPUTS)}).",
)
@flag_option(
    "--keep-held",
    text="Take the repeated values of slow and stuck sensors for measurements; by default they are excluded, with a note.",
)
@click.option(
    "--hold-initial",
    default="",
    metavar="NAMES",
    help="Comma-separated states whose initial values are fixed as measured, or NAME=VALUE; all.",
)
@click.option(
    "--free-initial",
    default="",
    metavar="NAMES",
    help="Comma-separated states whose initial values are estimated though the model fixes them; all.",
)
@flag_option("--stepwise", text=f"Keep only the terms that a partial F ratio finds ({_methods_with(Extra.STEPWISE)}).")
@json_option()
@report_option()
@figure_option("Write a figure of measured and estimated histories.")
@histories_option("shows")
@path_option(
    "--save-model",
    "model_path",
    text="Write the model with its estimates: joint if asked for, else of the first flight.",
    tried=tried_model,
)
@path_option("--truth", text="True derivatives of simulated flights (JSON), shown beside the means.")
@click.option(
    "--profile",
    default="",
    metavar="NAMES",
    help=f"Comma-separated parameters: 95 % interval by profile likelihood ({_methods_with(Extra.PROFILE)}).",
)
@click.option(
    "--bootstrap",
    default=0,
    metavar="N",
    help=f"Spread by N refits ({_methods_with(Extra.BOOTSTRAP)}): of simulated repetitions, or networks on resampled "
    "stretches (64 where not given).",
)
@click.option(
    "--structure",
    type=click.Choice(["off", "test", "auto"]),
    default="test",
    show_default=True,
    help="Test each fit for what its model lacks (derivatives, nonlinear terms, lags, scales); auto adds it and fits again.",
)
@seed_option("Of the bootstrap, and of the networks.", 0)
@flag_option(
    "--brief", text="Print each flight's estimates in one line; tables for the mean and the joint estimate only."
)
def estimate(
    flights: tuple[Path, ...],
    json_path: Path | None,
    report_folder: Path | None,
    figure_path: Path | None,
    histories_folder: Path | None,
    model_path: Path | None,
    brief: bool,
    **options: Any,
) -> int:
    """Estimate aerodynamic parameters of each FLIGHT (.mcap, .csv or .parquet), with bounds."""
    from estimation.answers import estimates
    from sideslip.verbs.delivery import Progress, beside_lines, deliver

    with Progress() as progress:
        answer = estimates.estimate(flights, progress=progress, **options)
    file_lines = []
    if model_path is not None:
        file_lines.append(f"model: {answer.save(model_path)}")
    if histories_folder is not None:
        file_lines += beside_lines(answer.write_histories(histories_folder))
    return deliver(answer, json_path, figure_path, report_folder, lines=answer.lines(brief=brief), written=file_lines)
