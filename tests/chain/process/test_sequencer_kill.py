"""kill -9 of the process that flies a manoeuvre: its heartbeat is over with it, and the hardware gives the aircraft back."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from firmware_sim.hardware.cockpit import Monostable, Multiplexer
from tests.support.paths import ROOT

MS = 1_000_000


@pytest.mark.parametrize("seed", [1, 2])
def test_killed_while_it_flies(tmp_path: Path, seed: int) -> None:
    line = tmp_path / "line"
    os.mkfifo(line)
    command = [sys.executable, str(ROOT / "tests/chain/process/sequencing.py"), str(line)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, text=True)
    edges: list[int] = []
    with line.open("rb", buffering=0) as beats:
        assert process.stdout is not None
        with process.stdout:
            while process.stdout.readline().strip() != "RUNNING":
                assert process.poll() is None, "the sequencer ended before it ran"
            until = time.monotonic() + random.Random(seed).uniform(0.2, 0.5)
            while time.monotonic() < until:
                edges += [time.monotonic_ns()] * beats.read(64).count(b"1")
            process.send_signal(signal.SIGKILL)
            killed = time.monotonic_ns()
            while data := beats.read(4096):  # to the end of the pipe: the writer is gone
                edges += [killed] * data.count(b"1")
            process.wait()
    assert process.returncode == -signal.SIGKILL
    assert len(edges) > 5
    now = [0]
    monostable = Monostable(lambda: now[0])
    for edge in edges:
        now[0] = edge
        monostable.beat()
    multiplexer = Multiplexer(lambda time_ns: 2000.0, monostable.up)
    assert multiplexer.selects_second(edges[-1] + 25 * MS)
    assert not any(multiplexer.selects_second(killed + 100 * MS + k * MS) for k in range(200))
