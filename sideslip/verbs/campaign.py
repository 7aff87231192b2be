"""The verb `campaign`: many flights on one machine or many, resumable, into tables that people can query."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daq.utilities.options import aircraft_option, flag_option, json_option, model_option, path_option, seed_option
from daq.utilities.outputs import tried_folder, write_json
from daq.utilities.plain_words import comma_separated

if TYPE_CHECKING:
    from estimation.campaign.plan import CampaignPlan
    from estimation.campaign.run import CampaignEngine, CampaignOutcome

SHOWN = 20  # sentences on failed flights, and on groups, that are printed; the tables hold all


def _names(_context: object, _parameter: object, text: str | None) -> tuple[str, ...] | None:
    return None if text is None else comma_separated(text)


@click.command(
    epilog="Example: sideslip campaign 'flights/*.mcap' --aircraft cdfp --method ml,ls --out campaign --workers 2"
)
@click.argument("flights", nargs=-1, required=True, metavar="PLAN.toml|FLIGHT...")
@path_option("--out", text="Folder of the data set.", tried=tried_folder, required=True)
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
def campaign(
    flights: tuple[str, ...],
    out: Path,
    workers: int | None,
    scheduler: str,
    serial: bool,
    retry: str | None,
    dashboard: bool,
    no_report: bool,
    trust_code: bool,
    json_path: Path | None,
    **options: Any,
) -> int:
    """Estimate many flights (files, patterns, folders, URLs; or a PLAN.toml); what lies in --out already is not done again."""
    from estimation.campaign.run import Campaign
    from estimation.campaign.sources import entries_of
    from estimation.campaign.store import Store
    from estimation.campaign.work_list import work_list
    from sideslip.simulated import simulator
    from sideslip.verbs.delivery import Progress

    begin = time.monotonic()
    plan, folder = _plan(flights, {k: v for k, v in options.items() if v is not None}, trust_code)
    with Store(out, time.monotonic) as store:
        work = work_list(plan, entries_of(plan, folder, simulator(), send=bool(scheduler)), folder)

        def engine(pieces: int) -> "CampaignEngine":
            return _engine(pieces, workers, scheduler, serial, dashboard)

        with Progress("campaign") as progress:
            outcome = Campaign(plan, work, store, engine, progress).run(retry_failed=retry is not None)
    page = None if no_report else _page(outcome, plan, out / "report")
    wall_s = time.monotonic() - begin
    if json_path is not None:
        write_json(outcome.to_json(wall_s), json_path)
    _say(outcome, out, page, wall_s)
    return 1 if outcome.failed else 0


def _plan(flights: tuple[str, ...], options: dict[str, Any], trust_code: bool) -> "tuple[CampaignPlan, Path]":
    """The plan, and the folder its paths begin at. Options go before what a file says."""
    from estimation.campaign.plan import named_programs, plan_from, read_plan

    if len(flights) == 1 and flights[0].endswith(".toml"):
        path = Path(flights[0])
        data = read_plan(path, trust_code=trust_code).model_dump(exclude_unset=True)
        for program in named_programs(data):
            click.echo(f"{path} names {program}: a program, which runs because of --trust-code", err=True)
        working_folder = Path.cwd()
        for key in (
            "model",
            "aircraft",
        ):  # a file named on the command line is where the person is, not beside the plan
            if str(options.get(key, "")).endswith(".toml"):
                options[key] = str(working_folder / options[key])
        return plan_from({**data, **options}, str(path)), path.parent
    return plan_from({"flights": flights, **options}, "of the command line"), Path()


def _engine(pieces: int, workers: int | None, scheduler: str, serial: bool, dashboard: bool) -> "CampaignEngine":
    import os

    if serial:
        from estimation.campaign.workers.in_process import SerialEngine

        return SerialEngine()
    from estimation.campaign.workers.cluster import Cluster

    cluster = Cluster(min(pieces, workers or os.cpu_count() or 1), scheduler, dashboard=dashboard)
    if cluster.dashboard:
        click.echo(f"dashboard: {cluster.dashboard}", err=True)
    return cluster


def _page(outcome: "CampaignOutcome", plan: "CampaignPlan", folder: Path) -> Path:
    """The page; drawn anew only where something is new."""
    page = folder / "index.html"
    if outcome.unchanged and page.is_file():
        return page
    from estimation.campaign.pages.page import write_campaign_page

    return write_campaign_page(outcome, plan, folder)


def _say(outcome: "CampaignOutcome", out: Path, page: Path | None, wall_s: float) -> None:
    from estimation.campaign.groups import claims_of

    click.echo(
        f"{outcome.flights} flights: {outcome.done} estimated, {len(outcome.failed)} not"
        f" ({outcome.skipped} were done before, {outcome.fitted} pieces of work now, {wall_s:.1f} s)"
    )
    for flight, reason in list(outcome.failed.items())[:SHOWN]:
        click.echo(f"  failed: {flight}: {reason}")
    for flight, same_flight in outcome.duplicates[:SHOWN]:
        click.echo(f"  left out: {flight}: the same bytes as {same_flight}")
    for path in outcome.damaged:
        click.echo(f"  set aside: {path}: cannot be read; its flights were done again")
    for row in claims_of(outcome.groups)[:SHOWN]:
        click.echo(f"  {row['text']}")
    click.echo(f"results: {out / 'results'}, groups: {out / 'groups'}, manifest: {out / 'manifest.json'}")
    if page is not None:
        click.echo(f"report: {page}")
