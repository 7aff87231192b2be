"""Byte ports of the link: serial, UDP, TCP and memory, none of which blocks.

`read` returns what has arrived, possibly nothing; `write` takes what fits and returns how much that was. The scan loop and a user
interface can therefore use any of them directly. Listeners bind to loopback unless a host is named.

A fast sender cannot occupy the reader: a read returns at most the requested bytes, from a bounded number of datagrams. The rest
waits in the system's buffer, and what exceeds that is lost.
"""

import errno
import os
import select
import socket
import struct
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from daq.utilities.errors import UserError

DEFAULT_BAUD = 57600  # of SiK radios
MAX_PEERS = 8  # of a listening port; of UDP's the latest, of TCP's the first
_LOOPBACK = "127.0.0.1"
_READ_BYTES = 65536
DATAGRAM_BYTES = 2048
"""Longer datagrams are dropped and counted: none of MAVLink needs more than an Ethernet frame's 1472 bytes."""
DATAGRAMS = 256
"""Most datagrams in one read: empty ones cost time, but count nothing towards the limit of bytes."""
_RECEIVE_BUFFER = 1 << 20  # bytes
_SO_MEMINFO, _MEMINFO_DROPS = 55, 8  # Linux, asm-generic/socket.h and linux/sock_diag.h: nine 32-bit counts
_MEMINFO = struct.Struct("9I")
_CLIENT_BACKLOG = 1 << 20  # bytes that a TCP peer may lag behind before it is disconnected
_CONNECT_S = 3.0
_WOULD_BLOCK = (errno.EAGAIN, errno.EWOULDBLOCK, errno.EINTR)
_PEER_GONE = (errno.ECONNREFUSED, errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENETDOWN)


class PortError(UserError):
    """A port that cannot be opened, or an invalid port description."""


class BytePort(Protocol):
    """A port of the link; no call blocks."""

    def read(self, limit: int = _READ_BYTES) -> bytes:
        """Return at most `limit` bytes that have arrived, none when there are none."""

    def write(self, data: bytes) -> int:
        """Send bytes; returns how many the port has taken, 0 when it is busy."""

    def close(self) -> None:
        """Close the port."""


PortKind = Literal["serial", "udp", "udpin", "tcp", "tcpin"]


@dataclass(frozen=True, slots=True)
class PortSpec:
    """A port description: `serial:DEVICE[:BAUD]`, `udp|udpin|tcp|tcpin:[HOST:]PORT`."""

    kind: PortKind
    address: str
    number: int  # baud rate or port number


def parse_port(text: str) -> PortSpec:
    """Parse a port description. Raises PortError with the reason."""
    kind, _, rest = text.partition(":")
    usage = "write serial:DEVICE:BAUD, udp:HOST:PORT, udpin:[HOST:]PORT, tcp:HOST:PORT or tcpin:[HOST:]PORT"
    if kind == "serial" and rest:
        device, colon, baud = rest.rpartition(":")
        if colon and baud.isdigit():
            return PortSpec("serial", device, int(baud))
        return PortSpec("serial", rest, DEFAULT_BAUD)
    if kind in ("udp", "udpin", "tcp", "tcpin"):
        host, _, number = rest.rpartition(":")
        if number.isdigit() and int(number) < 65536:
            return PortSpec(kind, host.strip("[]") or _LOOPBACK, int(number))  # type: ignore[arg-type]
    raise PortError(f"port {text!r} cannot be understood; {usage}")


def connected(spec: PortSpec) -> "UdpPort | TcpClientPort | TcpServerPort":
    """Open a UDP or TCP port. Raises OSError when the address is in use or nobody answers."""
    match spec.kind:
        case "udp":
            return UdpPort(remote=(spec.address, spec.number))
        case "udpin":
            return UdpPort(local=(spec.address, spec.number))
        case "tcp":
            return TcpClientPort(spec.address, spec.number)
        case "tcpin":
            return TcpServerPort(spec.address, spec.number)
        case _:
            raise PortError(f"{spec.kind}:{spec.address} is not a network port")


def open_socket_port(spec: PortSpec) -> "UdpPort | TcpClientPort | TcpServerPort":
    """Open a UDP or TCP port as `connected` does. Raises PortError with advice when it cannot be opened."""
    try:
        return connected(spec)
    except OSError as error:
        cause = error.strerror or str(error)
        raise PortError(
            f"{spec.kind}:{spec.address}:{spec.number} cannot be opened ({cause}); {_advice(spec, error)}"
        ) from error


def _advice(spec: PortSpec, error: OSError) -> str:
    if isinstance(error, socket.gaierror) or error.errno == socket.EAI_NONAME:
        return f"check the host name {spec.address!r}"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"{spec.address} is no address of this computer; write one that is, or leave the host out"
    if error.errno == errno.EACCES:
        return "take a port above 1023"
    if spec.kind == "tcp":
        return "nobody answers there; check host and port"
    return "is another program using it?"


