"""`sideslip fly --port`: a simulated aircraft that any ground station can listen to, and `sideslip ground` does."""

import json
import signal
import socket
import subprocess
import sys
from pathlib import Path

from daq.contract.recordings.reading import read_recording
from tests.support.free_ports import free_port


def start(folder: Path, *arguments: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-u", "-m", "sideslip", *arguments]
    return subprocess.Popen(
        command, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def ended(process: "subprocess.Popen[str]", words: str = "") -> str:
    """Wait for the end; what was said since."""
    try:
        return process.communicate(words or None, timeout=60)[0]
    finally:
        process.kill()


def test_ground_station_receives_a_flight_over_tcp_and_fetches_all_of_it(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_STREAM)
    (tmp_path / "short.toml").write_text('title = "short"\n[flight]\nmanoeuvres = "rich"\nduration_s = 5.0\n')
    (tmp_path / "ground.toml").write_text(
        f'[link]\nports = "tcp:127.0.0.1:{port}"\nbackfill = "all"\n[output]\ndirectory = "out"\ndated = false\n'
    )
    station = start(tmp_path, "ground", "ground.toml", "--json", "ground.json")  # before there is anybody to hear
    aircraft = start(tmp_path, "fly", "short.toml", "--port", f"tcpin:{port}", "--speed", "10", "--out", "f")
    assert aircraft.stdout is not None
    assert station.stdout is not None
    assert station.stdin is not None
    try:
        for line in station.stdout:
            if "heard" in line:
                break
        station.stdin.write("mark\n")
        station.stdin.flush()
        for line in aircraft.stdout:
            if "landed" in line:
                break
        onboard = list(read_recording(tmp_path / "f" / "onboard").scans())
        said = ""
        for line in station.stdout:
            said += line
            if f"air and ground agree: {len(onboard)} scans" in line:
                break
        said += ended(station, "quit\n")
        aircraft.send_signal(signal.SIGINT)
        landed = ended(aircraft)
    finally:
        for process in (station, aircraft):
            process.kill()
            process.wait()
    assert station.returncode == 0, said
    assert aircraft.returncode == 130, landed
    assert "mark 1" in said
    summary = json.loads((tmp_path / "ground.json").read_text())
    assert summary["backfilled"] == len(onboard)
    received = next((tmp_path / "out").glob("aircraft*.mcap"))
    assert list(read_recording(received).scans()) == onboard
