"""The ground station as a process: telemetry over UDP, ended by a signal, with its counters and flight on disk."""

import json
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from firmware_sim.world.scenario import load_scenario
from groundstation.flight import read_flight
from groundstation.receiver.tlog import read_tlog
from sideslip import fly_scenario
from tests.support.free_ports import free_port


def taken(port: int) -> None:
    """Wait until everything sent to a UDP port has been read: a loopback socket buffers some 200 packets, then drops."""
    ending = f":{port:04X}"
    while True:
        rows = [row.split() for row in Path("/proc/net/udp").read_text().splitlines()[1:]]
        queues = [int(row[4].partition(":")[2], 16) for row in rows if row[1].endswith(ending)]
        if not any(queues):
            return
        time.sleep(0.005)


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_telemetry_over_udp_until_a_signal(ending: signal.Signals, tmp_path: Path) -> None:
    scenario = load_scenario("quiet").altered(flight={"duration_s": 12.0})
    flown = fly_scenario(scenario, tmp_path / "flight", seed=5, backfill=False)
    packets = [data for _, data in read_tlog(tmp_path / "flight" / "ground" / "telemetry.tlog")]
    port = free_port()
    (tmp_path / "ground.toml").write_text(
        f'[link]\nports = ["udpin:{port}"]\nbackfill = "off"\n[output]\ndirectory = "{tmp_path}/out"\ndated = false\n'
    )
    command = [sys.executable, "-u", "-m", "sideslip", "ground", "ground.toml", "--json", "ground.json"]
    station = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert station.stdout is not None
    try:
        assert "listening" in station.stdout.readline()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
            for number, packet in enumerate(packets):
                radio.sendto(packet, ("127.0.0.1", port))
                if number % 20 == 19:
                    taken(port)
            taken(port)
        time.sleep(0.5)
        station.send_signal(ending)
        said, _ = station.communicate(timeout=60)
    finally:
        station.kill()
        station.wait()
        station.stdout.close()
    assert station.returncode == 130, said
    summary = json.loads((tmp_path / "ground.json").read_text())
    assert summary["scans_received"] == flown.summary["scans_received"]
    assert summary["frames_damaged"] == 0
    flight = read_flight(summary["flight"])
    assert len(flight) == summary["scans_received"]
