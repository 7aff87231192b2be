"""The ground station as a person starts it, against an aircraft of which every fact and every message is bad in every way."""

import json
import signal
import subprocess
import sys
import time
from itertools import cycle
from pathlib import Path
from socket import SOCK_STREAM

import numpy as np
import pytest

from daq.clock import RealClock
from daq.contract.recordings.reading import read_recordings
from daq.contract.recordings.recording import CALIBRATION_PREFIX, CONFIG_ATTACHMENT, RecordingInfo
from daq.telemetry.config import DownlinkConfig
from daq.telemetry.link import radio_link
from daq.transport.mavlink_codec import FrameEncoder
from daq.transport.ports import UdpPort
from tests.support.bad_values import bad_frames
from tests.support.free_ports import free_port
from tests.support.link_rig import FakeLogger, quiet_scan
from tests.unit.groundstation.test_quarantine import BAD, NUMBER_FACTS

pytestmark = [pytest.mark.timeout(180)]

PERIOD_S = 0.05
FACTS = {**dict(zip(NUMBER_FACTS, cycle(BAD), strict=False)), "static.nvm": "zz", "\x1b[2J": "\u202e", "x" * 128: "nan"}
ATTACHMENTS = {
    CONFIG_ATTACHMENT: b"[recorder]\nrate = nan\n" + b"[" * 2000,
    f"{CALIBRATION_PREFIX}imu.toml": b"[imu]\nscale = [nan, inf, 1e400]\n",
    f"{CALIBRATION_PREFIX}../../etc/x.toml": b"x = 1\n",
}


def _fly(port: int, station: "subprocess.Popen[bytes]", frames: list[bytes]) -> int:
    """Scans as sound as any, and all that is bad between them, from one sender; how many scans went after the last bad frame."""
    clock, wire = RealClock(), UdpPort(remote=("127.0.0.1", port))
    info = RecordingInfo("flight1", "simulated", "cdfp\u202e<script>", details=FACTS, attachments=ATTACHMENTS)
    link = radio_link(DownlinkConfig(budget_bytes_per_s=60_000), wire, clock, papers=lambda: info, boot=7)
    rng, logger, number, before = np.random.default_rng(7), FakeLogger(), 0, 0
    while station.poll() is None and (frames or len(link.downlink.sent) - before < 60):
        link.offer(quiet_scan(number, rng, time_ns=clock.monotonic_ns()))
        link.service(clock.monotonic_ns())
        link.uplink.service(clock.monotonic_ns(), logger)
        if number > 60:
            for data in frames[:60]:
                wire.write(data)
            del frames[:60]
        before = before if not frames else len(link.downlink.sent)
        number += 1
        time.sleep(PERIOD_S)
    sent = len(link.downlink.sent) - before
    link.close()
    wire.close()
    return sent


def test_the_session_goes_on_and_names_each_bad_thing_once(tmp_path: Path) -> None:
    port = free_port()
    view = f"[view]\nport = {free_port(SOCK_STREAM)}\nweb_port = {free_port(SOCK_STREAM)}\n"
    (tmp_path / "g.toml").write_text(f'[link]\nports = ["udpin:127.0.0.1:{port}"]\n{view}')
    command = [sys.executable, "-m", "sideslip", "ground", "g.toml", "--out", "s", "--view", "web", "--json", "g.json"]
    frames = [f.data for f in bad_frames(FrameEncoder(1, 1), {})]
    with (tmp_path / "said").open("wb") as said:
        station = subprocess.Popen(command, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=said, stderr=said)
        try:
            while b"listening" not in (tmp_path / "said").read_bytes() and station.poll() is None:
                time.sleep(0.1)
            sent = _fly(port, station, frames)
            time.sleep(1.0)
            assert station.poll() is None, (tmp_path / "said").read_text()
            station.send_signal(signal.SIGTERM)
            assert station.wait(90) in (0, 130)
        finally:
            station.kill()
            station.wait()
    words = (tmp_path / "said").read_text("utf-8")
    assert "Traceback" not in words
    assert "\x1b" not in words
    summary = json.loads((tmp_path / "g.json").read_text())
    named = {str(row["what"]) for row in summary["quarantined"]}
    assert named >= {f"fact {name}" for name in NUMBER_FACTS}
    assert {n for n in named if not n.startswith("fact ")} == set()
    for name in NUMBER_FACTS:
        assert words.count(f"fact {name} not used") == 1
    numbers = [
        n for path in (tmp_path / "s").glob("aircraft1_*.mcap") for r in read_recordings(path) for n in r.numbers
    ]
    assert sent >= 50
    assert len([n for n in numbers if n < 10_000]) >= sent
    assert not (tmp_path / "etc").exists()
