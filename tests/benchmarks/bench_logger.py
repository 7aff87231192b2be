"""What the logger costs: CPU, memory and deadlines at 20 Hz in real time; seconds by LOGGER_BENCH_S, default 60.

The bus is replayed, so that no simulator runs in the measured process; on hardware add the system calls of some 45 bus
transfers a scan. Run by `make bench`.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from daq.contract.accounting import verify
from daq.health import HealthSummary
from firmware_sim.flight import prepare_flight
from firmware_sim.scenario import load_scenario
from tests.benchmarks.replayed_bus import RecordingBus

ROOT = Path(__file__).resolve().parents[2]
SECONDS = float(os.environ.get("LOGGER_BENCH_S", "60"))


def record_answers(folder: Path) -> Path:
    """Fly a minute in simulation and keep what the chips said."""
    flight = prepare_flight(load_scenario("nominal"), folder / "flight", duration_s=60)
    sampler = flight.assembly.sampler
    recorder = RecordingBus(flight.aircraft.bus)
    for supervisor in sampler._on_bus:
        supervisor.driver._bus = recorder  # type: ignore[attr-defined]
    start = sampler.start

    def started() -> HealthSummary:
        summary = start()
        recorder.scans_begin()
        return summary

    sampler.start = started  # type: ignore[method-assign]
    flight.run()
    path = folder / "answers.json"
    recorder.save(path)
    return path


def bench_config(folder: Path) -> Path:
    """The example configuration without GPS, recording into `folder`."""
    text = (ROOT / "daq/configs/cdfp.toml").read_text()
    before, gnss, after = text.partition("[sensors.gnss]")
    text = before + after[after.index("[downlink]") :] if gnss else text
    text = text.replace('calibration = "/etc/sideslip/calibration"', "")
    text = text.replace("/var/lib/sideslip/recordings", str(folder / "recordings"))
    path = folder / "bench.toml"
    path.write_text(text)
    return path


@pytest.mark.benchmark
@pytest.mark.timeout(SECONDS + 120)
def test_logger_in_real_time(tmp_path: Path) -> None:
    answers, config = record_answers(tmp_path), bench_config(tmp_path)
    script = ROOT / "tests/benchmarks/logger_process.py"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(script), str(config), str(answers), str(SECONDS)]
    done = subprocess.run(command, check=False, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    print(json.dumps(result, indent=1))
    assert verify(tmp_path / "recordings").ok
    assert result["written"] == result["slots"] - result["missed"]
    assert result["cpu_percent"] < 2.0
    assert max(result["resident_mb"]) < 80.0
    assert result["resident_mb"][-1] - result["resident_mb"][0] < 2.0, "resident memory must be flat"
    assert result["missed"] == 0
