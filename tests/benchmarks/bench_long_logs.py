"""Import of long logs and the check of a long flight: time beside the reading library's own, and memory."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.conftest import Against
from tests.benchmarks.long_logs import dataflash, ulog

SECONDS = 3600.0
"""Of flight: 44 MB of .bin, 58 MB of .ulg."""
ROOM = 600e6
"""[bytes] that a program may have beside one and a half times the flight that it writes."""
CHECKED = 600_000
"""Samples of the flight that `check` reads: 3.3 h at 50 Hz."""
CHECK_MOST = 1450.0
"""Times the reference work: 20 s on the machine where that takes 14 ms."""

MEASURED = """
import json, sys, time
begin = time.process_time()
{work}
peak = next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps([time.process_time() - begin, 1024.0 * float(peak)]))
"""
"""Most memory is of this process's own image: getrusage has that of the process that started it too."""
IMPORT = """
from pathlib import Path
from groundstation.flight import write_flight
from groundstation.importers.run import import_data
write_flight(import_data(Path(sys.argv[1])), Path(sys.argv[2]))
"""
DFREADER = """
from pymavlink import DFReader
log = DFReader.DFReader_binary(sys.argv[1])
while log.recv_msg() is not None:
    pass
"""
PYULOG = """
from pyulog import ULog
ULog(sys.argv[1])
"""
CHECK = """
import sideslip as ss
ss.check(sys.argv[1]).to_json()
"""


def spent(work: str, *words: Path) -> tuple[float, float]:
    """Processor time [s] and most memory [bytes] of a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURED.format(work=work), *map(str, words)], capture_output=True, text=True, check=True
    )
    seconds, memory = json.loads(done.stdout.splitlines()[-1])
    return seconds, memory


@pytest.mark.benchmark
@pytest.mark.parametrize(
    ("write", "reader", "most"), [(dataflash, DFREADER, 1.3), (ulog, PYULOG, 3.0)], ids=["bin", "ulg"]
)
def test_a_long_log_is_imported(compared: Against, tmp_path: Path, write: object, reader: str, most: float) -> None:
    log = write(tmp_path / "log", SECONDS)  # type: ignore[operator]
    log = log.rename(log.with_suffix(".bin" if reader == DFREADER else ".ulg"))
    flight = tmp_path / "flight.mcap"
    seconds, memory = spent(IMPORT, log, flight)
    alone, _ = spent(reader, log)
    compared(f"import of {log.stat().st_size / 1e6:.0f} MB {log.suffix} / reading library", seconds / alone, most)
    compared(f"memory of it, beside {log.suffix}", memory / (ROOM + 1.5 * flight.stat().st_size), 1.0)


@pytest.mark.benchmark
def test_a_long_flight_is_checked(compared: Against, against_reference: Against, tmp_path: Path) -> None:
    log = dataflash(tmp_path / "log.bin", CHECKED / 50.0)
    flight = tmp_path / "flight.mcap"
    spent(IMPORT, log, flight)
    seconds, memory = spent(CHECK, flight)
    against_reference(f"check of {CHECKED} samples", seconds, CHECK_MOST)
    compared("memory of it", memory / (ROOM + 1.5 * flight.stat().st_size), 1.0)
