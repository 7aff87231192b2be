"""`sideslip performance`: drag polar, glide ratio, sink and power required from flights whose thrust is known."""

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

EXAMPLE = "Example: sideslip performance glide1.mcap glide2.mcap --aircraft mine.toml --figure polar.png"


@click.command(epilog=EXAMPLE)
@flights_argument()
@aircraft_option("Whose mass and area make coefficients")
@segments_option("Use only these stretches: 2:12,15:25 [s].")
@flag_option("--throttle-off", text="The throttle was closed throughout; for flights without a column that shows it.")
@json_option()
@report_option()
@figure_option("Write the figure of polar, sink and power (.png .svg .pdf).")
def performance(
    flights: tuple[Path, ...],
    json_path: Path | None,
    report_folder: Path | None,
    figure_path: Path | None,
    **options: Any,
) -> int:
    """Drag polar of the FLIGHTs together, and glide, sink and power required over speed, with bounds; exit status 1 where the
    flights cannot tell."""
    from estimation.answers import performances
    from sideslip.verbs.delivery import deliver

    return deliver(performances.performance(flights, **options), json_path, figure_path, report_folder)
