"""Whatever arrives, and however fast: a turn of the link is bounded, requests and commands have budgets, all is counted."""

import os
import pty
import re
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.clock import NS, SimulatedClock
from daq.contract.link import commands as c
from daq.contract.recordings.recording import RecordingInfo
from daq.telemetry import backfill
from daq.telemetry.config import DownlinkConfig, LinkLimits
from daq.telemetry.link import RadioLink, radio_link
from daq.telemetry.request_limits import CommandBudget, Refusals, SenderLimits, TokenBucket
from daq.telemetry.send_queue import SendQueue, item
from daq.telemetry.uplink import FRAMES_PER_TURN, READ_BYTES, TURN_NS, Uplink
from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder, MavlinkFrame, frames_of, message_types
from daq.transport.ports import BytePort, SerialPort, UdpPort
from tests.support.link_rig import PERIOD_NS, START_UTC_NS, FakeLogger, quiet_scan

MINE, OTHER = FrameEncoder(255, 190), FrameEncoder(254, 190)


@dataclass
class HostilePort:
    """A port at which something always waits, and that takes all that is sent."""

    source: Iterator[bytes]
    on_read: Callable[[], None] = lambda: None
    given: int = 0
    rest: bytes = b""
    sent: bytearray = field(default_factory=bytearray)

    def read(self, limit: int = 65536) -> bytes:
        self.on_read()
        while len(self.rest) < limit:
            more = next(self.source, b"")
            if not more:
                break
            self.rest += more
        data, self.rest = self.rest[:limit], self.rest[limit:]
        self.given += len(data)
        return data

    def write(self, data: bytes) -> int:
        self.sent += data
        return len(data)

    def close(self) -> None:
        return


class Aircraft:
    """A link and a fake logger behind a port, in simulated time; `turns` of 0.1 s with two scans each."""

    def __init__(self, port: BytePort, config: DownlinkConfig | None = None, **options: Any) -> None:
        self.clock = SimulatedClock(START_UTC_NS)
        self.logger = FakeLogger()
        self.port = port
        self.link: RadioLink = radio_link(config or DownlinkConfig(), port, self.clock, boot=7, **options)
        self.clock.follow(lambda: self.link.backfill.preparing)
        self._rng = np.random.default_rng(5)
        self._number = 0

    def turns(self, count: int) -> None:
        for _ in range(count):
            for _ in range(2):
                self.clock.advance(PERIOD_NS)
                self.link.offer(quiet_scan(self._number, self._rng, time_ns=self.clock.monotonic_ns()))
                self._number += 1
            self.link.uplink.service(self.clock.monotonic_ns(), self.logger)
            self.link.service(self.clock.monotonic_ns())

    def heard(self) -> list[MavlinkFrame]:
        """All that the aircraft has sent."""
        return frames_of(FrameDecoder().feed(bytes(self.port.sent)))  # type: ignore[attr-defined]

    def texts(self) -> list[str]:
        """Sentences it has sent, put together."""
        out: dict[int, str] = {}
        for i, frame in enumerate(f for f in self.heard() if f.name == "STATUSTEXT"):
            f = frame.fields()
            key = int(str(f["id"])) or -i - 1
            out[key] = out.get(key, "") + str(f["text"])
        return list(out.values())

    def acknowledged(self, command: int) -> list[int]:
        """Results of the acknowledgements of a command."""
        acks = [f.fields() for f in self.heard() if f.name == "COMMAND_ACK"]
        return [int(str(a["result"])) for a in acks if a["command"] == command]

    @property
    def refused(self) -> int:
        return self.link.downlink.rejected_frames


def told(texts: list[str]) -> int:
    """How many refusals the texts speak of."""
    return sum(1 + int(t.rpartition("(and ")[2].split()[0]) if "(and " in t else 1 for t in texts)


# ------------------------------------------------------------------------------------------------- one turn


