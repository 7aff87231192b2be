"""Campaigns of simulated flights, some of them bad: what the engine costs, how workers scale, whether numbers care.

    python -m tests.studies.campaign_scaling FOLDER [--flights 200] [--bad 20] [--workers 1,2]

The last table is kept in docs/campaign.md. Processor seconds are of the whole tree of processes; walls are only of use on an idle
machine, and side by side.
"""

import json
import os
import resource
import time
from pathlib import Path

import click
import numpy as np
import pyarrow.compute as pc

from firmware_sim.runs.direct import direct_flights, write_csv
from firmware_sim.world.scenario import load_scenario
from tests.unit.estimation.campaign.running import HOSTILE, altered, children, repeatable, results_of, start

BAD = ("truncated", "empty", "degrees", "column", "kills", "hangs", "pipe", "noise", "twice", "words")
BLOCK = 50  # flights flown side by side


def make_flights(folder: Path, flights: int, bad: int) -> None:
    """Sound ones at speeds over the envelope, and `bad` that are broken in turn as BAD says."""
    folder.mkdir(parents=True)
    base = load_scenario("quiet")
    speeds = np.random.default_rng(1).uniform(14.0, 19.0, flights)
    for first in range(0, flights, BLOCK):
        numbers = range(first, min(first + BLOCK, flights))
        plans = [
            base.altered(flight={"speed_m_s": float(speeds[i]), "duration_s": 20.0, "manoeuvres": "rich"})
            for i in numbers
        ]
        for i, columns in zip(numbers, direct_flights(plans, list(numbers)), strict=True):
            write_csv(folder / f"flight{i:04d}.csv", columns)
    for i in range(bad):
        _spoil(folder / f"flight{i:04d}.csv", BAD[i % len(BAD)])


def _spoil(path: Path, how: str) -> None:
    lines = path.read_text().splitlines()
    head = lines[0].split(",")
    if how in ("kills", "hangs"):
        altered(path, path.with_name(f"{how}{path.name}"), 1.0)
        path.unlink()
        return
    if how == "pipe":
        path.unlink()
        os.mkfifo(path)
        return
    table = [line.split(",") for line in lines[1:]]
    if how == "degrees":
        for row in table:
            for name in ("p", "r", "phi", "beta"):
                row[head.index(name)] = repr(57.3 * float(row[head.index(name)]))
    if how == "column":
        place = head.index("beta")
        head, table = [h for h in head if h != "beta"], [[c for j, c in enumerate(r) if j != place] for r in table]
    text = "\n".join([",".join(head), *(",".join(r) for r in table)])
    spoilt = {
        "truncated": text[: len(text) // 2 + 3],
        "empty": "",
        "noise": text[:3000] + "\x00\xff" + text[3000:],
        "twice": text.replace("alpha", "beta", 1),
        "words": text.replace(table[3][1], "n/a", 1),
    }
    path.write_text(spoilt.get(how, text))


def run(folder: Path, out: Path, workers: int, methods: str, limit: float) -> dict[str, float]:
    """One campaign; seconds of processor and wall, and what came of it."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    words = ["--serial"] if workers == 0 else ["--workers", str(workers)]
    process = start(
        str(folder),
        "--out",
        str(out),
        "--aircraft",
        "cdfp",
        "--method",
        methods,
        "--no-report",
        "--json",
        str(out / "said.json"),
        "--time-limit",
        str(limit),
        *words,
    )
    peak = 0.0
    while process.poll() is None:
        peak = max(peak, *(memory_of(p) for p in children(process.pid)), 0.0)
        time.sleep(1.0)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    said = json.loads((out / "said.json").read_text())
    table = results_of(out)
    fits = pc.sum(table["cpu"]).as_py() or 0.0
    return {
        "workers": workers,
        "flights": said["flights"],
        "done": said["done"],
        "failed": len(said["failed"]),
        "exit": process.returncode,
        "cpu": cpu,
        "fits": fits,
        "wall": time.monotonic() - begin,
        "worker_mb": peak,
    }


def memory_of(pid: int) -> float:
    """Resident set of a process [MB]."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except OSError:
        return 0.0


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--flights", default=200)
@click.option("--bad", default=20)
@click.option("--workers", default="1,2", help="0 is --serial.")
@click.option("--methods", default="ml,ls")
@click.option("--limit", default=60.0)
def main(folder: Path, flights: int, bad: int, workers: str, methods: str, limit: float) -> None:
    """Fly, run with each number of workers, compare every bit."""
    make_flights(folder / "flights", flights, bad)
    chosen = f"{methods},{HOSTILE}" if bad else methods
    tables = []
    for count in map(int, workers.split(",")):
        out = folder / f"out{count}"
        out.mkdir()
        print(json.dumps(run(folder / "flights", out, count, chosen, limit)), flush=True)
        tables.append(repeatable(results_of(out)))
    print("identical:", all(t == tables[0] for t in tables), "rows:", len(tables[0]))


if __name__ == "__main__":
    main()
