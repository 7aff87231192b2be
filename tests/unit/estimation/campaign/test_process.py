"""The command as people run it: workers that die, a client that is killed, numbers that do not care."""

import json
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from estimation.campaign.run import CampaignOutcome
from tests.cli.docs.follow import run_here
from tests.unit.estimation.campaign.running import HOSTILE, altered, children, repeatable, results_of, start, workers_of

pytestmark = [pytest.mark.timeout(300)]


def wait_until(true: Callable[[], object], process: "subprocess.Popen[str]", limit_s: float = 120.0) -> None:
    """Poll; the process must not end meanwhile."""
    end = time.monotonic() + limit_s
    while not true():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.05)


def test_bad_flights_are_sentences_and_the_others_as_without_an_engine(
    campaign: Callable[..., CampaignOutcome], flights: list[str], tmp_path: Path
) -> None:
    """Two workers, any order, two of whom a flight kills and hangs: the same bits as one after the other in one process."""
    folder = tmp_path / "flights"
    folder.mkdir()
    for path in flights:
        shutil.copy(path, folder)
    first = Path(flights[0])
    altered(first, folder / "kills.csv", 1.0)
    altered(first, folder / "hangs.csv", 2.0)
    (folder / "truncated.csv").write_text(first.read_text()[:40_003])
    (folder / "empty.csv").write_text("")
    os.mkfifo(folder / "pipe.csv")
    out, said = tmp_path / "out", tmp_path / "said.json"
    words = ("--out", str(out), "--aircraft", "cdfp", "--workers", "2", "--json", str(said), "--no-report")
    process = start(str(folder), *words, "--method", f"{HOSTILE},ls", "--time-limit", "8")
    printed, error = process.communicate(timeout=280)
    assert process.returncode == 1, (printed, error)
    answer = json.loads(said.read_text())
    assert (answer["flights"], answer["done"], answer["fitted"]) == (9, 4, 8)
    why = {Path(f["flight"]).stem: f["why"] for f in answer["failed"]}
    for name, words_ in {
        "kills": "died four times",
        "hangs": "took longer than 8 s",
        "truncated": "cells, the header has",
        "empty": "not a header",
        "pipe": "not a file that can be read again",
    }.items():
        assert words_ in why.pop(name)
    assert not why
    serial = campaign({"flights": flights[::-1], "methods": [HOSTILE, "ls"]}, tmp_path / "serial")
    assert serial.done == 4
    found = results_of(out)
    kept = pc.is_in(found["key"], value_set=serial.results["key"].combine_chunks())
    assert repeatable(found.filter(kept)) == repeatable(serial.results)
    assert "Traceback" not in error


def test_killed_client_and_worker_lose_and_repeat_nothing_that_is_on_disk(flights: list[str], tmp_path: Path) -> None:
    folder = tmp_path / "flights"
    folder.mkdir()
    for i in range(10):
        altered(Path(flights[i % 4]), folder / f"slow{i}.csv", float(1 + i))
    out, said = tmp_path / "out", tmp_path / "said.json"
    words = (str(folder), "--out", str(out), "--aircraft", "cdfp", "--workers", "1", "--json", str(said))
    words = (*words, "--method", HOSTILE, "--no-report")
    process = start(*words, SLOW_S="0.7")
    wait_until(lambda: list((out / "results").glob("*.parquet")), process)
    below = children(process.pid)
    process.kill()
    process.communicate()
    end = time.monotonic() + 60.0
    while any(Path(f"/proc/{c}").exists() and "Z" not in Path(f"/proc/{c}/stat").read_text() for c in below):
        assert time.monotonic() < end, "workers outlive their client"
        time.sleep(0.1)
    kept = set(results_of(out)["flight"].to_pylist())
    assert 0 < len(kept) < 9

    process = start(*words, SLOW_S="0.7")
    wait_until(lambda: len(list((out / "results").glob("*.parquet"))) > 1, process)
    os.kill(min(workers_of(process.pid)), signal.SIGKILL)
    printed, error = process.communicate(timeout=200)
    assert process.returncode == 0, (printed, error)
    answer = json.loads(said.read_text())
    assert (answer["skipped_done"], answer["fitted"]) == (len(kept), 10 - len(kept))
    runs = results_of(out).filter(pc.equal(results_of(out)["kind"], "run"))
    assert sorted(runs["flight"].to_pylist()) == [f"slow{i}" for i in range(10)]
    assert len(list((out / "results").iterdir())) == 1


@pytest.mark.usefixtures("unwritten_figures")
def test_simulated_flights_are_flown_on_the_worker_and_known_again(tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(
        'methods = ["ls"]\n[[simulate]]\nscenario = "quiet"\ncount = 2\nset = {"flight.duration_s" = 10.0}\n'
        'vary = {"flight.speed_m_s" = [15.0, 19.0]}\n'
    )
    said = tmp_path / "said.json"
    words = (str(plan), "--out", str(tmp_path / "out"), "--serial", "--json", str(said))
    for done, fitted in ((0, 2), (2, 0)):
        status, printed = run_here(["campaign", *words], tmp_path)
        assert status == 0, printed
        answer = json.loads(said.read_text())
        assert (answer["skipped_done"], answer["fitted"]) == (done, fitted)
    page = (tmp_path / "out" / "report" / "index.html").read_text()
    assert "2 estimated" in page
    assert not re.search(r"(src|href)=.https?:", page)
    rows = pq.read_table(tmp_path / "out" / "results").to_pylist()
    speeds = sorted({r["V"] for r in rows if r["kind"] == "run"})
    assert len(speeds) == 2
    assert 14.0 < speeds[0] < speeds[1] < 20.0
