"""Words typed at a running ground station reach the aircraft, and what comes of them is said."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from daq.contract.recordings.messages import SequencerFrame
from daq.transport.mavlink_codec import FrameEncoder
from groundstation.live.config import GroundConfig
from groundstation.live.console import Console, Lines
from groundstation.live.station import Station
from groundstation.receiver.ports import LinkConfig
from tests.support.link_rig import Rig, quiet_scan


class Desktop:
    """A rig whose ground end is a whole station with a console."""

    def __init__(self, folder: Path) -> None:
        recordings = folder / "card"
        recordings.mkdir()
        (recordings / "session_000.mcap").write_bytes(bytes(range(256)) * 20)
        self.said: list[str] = []
        self.rig = Rig(folder, ground=LinkConfig(ports=("memory",), backfill="lost"), recordings=(recordings,))
        self.station = Station(GroundConfig(), self.rig.ground, self.rig.clock, folder, echo=self.said.append)
        self.rig.look = self.station.step  # type: ignore[method-assign]
        self.read_end, self.write_end = os.pipe()
        self.console = Console(self.station, Lines(self.read_end), self.said.append)
        self._rng = np.random.default_rng(1)

    def fly(self, scans: int) -> None:
        self.rig.fly(scans, lambda n: quiet_scan(n, self._rng, time_ns=self.rig.clock.monotonic_ns()))

    def type(self, text: str, scans: int = 40) -> str:
        """Type a line, let time pass; what was said since."""
        before = len(self.said)
        os.write(self.write_end, text.encode() + b"\n")
        self.console.poll()
        self.fly(scans)
        self.console.poll()
        return "\n".join(self.said[before:])

    def close(self) -> None:
        os.close(self.read_end)
        os.close(self.write_end)
        self.rig.link.close()
        self.station.close()


@pytest.fixture
def desktop(tmp_path: Path) -> Iterator[Desktop]:
    made = Desktop(tmp_path)
    yield made
    made.close()


def test_commands_reach_the_aircraft(desktop: Desktop) -> None:
    assert "has been heard" in desktop.type("mark", scans=0)
    desktop.fly(60)
    assert "accepted" in desktop.type("mark")
    assert desktop.rig.logger.marks == [("mark 1", "ground")]
    assert "accepted" in desktop.type("stop")
    assert (desktop.rig.logger.stops, desktop.rig.logger.recording) == (1, False)
    assert "accepted" in desktop.type("start")
    assert desktop.rig.logger.recording
    assert "accepted" in desktop.type("rate 5")
    assert desktop.rig.link.downlink.rate_hz == 5.0
    assert "denied" in desktop.type("rate 1")
    assert "accepted" in desktop.type("1 rate 0")
    assert desktop.rig.link.downlink.rate_hz == desktop.rig.aircraft_config.rate_hz
    assert "accepted" in desktop.type("zero")
    assert desktop.rig.logger.marks[-1][0].startswith("pitot_zero")


def test_several_aircraft_are_told_apart(desktop: Desktop) -> None:
    desktop.fly(40)
    other = FrameEncoder(2, 1)
    for _ in range(3):
        desktop.rig._ground.write(other.message("HEARTBEAT", type=1, autopilot=0, system_status=4))
        desktop.fly(5)
    assert desktop.station.receiver.systems == [1, 2]
    assert "begin with its number: 1, 2" in desktop.type("mark")
    assert desktop.rig.logger.marks == []
    assert "aircraft 1" in desktop.type("1 mark")
    assert desktop.rig.logger.marks == [("mark 1", "ground")]
    assert "aircraft 2" in desktop.type("status")


def test_recordings_are_listed_and_fetched(desktop: Desktop, tmp_path: Path) -> None:
    desktop.fly(40)
    assert "type logs first" in desktop.type("fetch 1")
    found = ""
    while "recording 1: 5120 bytes" not in found:  # the card is read by a thread
        found = desktop.type("logs")
    desktop.type("fetch 1")
    for _ in range(400):
        if any("is here" in line for line in desktop.said):
            break
        desktop.fly(5)
        desktop.console.poll()
    assert (tmp_path / "aircraft1_log1.mcap").read_bytes() == bytes(range(256)) * 20


def test_status_help_nonsense_and_the_end(desktop: Desktop) -> None:
    desktop.fly(120)
    assert "recorder" in desktop.type("status")
    assert "fetch NUMBER" in desktop.type("help")
    for nonsense in ("fly higher", "rate fast", "rate -3", "backfill some", "2", "7 mark", "fetch x"):
        said = desktop.type(nonsense, scans=0)
        assert "not understood" in said or "heard" in said, nonsense
    assert "did you mean logs?" in desktop.type("lgs", scans=0)
    assert "type rate HZ" in desktop.type("rate fast", scans=0)
    os.write(desktop.write_end, b"mark\nqu")
    assert desktop.console.poll()
    os.write(desktop.write_end, b"it\n")
    assert not desktop.console.poll()


def test_no_input_is_no_trouble() -> None:
    with open(os.devnull, encoding="utf-8") as nothing:
        lines = Lines(nothing.fileno())
        assert lines.read() == []
        assert lines.read() == []


def test_the_sequencer_is_asked_and_shown(desktop: Desktop) -> None:
    """Without a key a start is denied on board; letting go is always taken. What it does is on the status page."""
    desktop.fly(60)
    assert "denied" in desktop.type("fly abcdef0123")
    assert "accepted" in desktop.type("release")
    assert desktop.rig.logger.asked == [None]
    assert "not understood" in desktop.type("fly")
    assert "not understood" in desktop.type("fly xyz")
    now = desktop.rig.clock.monotonic_ns()
    running = SequencerFrame(now, 0, 5, 3, 0, 3, elapsed_us=2_500_000, beating=True, increments=(0.0, 0.0524, -0.0175))
    desktop.rig.link.sequencer(running)
    page = desktop.type("status")
    assert "sequencer: running for 2.5 s, e a r +0.0, +3.0, -1.0 deg" in desktop.type("status"), page
    desktop.rig.link.sequencer(SequencerFrame(now, 0, 6, 5, 99, 1))
    desktop.fly(20)
    assert "sequencer: released for 0.0 s" in desktop.type("status")
    assert "(reason 99)" in desktop.type("status")