@pytest.mark.parametrize("data", [b"\xfd" * 1000, b"\xfe\x09\x00\x33\x44\x6d", MINE.message("HEARTBEAT", type=6)])
def test_a_turn_reads_a_bounded_number_of_bytes(data: bytes) -> None:
    port = HostilePort(cycle([data]))
    aircraft = Aircraft(port)
    for turn in range(1, 20):
        aircraft.turns(1)
        assert port.given <= turn * READ_BYTES
    aircraft.link.close()


def test_a_turn_takes_a_bounded_number_of_frames_and_leaves_the_others_for_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken: list[int] = []
    monkeypatch.setattr(Uplink, "_receive", lambda self, frame, now, control: taken.append(frame.sequence))
    encoder = FrameEncoder(255, 190)
    frames = (encoder.message("HEARTBEAT") for _ in range(3 * FRAMES_PER_TURN))
    aircraft = Aircraft(HostilePort(frames))
    counts = []
    for _ in range(20):
        before = len(taken)
        aircraft.turns(1)
        counts.append(len(taken) - before)
    assert max(counts) <= FRAMES_PER_TURN
    assert taken == [i % 256 for i in range(3 * FRAMES_PER_TURN)]
    aircraft.link.close()


def test_a_turn_ends_when_its_time_is_over() -> None:
    begun: list[int] = []
    port = HostilePort(cycle([b"\xfd"]))
    aircraft = Aircraft(port)
    port.on_read = lambda: aircraft.clock.advance(1_000_000)  # a slow computer
    for _ in range(10):
        begun.append(aircraft.clock.monotonic_ns())
        aircraft.link.uplink.service(begun[-1], aircraft.logger)
        assert aircraft.clock.monotonic_ns() - begun[-1] <= TURN_NS + 1_000_000
    aircraft.link.close()


def test_slow_frames_end_a_turn_too(monkeypatch: pytest.MonkeyPatch) -> None:
    aircraft = Aircraft(HostilePort(cycle([MINE.message("HEARTBEAT", type=6)])))
    slow = lambda self, frame, now, control: aircraft.clock.advance(400_000)  # noqa: E731
    monkeypatch.setattr(Uplink, "_receive", slow)
    for _ in range(5):
        begun = aircraft.clock.monotonic_ns()
        aircraft.link.uplink.service(begun, aircraft.logger)
        assert TURN_NS <= aircraft.clock.monotonic_ns() - begun <= TURN_NS + 400_000
    aircraft.link.close()


@contextmanager
def udp_line() -> Iterator[tuple[BytePort, Callable[[bytes], None]]]:
    """A listening UDP port, and how to send to it."""
    port = UdpPort(local=("127.0.0.1", 0))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:

        def send(data: bytes) -> None:
            for i in range(0, len(data), 1400):
                sender.sendto(data[i : i + 1400], port.address)

        yield port, send
    port.close()


@contextmanager
def serial_line() -> Iterator[tuple[BytePort, Callable[[bytes], None]]]:
    """A pseudo-terminal, and how to send to it: what finds no room in it is lost, as on a radio."""
    master, slave = pty.openpty()
    tty.setraw(master)
    os.set_blocking(master, False)
    port = SerialPort(os.fdopen(slave, "r+b", buffering=0))

    def send(data: bytes) -> None:
        with suppress(BlockingIOError):
            os.write(master, data)
        with suppress(BlockingIOError):
            os.read(master, 65536)  # what the aircraft says: the line does not fill up

    yield port, send
    port.close()
    os.close(master)


@pytest.mark.parametrize("line", [udp_line, serial_line])
def test_behind_noise_a_command_still_arrives(
    line: Callable[[], AbstractContextManager[tuple[BytePort, Callable[[bytes], None]]]],
) -> None:
    with line() as (port, send):
        aircraft = Aircraft(port)
        for _ in range(20):
            send(b"\xfd" * 3000)
            aircraft.turns(1)
        send(MINE.message("COMMAND_LONG", command=c.EVENT_MARK, param1=5.0))
        for _ in range(200):
            time.sleep(0.0005)  # the kernel hands over what goes through a terminal when it likes
            aircraft.turns(1)
            if aircraft.logger.marks:
                break
        assert aircraft.logger.marks == [("mark 5", "ground")]
        assert aircraft.link.uplink._decoder.counts.discarded_bytes > 3000
        aircraft.link.close()


