"""kill -9 at random instants of a running flight: at most the last second is lost, and the sums close."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from daq.contract.recordings.accounting import verify
from daq.contract.recordings.reading import read_recording
from daq.contract.recordings.recovery import recover
from tests.support.paths import ROOT

SPEED = 4.0
ONE_SECOND = 20


def nothing() -> None:
    return


def fly_and_kill(folder: Path, seed: int, at_the_end: Callable[[], None] = nothing) -> tuple[int, int]:
    """Kill a flight some time into a scan chosen by `seed`; returns (scans taken, scans in the file).

    at_the_end: done just before.
    """
    chance = random.Random(seed)
    last, into = chance.randint(6, 200), chance.uniform(0.0, 1.5 / 20 / SPEED)
    command = [sys.executable, str(ROOT / "tests/chain/process/flying.py"), str(folder), str(SPEED), str(seed)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment)
    assert process.stdout is not None
    assert process.stderr is not None
    with process.stdout, process.stderr:
        while int(process.stdout.readline() or last) < last:
            pass
        time.sleep(into)
        at_the_end()
        process.send_signal(signal.SIGKILL)
        told = [str(last).encode(), *process.stdout.read().split()]
        errors = process.stderr.read()
        process.wait()
    assert process.returncode == -signal.SIGKILL, errors.decode()
    taken = int(told[-1])
    onboard = folder / "onboard"
    result = verify(onboard)
    assert not result.ok
    assert not result.closed
    assert result.slots == result.scans == result.written, result.text
    assert result.missing == ()
    if not result.scans:
        return taken, 0  # killed before the first flush: the file has its head and nothing to recover
    saved = recover(onboard, folder / "recovered.mcap")
    assert saved.recovered == result.scans
    assert verify(folder / "recovered.mcap").ok
    assert read_recording(folder / "recovered.mcap").info.source == "simulated"
    return taken, result.scans


def check(folder: Path, seeds: range) -> list[int]:
    """Kill one flight for each seed, two at a time; returns the scans lost in each."""
    with ThreadPoolExecutor(2) as pool:
        outcomes = list(pool.map(lambda seed: fly_and_kill(folder / str(seed), seed), seeds))
    lost = [taken - kept for taken, kept in outcomes]
    assert max(lost) <= ONE_SECOND, f"scans lost at each kill: {lost}"
    return lost


def test_kill_loses_at_most_the_last_second(tmp_path: Path) -> None:
    check(tmp_path, range(4))


@pytest.mark.study
@pytest.mark.timeout(600)
def test_kill_at_fifty_instants(tmp_path: Path) -> None:
    lost = check(tmp_path, range(100, 150))
    print(f"50 kills: scans lost mean {sum(lost) / len(lost):.1f}, worst {max(lost)}")
