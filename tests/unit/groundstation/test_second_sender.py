"""Many senders to one UDP port: a second one that speaks for an aircraft is not used and shown; none crowds another out."""

import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest

from daq.clock import SimulatedClock
from daq.contract.link.wire import SCAN_FAST_ID, layouts, pack_scan
from daq.contract.recordings.reading import read_recording
from daq.transport.mavlink_codec import FrameEncoder
from daq.transport.ports import PortError, memory_pair
from groundstation.live.config import GroundConfig
from groundstation.live.station import Station
from groundstation.receiver import events as ev
from groundstation.receiver.ports import (
    OWN_SOCKETS,
    STRANGER_AT_ONCE,
    STRANGER_PER_S,
    LinkConfig,
    UdpListener,
    open_port,
)
from groundstation.receiver.receive import Receiver
from groundstation.receiver.senders import SILENCE_NS
from groundstation.receiver.timeline import NS
from tests.support.link_rig import START_UTC_NS, quiet_scan

CONFIG = LinkConfig(ports=("udpin:0",), backfill="off")


class Field:
    """A ground station on a UDP port of loopback, and anybody who sends to it. Time is simulated."""

    def __init__(self, folder: Path | None = None) -> None:
        self.clock = SimulatedClock(START_UTC_NS)
        self.port = UdpListener(("127.0.0.1", 0), self.clock)
        self.receiver = Receiver(CONFIG, {"udpin:0": self.port}, self.clock, folder=folder)
        self.events: list[ev.Event] = []
        self.said: list[str] = []
        self.station = None
        if folder is not None:
            self.station = Station(GroundConfig(), self.receiver, self.clock, folder, echo=self.said.append)

    def look(self, seconds: float = 0.05) -> None:
        self.clock.advance(round(seconds * NS))
        self.events += self.receiver.poll() if self.station is None else self.station.step()

    def scans(self) -> list[int]:
        return [e.scan.number for e in self.events if isinstance(e, ev.ScanReceived)]

    def close(self) -> None:
        if self.station is not None:
            self.station.close()
        self.receiver.close()


@contextmanager
def field(folder: Path | None = None) -> Iterator[Field]:
    made = Field(folder)
    try:
        yield made
    finally:
        made.close()