def test_datagrams_that_were_not_read_are_told_of() -> None:
    with udp_line() as (port, _), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        aircraft = Aircraft(port)
        sender.sendto(MINE.message("HEARTBEAT", type=6), port.address)  # type: ignore[attr-defined]
        for _ in range(70):
            sender.sendto(b"\xfd" * 60_000, port.address)  # type: ignore[attr-defined]
            aircraft.turns(1)
        assert port.dropped == 70  # type: ignore[attr-defined]
        sender.setblocking(False)
        heard = FrameDecoder()
        frames: list[MavlinkFrame] = []
        with suppress(BlockingIOError):
            while True:
                frames += frames_of(heard.feed(sender.recv(2048)))
        texts = "".join(str(f.fields()["text"]) for f in frames if f.name == "STATUSTEXT")
        told_of = [int(n) for n in re.findall(r"(\d+) datagrams dropped unread", texts)]
        assert len(told_of) == 1, "after five seconds; the others are told of in the next five"
        assert 40 <= told_of[0] <= 60
        aircraft.link.close()


# ------------------------------------------------------------------------------------------------- requests


def test_requests_of_a_sender_are_limited_and_another_s_are_answered() -> None:
    flood = [MINE.message("SENT_MAP_REQUEST", first_number=512 * i, boot=7) for i in range(600)]
    one = OTHER.message("SENT_MAP_REQUEST", first_number=512 * 77_777, boot=7)
    aircraft = Aircraft(HostilePort(iter([*flood, one])), DownlinkConfig(budget_bytes_per_s=20_000))
    aircraft.turns(30)
    answered = [int(str(f.fields()["first_number"])) for f in aircraft.heard() if f.name == "SENT_MAP"]
    assert 512 * 77_777 in answered
    per_s = LinkLimits().requests_per_s
    assert len(answered) <= 2 + per_s + 3.0 * per_s, "a burst of a second, then the rate"
    assert aircraft.refused >= 600 - len(answered)
    aircraft.turns(60)
    texts = [t for t in aircraft.texts() if t.startswith("refused SENT_MAP_REQUEST from 255/190: ")]
    assert 0 < len(texts) <= 3
    assert told(aircraft.texts()) == aircraft.refused
    aircraft.link.close()


