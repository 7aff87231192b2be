"""Ctrl-C at any moment of a command: exit status 130, one line, no traceback, files closed.

Python told to report its imports (`-X importtime`) says on standard error what it has just imported: that is the clock by
which the interrupt is sent, so that each run is interrupted at the instant it is meant to be, however slow the machine.
"""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from tests.support.paths import ROOT

RECORDINGS = ROOT / "recordings"
FIRST = "daq.utilities.interrupts"
"""Our first import: what comes before is Python's own start, in which nobody can interfere; from the next one on we answer."""

VERBS: dict[str, list[str]] = {
    "help": ["--help"],
    "info": ["info", str(RECORDINGS / "cdfp_ld1_raw.mcap")],
    "import": ["import", str(RECORDINGS / "foreign" / "ordinary_0.csv"), "-o", "flight.mcap"],
    "check": ["check", str(RECORDINGS / "cdfp_ld1.mcap"), "--json", "check.json"],
    "estimate": ["estimate", str(RECORDINGS / "cdfp_ld1.mcap"), "--method", "ml", "--report", "report"],
    "fly": ["fly", "nominal", "--out", "flown"],
}


def _started(words: Sequence[str], folder: Path) -> "subprocess.Popen[str]":
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-X", "importtime", "-m", "sideslip", *words],
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def _interrupted(words: Sequence[str], folder: Path, due: Callable[[int, str], bool]) -> tuple[int, str, bool]:
    """Exit status, what was said beside the list of imports, and whether the interrupt was sent before the end.

    due: told the number of our imports so far and the last line; the interrupt is sent when it says so.
    """
    said, count, sent = [], -1, False
    with _started(words, folder) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if not line.startswith("import time:"):
                said.append(line)
            else:
                count += 1 if count >= 0 or line.rsplit("|", 1)[1].strip() == FIRST else 0
            if not sent and count >= 0 and due(count, line):
                process.send_signal(signal.SIGINT)
                sent = True
        return process.wait(timeout=60), "".join(said), sent


def _after(imports: int) -> Callable[[int, str], bool]:
    return lambda number, line: number >= max(1, imports)


def _imports(words: Sequence[str], folder: Path) -> int:
    """How many imports a verb makes from our first one on."""
    seen = 0

    def count(number: int, line: str) -> bool:
        nonlocal seen
        seen = number
        return False

    status, said, _ = _interrupted(words, folder, count)
    assert status in (0, 1), said
    return seen


@pytest.mark.parametrize("verb", ["help", "info", "import"])
def test_interrupt_during_imports(verb: str, tmp_path: Path) -> None:
    total = _imports(VERBS[verb], tmp_path)
    for share in (0.0, 0.4, 0.9):
        status, said, sent = _interrupted(VERBS[verb], tmp_path, _after(int(share * total)))
        assert sent
        assert "Traceback" not in said, said
        assert said.count("sideslip: interrupted") == 1, said
        assert status == 130


@pytest.mark.study
@pytest.mark.timeout(0)
@pytest.mark.parametrize("verb", list(VERBS))
def test_interrupt_at_many_instants(verb: str, tmp_path: Path) -> None:
    """Twenty instants of each verb."""
    total = _imports(VERBS[verb], tmp_path)
    for i in range(20):
        folder = tmp_path / str(i)
        folder.mkdir()
        status, said, _ = _interrupted(VERBS[verb], folder, _after(i * total // 20))
        assert "Traceback" not in said, said
        assert status == 130, said


def test_interrupt_in_flight_closes_the_recording(tmp_path: Path) -> None:
    """Half of it is flown when the interrupt comes; afterwards the recording of that half is sound."""
    onboard = tmp_path / "flown" / "onboard"
    (tmp_path / "short.toml").write_text("[flight]\nduration_s = 8.0\n")
    status, said, sent = _interrupted(
        ["fly", "short.toml", "--out", "flown"], tmp_path, lambda _, line: re.search(r"[45]\d%", line) is not None
    )
    assert sent
    assert status == 130, said
    assert "Traceback" not in said
    checked = subprocess.run(
        [sys.executable, "-m", "sideslip", "verify", str(onboard)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_a_job_in_the_background_is_not_interrupted(tmp_path: Path) -> None:
    """A shell starts such a job with SIGINT ignored, and means it."""
    command = f'trap "" INT; exec {sys.executable} -X importtime -m sideslip --help'
    process = subprocess.Popen(
        ["sh", "-c", command],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    with process:
        assert process.stderr is not None
        for line in process.stderr:
            if FIRST in line:
                process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 0
