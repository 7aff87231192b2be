"""Ports never wait, listen on loopback only unless told, and explain themselves when they cannot be opened."""

import os
import pty
import socket
import time

import pytest

from daq.transport.ports import (
    DATAGRAM_BYTES,
    DATAGRAMS,
    PortError,
    SerialPort,
    TcpClientPort,
    TcpServerPort,
    UdpPort,
    memory_pair,
    open_socket_port,
    parse_port,
)


@pytest.mark.parametrize(
    ("text", "kind", "address", "number"),
    [
        ("serial:/dev/ttyUSB0:115200", "serial", "/dev/ttyUSB0", 115200),
        ("serial:/dev/ttyUSB0", "serial", "/dev/ttyUSB0", 57600),
        ("udpin:14550", "udpin", "127.0.0.1", 14550),
        ("udp:10.0.0.2:14550", "udp", "10.0.0.2", 14550),
        ("tcpin:[::1]:5760", "tcpin", "::1", 5760),
    ],
)
def test_port_descriptions(text: str, kind: str, address: str, number: int) -> None:
    spec = parse_port(text)
    assert (spec.kind, spec.address, spec.number) == (kind, address, number)


@pytest.mark.parametrize("text", ["", "udp", "udp:", "udp:host", "udp:h:99999", "ftp:h:1", "serial:"])
def test_wrong_descriptions_say_what_to_write(text: str) -> None:
    with pytest.raises(PortError, match="write serial:DEVICE:BAUD"):
        parse_port(text)


def test_busy_port_is_one_sentence() -> None:
    first = UdpPort(local=("127.0.0.1", 0))
    with pytest.raises(PortError, match="is another program using it"):
        open_socket_port(parse_port(f"udpin:{first.address[1]}"))
    first.close()


def test_udp_both_ways() -> None:
    server = UdpPort(local=("127.0.0.1", 0))
    client = UdpPort(remote=server.address)
    assert server.write(b"nobody there") == 12
    client.write(b"hello")
    assert server.receive()[0][1] == b"hello"
    server.write(b"back")
    assert client.read() == b"back"
    server.close()
    assert client.write(b"gone") == 4
    assert client.read() == b""
    assert client.write(b"gone") == 4
    client.close()


def test_tcp_several_clients_and_one_that_leaves() -> None:
    server = TcpServerPort("127.0.0.1", 0)
    one, two = (TcpClientPort(*server.address) for _ in range(2))
    assert server.receive() == []
    server.write(b"all")
    assert (one.read(), two.read()) == (b"all", b"all")
    one.write(b"1")
    two.close()
    assert [d for _, d in server.receive()] == [b"1"]
    server.write(b"more")
    assert one.read() == b"more"
    server.close()
    one.read()
    assert not one.is_open
    assert one.write(b"x") == 1
    one.close()


def test_full_serial_line_takes_nothing_and_does_not_wait() -> None:
    master, slave = pty.openpty()
    port = SerialPort(os.fdopen(slave, "r+b", buffering=0))
    total = 0
    for _ in range(1000):
        taken = port.write(bytes(4096))
        total += taken
        if not taken:
            break
    assert taken == 0
    assert total > 0
    os.set_blocking(master, False)
    assert os.read(master, 100)
    os.write(master, b"in\n")
    time.sleep(0.01)
    assert b"in" in port.read()
    os.close(master)
    assert port.read() == b""
    port.close()


def test_memory_pair_keeps_order_and_limits() -> None:
    one, two = memory_pair()
    one.write(b"abc")
    one.write(b"def")
    assert two.read(4) == b"abcd"
    assert two.read() == b"ef"
    assert two.read() == b""


def datagrams(*contents: bytes) -> UdpPort:
    """A listening port to which these datagrams have been sent."""
    server = UdpPort(local=("127.0.0.1", 0))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for content in contents:
            sender.sendto(content, server.address)
    return server


def test_udp_gives_no_more_than_asked_for_and_loses_nothing_of_it() -> None:
    sent = [bytes([i]) * 280 for i in range(40)]
    server = datagrams(*sent)
    pieces = []
    while data := server.read(1000):
        assert len(data) <= 1000
        pieces.append(data)
    assert b"".join(pieces) == b"".join(sent)
    assert len(pieces) == 14, "three whole datagrams at a time: none is cut that fits the next time"
    server.close()


