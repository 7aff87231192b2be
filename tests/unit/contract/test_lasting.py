"""Ports that are lost and come back, as the system really takes them away: closed sockets, unplugged terminals."""

import os
import pty
import re
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from daq.transport import reconnecting_port
from daq.transport.ports import BytePort, PortError, SerialPort, TcpServerPort
from daq.transport.reconnecting_port import FIRST_RETRY_NS, LONGEST_RETRY_NS, ReconnectingPort, open_lasting
from groundstation.receiver.ports import open_port


class StepClock:
    """Time that moves on by itself at every look, so that no test waits for a pause to be over."""

    def __init__(self) -> None:
        self.now = 0

    def __call__(self) -> int:
        self.now += FIRST_RETRY_NS // 4
        return self.now


@pytest.fixture
def closing() -> Iterator[list[BytePort]]:
    ports: list[BytePort] = []
    yield ports
    for port in ports:
        port.close()


def soon(what: Callable[[], object]) -> None:
    """Wait until something is so; an OSError means not yet."""
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        try:
            if what():
                return
        except OSError:
            pass
        time.sleep(0.002)
    raise AssertionError("it never became so")


def quick(port: BytePort) -> ReconnectingPort:
    """A lasting port whose pauses are over at once."""
    assert isinstance(port, ReconnectingPort)
    port._now_ns = StepClock()
    port._next_ns = 0
    return port


def away(port: BytePort) -> str:
    """Read until the port is found to be away; what it then says."""
    said: list[str] = []

    def look() -> bool:
        try:
            port.read()
        except OSError as error:
            said.append(str(error.strerror))
        return bool(said)

    soon(look)
    return said[0]


def test_tcp_peer_goes_and_comes_back(closing: list[BytePort]) -> None:
    server = TcpServerPort("127.0.0.1", 0)
    number = server.address[1]
    client = quick(open_port(f"tcp:127.0.0.1:{number}"))
    closing.append(client)
    server.write(b"last words")
    server.close()
    soon(lambda: client.read() == b"last words")
    assert "away (the other end has gone)" in away(client)
    with pytest.raises(OSError, match="away"):
        client.write(b"x")
    again = TcpServerPort("127.0.0.1", number)
    closing.append(again)
    soon(lambda: client.write(b"hello") == 5)
    soon(lambda: [d for _, d in again.receive()] == [b"hello"])
    again.write(b"back")
    soon(lambda: client.read() == b"back")


def test_tcp_peer_that_is_not_there_yet(closing: list[BytePort]) -> None:
    probe = TcpServerPort("127.0.0.1", 0)
    number = probe.address[1]
    probe.close()
    client = quick(open_port(f"tcp:127.0.0.1:{number}"))
    closing.append(client)
    assert "Connection refused" in away(client)
    server = TcpServerPort("127.0.0.1", number)
    closing.append(server)
    soon(lambda: client.write(b"hello") == 5)


def test_listener_takes_the_next_client_after_one_that_died(closing: list[BytePort]) -> None:
    server = TcpServerPort("127.0.0.1", 0)
    closing.append(server)
    for words in (b"one", b"two", b"three"):
        client = open_port(f"tcp:127.0.0.1:{server.address[1]}")
        client.write(words)
        soon(lambda words=words: [d for _, d in server.receive()] == [words])  # type: ignore[misc]
        client.close()
        assert server.write(b"to nobody, or to one that has just gone") > 0


def test_serial_adapter_unplugged_and_put_back(tmp_path: Path, closing: list[BytePort]) -> None:
    name = tmp_path / "ttyUSB0"

    def plug() -> tuple[int, int]:
        master, slave = pty.openpty()
        tty.setraw(slave)
        name.unlink(missing_ok=True)
        name.symlink_to(os.ttyname(slave))
        return master, slave

    master, slave = plug()
    port = quick(open_port(f"serial:{name}:57600"))
    closing.append(port)
    os.close(slave)
    os.write(master, b"before")
    soon(lambda: port.read() == b"before")
    assert port.read() == b""  # silence is not absence
    os.close(master)
    name.unlink()
    assert "away (" in away(port)
    master, slave = plug()
    soon(lambda: port.write(b"again") == 5)
    os.close(slave)
    assert os.read(master, 10) == b"again"
    os.write(master, b"after")
    soon(lambda: port.read() == b"after")
    os.close(master)


