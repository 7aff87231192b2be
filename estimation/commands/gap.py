"""`sideslip gap`: find where model and flight disagree, name the effect, add it, show the gap shrink."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from estimation.gap.answer.result import GapResult

EXAMPLE = "Example: sideslip gap f0.mcap f1.mcap f2.mcap --holdout f3.mcap --report out/ --json out/gap.json"


class _ManyHoldouts(click.Command):
    """Lets `--holdout` take several flights in a row, as the flights themselves do."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        spread: list[str] = []
        before = holding = 0
        for word in args:
            if word == "--holdout":
                holding = 1
            elif word.startswith("-"):
                holding = 0
                spread.append(word)
            elif holding and (holding == 1 or before):
                spread += ["--holdout", word]
                holding = 2
            else:
                spread.append(word)
                before += 1
        return super().parse_args(ctx, spread)


@click.command(cls=_ManyHoldouts, epilog=EXAMPLE)
@click.argument("flights", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FLIGHT...")
@click.option(
    "--holdout",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FLIGHT...",
    help="Flights kept out of every fit, to confirm what is found; several may follow.",
)
@click.option(
    "--model",
    default="lateral",
    show_default=True,
    help="Base model: built-in name (lateral, longitudinal, six-dof, ...), MODEL.toml or module:Class.",
)
@click.option("--aircraft", help="Built-in aircraft or an AIRCRAFT.toml  [default: the one the flights carry or name].")
@click.option(
    "--simulation",
    help="A simulation of your own as base: jsbsim:AIRCRAFT (name or folder), ardupilot:FILE.json, gazebo:FILE.sdf,"
    " module:function or MODEL.toml.",
)
@click.option(
    "--report",
    "report_folder",
    type=click.Path(path_type=Path),
    help="Write an HTML report, the same as a rerun recording, and the models.",
)
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write the answer as JSON.")
@click.option("--seed", default=1, show_default=True, help="Of every random draw: same seed, same answer.")
@click.option(
    "--nulls",
    default=200,
    show_default=True,
    type=click.IntRange(min=20),
    help="Simulated baselines from which every threshold comes.",
)
@click.option(
    "--effects",
    "effect_files",
    multiple=True,
    type=click.Path(path_type=Path),
    help="A .toml or .py file with effects of your own; may be repeated.",
)
def gap(
    flights: tuple[Path, ...],
    holdout: tuple[Path, ...],
    model: str,
    aircraft: str | None,
    simulation: str | None,
    report_folder: Path | None,
    json_path: Path | None,
    seed: int,
    nulls: int,
    effect_files: tuple[Path, ...],
) -> int:
    """Find what the model of the FLIGHTs is missing, name it with what it may be confused with, and add it."""
    from estimation.aircraft.of_flight import aircraft_of
    from estimation.commands.outputs import check_outputs
    from estimation.commands.progress import Progress
    from estimation.commands.simulation import attached_to
    from estimation.gap.effects import catalogue
    from estimation.gap.run import analyse
    from estimation.gap.workflow import Options
    from estimation.models.load import asks_for_aircraft, check_model, load_model
    from estimation.session.flights import unique_names
    from groundstation.flight import read_flight

    check_outputs(json=json_path, report=report_folder)
    catalogue(effect_files)  # what is mistyped in them or in the model is said before a flight is read
    check_model(model)
    read = unique_names([read_flight(path) for path in (*flights, *holdout)])  # of a ground station each is `flight`
    training, held = read[: len(flights)], read[len(flights) :]
    if simulation is None:
        chosen = load_model(model, aircraft_of([*training, *held], aircraft) if asks_for_aircraft(model) else None)
    else:
        attached = attached_to(simulation, model, [*training, *held], aircraft)
        chosen, training, held = attached.model, attached.training(len(training)), attached.holdout(len(training))
    effects = catalogue(effect_files, chosen)
    options = Options(seed=seed, nulls=nulls)
    with Progress() as progress:
        result = analyse(chosen, training, held, effects, options, progress, report_folder, json_path)
    for line in lines(result):
        click.echo(line)
    if report_folder is not None:
        from estimation.gap.pages.report import write_gap_report
        from estimation.gap.pages.rerun_report import available, write_gap_recording

        click.echo(f"report: {write_gap_report(result, report_folder, effects)}")
        if available():
            click.echo(f"the same in rerun: sideslip view {write_gap_recording(result, report_folder / 'gap.rrd')}")
    return 0


def lines(result: "GapResult") -> list[str]:
    """What a person reads on the terminal."""
    out = [f"verdict: {result.verdict.value}", result.text]
    if result.steps:
        out.append("")
        out.append(
            f"{'effect':20s} {'score':>7s} {'threshold':>9s} {'weight':>7s}  {'gap before':>10s} {'after':>7s} "
            f"{'floor':>7s} {'closed':>7s} {'held out':>9s}"
        )
    for s in result.steps:
        held = "-" if s.holdout is None else f"{s.holdout.closed:.0%}"
        out.append(
            f"{s.effect:20s} {s.score:7.1f} {s.threshold:9.2f} {s.confidence:7.2f}  {s.gap.before:10.3f} {s.gap.after:7.3f} "
            f"{s.gap.floor:7.3f} {s.gap.closed:7.0%} {held:>9s}"
        )
    before = result.model_before.parameters
    believed = {p.name: p for p in before if p.reference_source.startswith("simulation")}
    for step in result.steps:
        for name, (value, _) in step.estimates.items():
            if name in believed:
                own = believed[name]
                out.append(f"{name}: the {own.reference_source} has {own.reference:.4g}, the flights {value:.4g}")
    if result.files[1]:
        out.append(f"model: {result.files[0]} -> {result.files[1]}")
    return out