class UdpPort:
    """A UDP port that sends to a fixed remote or, listening, to the latest MAX_PEERS senders."""

    is_open = True  # a silent peer may send again

    def __init__(self, *, local: tuple[str, int] | None = None, remote: tuple[str, int] | None = None) -> None:
        host = (local or remote or (_LOOPBACK, 0))[0]
        family = socket.getaddrinfo(host, None, type=socket.SOCK_DGRAM)[0][0]
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            if local is not None:
                self._socket.bind(local)
            if remote is not None:
                self._socket.connect(remote)
        except OSError:
            self._socket.close()
            raise
        self._fixed = remote is not None
        self._peers: dict[Any, None] = {}
        self._unread: tuple[str, bytes] | None = None  # sender and datagram read from the system, beyond the last limit
        self._too_long = 0

    @property
    def address(self) -> tuple[str, int]:
        name = self._socket.getsockname()
        return str(name[0]), int(name[1])

    @property
    def dropped(self) -> int:
        """Datagrams dropped so far: too long, or the system's buffer was full."""
        with suppress(OSError):  # not Linux
            counts = self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
            return self._too_long + int(_MEMINFO.unpack(counts)[_MEMINFO_DROPS])
        return self._too_long

    def receive(self, limit: int = _READ_BYTES) -> list[tuple[str, bytes]]:
        """Return (sender, datagram) of what has arrived, at most `limit` bytes in all.

        A datagram beyond the limit comes with the next call; only one longer than the limit itself is split.
        """
        datagrams: list[tuple[str, bytes]] = []
        for _ in range(DATAGRAMS):
            name, data = self._unread or self._next_datagram()
            self._unread = None
            if len(data) > limit and not datagrams:
                data, rest = data[:limit], data[limit:]
                self._unread = (name, rest)
            elif len(data) > limit:
                self._unread = (name, data)
                break
            if data:
                datagrams.append((name, data))
                limit -= len(data)
            if not name or not limit:
                break
        return datagrams

    def _next_datagram(self) -> tuple[str, bytes]:
        """Sender and data of the next datagram; no data for one that is dropped, no sender when none has arrived."""
        try:
            data, peer = self._socket.recvfrom(DATAGRAM_BYTES + 1)
        except OSError as error:
            if error.errno in _PEER_GONE:
                return "gone", b""
            if error.errno in _WOULD_BLOCK:
                return "", b""
            raise
        if len(data) > DATAGRAM_BYTES:
            self._too_long += 1
            return "too long", b""
        if not self._fixed:
            self._peers.pop(peer, None)
            self._peers[peer] = None
            if len(self._peers) > MAX_PEERS:
                self._peers.pop(next(iter(self._peers)))
        return f"{peer[0]}:{peer[1]}", data

    def read(self, limit: int = _READ_BYTES) -> bytes:
        return b"".join(data for _, data in self.receive(limit))

    def write(self, data: bytes) -> int:
        """Send one datagram to each peer; without any it is discarded, as on a radio."""
        if self._fixed:
            return self._send(data, None)
        counts = [self._send(data, peer) for peer in list(self._peers)]
        return min(counts, default=len(data))

    def _send(self, data: bytes, peer: Any) -> int:
        try:
            return self._socket.send(data) if peer is None else self._socket.sendto(data, peer)
        except OSError as error:
            if error.errno in _PEER_GONE:
                return len(data)
            if error.errno in (*_WOULD_BLOCK, errno.ENOBUFS):
                return 0
            raise

    def close(self) -> None:
        self._socket.close()


class _Stream:
    """One TCP connection with a bounded backlog of data still to be sent."""

    def __init__(self, connection: socket.socket, name: str) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.name = name
        self.open = True
        self._connection = connection
        self._backlog = bytearray()

    def read(self, limit: int) -> bytes:
        if not limit:
            return b""  # recv(0) would look like the end of the connection
        try:
            data = self._connection.recv(limit)
        except OSError as error:
            if error.errno not in _WOULD_BLOCK:
                self.close()
            return b""
        if not data:
            self.close()
        return data

    def write(self, data: bytes) -> int:
        if self._backlog:
            del self._backlog[: self._send(self._backlog)]
        return 0 if self._backlog or not data else self._send(data)

    def _send(self, data: bytes | bytearray) -> int:
        try:
            return self._connection.send(data)
        except OSError as error:
            if error.errno not in _WOULD_BLOCK:
                self.close()
            return 0

    def push(self, data: bytes) -> None:
        """Send all of `data`, now or later; a peer that lags by more than _CLIENT_BACKLOG is disconnected."""
        count = self.write(data)
        self._backlog += data[count:]
        if len(self._backlog) > _CLIENT_BACKLOG:
            self.close()

    def close(self) -> None:
        self.open = False
        self._connection.close()


