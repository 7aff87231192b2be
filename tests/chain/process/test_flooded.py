"""The logger while somebody sends to its radio port at full loopback speed: it ends when told, and its sums close."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from daq.assembly import HardwareEdge
from daq.clock import RealClock
from daq.config import parse_config
from daq.contract.recordings.accounting import verify
from daq.service.run import run_until_signal
from daq.transport.ports import UdpPort
from tests.support.paths import ROOT

LASTS_S = 30  # of the flood: who waits for its end instead of ending when told is found out by that


class Watched(UdpPort):
    """A listening port that counts what it has given."""

    given = 0

    def receive(self, limit: int = 65536) -> list[tuple[str, bytes]]:
        out = super().receive(limit)
        self.given += sum(len(data) for _, data in out)
        return out


class Ends(RealClock):
    """Raises SIGTERM in this process some waits after the port has been flooded."""

    def __init__(self, port: Watched) -> None:
        self._port = port
        self._left = 60

    def sleep_until(self, monotonic_ns: int) -> None:
        super().sleep_until(monotonic_ns)
        if self._port.given > 20_000 or self._port.dropped > 100:
            self._left -= 1
            if self._left == 0:
                signal.raise_signal(signal.SIGTERM)


@pytest.mark.parametrize("kind", ["noise of 0xFD, 280 bytes", "0xFD, 60 kB", "all"])
def test_told_to_end_it_ends_though_the_flood_goes_on(tmp_path: Path, kind: str) -> None:
    text = '[recorder]\ndirectories = ["rec"]\n[scan]\nrate_hz = 50\n[sensors]\n[downlink]\n'
    config = parse_config(text, tmp_path / "logger.toml")
    port = Watched(local=("127.0.0.1", 0))
    command = [sys.executable, "-m", "tests.support.hostile_sender", str(port.address[1]), kind, str(LASTS_S)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL) as sender:
        edge = HardwareEdge(Ends(port), None, None, "simulated", radio=port)
        outcome = run_until_signal(config, text, edge, [])
        flooding = sender.poll() is None
        sender.terminate()
    port.close()
    assert flooding, "the logger ended only when nothing came in any more"
    assert outcome.signal_name == "SIGTERM"
    statistics = outcome.statistics
    assert statistics.closes
    assert statistics.slots == statistics.written + statistics.missed
    sessions = sorted(p for p in (tmp_path / "rec").iterdir() if p.is_dir())
    assert len(sessions) <= 3
    for session in sessions:
        result = verify(session)
        assert result.ok, result.text