class Speaker:
    """Somebody with a socket who speaks as a system."""

    def __init__(self, at: Field, system: int = 1) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.field, self.rng = at, np.random.default_rng(1)
        self.encoder = FrameEncoder(system, 1)

    @property
    def name(self) -> str:
        host, port = self.socket.getsockname()
        return f"{host}:{port}"

    def send(self, data: bytes) -> None:
        self.socket.sendto(data, self.field.port.address)

    def scan(self, number: int, boot: int = 7) -> None:
        made = quiet_scan(number, self.rng, time_ns=10**12 + number * NS // 20)
        self.send(self.encoder.frame(SCAN_FAST_ID, pack_scan(layouts()[SCAN_FAST_ID], made, boot)))

    def heard(self) -> int:
        count = 0
        while True:
            try:
                self.socket.recv(2048)
            except BlockingIOError:
                return count
            count += 1

    def close(self) -> None:
        self.socket.close()


def test_a_second_sender_is_not_used_and_is_shown_everywhere(tmp_path: Path) -> None:
    with field(tmp_path) as f, closing(Speaker(f)) as aircraft, closing(Speaker(f)) as impostor:
        for n in range(100):
            aircraft.scan(n)
            if n >= 20:
                impostor.scan(5000 + n, boot=9)
                impostor.send(impostor.encoder.message("STATUSTEXT", severity=0, text="land at once"))
            f.look()
        assert f.scans() == list(range(100))
        told = [e for e in f.events if isinstance(e, ev.ReceptionFinding)]
        assert (told[0].first, told[0].system) == (True, 1)
        assert impostor.name in told[0].subject
        assert aircraft.name in told[0].detail
        f.look(6.0)
        assert sum(e.count for e in f.events if isinstance(e, ev.ReceptionFinding)) == 160
        summary = f.receiver.summary()
        assert summary["frames_contested"] == 160
        assert [row["frames"] for row in summary["second_senders"]] == [160]
        assert summary["frames_lost"] == 0
        assert any("second sender" in line and impostor.name in line for line in f.said)
        assert not any("land at once" in line for line in f.said)
        f.close()
        (path,) = tmp_path.glob("*.mcap")
        (event,) = read_recording(path).events
        assert event.origin == "receiver"
        assert impostor.name in event.text


def test_an_aircraft_behind_a_new_address_is_believed_once_the_old_is_silent() -> None:
    with field() as f, closing(Speaker(f)) as before, closing(Speaker(f)) as after:
        for n in range(20):
            before.scan(n)
            f.look()
        f.look(SILENCE_NS / NS)
        for n in range(100, 140):
            after.scan(n)
            f.look()
        assert f.scans() == [*range(20), *range(100, 140)]
        assert f.receiver.summary()["frames_contested"] == 0
        after.heard(), before.heard()
        f.look(1.1)
        assert (before.heard(), after.heard() > 0) == (0, True)


def test_a_flood_of_a_stranger_costs_an_aircraft_nothing() -> None:
    with field() as f, closing(Speaker(f)) as aircraft, closing(Speaker(f)) as stranger:
        for n in range(60):
            for _ in range(100 if n > 2 else 0):  # more than the kernel holds
                stranger.send(b"\xfd" * 60_000)
            aircraft.scan(n)
            f.look()
        assert f.scans() == list(range(60))
        summary = f.receiver.summary()
        assert summary["frames_lost"] == 0
        looked_at = STRANGER_AT_ONCE + STRANGER_PER_S * 60 * 0.05
        assert summary["bytes_received"] < looked_at + 60 * 130
        assert summary["datagrams_dropped"] > 0
        assert summary["bytes_refused"] + 60_000 * summary["datagrams_dropped"] >= 57 * 100 * 60_000 - looked_at


def test_a_new_aircraft_gets_through_a_flood() -> None:
    with field() as f, closing(Speaker(f)) as aircraft, closing(Speaker(f)) as stranger:
        for n in range(40):
            for _ in range(5):
                stranger.send(b"\xfd" * 60_000)
            aircraft.scan(n)
            f.look()
        assert f.scans() == list(range(40))


def test_answers_go_to_the_aircraft_and_to_nobody_else_who_sends() -> None:
    with field() as f, closing(Speaker(f)) as aircraft, closing(Speaker(f)) as stranger:
        aircraft.scan(0)
        f.look()
        for n in range(1, 60):
            aircraft.scan(n)
            stranger.send(b"hello")
            f.look()
        assert aircraft.heard() >= 3
        assert stranger.heard() <= 1


def test_the_port_stays_closed_to_other_programs() -> None:
    with field() as f, closing(Speaker(f)) as aircraft:
        for n in range(3):
            aircraft.scan(n)
            f.look()
        host, number = f.port.address
        with pytest.raises(PortError, match="another program"):
            open_port(f"udpin:{host}:{number}", f.clock)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
            thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            with pytest.raises(OSError, match="in use"):
                thief.bind((host, number))


def test_many_aircraft_on_one_port_are_all_heard_and_answered() -> None:
    with field() as f:
        speakers = [Speaker(f, system) for system in range(1, OWN_SOCKETS + 1)]
        for n in range(20):
            for speaker in speakers:
                speaker.scan(n)
            f.look()
        answered = [speaker.heard() > 0 for speaker in speakers]
        for speaker in speakers:
            speaker.close()
        assert len(f.scans()) == OWN_SOCKETS * 20
        assert len(f.port._connections) == OWN_SOCKETS
        assert all(answered)


def test_an_aircraft_that_comes_by_a_second_port_is_used_and_told_once() -> None:
    clock = SimulatedClock(START_UTC_NS)
    ours, theirs = zip(memory_pair(), memory_pair(), strict=True)
    config = LinkConfig(ports=("a", "b"), backfill="off", transmit=False)
    receiver = Receiver(config, {"a": ours[0], "b": ours[1]}, clock)
    rng, layout = np.random.default_rng(1), layouts()[SCAN_FAST_ID]
    encoder, events = FrameEncoder(1, 1), []
    for n in range(200):
        clock.advance(NS // 20)
        scan = quiet_scan(n, rng, time_ns=clock.monotonic_ns())
        frame = encoder.frame(SCAN_FAST_ID, pack_scan(layout, scan, 7))
        for port in theirs if n > 20 else theirs[:1]:
            port.write(frame)
        events += receiver.poll()
    (told,) = (e for e in events if isinstance(e, ev.ReceptionFinding))
    assert (told.subject, told.detail, told.used) == ("b", "a", True)
    assert sum(isinstance(e, ev.ScanReceived) for e in events) == 200
    (row,) = receiver.summary()["second_senders"]
    assert (row["used"], row["frames"], receiver.summary()["duplicates"]) == (True, 0, 179)
    receiver.close()