def test_sender_ids_chosen_freely_share_a_limit() -> None:
    limits = SenderLimits(10.0)
    allowed = sum(limits.allow((i % 250 + 1, i // 250), 0) for i in range(5000))
    assert allowed == 20
    assert sum(limits.allow((i % 250 + 1, 3), NS * i // 1000) for i in range(1, 10_001)) <= 10 * 20 + 20
    assert len(limits._senders) <= 16


def test_bucket_fills_at_its_rate_and_no_further_than_its_burst() -> None:
    bucket = TokenBucket(2.0, 3.0)
    assert [bucket.allows(0) for _ in range(4)] == [True, True, True, False]
    assert [bucket.allows(NS // 2), bucket.allows(NS // 2)] == [True, False]
    assert [bucket.allows(1000 * NS) for _ in range(4)] == [True, True, True, False]


def test_papers_are_made_once_and_not_in_the_scan_loop_s_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    here = threading.get_ident()
    made: list[int] = []
    asked: list[int] = []
    real = backfill.papers_of
    info = RecordingInfo("s", "simulated", "cdfp", attachments={"config.toml": b"x = 1\n" * 5000})

    def papers() -> RecordingInfo:
        asked.append(threading.get_ident())
        return info

    monkeypatch.setattr(backfill, "papers_of", lambda *given: (made.append(threading.get_ident()), real(*given))[1])
    requests = [MINE.message("BACKFILL_REQUEST", fragments=2**64 - 1, boot=7) for _ in range(200)]
    aircraft = Aircraft(HostilePort(iter(requests)), DownlinkConfig(budget_bytes_per_s=20_000), papers=papers)
    aircraft.turns(60)
    assert len(made) == 1
    assert here not in (*asked, *made)
    assert any(f.name == "BACKFILL_DATA" for f in aircraft.heard())
    aircraft.link.close()


def test_scans_asked_for_again_are_packed_once_and_not_in_the_scan_loop_s_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    packed: list[int] = []
    real = backfill.pack_scans
    monkeypatch.setattr(backfill, "pack_scans", lambda rows: (packed.append(threading.get_ident()), real(rows))[1])
    aircraft = Aircraft(HostilePort(iter([])), DownlinkConfig(budget_bytes_per_s=20_000))
    aircraft.turns(100)
    asking = MINE.message("BACKFILL_REQUEST", first_number=10, wanted=0b111, fragments=2**64 - 1, boot=7)
    for _ in range(5):
        aircraft.port.source = iter([asking] * 20)  # type: ignore[attr-defined]
        aircraft.turns(20)
    assert len(packed) == 1
    assert packed[0] != threading.get_ident()
    assert sum(f.name == "BACKFILL_DATA" for f in aircraft.heard()) >= 5
    aircraft.link.close()


def test_more_answers_than_can_be_prepared_are_refused_and_told() -> None:
    frames = [MINE.message("BACKFILL_REQUEST", first_number=64 * i, wanted=1, fragments=1, boot=7) for i in range(45)]
    aircraft = Aircraft(HostilePort(iter(frames)))
    aircraft.turns(1)
    aircraft.turns(60)
    assert aircraft.refused >= 45 - 16
    assert told(aircraft.texts()) == aircraft.refused
    aircraft.link.close()


def test_identity_that_cannot_be_made_is_said_and_nothing_ends(caplog: pytest.LogCaptureFixture) -> None:
    def papers() -> RecordingInfo:
        raise OSError(5, "Input/output error")

    asking = MINE.message("BACKFILL_REQUEST", fragments=1, boot=7)
    aircraft = Aircraft(HostilePort(iter([asking])), papers=papers)
    aircraft.turns(30)
    (answer,) = (f.fields() for f in aircraft.heard() if f.name == "BACKFILL_DATA")
    assert answer["fragments"] == 0
    assert "identity cannot be sent" in caplog.text
    aircraft.link.close()


# ------------------------------------------------------------------------------------------------- commands

RADIO_SPEED = 5760 // 45
"""COMMAND_LONG frames a second at 57600 baud."""


def test_recordings_started_and_stopped_at_radio_speed_stay_few() -> None:
    frames = [MINE.message("COMMAND_LONG", command=2511 - i % 2) for i in range(8 * RADIO_SPEED)]
    per_turn = RADIO_SPEED // 10
    aircraft = Aircraft(HostilePort(iter([])))
    for i in range(0, len(frames), per_turn):
        aircraft.port.source = iter(frames[i : i + per_turn])  # type: ignore[attr-defined]
        aircraft.turns(1)
    assert aircraft.logger.starts <= 1 + 8 / LinkLimits().recording_s + 1
    assert aircraft.logger.recording, "a recording is under way at the end: ending it was refused"
    results = aircraft.acknowledged(c.LOGGING_STOP)
    assert c.TEMPORARILY_REJECTED in results
    assert aircraft.link.downlink.rejected_commands > 100
    aircraft.turns(60)
    assert any("a recording begun by command lasts at least 10 s" in t for t in aircraft.texts())
    aircraft.link.close()


def test_the_last_recording_of_the_budget_cannot_be_ended() -> None:
    budget = CommandBudget(LinkLimits(recordings=2, recording_s=0.0))
    for now in (1, 2):
        assert budget.check_stop(now) == budget.check_start() == ""
        budget.note_start(now)
    assert "all 2 recordings" in budget.check_stop(10**15)
    assert "all 2 recordings" in budget.check_start()


def test_marks_at_radio_speed_stay_few_and_a_refused_one_may_be_repeated() -> None:
    aircraft = Aircraft(HostilePort(iter([])))
    for second in range(8):
        marks = [MINE.message("COMMAND_LONG", command=c.EVENT_MARK, param1=float(100 * second + i)) for i in range(60)]
        for at in range(0, 60, 6):
            aircraft.port.source = iter(marks[at : at + 6])  # type: ignore[attr-defined]
            aircraft.turns(1)
    limits = LinkLimits()
    accepted = len(aircraft.logger.marks)
    assert limits.marks_at_once <= accepted <= limits.marks_at_once + 8 * limits.marks_per_s + 1
    assert aircraft.link.downlink.rejected_commands >= 400 - accepted
    assert c.TEMPORARILY_REJECTED in aircraft.acknowledged(c.EVENT_MARK)
    assert any("more than 1 marks a second" in t for t in aircraft.texts())
    aircraft.turns(40)
    aircraft.port.source = iter([marks[-1]])  # type: ignore[attr-defined]
    aircraft.turns(2)
    assert aircraft.logger.marks[-1] == ("mark 759", "ground")
    assert len(aircraft.logger.marks) == accepted + 1
    aircraft.link.close()


def test_a_flood_of_commands_takes_no_scan_from_the_downlink_but_its_share() -> None:
    """Acknowledgements come before scans, and there are as many as anybody likes to ask for."""
    quiet, flooded = Aircraft(HostilePort(iter([]))), Aircraft(HostilePort(iter([])))
    rng = np.random.default_rng(1)
    for _ in range(200):
        quiet.turns(1)
        senders = [FrameEncoder(int(s), 1) for s in rng.integers(2, 250, 30)]
        flooded.port.source = iter(  # type: ignore[attr-defined]
            [s.message("COMMAND_LONG", command=int(rng.integers(1, 60_000))) for s in senders]
        )
        flooded.turns(1)
    sent = [sum(f.name == "SCAN_FAST" for f in a.heard()) for a in (quiet, flooded)]
    assert sent[1] >= 0.8 * sent[0]
    assert sum(f.name == "HEARTBEAT" for f in flooded.heard()) == 20
    answers = sum(len(f.raw) for f in flooded.heard() if f.name == "COMMAND_ACK")
    assert answers <= 20 * 0.15 * 1636 + 400
    assert len(flooded.port.sent) <= 20 * 1636 * 1.1  # type: ignore[attr-defined]
    for aircraft in (quiet, flooded):
        aircraft.link.close()


@pytest.mark.parametrize(
    "frame",
    [
        MINE.message("LOG_ERASE"),
        MINE.message("COMMAND_LONG", command=c.SET_MESSAGE_INTERVAL, param1=44100.0, param2=1.0),
        MINE.message("COMMAND_LONG", command=c.PREFLIGHT_CALIBRATION, param6=2.0),
    ],
    ids=["erase", "rate", "pitot"],
)
def test_sentences_to_the_ground_are_few(frame: bytes) -> None:
    aircraft = Aircraft(HostilePort(cycle([frame])))
    aircraft.turns(200)
    # One refusal every 5 s, each up to 3 pieces; a pitot that was really zeroed is an event, limited as marks are.
    assert sum(f.name == "STATUSTEXT" for f in aircraft.heard()) <= 3 * 5 + 26
    assert len(aircraft.logger.marks) <= 26
    assert len(aircraft.port.sent) <= 20 * 1636 * 1.1  # type: ignore[attr-defined]
    aircraft.link.close()


def test_unsigned_frames_are_refused_counted_and_told_all_of_them(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    config = DownlinkConfig(key_file=key)
    frames = [MINE.message("BACKFILL_REQUEST", fragments=1, boot=7) for _ in range(2000)]
    aircraft = Aircraft(HostilePort(iter(frames)), config)
    aircraft.turns(120)
    assert aircraft.refused == 2000
    assert told(aircraft.texts()) == 2000
    assert len(aircraft.texts()) <= 3
    assert not aircraft.link.backfill.busy
    aircraft.link.close()


def test_of_many_kinds_of_refusals_some_are_told_and_all_are_counted() -> None:
    texts: list[str] = []
    refusals = Refusals(lambda severity, words: texts.append(words))
    for i in range(100):
        refusals.note(f"refused {i}")
    refusals.note("refused 0")
    refusals.report(0)
    assert texts == ["refused 0 (and 1 more)", "refused 1", "refused 2 (and 97 more)"]
    refusals.note("refused 0")
    refusals.report(4 * NS)
    assert len(texts) == 3
    refusals.report(5 * NS)
    assert texts[3:] == ["refused 0"]


@pytest.mark.parametrize("seed", range(3))
def test_no_field_of_any_message_raises(seed: int, tmp_path: Path) -> None:
    """Every message of the dialect with fields anywhere in their ranges, at a link that has all its servers."""
    rng = np.random.default_rng(seed)
    (tmp_path / "a.mcap").write_bytes(bytes(1000))
    interesting = [b"\0", b"\xff", b"\x7f", b"\x80", b"\x00\x00\xc0\x7f", b"\x00\x00\x80\xff", b"\x01\x00\x07\x00"]
    frames = []
    for made in message_types().values():
        for _ in range(12):
            parts = [interesting[int(rng.integers(len(interesting)))], rng.bytes(made.codec.size)]
            payload = parts[int(rng.integers(2))] * made.codec.size
            frames.append(MINE.frame(made.msg_id, payload[: made.codec.size]))
    for command in (c.SET_MESSAGE_INTERVAL, c.PREFLIGHT_CALIBRATION, c.LOGGING_START, c.LOGGING_STOP, c.EVENT_MARK):
        for value in (float("nan"), float("inf"), -0.0, 1e-45, 3.4e38):
            others = {f"param{i}": value for i in range(2, 8)}
            first = 44100.0 if command == c.SET_MESSAGE_INTERVAL else value
            frames.append(MINE.message("COMMAND_LONG", command=command, param1=first, **others))
    rng.shuffle(frames)
    config = DownlinkConfig(budget_bytes_per_s=20_000, limits=LinkLimits(requests_per_s=1000, marks_per_s=100))
    aircraft = Aircraft(HostilePort(iter(frames)), config, recordings=(tmp_path,))
    aircraft.turns(100)
    assert not aircraft.link.uplink._frames
    assert aircraft.link.uplink._decoder.counts.frames == len(frames)
    aircraft.turns(5)
    assert aircraft.heard()[-1].name
    aircraft.link.close()


@pytest.mark.parametrize("scans", [0, 2])
def test_what_is_asked_for_and_bulk_do_not_keep_each_other_waiting(scans: int) -> None:
    port = HostilePort(iter([]))
    send_queue = SendQueue(port, FrameEncoder(1, 1), 2000.0, 4)
    bulk = iter(range(10**6))
    send_queue.bulk = lambda: item("LOG_DATA", ofs=next(bulk), count=90, data=bytes([1] * 90))
    for turn in range(600):
        for i in range(8):
            send_queue.put_requested(item("SENT_MAP", first_number=8 * turn + i, sent=bytes([1] * 64)))
        for _ in range(scans):
            send_queue.put_scan([item("STATUSTEXT", severity=6, text="x" * 50)])
        send_queue.service(turn * NS // 10)
    sizes = {"SENT_MAP": 0, "LOG_DATA": 0, "STATUSTEXT": 0}
    for frame in frames_of(FrameDecoder().feed(bytes(port.sent))):
        sizes[frame.name] += len(frame.raw)
    left = 60 * 2000 - sizes["STATUSTEXT"]
    assert sizes["STATUSTEXT"] >= 0.95 * 600 * scans * 66
    assert min(sizes["SENT_MAP"], sizes["LOG_DATA"]) >= 0.2 * left
    assert sum(sizes.values()) <= 60 * 2000 + 1000


def test_equal_answers_are_sent_once_and_too_many_are_not_kept() -> None:
    send_queue = SendQueue(HostilePort(iter([])), FrameEncoder(1, 1), 2000.0, 4)
    ack = item("COMMAND_ACK", command=1, result=1)
    assert all(send_queue.put_acknowledgement(ack) for _ in range(1000))
    taken = [send_queue.put_acknowledgement(item("COMMAND_ACK", command=n, result=1)) for n in range(2, 100)]
    assert taken == [True] * 15 + [False] * 83
