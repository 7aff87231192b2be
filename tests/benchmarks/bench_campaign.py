"""What a campaign costs beside its fits: make bench.

Processor seconds, which do not grow where something else runs; the gain of a second worker is a ratio of walls, so both arms are
run in alternation and the load of the machine is printed beside it.
"""

import os
import resource
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from estimation.campaign.aerodynamics.tables import database_rows, envelopes
from estimation.campaign.groups import group_rows
from estimation.campaign.plan import CampaignPlan
from estimation.campaign.run import Campaign
from estimation.campaign.schema import RESULTS, arrow_schema
from estimation.campaign.sources import entries_of
from estimation.campaign.store import Store
from estimation.campaign.work_list import work_list
from estimation.campaign.workers.in_process import SerialEngine
from estimation.campaign.workers.subjects import read_subject
from estimation.campaign.workers.work import do_work
from groundstation.flight.quality.report import quality_report
from tests.studies.campaign_scaling import make_flights, memory_of
from tests.unit.estimation.campaign.running import children, results_of, start

pytestmark = [pytest.mark.benchmark, pytest.mark.timeout(1800)]

FLIGHTS = 124
WARM = 4  # flights before the clock starts: libraries are loaded, forms traced
ROUNDS = 2  # of one worker and two in alternation
ROWS = 100_000
QUERIES = {
    "mean and scatter by parameter": "SELECT parameter, method, avg(estimate), stddev_samp(estimate) FROM rows GROUP BY ALL",
    "medians by group": "SELECT configuration, parameter, median(estimate) FROM rows GROUP BY ALL",
    "worst ten": "SELECT flight, parameter, std_coloured FROM rows ORDER BY std_coloured DESC LIMIT 10",
}


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of flights of 20 s."""
    folder = tmp_path_factory.mktemp("flights") / "sound"
    make_flights(folder, FLIGHTS, 0)
    return folder


def spent(words: Sequence[str], folder: Path, out: Path) -> tuple[float, float, float]:
    """Processor seconds of all processes and wall of a campaign, and the largest resident set of a process below it [MB]."""
    before, begin, peak = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic(), 0.0
    process = start(str(folder), "--out", str(out), "--aircraft", "cdfp", "--no-report", *words)
    while process.poll() is None:
        peak = max([peak, *(memory_of(p) for p in children(process.pid))])
        time.sleep(0.2)
    assert process.stdout is not None
    process.communicate()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu, time.monotonic() - begin, peak


def test_overhead_of_a_flight(flights: Path, tmp_path: Path) -> None:
    """All of it in one process, less reading, checks and fits."""
    plan = CampaignPlan(flights=(str(flights),), aircraft="cdfp", methods=("ml", "ls"))
    engine = SerialEngine()
    begin = time.process_time()
    works = work_list(plan, entries_of(plan, Path()), Path())
    planning = time.process_time() - begin
    do_work(works.planned[0].work)  # libraries are loaded, forms traced
    begin = time.process_time()
    rows = [do_work(p.work) for p in works.planned]
    whole = time.process_time() - begin
    runs = [r for own in rows for r in own if r["kind"] == "run"]
    fits = sum(r["cpu"] for r in runs)
    begin = time.process_time()
    read = [read_subject(p.work.subjects[0]) for p in works.planned]
    reading = time.process_time() - begin
    begin = time.process_time()
    for flight in read:
        quality_report(flight)
    checks = time.process_time() - begin
    begin = time.process_time()
    with Store(tmp_path / "out", time.monotonic) as store:
        Campaign(plan, works, store, lambda _: engine, lambda *told: None).run()
    publishing = time.process_time() - begin - whole
    each = {"fits": fits, "reading": reading, "checks": checks, "planning": planning}
    each["rows"] = whole - fits - reading - checks
    said = ", ".join(f"{what} {1e3 * seconds / FLIGHTS:.1f}" for what, seconds in each.items())
    print(
        f"\na flight of 20 s by ml and ls [ms of processor]: {said}; tables, groups, curves {publishing:.2f} s a campaign"
    )
    assert len(runs) == 2 * FLIGHTS


def test_memory_of_a_worker_does_not_grow(flights: Path) -> None:
    """The same work in this process, flight after flight."""
    plan = CampaignPlan(flights=(str(flights),), aircraft="cdfp", methods=("ml", "ls"))
    works = [p.work for p in work_list(plan, entries_of(plan, Path()), Path()).planned]
    sizes = [memory_of(os.getpid())]
    for _ in range(3):
        for work in works:
            assert {r["status"] for r in do_work(work) if r["kind"] == "run"} == {"ok"}
        sizes.append(memory_of(os.getpid()))
    growth = (sizes[3] - sizes[1]) / (2 * len(works))
    print(f"\nresident set: {', '.join(f'{s:.0f}' for s in sizes)} MB after 0, 1, 2, 3 times {len(works)} flights")
    print(f"growth: {1e3 * growth:.1f} kB a flight")


def empty_flights(folder: Path, count: int) -> Path:
    """Files that are refused at their first line: all that is left to pay is the engine."""
    folder.mkdir()
    for i in range(count):
        (folder / f"flight{i}.csv").write_text(f"nothing {i}\n")
    return folder


def test_engine_costs_of_a_piece(tmp_path: Path) -> None:
    """Processor time of all processes, from the slope over pieces that have no work in them."""
    few, many = empty_flights(tmp_path / "few", 30), empty_flights(tmp_path / "many", 330)
    for name, words in (("serial", ["--serial"]), ("1 worker", ["--workers", "1"]), ("2 workers", ["--workers", "2"])):
        slopes = []
        for turn in range(3):
            (a, _, _), (b, _, peak) = (
                spent([*words, "--method", "ls"], folder, tmp_path / f"{name} {folder.name} {turn}")
                for folder in (few, many)
            )
            slopes.append((b - a) / 300)
        print(f"\n{name}: {1e3 * min(slopes):.1f} to {1e3 * max(slopes):.1f} ms a piece; largest worker {peak:.0f} MB")


def arms() -> Iterator[tuple[int, int]]:
    for turn in range(ROUNDS):
        yield turn, 1
        yield turn, 2


def some_of(flights: Path, folder: Path, which: slice) -> Path:
    """Copies of some of the flights in a folder of their own."""
    folder.mkdir()
    for path in sorted(flights.glob("*.csv"))[which]:
        (folder / path.name).write_bytes(path.read_bytes())
    return folder


def wall_of(folders: Sequence[Path], out: Path) -> float:
    """Wall of campaigns of one process each that know nothing of one another, begun together, until the last is over."""
    begin = time.monotonic()
    words = ["--aircraft", "cdfp", "--no-report", "--serial", "--method", "ml,ls"]
    running = [start(str(folder), "--out", str(out / str(k)), *words) for k, folder in enumerate(folders)]
    for process in running:
        process.communicate()
    return time.monotonic() - begin


def test_gain_of_a_second_worker(flights: Path, tmp_path: Path) -> None:
    """Walls without start and end: from the slope over flights. Beside it what the machine gives for two processes that share
    nothing but its memory and caches: no engine gains more."""
    few = some_of(flights, tmp_path / "few", slice(WARM))
    halves = [some_of(flights, tmp_path / f"half {k}", slice(k, None, 2)) for k in (0, 1)]
    walls: dict[int, list[float]] = {1: [], 2: []}
    machine = []
    for turn, workers in arms():
        words = ["--workers", str(workers), "--method", "ml,ls"]
        short = spent(words, few, tmp_path / f"short {turn} {workers}")
        out = tmp_path / f"long {turn} {workers}"
        long = spent(words, flights, out)
        fits = float(np.nansum(results_of(out)["cpu"].to_numpy(zero_copy_only=False)))
        walls[workers].append(long[1] - short[1])
        print(
            f"\n{workers} workers: {long[0]:.1f} s of processor ({short[0]:.1f} with {WARM} flights), {fits:.1f} in fits,"
            f" {long[1]:.1f} s wall ({short[1]:.1f}), largest worker {long[2]:.0f} MB, load {os.getloadavg()[0]:.1f}"
        )
        if workers == 2:
            alone = wall_of([flights], tmp_path / f"alone {turn}") - wall_of([few], tmp_path / f"alone few {turn}")
            both = wall_of(halves, tmp_path / f"both {turn}") - wall_of([few, few], tmp_path / f"both few {turn}")
            machine.append(alone / both)
            print(f"\nno engine: {alone:.1f} s wall alone, {both:.1f} s as two processes side by side")
    print(f"gain: {' '.join(f'{a / b:.2f}' for a, b in zip(walls[1], walls[2], strict=True))}")
    print(f"gain of two processes without an engine: {' '.join(f'{g:.2f}' for g in machine)}")


def test_a_hundred_thousand_rows_are_asked(tmp_path: Path) -> None:
    """Queries as in docs/campaign.md, and the tables that every run makes."""
    rng = np.random.default_rng(1)
    names = [f"C{i:02d}" for i in range(16)]
    count = ROWS // len(names)
    rows = [
        {
            "kind": "estimate", "flight": f"f{i:05d}", "key": f"k{i:05d}", "method": "ml", "parameter": name,
            "estimate": float(rng.normal(1.0, 0.05)), "std_coloured": 0.05, "identifiable": True, "status": "ok",
            "configuration": "new" if i % 2 else "old", "alpha": 0.1, "V": 17.0, "beta_max": 0.1, "delta_e": 0.0,
        }
        for i in range(count) for name in names
    ]  # fmt: skip
    table = pa.Table.from_pylist(rows, arrow_schema(RESULTS))
    path = tmp_path / "rows.parquet"
    pq.write_table(table, path, compression="zstd")
    with duckdb.connect() as asked:
        asked.execute(f"CREATE VIEW rows AS SELECT * FROM '{path}'")
        for what, query in QUERIES.items():
            begin, wall = time.process_time(), time.monotonic()
            assert asked.execute(query).fetchall()
            print(f"\n{what}: {time.process_time() - begin:.3f} s of processor, {time.monotonic() - wall:.3f} s wall")
    begin = time.process_time()
    assert len(group_rows(table, ("configuration",))) >= 2 * len(names)
    print(f"groups of {table.num_rows} rows: {time.process_time() - begin:.2f} s of processor")
    begin = time.process_time()
    assert database_rows(envelopes(table, ("configuration",), 0), 0)
    print(f"curves of {table.num_rows} rows: {time.process_time() - begin:.2f} s of processor")
