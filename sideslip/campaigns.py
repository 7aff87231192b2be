"""`campaign`: the estimation of many flights into a data set."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimation.answers.answer import Answer, Rows
from estimation.answers.files import bars

if TYPE_CHECKING:
    from estimation.campaign.plan import CampaignPlan
    from estimation.campaign.run import CampaignEngine, CampaignOutcome

SHOWN = 20  # printed lines on failed flights, duplicates and groups each; the tables have all
Names = str | Sequence[str] | None


def campaign(
    flights: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    methods: Names = None,
    model: str | Path | None = None,
    aircraft: str | Path | None = None,
    groups: Names = None,
    check: str | None = None,
    joint: bool | None = None,
    envelope: bool | None = None,
    match: bool | None = None,
    bootstrap: int | None = None,
    each_segment: bool | None = None,
    seed: int | None = None,
    time_limit: float | None = None,
    workers: int | None = None,
    scheduler: str = "",
    serial: bool = False,
    retry: str | None = None,
    dashboard: bool = False,
    no_report: bool = False,
    trust_code: bool = False,
    progress: Callable[..., None] | None = None,
    notice: Callable[[str], None] = lambda sentence: None,
) -> "CampaignAnswer":
    """Estimate many flights into a data set; finished work of the data set is not repeated.

    Args:
        flights: files, patterns, folders, URLs, or one PLAN.toml, whose keys the other arguments replace.
        out: the folder of the data set.
        methods: as `method` of `estimate`. None, for this and all arguments up to time_limit: the plan's value, or its default.
        model: as for `estimate`.
        aircraft: a built-in name or a file; by default what the flights carry.
        groups: of aircraft, configuration, day, manoeuvre.
        check: none, quality or full.
        joint: also one estimate over all flights of a group.
        envelope: also one model over the envelope.
        match: also predict each flight with the others of its group.
        bootstrap: replicates of each flight.
        each_segment: each segment of a flight as a separate manoeuvre.
        seed: of all random draws.
        time_limit: of one piece of work [s].
        workers: processes of this computer, by default one for each processor.
        scheduler: address of a dask scheduler, instead of workers.
        serial: all work in this process.
        retry: "failed" repeats failed work.
        dashboard: open the dashboard of the engine; needs bokeh.
        no_report: write the tables only.
        trust_code: run the Python code that a plan names.
        progress: called with a text and the fraction done.
        notice: called with sentences for a person before the work begins.

    Raises:
        CampaignError: one sentence, for a plan that cannot be carried out.

    Example::

        answer = ss.campaign("flights/*.mcap", "campaign", aircraft="cdfp", methods=["ml", "ls"], serial=True)
        print(answer.summary())
    """
    begin = time.monotonic()
    options = {
        "methods": methods, "groups": groups, "model": model, "aircraft": aircraft, "check": check, "joint": joint,
        "envelope": envelope, "match": match, "bootstrap": bootstrap, "each_segment": each_segment, "seed": seed,
        "time_limit": time_limit,
    }  # fmt: skip
    sources = [str(f) for f in ([flights] if isinstance(flights, str | Path) else flights)]
    plan, folder = _plan(sources, _plan_keys(options), trust_code, notice)
    engine = partial(_engine, workers=workers, scheduler=scheduler, serial=serial, dashboard=dashboard, notice=notice)
    report = progress or (lambda *words_and_share: None)
    out = Path(out)
    outcome = _outcome(plan, folder, out, engine, report, send=bool(scheduler), retry_failed=retry is not None)
    page = None if no_report else _page(outcome, plan, out / "report")
    return CampaignAnswer(outcome, out, page, time.monotonic() - begin)


def _outcome(
    plan: "CampaignPlan",
    folder: Path,
    out: Path,
    engine: "Callable[[int], CampaignEngine]",
    report: Callable[..., None],
    *,
    send: bool,
    retry_failed: bool,
) -> "CampaignOutcome":
    """Run a plan into the data set `out`. folder: of the plan's relative paths. send: whether workers get flights as bytes."""
    from estimation.campaign.run import Campaign
    from estimation.campaign.sources import entries_of
    from estimation.campaign.store import Store
    from estimation.campaign.work_list import work_list
    from sideslip.simulated import simulator

    with Store(out, time.monotonic) as store:
        work = work_list(plan, entries_of(plan, folder, simulator(), send=send), folder)
        return Campaign(plan, work, store, engine, report).run(retry_failed=retry_failed)


