"""A scheduler that others started, with a worker of theirs: the same bits as one after the other, in any order."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.cli.docs.follow import run_here
from tests.unit.estimation.campaign.running import ROOT, environment, repeatable, results_of, start

pytestmark = [pytest.mark.timeout(600)]

WORDS = (
    "--aircraft",
    "cdfp",
    "--method",
    "ml",
    "--bootstrap",
    "10",
    "--joint",
    "--match",
    "--envelope",
    "--no-report",
)


@pytest.fixture
def scheduler(tmp_path: Path) -> "Iterator[tuple[str, subprocess.Popen[bytes]]]":
    """Address and process of a scheduler with one worker, each started by dask's own command."""
    file = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    local = ("--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(file))
    first = subprocess.Popen([*dask, "scheduler", "--port", "0", *local], cwd=ROOT, env=environment(), **quiet)
    processes = [first]
    try:
        end = time.monotonic() + 60.0
        while not file.is_file() or not file.read_text():
            assert first.poll() is None
            assert time.monotonic() < end
            time.sleep(0.05)
        worker = [*dask, "worker", "--nthreads", "1", "--no-dashboard", "--scheduler-file", str(file)]
        worker += ["--local-directory", str(tmp_path)]
        processes.append(subprocess.Popen(worker, cwd=tmp_path, env=environment(), **quiet))
        yield json.loads(file.read_text())["address"], first
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait(timeout=60)


def test_the_same_bits_as_serially_and_one_more_flight_is_one_more_fit(
    scheduler: "tuple[str, subprocess.Popen[bytes]]", flights: list[str], tmp_path: Path
) -> None:
    address, process = scheduler
    said = tmp_path / "said.json"

    def run(out: str, which: list[str], *how: str) -> dict[str, int]:
        done = start(*which, "--out", str(tmp_path / out), *WORDS, "--json", str(said), *how)
        printed, error = done.communicate(timeout=500)
        assert done.returncode == 0, (printed, error)
        answer: dict[str, int] = json.loads(said.read_text())
        return answer

    first = run("there", flights[2::-1], "--scheduler", address)
    assert (first["flights"], first["workers"]) == (3, 1)
    assert process.poll() is None, "a scheduler of others goes on"
    more = run("there", [flights[3], *flights[:3]], "--scheduler", address)
    alone = 4 + 1 + 1  # matches, which all know another flight now; the joint fit; the first model over the envelope
    assert more["skipped_done"] == 3
    assert more["fitted"] == 1 + alone
    status, printed = run_here(
        ["campaign", *flights, "--out", str(tmp_path / "here"), *WORDS, "--json", str(said), "--serial"], tmp_path
    )
    assert status == 0, printed
    assert repeatable(results_of(tmp_path / "there")) == repeatable(results_of(tmp_path / "here"))
    for table in ("groups/groups.parquet", "database/database.parquet"):
        assert pq.read_table(tmp_path / "there" / table).equals(pq.read_table(tmp_path / "here" / table))
    assert any(r["bootstrap_std"] for r in results_of(tmp_path / "there").to_pylist())
