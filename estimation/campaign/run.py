"""Runs a campaign: unfinished work goes to the engine, its rows into the store; then groups, tables and files are made."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from estimation.campaign.aerodynamics.differences import difference_rows, step_rows
from estimation.campaign.aerodynamics.joint_tables import joint_model_rows, joint_rows, model_texts
from estimation.campaign.aerodynamics.jsbsim import aerodynamics_files
from estimation.campaign.aerodynamics.tables import database_rows, envelopes, flight_rows, starts_in
from estimation.campaign.groups import group_rows, label_of
from estimation.campaign.plan import CampaignPlan
from estimation.campaign.publish import (
    conditions_of,
    manifest,
    ordered,
    planned_rows,
    unreadable_rows,
    write_manifest,
    write_table,
    write_texts,
)
from estimation.campaign.schema import DATABASE, GROUPS, usable_estimates
from estimation.campaign.sources import CampaignFlight
from estimation.campaign.store import Store
from estimation.campaign.tasks import Finished, Row, Work
from estimation.campaign.work_list import Member, WorkList, envelope_work, joint_work, match_works, unfinished
from estimation.campaign.workers.work import OK

if TYPE_CHECKING:
    import pyarrow as pa

LEAST_VARIANCE = 1e-300  # in place of 0: weights are inverse variances


class CampaignEngine(Protocol):
    """Where work is done: `estimation.campaign.workers.in_process` or `estimation.campaign.workers.cluster`."""

    workers: int
    dashboard: str

    def run(self, works: Iterator[Work]) -> Iterator[Finished | None]:
        """Finished work in any order; None from time to time while no work ends."""

    def close(self) -> None:
        """Release the workers."""


@dataclass(frozen=True)
class CampaignOutcome:
    """flights: in the plan; done: with results; failed: location -> reason; skipped: done by an earlier run; fitted: pieces of
    work done by this run; duplicates: (location, location of the same flight); damaged: result parts that could not be read;
    unchanged: no file differs from those of the run before."""

    flights: int
    done: int
    failed: Mapping[str, str]
    skipped: int
    fitted: int
    duplicates: Sequence[tuple[str, str]]
    workers: int
    results: "pa.Table"
    groups: Sequence[Row]
    database: Sequence[Row]
    damaged: Sequence[Path] = ()
    unchanged: bool = False

    def to_json(self, wall_s: float) -> dict[str, Any]:
        return {
            "version": 1,
            "flights": self.flights,
            "done": self.done,
            "failed": [{"flight": flight, "why": reason} for flight, reason in self.failed.items()],
            "skipped_done": self.skipped,
            "fitted": self.fitted,
            "duplicates": [list(pair) for pair in self.duplicates],
            "wall_s": wall_s,
            "workers": self.workers,
        }


class Campaign:
    """One run of a plan into a store. make_engine: number of pieces of work -> engine, called only when there is work. tell:
    takes a text and the fraction done."""

    def __init__(
        self,
        plan: CampaignPlan,
        work: WorkList,
        store: Store,
        make_engine: Callable[[int], CampaignEngine],
        tell: Callable[..., None],
    ) -> None:
        self._plan, self._work, self._store = plan, work, store
        self._make_engine, self._tell = make_engine, tell
        self._engine: CampaignEngine | None = None
        self._conditions: dict[str, Row] = {key: conditions_of(p.entry) for key, p in work.by_key.items()}
        self._fitted = 0
        self._workers = 0

    def run(self, *, retry_failed: bool = False) -> CampaignOutcome:
        """Do the unfinished work and publish the tables. Finished work is on disk whatever interrupts the run."""
        stored_table = self._store.load()
        if retry_failed:
            stored_table = self._without_failures(stored_table)
        stored_keys = set(stored_table["key"].to_pylist())
        skipped = sum(all(k in stored_keys for k in p.work.pieces.values()) for p in self._work.planned)
        try:
            self._run_work([p.work for p in self._work.planned], stored_keys, "flights")
            if self._plan.match or self._plan.joint or self._plan.envelope:
                self._run_groups(stored_keys)
        finally:
            if self._engine is not None:
                self._engine.close()
        return self._publish(skipped)

    def _without_failures(self, table: "pa.Table") -> "pa.Table":
        """The table without the rows of failed work, so that it is done again."""
        import pyarrow as pa
        import pyarrow.compute as pc

        failed = set(table.filter(pc.equal(table["status"], "failed"))["key"].to_pylist())
        successful = table.filter(pc.invert(pc.is_in(table["key"], value_set=pa.array(sorted(failed), pa.string()))))
        self._store.replace_all(successful, successful.slice(0, 0))
        return successful

    def _run_work(self, works: Iterable[Work], done: set[str], what: str) -> None:
        """Run the pieces of work whose keys are not in `done`. what: their name in messages."""
        open_works = list(unfinished(works, done))
        if not open_works:
            return
        if self._engine is None:
            self._engine = self._make_engine(len(open_works))
        self._workers = self._engine.workers
        finished_count = 0
        for finished in self._engine.run(iter(open_works)):
            if finished is None:
                self._store.tick()
                continue
            self._store.add([{**row, "attempts": finished.attempts} for row in finished.rows])
            finished_count += 1
            self._fitted += 1
            self._tell(f"{what}: {finished_count} of {len(open_works)}", finished_count / len(open_works))
        self._store.flush()

    def _run_groups(self, done: set[str]) -> None:
        """Joint fits, models over the envelope and matches, which need the estimates of all flights of a group."""
        results, _ = planned_rows(self._store.load(), self._conditions)
        works: list[Work] = []
        for group, members in members_of(results, self._work, self._plan).items():
            label = label_of(dict(group))
            group_columns: Row = {"group": label, **{k: v or None for k, v in group}}
            joint = joint_work(self._plan, label, members) if self._plan.joint else None
            envelope = envelope_work(self._plan, label, members) if self._plan.envelope else None
            for group_work in (joint, envelope):
                if group_work is not None:
                    works.append(group_work)
                    self._conditions |= dict.fromkeys(group_work.pieces.values(), group_columns)
            for match in match_works(self._plan, label, members) if self._plan.match else ():
                entry = next(p.entry for p in self._work.planned if p.work.subjects[0] is match.subjects[0])
                works.append(match)
                self._conditions |= {key: {**group_columns, **conditions_of(entry)} for key in match.pieces.values()}
        self._run_work(works, done, "groups")

    def _publish(self, skipped: int) -> CampaignOutcome:
        import pyarrow as pa

        results, superseded = planned_rows(self._store.load(), self._conditions)
        unusable_entries = [*self._work.unreadable, *self._duplicates_of_failed(failures_of(results))]
        if unusable_entries:
            results = ordered(pa.concat_tables([results, unreadable_rows(unusable_entries)]))
        self._store.replace_all(results, superseded)
        keys = self._plan.groups
        curves = envelopes(results, keys, self._plan.seed)
        starts = starts_in(curves)
        groups = [
            *group_rows(results, keys, starts),
            *flight_rows(curves),
            *step_rows(curves),
            *difference_rows(curves, keys),
            *joint_model_rows(results, starts),
        ]
        folder = self._store.folder
        write_table(groups, GROUPS, folder / "groups" / "groups.parquet")
        database = [*database_rows(curves, self._plan.seed), *joint_rows(results, curves)]
        write_table(database, DATABASE, folder / "database" / "database.parquet")
        write_texts(model_texts(results), folder / "database", ".toml")
        write_texts(aerodynamics_files(database), folder / "database", ".xml")
        failures = failures_of(results)
        planned = len(self._work.planned) + len(unusable_entries)
        unchanged = not write_manifest(manifest(self._plan, self._work, self._store, failures), folder)
        return CampaignOutcome(
            len(self._work.planned) + len(self._work.unreadable) + len(self._work.duplicates),
            planned - len(failures),
            failures,
            skipped,
            self._fitted,
            [(e.location, same_flight.location) for e, same_flight in self._work.duplicates],
            self._workers,
            results,
            groups,
            database,
            self._store.damaged,
            unchanged,
        )

    def _duplicates_of_failed(self, failures: Mapping[str, str]) -> list[CampaignFlight]:
        """Duplicates of a flight that failed, with its reason: several empty files are several bad flights."""
        return [
            replace(entry, why=f"{failures[first.location]} (the same bytes as {first.location})")
            for entry, first in self._work.duplicates
            if first.location in failures
        ]


def failures_of(results: "pa.Table") -> dict[str, str]:
    """Location -> why a method could not use a flight, or why its estimates are not recommended."""
    import pyarrow.compute as pc

    runs = results.filter(
        pc.and_(
            pc.equal(results["kind"], "run"),
            pc.and_(pc.not_equal(results["status"], OK), pc.is_valid(results["source"])),
        )
    )
    reasons_by_source: dict[str, list[str]] = {}
    for source, reason in zip(runs["source"].to_pylist(), runs["why"].to_pylist(), strict=True):
        reasons_by_source.setdefault(source, []).append(reason)
    return {source: "; ".join(dict.fromkeys(words)) for source, words in sorted(reasons_by_source.items())}


def members_of(
    results: "pa.Table", work: WorkList, plan: CampaignPlan
) -> dict[tuple[tuple[str, str], ...], list[Member]]:
    """Group (column, value pairs of the plan's group columns) -> its flights with their estimates and variances by method."""
    groups: dict[tuple[tuple[str, str], ...], dict[str, dict[str, dict[str, tuple[float, float]]]]] = {}
    by_key = work.by_key
    for row in usable_estimates(results, ("estimate",), plan.groups):
        group = tuple((k, row[k] or "") for k in plan.groups)
        methods = groups.setdefault(group, {}).setdefault(by_key[row["key"]].work.identity, {})
        variance = max(row["std_coloured"] ** 2, LEAST_VARIANCE)
        methods.setdefault(row["method"], {})[row["parameter"]] = (row["estimate"], variance)
    return {
        g: [Member(by_key[key], methods) for key, methods in flights.items()] for g, flights in sorted(groups.items())
    }