def test_a_datagram_longer_than_the_limit_comes_in_parts() -> None:
    server = datagrams(b"0123456789", b"next")
    assert [server.read(4) for _ in range(5)] == [b"0123", b"4567", b"89", b"next", b""]
    server.close()


def test_datagrams_too_long_for_mavlink_are_dropped_and_counted() -> None:
    server = datagrams(b"\xfd" * 60_000, b"\xfd" * (DATAGRAM_BYTES + 1), b"x" * DATAGRAM_BYTES, b"y")
    assert server.read() == b"x" * DATAGRAM_BYTES + b"y"
    assert server.dropped == 2
    server.close()


def test_what_finds_no_room_in_the_system_s_buffer_is_counted() -> None:
    count = 4000
    server = datagrams(*[bytes(1400)] * count)
    taken = 0
    while data := server.receive():
        taken += len(data)
    assert 0 < taken < count
    assert taken + server.dropped == count
    server.close()


class Endless:
    """A socket whose sender is always faster than its reader."""

    def __init__(self, datagram: bytes) -> None:
        self.calls = 0
        self._datagram = datagram

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        self.calls += 1
        assert self.calls < 100_000, "this read never ends"
        return self._datagram[:size], ("127.0.0.1", 1 + self.calls % 5)

    def accept(self) -> tuple[socket.socket, tuple[str, int]]:
        self.calls += 1
        assert self.calls < 1000, "this accept never ends"
        return socket.socket(), ("127.0.0.1", self.calls)


@pytest.mark.parametrize("datagram", [b"", b"\xfd", b"\xfd" * 280, b"\xfd" * 60_000])
def test_one_read_ends_however_fast_datagrams_come(datagram: bytes) -> None:
    server = UdpPort(local=("127.0.0.1", 0))
    server._socket.close()
    server._socket = Endless(datagram)  # type: ignore[assignment]
    for turn in range(1, 4):
        assert len(server.read(4096)) <= 4096
        assert server._socket.calls <= turn * DATAGRAMS  # type: ignore[attr-defined]


def test_tcp_peers_share_the_limit() -> None:
    server = TcpServerPort("127.0.0.1", 0)
    loud, quiet = (TcpClientPort(*server.address) for _ in range(2))
    server.read()
    assert loud.write(bytes(60_000)) == 60_000
    quiet.write(b"here")
    heard = b""
    for _ in range(3):
        data = server.read(1000)
        assert 0 < len(data) <= 1000
        heard += data
    assert b"here" in heard
    assert server.read(1) + server.read(1) != b"", "one of the two turns is the loud one's"
    assert server.read(0) == b""
    server.write(b"all")
    assert loud.read() == b"all", "to ask for nothing is not to hang up"
    for port in (loud, quiet, server):
        port.close()


def test_accepting_ends_however_fast_peers_come() -> None:
    server = TcpServerPort("127.0.0.1", 0)
    server._listener.close()
    endless = server._listener = Endless(b"")  # type: ignore[assignment]
    server._streams = []
    endless.close = lambda: None  # type: ignore[attr-defined]
    server._accept()
    assert endless.calls == 8  # type: ignore[attr-defined]
    server.close()


def test_serial_line_gives_no_more_than_asked_for() -> None:
    master, slave = pty.openpty()
    port = SerialPort(os.fdopen(slave, "r+b", buffering=0))
    os.write(master, b"\xfd" * 3000 + b"\n")
    time.sleep(0.01)
    first = port.read(1000)
    assert len(first) == 1000
    assert len(first + port.read()) == 3001
    port.close()
    os.close(master)


def test_a_peer_that_does_not_read_is_sent_what_it_missed_or_disconnected() -> None:
    server = TcpServerPort("127.0.0.1", 0)
    with socket.create_connection(server.address) as slow:
        sent = b"".join(i.to_bytes(4, "little") for i in range(1_500_000))
        for at in range(0, len(sent), 60_000):
            server.write(sent[at : at + 60_000])
        slow.settimeout(1.0)
        heard = bytearray()
        while data := slow.recv(1 << 20):
            heard += data
        assert heard == sent[: len(heard)]
    server.close()
