"""A long campaign whose workers and client are killed again and again, against the same flights in one process left alone.

    nice -n 10 python -m tests.studies.campaign_kills FOLDER [--flights 300] [--every 60] [--clients 2] [--part 30]

Simulated flights of 20 s (scenario quiet, 14 to 19 m/s) by ml and ls on two workers. A worker is killed every `every` seconds,
the client each time another share of the flights is on the disk; the same command then goes on. The last table is kept in
docs/campaign.md.
"""

import contextlib
import hashlib
import json
import os
import random
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import pyarrow as pa
import pyarrow.compute as pc

from tests.unit.estimation.campaign.running import children, repeatable, results_of, start, workers_of

LOOK_S = 1.0
GONE_S = 120.0  # in which processes below a killed client must be gone
PLAN = """model = "lateral"
aircraft = "cdfp"
methods = ["ml", "ls"]

[[simulate]]
scenario = "quiet"
count = {count}
seed = 1
set = {{ "flight.duration_s" = 20.0 }}
vary = {{ "flight.speed_m_s" = [14.0, 19.0] }}
"""


@dataclass
class Counts:
    """What was done to the campaign, and what was on the disk each time the client died."""

    workers: int = 0
    clients: int = 0
    on_disk: list[int] = field(default_factory=list)


def plan_of(folder: Path, count: int) -> Path:
    path = folder / f"plan{count}.toml"
    path.write_text(PLAN.format(count=count))
    return path


def flights_done(out: Path) -> int:
    """Flights that are on the disk; files that are being put together are looked at the next time."""
    with contextlib.suppress(OSError, pa.ArrowInvalid):
        return len(set(results_of(out)["flight"].to_pylist())) if list((out / "results").glob("*.parquet")) else 0
    return 0


def killed(folder: Path, flights: int, every: float, clients: int) -> tuple[Counts, dict[str, Any], int]:
    """The campaign with its accidents; what was done to it, what the last client said, and its exit status."""
    counts, rng, out, said = Counts(), random.Random(1), folder / "killed", folder / "said.json"
    words = (str(plan_of(folder, flights)), "--out", str(out), "--workers", "2", "--no-report", "--json", str(said))
    limits = [flights * (i + 1) // (clients + 1) for i in range(clients)]
    next_kill = time.monotonic() + every
    while True:
        process = start(*words)
        for _ in running(process):
            if time.monotonic() >= next_kill and (workers := sorted(workers_of(process.pid))):
                os.kill(rng.choice(workers), signal.SIGKILL)
                counts.workers += 1
                next_kill = time.monotonic() + every
            if counts.clients < clients and flights_done(out) >= limits[counts.clients]:
                ended(process)
                counts.clients += 1
                counts.on_disk.append(flights_done(out))
        if process.returncode != -signal.SIGKILL:
            _, error = process.communicate()
            if process.returncode:
                click.echo(error[-2000:])
            return counts, json.loads(said.read_text()), process.returncode


def running(process: "subprocess.Popen[str]") -> Iterator[None]:
    """A look now and then until it has ended."""
    while process.poll() is None:
        yield
        time.sleep(LOOK_S)


def ended(process: "subprocess.Popen[str]") -> None:
    """Kill the client and wait until nothing below it is left."""
    below = children(process.pid)
    process.kill()
    process.communicate()
    last = time.monotonic() + GONE_S
    while any(alive(pid) for pid in below):
        if time.monotonic() > last:
            raise RuntimeError(f"processes outlive their client: {sorted(filter(alive, below))}")
        time.sleep(0.1)


def alive(pid: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


def digest(table: pa.Table, names: set[str]) -> str:
    """SHA-256 over the rows of some flights, without what tells of the run."""
    own = table.filter(pc.is_in(table["flight"], pa.array(sorted(names))))
    return hashlib.sha256(json.dumps(repeatable(own), sort_keys=True, default=str).encode()).hexdigest()


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--flights", default=300)
@click.option("--every", default=60.0)
@click.option("--clients", default=2)
@click.option("--part", default=30)
def main(folder: Path, flights: int, every: float, clients: int, part: int) -> None:
    """Fly and kill, then the first flights again in one process."""
    folder.mkdir(parents=True)
    begin = time.monotonic()
    counts, said, status = killed(folder, flights, every, clients)
    wall = time.monotonic() - begin
    table = results_of(folder / "killed")
    runs = table.filter(pc.equal(table["kind"], "run"))
    serial = start(str(plan_of(folder, part)), "--out", str(folder / "serial"), "--serial", "--no-report")
    serial.communicate()
    alone = results_of(folder / "serial")
    names = set(alone["flight"].to_pylist())
    row = {
        "flights": flights,
        "exit": status,
        "workers killed": counts.workers,
        "clients killed": counts.clients,
        "on disk when they were": counts.on_disk,
        "done before the last client": said["skipped_done"],
        "runs": runs.num_rows,
        "keys": len(set(runs["key"].to_pylist())),
        "not ok": sum(s != "ok" for s in runs["status"].to_pylist()),
        "rows": table.num_rows,
        "wall [s]": round(wall),
        "load": os.getloadavg()[0],
        "part": len(names),
        "part equal": digest(table, names) == digest(alone, names),
        "digest": digest(alone, names)[:16],
    }
    click.echo(json.dumps(row))


if __name__ == "__main__":
    main()
