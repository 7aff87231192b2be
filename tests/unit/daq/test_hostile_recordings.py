"""Whatever the bytes of a file, every verb answers it within 10 s of processor time and 500 MB, with a status, no traceback."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.unit.daq.hostile import CASES, TLOGS

SECONDS, MEGABYTES = 10, 500
READERS = ("verify", "info", "recover")
OPENERS = ("calibrate", "calibrate with", "check")
LIBRARIES = 700
"""Address space [MB] that numpy, pydantic and the estimation's libraries map besides, before a byte is read."""


FOR_OPENERS = (
    "tags 16 KiB", "zstd of 4 GiB claiming 1 MiB", "scans 0 and 2^32-1", "tiny scans", "statistics that lie", "identity nested",
    "calibration that is no text", "calibration nested", "facts that are none", "segment number huge",
)  # fmt: skip


def bounded(
    folder: Path, verbs: tuple[str, ...], megabytes: int, cases: tuple[str, ...], ending: str = ".mcap"
) -> dict[str, tuple[int, ...]]:
    """Exit statuses of the verbs by case, each file within the limits; the reason where the run ended before a case."""
    files = []
    for name in cases:
        file = folder / f"{name}{ending}"
        file.write_bytes((CASES | TLOGS)[name]())
        assert file.stat().st_size < 16 << 20
        files.append(str(file))
    command = [sys.executable, "-m", "tests.unit.daq.bounded", str(SECONDS), str(megabytes), ",".join(verbs), *files]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    rows = [line.split("\t") for line in done.stdout.splitlines() if line.startswith("bounded\t")]
    found = {name: tuple(map(int, statuses)) for _, name, *statuses in rows}
    if len(found) < len(cases):
        pytest.fail(f"{cases[len(found)]!r} ended the run (status {done.returncode}): {done.stderr[-1500:]}")
    return found


@pytest.mark.timeout(600)
def test_readers_are_bounded(tmp_path: Path) -> None:
    found = bounded(tmp_path, READERS, MEGABYTES, tuple(CASES))
    assert {name for name, statuses in found.items() if not set(statuses) <= {0, 1, 2}} == set()
    assert found["noise 1 MiB"] == (2, 2, 2)
    assert found["scans 0 and 2^32-1"] == (1, 0, 1)
    assert found["tiny scans"] == (1, 0, 1)


@pytest.mark.timeout(600)
def test_what_makes_or_opens_a_flight_is_bounded(tmp_path: Path) -> None:
    found = bounded(tmp_path, OPENERS, MEGABYTES + LIBRARIES, FOR_OPENERS)
    assert {name for name, statuses in found.items() if not set(statuses) <= {0, 1, 2}} == set()
    assert found["statistics that lie"][1] == 0, "what is intact is calibrated"


@pytest.mark.timeout(600)
def test_readers_of_telemetry_logs_are_bounded(tmp_path: Path) -> None:
    found = bounded(tmp_path, ("info", "verify", "calibrate"), MEGABYTES + LIBRARIES, tuple(TLOGS), ".tlog")
    assert {name for name, statuses in found.items() if not set(statuses) <= {0, 1, 2}} == set()
    assert found["frames among noise"][0] == 0
    assert found["heads of frames"][0] == 2