class TcpClientPort:
    """A TCP connection to a listening peer."""

    def __init__(self, host: str, number: int) -> None:
        self._stream = _Stream(socket.create_connection((host, number), timeout=_CONNECT_S), f"{host}:{number}")

    @property
    def is_open(self) -> bool:
        return self._stream.open

    def read(self, limit: int = _READ_BYTES) -> bytes:
        return self._stream.read(limit) if self._stream.open else b""

    def write(self, data: bytes) -> int:
        return self._stream.write(data) if self._stream.open else len(data)

    def close(self) -> None:
        self._stream.close()


class TcpServerPort:
    """A TCP listener: sends everything to each connected peer and reads from all of them."""

    is_open = True  # another peer may connect

    def __init__(self, host: str, number: int) -> None:
        self._listener = socket.create_server((host, number))
        self._listener.setblocking(False)
        self._streams: list[_Stream] = []  # rotated, so that each is read first in turn

    @property
    def address(self) -> tuple[str, int]:
        name = self._listener.getsockname()
        return str(name[0]), int(name[1])

    def receive(self, limit: int = _READ_BYTES) -> list[tuple[str, bytes]]:
        """Return (peer, bytes) of what has arrived, at most `limit` bytes in all; peers are read first in turn."""
        self._accept()
        pieces: list[tuple[str, bytes]] = []
        for remaining, stream in zip(range(len(self._streams), 0, -1), tuple(self._streams), strict=True):
            data = stream.read(limit // remaining)  # an equal share of what remains
            if data:
                pieces.append((stream.name, data))
                limit -= len(data)
        self._streams = [s for s in (*self._streams[1:], *self._streams[:1]) if s.open]
        return pieces

    def read(self, limit: int = _READ_BYTES) -> bytes:
        return b"".join(data for _, data in self.receive(limit))

    def write(self, data: bytes) -> int:
        self._accept()
        for stream in self._streams:
            stream.push(data)
        self._streams = [s for s in self._streams if s.open]
        return len(data)

    def _accept(self) -> None:
        for _ in range(MAX_PEERS):
            try:
                connection, peer = self._listener.accept()
            except OSError as error:
                if error.errno in (*_WOULD_BLOCK, errno.ECONNABORTED):
                    return
                raise
            if len(self._streams) >= MAX_PEERS:
                connection.close()
                continue
            self._streams.append(_Stream(connection, f"{peer[0]}:{peer[1]}"))

    def close(self) -> None:
        for stream in self._streams:
            stream.close()
        self._listener.close()


class SerialPort:
    """An open serial device. device: a `pyserial` object with timeout 0, or anything with `fileno`.

    Writes to the file descriptor, because pyserial's write with write_timeout=0 spins while the driver's buffer is full.
    """

    def __init__(self, device: Any) -> None:
        self._device = device
        self._descriptor = int(device.fileno())
        os.set_blocking(self._descriptor, False)

    @property
    def is_open(self) -> bool:
        """Whether the device, or a pseudo-terminal's other end, is still there."""
        watch = select.poll()
        watch.register(self._descriptor, 0)
        return not watch.poll(0)  # poll reports hang-up and error without being asked to

    def read(self, limit: int = _READ_BYTES) -> bytes:
        try:
            return os.read(self._descriptor, limit)
        except OSError as error:
            if error.errno in (*_WOULD_BLOCK, errno.EIO):  # EIO: a pseudo-terminal whose other end is closed
                return b""
            raise

    def write(self, data: bytes) -> int:
        try:
            return os.write(self._descriptor, data)
        except OSError as error:
            if error.errno in (*_WOULD_BLOCK, errno.EIO):
                return 0
            raise

    def close(self) -> None:
        self._device.close()


def open_serial_port(device: str, baud: int) -> SerialPort:
    """Open a serial device. Raises OSError or ValueError where it cannot be opened."""
    import serial

    return SerialPort(serial.Serial(device, baud, timeout=0, exclusive=True))


class MemoryPort:
    """One end of a pair that exchanges bytes within a process; see `memory_pair`."""

    def __init__(self, inbox: deque[memoryview], outbox: deque[memoryview]) -> None:
        self._inbox = inbox
        self._outbox = outbox

    def read(self, limit: int = _READ_BYTES) -> bytes:
        data_read = bytearray()
        while self._inbox and len(data_read) < limit:
            data = self._inbox.popleft()
            remaining = limit - len(data_read)
            data_read += data[:remaining]
            if len(data) > remaining:
                self._inbox.appendleft(data[remaining:])
        return bytes(data_read)

    def write(self, data: bytes) -> int:
        self._outbox.append(memoryview(bytes(data)))  # a memoryview: partial reads do not copy the rest
        return len(data)

    def close(self) -> None:
        self._inbox.clear()


def memory_pair() -> tuple[MemoryPort, MemoryPort]:
    """Two connected ports: each reads what the other writes."""
    first: deque[memoryview] = deque()
    second: deque[memoryview] = deque()
    return MemoryPort(first, second), MemoryPort(second, first)