@dataclass(frozen=True, repr=False)
class CampaignAnswer(Answer):
    """The outcome of a campaign. folder: of the data set; page: of the report, None without one; wall_s: duration [s]."""

    outcome: "CampaignOutcome"
    folder: Path
    page: Path | None
    wall_s: float

    @property
    def passed(self) -> bool:
        """Whether every flight was estimated."""
        return not self.outcome.failed

    def to_json(self) -> dict[str, Any]:
        return self.outcome.to_json(self.wall_s)

    def headline(self) -> str:
        o = self.outcome
        return (
            f"{o.flights} flights: {o.done} estimated, {len(o.failed)} not"
            f" ({o.skipped} were done before, {o.fitted} pieces of work now, {self.wall_s:.1f} s)"
        )

    def lines(self) -> Iterator[str]:
        from estimation.campaign.groups import claims_of

        o = self.outcome
        yield self.headline()
        yield from (f"  failed: {flight}: {reason}" for flight, reason in list(o.failed.items())[:SHOWN])
        yield from (f"  left out: {flight}: the same bytes as {same}" for flight, same in o.duplicates[:SHOWN])
        yield from (f"  set aside: {path}: cannot be read; its flights were done again" for path in o.damaged)
        yield from (f"  {row['text']}" for row in claims_of(o.groups)[:SHOWN])
        yield f"results: {self.folder / 'results'}, groups: {self.folder / 'groups'}, manifest: {self.folder / 'manifest.json'}"
        if self.page is not None:
            yield f"report: {self.page}"

    def to_pandas(self) -> Any:
        """The table of results, a row for each parameter of each flight and method."""
        import pandas as pd

        return pd.read_parquet(self.folder / "results")

    def rows(self) -> Rows:
        o = self.outcome
        counts = {"flights": o.flights, "estimated": o.done, "failed": len(o.failed), "done before": o.skipped}
        return ("", "number"), [(name, str(count)) for name, count in counts.items()]

    def plot(self, ax: Any = None) -> Any:
        """Draw the numbers of flights that were estimated and that failed."""
        return bars({"estimated": self.outcome.done, "failed": len(self.outcome.failed)}, ax)


def _plan_keys(options: dict[str, Any]) -> dict[str, Any]:
    """The given arguments as keys of a plan; None leaves a key to the plan."""
    from daq.utilities.plain_words import comma_separated

    keys = {name: value for name, value in options.items() if value is not None}
    for name in {"methods", "groups"} & keys.keys():
        keys[name] = comma_separated(keys[name]) if isinstance(keys[name], str) else keys[name]
    for name in {"model", "aircraft"} & keys.keys():
        keys[name] = str(keys[name])
    return keys


def _plan(
    flights: Sequence[str], options: dict[str, Any], trust_code: bool, notice: Callable[[str], None]
) -> "tuple[CampaignPlan, Path]":
    """The plan, and the folder of its relative paths. `options` replace keys of a plan file."""
    from estimation.campaign.plan import named_programs, plan_from, read_plan

    if len(flights) != 1 or not flights[0].endswith(".toml"):
        return plan_from({"flights": tuple(flights), **options}, "of the command line"), Path()
    path = Path(flights[0])
    data = read_plan(path, trust_code=trust_code).model_dump(exclude_unset=True)
    for program in named_programs(data):
        notice(f"{path} names {program}: a program, which runs because of --trust-code")
    for key in ("model", "aircraft"):  # relative to the working directory, not to the plan
        if str(options.get(key, "")).endswith(".toml"):
            options[key] = str(Path.cwd() / options[key])
    return plan_from({**data, **options}, str(path)), path.parent


def _engine(
    pieces: int, workers: int | None, scheduler: str, serial: bool, dashboard: bool, notice: Callable[[str], None]
) -> "CampaignEngine":
    import os

    if serial:
        from estimation.campaign.workers.in_process import SerialEngine

        return SerialEngine()
    from estimation.campaign.workers.cluster import Cluster

    cluster = Cluster(min(pieces, workers or os.cpu_count() or 1), scheduler, dashboard=dashboard)
    if cluster.dashboard:
        notice(f"dashboard: {cluster.dashboard}")
    return cluster


def _page(outcome: "CampaignOutcome", plan: "CampaignPlan", folder: Path) -> Path:
    """The report's page; an existing one is reused where the results have not changed."""
    page = folder / "index.html"
    if outcome.unchanged and page.is_file():
        return page
    from estimation.campaign.pages.page import write_campaign_page

    return write_campaign_page(outcome, plan, folder)
