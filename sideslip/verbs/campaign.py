"""The verb `campaign`: many flights on one machine or several, resumable, into tables to query."""

from pathlib import Path
from typing import Any

import click

from daq.utilities.options import aircraft_option, flag_option, json_option, model_option, path_option, seed_option
from daq.utilities.outputs import tried_folder
from daq.utilities.plain_words import comma_separated


def _names(_context: object, _parameter: object, text: str | None) -> tuple[str, ...] | None:
    return None if text is None else comma_separated(text)


@click.command(
    epilog="Example: sideslip campaign 'flights/*.mcap' --aircraft cdfp --method ml,ls --out campaign --workers 2"
)
@click.argument("flights", nargs=-1, required=True, metavar="PLAN.toml|FLIGHT...")
@path_option("-o", "--out", "--output", text="Folder of the data set.", tried=tried_folder, required=True)
@click.option("--workers", type=click.IntRange(min=1), help="Processes on this machine  [default: one a processor].")
@click.option(
    "--scheduler", default="", metavar="ADDRESS", help="A dask scheduler that runs already, like tcp://host:8786."
)
@flag_option("--serial", text="In this process, without the engine.")
@click.option("--method", "methods", callback=_names, help="Comma-separated, as of estimate  [default: ml].")
@model_option("As of estimate  [default: lateral].", None)
@aircraft_option(default="the one each flight carries or names")
@click.option(
    "--group", "groups", callback=_names, help="Of aircraft,configuration,day,manoeuvre  [default: the first two]."
)
@click.option(
    "--check", type=click.Choice(["none", "quality", "full"]), help="Data checks; full also reconstructs the motion."
)
@flag_option("--joint", text="Also one estimate over all flights of each group.", default=None)
@flag_option("--envelope", text="Also one model over the envelope, fitted to all flights of each group.", default=None)
@flag_option("--match", text="Also predict each flight with the others of its group.", default=None)
@click.option("--bootstrap", type=click.IntRange(min=0), help="Replicates a flight.")
@flag_option("--each-segment", text="Each segment of a flight is a manoeuvre of its own.", default=None)
@seed_option("Of every random draw  [default: 0].", None, 0)
@click.option("--time-limit", type=float, help="Seconds that one piece of work may take  [default: 300].")
@click.option("--retry", type=click.Choice(["failed"]), help="Try again what failed before.")
@flag_option(
    "--trust-code", text="Run the Python that the PLAN names (module:NAME); read it first: it can do anything."
)
@flag_option("--dashboard", text="Print the address of the engine's dashboard (needs bokeh).")
@flag_option("--no-report", text="Tables only, no page.")
@json_option("Write counts and failures as JSON.")
def campaign(flights: tuple[str, ...], json_path: Path | None, **options: Any) -> int:
    """Estimate many flights (files, patterns, folders, URLs; or a PLAN.toml); finished work in --out is not repeated."""
    from sideslip.campaigns import campaign as estimate_all
    from sideslip.verbs.delivery import Progress, deliver

    def notice(sentence: str) -> None:
        click.echo(sentence, err=True)

    with Progress("campaign") as progress:
        answer = estimate_all(flights, progress=progress, notice=notice, **options)
    return deliver(answer, json_path)
