"""`sideslip match`: proof of match, a model's prediction of flights it was not estimated from."""

from pathlib import Path
from typing import Any

import click

from daq.utilities.options import (
    aircraft_option,
    figure_option,
    flights_argument,
    histories_option,
    json_option,
    report_option,
    segments_option,
    simulation_option,
)
from estimation.signals.goodness_of_fit import THEIL_LIMIT

EXAMPLE = "Example: sideslip match ld4.toml ld2.mcap --json match.json"


@click.command(epilog=EXAMPLE)
@click.argument("model", type=click.Path(path_type=Path), metavar="MODEL.toml")
@flights_argument()
@click.option(
    "--free", default="", help="Comma-separated parameters refitted on each flight (biases); all others are frozen."
)
@click.option(
    "--limit",
    type=float,
    default=THEIL_LIMIT,
    show_default=True,
    help="Theil's coefficient, beyond what its noise alone leaves, above which a channel does not match (exit status 1).",
)
@segments_option()
@histories_option("predicts")
@aircraft_option("For a built-in model or a class of your own")
@simulation_option()
@json_option("Write the fit as JSON.")
@figure_option("Write a figure of measured and predicted histories.")
@report_option("Write an HTML page.")
def match(
    model: Path,
    flights: tuple[Path, ...],
    histories_folder: Path | None,
    json_path: Path | None,
    figure_path: Path | None,
    report_folder: Path | None,
    **options: Any,
) -> int:
    """Predict each FLIGHT with MODEL.toml, parameters frozen and only initial states refitted, and judge the match."""
    from estimation.answers import matches
    from sideslip.verbs.delivery import beside_lines, deliver

    answer = matches.match(model, flights, **options)
    history_lines = () if histories_folder is None else beside_lines(answer.write_histories(histories_folder))
    return deliver(answer, json_path, figure_path, report_folder, written=history_lines)
