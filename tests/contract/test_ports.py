"""Ports never wait, listen on loopback only unless told, and explain themselves when they cannot be opened."""

import os
import pty
import time

import pytest

from daq.transport.ports import (
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
