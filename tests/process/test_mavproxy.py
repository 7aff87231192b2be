"""MAVProxy and mavlogdump, as people run them, see the aircraft, download a recording, and read our log."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from daq.clock import RealClock
from daq.telemetry.config import DownlinkConfig
from daq.telemetry.link import radio_link
from daq.transport.ports import TcpServerPort
from groundstation.receiver import events as ev
from tests.link_rig import FakeLogger, Rig, quiet_scan

MAVPROXY = Path(sys.executable).with_name("mavproxy.py")
PATIENCE_S = 60.0


@pytest.mark.skipif(not MAVPROXY.exists(), reason="MAVProxy is not installed")
def test_mavproxy_sees_the_aircraft_and_downloads_a_recording(tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    recordings.mkdir()
    content = np.random.default_rng(1).integers(0, 256, 12_000, dtype=np.uint8).tobytes()
    (recordings / "session_000.mcap").write_bytes(content)
    port, clock, logger = TcpServerPort("127.0.0.1", 0), RealClock(), FakeLogger()
    link = radio_link(DownlinkConfig(budget_bytes_per_s=60_000), port, clock, recordings=(recordings,), boot=3)
    said = tmp_path / "said"
    command = [sys.executable, str(MAVPROXY), f"--master=tcp:127.0.0.1:{port.address[1]}", "--default-modules=log,link"]
    environment = {**os.environ, "HOME": str(tmp_path), "MAVLINK20": "1"}
    with said.open("w") as out:
        proxy = subprocess.Popen(
            [*command, f"--state-basedir={tmp_path}"],
            cwd=tmp_path,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=out,
            stderr=subprocess.STDOUT,
        )
    rng, number = np.random.default_rng(2), 0

    def fly_until(done: Callable[[], bool]) -> None:
        nonlocal number
        deadline = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < deadline, said.read_text()
            now = clock.monotonic_ns()
            link.offer(quiet_scan(number, rng, time_ns=now))
            number += 1
            link.uplink.service(now, logger)
            link.service(now)
            time.sleep(0.02)

    def ask(words: str) -> None:
        assert proxy.stdin is not None
        proxy.stdin.write(words.encode() + b"\n")
        proxy.stdin.flush()

    try:
        fly_until(lambda: "Detected vehicle 1:1" in said.read_text())
        link.text(4, "hello from the aircraft")
        fly_until(lambda: "hello from the aircraft" in said.read_text())
        ask("log list")
        fly_until(lambda: "size 12000" in said.read_text())
        ask("log download 1 got.bin")
        fly_until(lambda: "Finished downloading" in said.read_text())
    finally:
        proxy.kill()
        proxy.communicate()
        link.close()
    assert (tmp_path / "got.bin").read_bytes() == content


@pytest.mark.skipif(not MAVPROXY.exists(), reason="pymavlink's tools are not installed")
def test_mavlogdump_reads_the_telemetry_log_of_a_bad_link(tmp_path: Path) -> None:
    rng, damage = np.random.default_rng(2), np.random.default_rng(3)
    rig = Rig(tmp_path, down=lambda data: data[:9] + data[10:] if damage.random() < 0.05 else data)
    rig.fly(200, lambda n: quiet_scan(n, rng, time_ns=rig.clock.monotonic_ns()))
    rig.link.text(4, "low airspeed")
    rig.rest(1)
    rig.close()
    dump = subprocess.run(
        [sys.executable, str(MAVPROXY.with_name("mavlogdump.py")), str(tmp_path / "telemetry.tlog")],
        capture_output=True,
        text=True,
        env={**os.environ, "HOME": str(tmp_path), "MAVLINK20": "1"},
        check=True,
        timeout=PATIENCE_S,
    ).stdout
    assert dump.count("HEARTBEAT {type : 1") == sum(isinstance(e, ev.Heartbeat) for e in rig.events)
    assert "UNKNOWN_44100" in dump
    for kind in ("ATTITUDE {", "GPS_RAW_INT {", "STATUSTEXT {severity : 4, text : low airspeed"):
        assert kind in dump
