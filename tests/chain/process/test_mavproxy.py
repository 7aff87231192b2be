"""MAVProxy and mavlogdump, as people run them, see the aircraft, download a recording, and read our log."""

import math
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from daq.clock import RealClock
from daq.telemetry.config import DisplayConfig, DownlinkConfig
from daq.telemetry.link import radio_link
from daq.transport.ports import TcpServerPort
from groundstation.receiver import events as ev
from tests.support.link_rig import FakeLogger, Rig, quiet_scan

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


WARNINGS = re.compile(
    r"(?i)warn|time.?out|timed|fail|error|lost|breach|no link|\bdown\b|critical|unable|traceback|wrapped"
)
SHOWN = {
    "VFR_HUD": r"airspeed : 13\.\d",
    "GLOBAL_POSITION_INT": "relative_alt : 0",
    "AOA_SSA": r"AOA : [45]\.\d",
    "BATTERY_STATUS": r"voltages : \[1[0-2]\d{3}, 65535",
    "SYS_STATUS": r"voltage_battery : 1[0-2]\d{3}\b",
    "SERVO_OUTPUT_RAW": "servo4_raw : 1000",
    "HEARTBEAT": "autopilot : 8",
}
_PA = 101325 * ((1 + 0.2 * (13.05 / 340.294) ** 2) ** 3.5 - 1)  # of 13.05 m/s calibrated airspeed


@pytest.mark.skipif(not MAVPROXY.exists(), reason="MAVProxy is not installed")
def test_stock_mavproxy_shows_the_aircraft_and_has_nothing_to_complain_of(tmp_path: Path) -> None:
    """All its default modules, no options: parameters, files, missions, fences and home are asked for, all answered."""
    display = DisplayConfig(
        pitot_zero_count=0,
        pitot_pa_per_count=_PA / 8192,
        alpha_zero_count=0,
        alpha_rad_per_count=math.radians(5.05) / 100,
        beta_zero_count=0,
        beta_rad_per_count=1e-4,
    )
    config = DownlinkConfig(display=display, supply_volts_per_count=0.115)
    with Station(tmp_path, config) as station:
        station.fly_until(lambda: "Received 2 parameters" in station.said)
        for kind, words in SHOWN.items():
            station.ask_until(f"status {kind}", words)
        for kind in ("wp", "fence", "rally"):
            station.ask(f"{kind} list")
        station.fly_until(lambda: station.said.count("Requesting 0") == 3)
        station.ask("ftp list")
        station.fly_until(lambda: "Total size" in station.said)
        station.ask("param show *")
        station.fly_until(lambda: "BATT_MONITOR     3.0" in station.said)
        start = time.monotonic()
        station.fly_until(lambda: time.monotonic() - start > 6)  # its requests are given up after some five seconds
    spoken = [line for line in station.said.splitlines() if "{" not in line and "DOWNLINK_RATE" not in line]
    assert not [line for line in spoken if WARNINGS.search(line)]


class Station:
    """A stock MAVProxy connected to an aircraft that stands still, in real time."""

    def __init__(self, folder: Path, config: DownlinkConfig) -> None:
        port, self._clock, self._logger = TcpServerPort("127.0.0.1", 0), RealClock(), FakeLogger()
        self._link = radio_link(config, port, self._clock, boot=3)
        self._said = folder / "said"
        self._rng, self._number = np.random.default_rng(2), 0
        command = [sys.executable, str(MAVPROXY), f"--master=tcp:127.0.0.1:{port.address[1]}"]
        with self._said.open("w") as out:
            self._proxy = subprocess.Popen(
                [*command, f"--state-basedir={folder}"],
                cwd=folder,
                env={**os.environ, "HOME": str(folder)},
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=subprocess.STDOUT,
            )

    @property
    def said(self) -> str:
        return self._said.read_text()

    def ask_until(self, words: str, pattern: str) -> None:
        """Ask every second until it says what is expected: what comes seldom may not have come yet."""
        asked = -math.inf

        def answered() -> bool:
            nonlocal asked
            if time.monotonic() - asked > 1:
                asked = time.monotonic()
                self.ask(words)
            return re.search(pattern, self.said) is not None

        self.fly_until(answered)

    def ask(self, words: str) -> None:
        assert self._proxy.stdin is not None
        self._proxy.stdin.write(words.encode() + b"\n")
        self._proxy.stdin.flush()

    def fly_until(self, done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < deadline, self.said
            now = self._clock.monotonic_ns()
            self._link.offer(quiet_scan(self._number, self._rng, time_ns=now))
            self._number += 1
            self._link.uplink.service(now, self._logger)
            self._link.service(now)
            time.sleep(0.05)

    def __enter__(self) -> "Station":
        return self

    def __exit__(self, *_: object) -> None:
        self._proxy.kill()
        self._proxy.communicate()
        self._link.close()


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