def test_pauses_grow_and_opening_happens_beside_the_caller() -> None:
    asked: list[int] = []
    clock = StepClock()

    def refuse() -> SerialPort:
        asked.append(clock.now)
        raise OSError("not yet")

    port = ReconnectingPort(refuse, None, reason="unplugged", now_ns=clock)
    while len(asked) < 8:
        with pytest.raises(OSError, match=r"away \(unplugged\)"):
            port.read()
    pauses = [b - a for a, b in zip(asked, asked[1:], strict=False)]
    assert pauses[0] >= FIRST_RETRY_NS
    assert pauses[-1] >= LONGEST_RETRY_NS // 2
    port.close()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("serial:/dev/nowhere:57600", "check the name"),
        ("serial:/dev/null:57600", "cannot be opened"),
        ("tcp:no-such-host.invalid:5760", "check the host name"),
    ],
)
def test_a_wrong_port_is_one_sentence(text: str, said: str) -> None:
    with pytest.raises(PortError, match=said) as refusal:
        open_port(text)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("serial:{folder}/ttyRadio:57600", "No such file"),
        ("udp:no-such-host.invalid:14550", "not known|Temporary failure|No address|no answer yet"),
    ],
)
def test_an_aircraft_waits_for_what_is_not_there_yet(
    text: str, why: str, tmp_path: Path, closing: list[BytePort]
) -> None:
    def absent(device: str, baud: int) -> SerialPort:
        return SerialPort(Path(device).open("rb"))

    port = open_lasting(text.format(folder=tmp_path), absent, wait=True)
    closing.append(port)
    with pytest.raises(OSError, match="away") as refusal:
        port.write(b"\xfd")
    assert re.search(why, str(refusal.value))


def test_a_radio_that_is_plugged_in_late_joins(tmp_path: Path, closing: list[BytePort]) -> None:
    name = tmp_path / "ttyLate"

    def serial(device: str, baud: int) -> SerialPort:
        return SerialPort(os.fdopen(os.open(device, os.O_RDWR | os.O_NOCTTY), "r+b", buffering=0))

    port = open_lasting(f"serial:{name}:57600", serial, wait=True)
    closing.append(port)
    assert "away (" in away(port)
    master, slave = pty.openpty()
    tty.setraw(slave)
    name.symlink_to(os.ttyname(slave))
    soon(lambda: port.write(b"beat") == 4)
    assert os.read(master, 10) == b"beat"
    os.close(master)
    os.close(slave)


def test_waiting_does_not_hide_a_listener_that_another_program_has(closing: list[BytePort]) -> None:
    server = TcpServerPort("127.0.0.1", 0)
    closing.append(server)
    with pytest.raises(PortError, match="is another program using it"):
        open_lasting(f"tcpin:{server.address[1]}", lambda *_: pytest.fail("no serial port"), wait=True)


def test_busy_listener_is_one_sentence(closing: list[BytePort]) -> None:
    server = TcpServerPort("127.0.0.1", 0)
    closing.append(server)
    with pytest.raises(PortError, match="is another program using it"):
        open_lasting(f"tcpin:{server.address[1]}", lambda *_: pytest.fail("no serial port"))


def test_closing_does_not_wait_for_a_host_that_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reconnecting_port, "OPEN_TIMEOUT_S", 0.01, raising=False)
    answered = threading.Event()
    late = TcpServerPort("127.0.0.1", 0)
    closed = threading.Event()
    late.close = lambda: (TcpServerPort.close(late), closed.set())  # type: ignore[assignment,method-assign,func-returns-value]

    def opening() -> TcpServerPort:
        assert answered.wait(20.0)
        return late

    port = quick(ReconnectingPort(opening, None, reason="no answer"))  # type: ignore[arg-type]
    away(port)
    closer = threading.Thread(target=port.close)
    closer.start()
    closer.join(5.0)
    waits = closer.is_alive()
    answered.set()
    closer.join()
    assert not waits
    assert closed.wait(20.0), "what is opened too late is closed at once"
