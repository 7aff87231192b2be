"""`sideslip gap`: find where model and flight disagree, name the effect, add it, show the gap shrink."""

from pathlib import Path
from typing import Any

import click

from daq.utilities.options import (
    aircraft_option,
    flights_argument,
    json_option,
    model_option,
    path_option,
    report_option,
    seed_option,
    simulation_option,
)

EXAMPLE = "Example: sideslip gap f0.mcap f1.mcap f2.mcap --holdout f3.mcap --report out/ --json out/gap.json"


class _ManyHoldouts(click.Command):
    """Lets `--holdout` take several flights in a row, as the flights themselves do."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        spread: list[str] = []  # the words, with --holdout before each holdout
        flight_count = 0
        holding = 0  # 1 after --holdout, 2 after its first flight, 0 elsewhere
        for word, following in zip(args, [*args[1:], "-"], strict=True):
            if word == "--holdout":
                if following.startswith("-"):  # such as a shell's pattern that matches no file
                    raise click.UsageError("--holdout has no flight after it; name one, or leave --holdout out", ctx)
                holding = 1
            elif word.startswith("-"):
                holding = 0
                spread.append(word)
            elif holding and (holding == 1 or flight_count):
                spread += ["--holdout", word]
                holding = 2
            else:
                spread.append(word)
                flight_count += 1
        return super().parse_args(ctx, spread)


@click.command(cls=_ManyHoldouts, epilog=EXAMPLE)
@flights_argument()
@path_option(
    "--holdout",
    text="Flights used in no fit, to confirm what is found; several may follow.",
    multiple=True,
    metavar="FLIGHT...",
)
@model_option("Base model: built-in name (lateral, longitudinal, six-dof, ...), MODEL.toml or module:Class.")
@aircraft_option()
@simulation_option()
@report_option("Write an HTML report, the same as a rerun recording, and the models.")
@json_option()
@seed_option()
@click.option(
    "--nulls",
    default=200,
    show_default=True,
    type=click.IntRange(min=20),
    help="Simulated baselines from which every threshold comes.",
)
@path_option("--effects", text="A .toml or .py file with effects of your own; may be repeated.", multiple=True)
def gap(
    flights: tuple[Path, ...], report_folder: Path | None, json_path: Path | None, model: str, **options: Any
) -> int:
    """Find what the model of the FLIGHTs is missing, name it with what it may be confused with, and add it."""
    from estimation.answers import gaps
    from sideslip.verbs.delivery import Progress, deliver

    with Progress() as progress:
        answer = gaps.gap(model, flights, progress=progress, **options)
        if report_folder is not None:
            answer = answer.with_models(report_folder / "models")
        elif json_path is not None:
            answer = answer.with_models(json_path.parent / f"{json_path.stem}-models")
        progress("done", 1.0)
    deliver(answer, json_path, report_folder=report_folder)
    if report_folder is not None:
        from estimation.gap.pages.rerun_report import available, write_gap_recording

        if available():
            recording = write_gap_recording(answer.result, report_folder / "gap.rrd")
            click.echo(f"the same in rerun: sideslip view {recording}")
    return 0
