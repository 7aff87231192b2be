"""Connections of the ground station: `[link]` of the configuration, its ports, and a UDP listener that cannot be flooded.

All datagrams of a UDP port share one buffer in the kernel, and a sender at loopback speed fills it in a millisecond: the kernel
then drops those of the aircraft. So each aircraft's sender gets its own socket and buffer, bound to the same port and connected
to that sender, which the kernel prefers. The port stays closed to other programs. Datagrams of strangers are all read, so that a
new aircraft gets through, but only used within an allowance.
"""

import contextlib
import errno
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from daq.transport.ports import (
    MAX_PEERS,
    BytePort,
    PortError,
    UdpPort,
    open_socket_port,
    parse_port,
)
from daq.transport.reconnecting_port import open_lasting
from groundstation.receiver.timeline import Allowance, GroundClock, SystemClock


class LinkConfig(BaseModel):
    """ports: as `daq.transport.ports.parse_port` reads them; listeners bind to loopback unless a host is named.

    systems: aircraft to listen to, all when empty. backfill: `lost` fetches scans lost on the link whenever there is
    bandwidth, `all` fetches every scan in full (at the end of a flight), `off` fetches none.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    ports: tuple[str, ...] = ("udpin:14550",)
    systems: tuple[Annotated[int, Field(ge=1, le=254)], ...] = ()
    system_id: Annotated[int, Field(ge=1, le=255)] = 255
    component_id: Annotated[int, Field(ge=1, le=255)] = 190
    key_file: Path | None = None  # 32 bytes or 64 hexadecimal digits, mode 0600; with it unsigned frames are refused
    signing_state: Path | None = None  # where signing timestamps survive a restart; default beside the key
    backfill: Literal["off", "lost", "all"] = "lost"
    transmit: bool = True  # False: listen only (no heartbeat, no time sync, no backfill)

    @field_validator("ports", mode="before")
    @classmethod
    def _one_port_is_a_list_too(cls, value: Any) -> Any:
        return (value,) if isinstance(value, str) else value

    @field_validator("ports")
    @classmethod
    def _each_port_once(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        repeated = [p for p in value if value.count(p) > 1]
        if repeated:
            raise ValueError(f"port {repeated[0]!r} is listed twice")
        return value


READ_BYTES = 65536  # at once: no datagram is longer
TURN_DATAGRAMS, TURN_BYTES = 4096, 1 << 24
"""Read from one socket in a turn, at most: ten milliseconds of work."""
STRANGER_AT_ONCE, STRANGER_PER_S = 1 << 16, 100_000
"""Bytes of one sender that is not known as an aircraft: ten times what a radio carries."""
STRANGERS_AT_ONCE, STRANGERS_PER_S = 1 << 18, 400_000
"""Bytes of all strangers together: the search for frames in noise takes a microsecond a byte."""
AIRCRAFT_AT_ONCE, AIRCRAFT_PER_S = 1 << 19, 400_000
"""Bytes of one aircraft: two hundred times the default budget of its radio link, for a fast one."""
OWN_SOCKETS = 16  # for as many aircraft as are served
_STRANGERS = 64  # senders that are remembered
_SOCKET_BUFFER = 1 << 20  # bytes
_MEMORY_INFO = 55  # SO_MEMINFO of Linux
_MEMORY_COUNTERS = struct.Struct("=9I")  # its content, whose last counter is of dropped datagrams
_QUIET = (errno.EAGAIN, errno.EWOULDBLOCK, errno.EINTR)
_REFUSED = (errno.ECONNREFUSED, errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENETDOWN)
Address = tuple[str | int, ...]


@dataclass(frozen=True)
class _UdpAircraft:
    """The sender of an aircraft."""

    address: Address
    allowance: Allowance


class UdpListener(UdpPort):
    """A UDP port to which anybody may send. `favour` marks a sender as an aircraft; refused_bytes: beyond the allowances."""

    def __init__(self, local: tuple[str, int], clock: GroundClock) -> None:
        super().__init__(local=local)
        self._clock = clock
        self._buffer = bytearray(READ_BYTES)
        self._connections: dict[str, socket.socket] = {}  # sender's name -> socket connected to it
        self._aircraft: dict[str, _UdpAircraft] = {}
        self._addresses: dict[str, Address] = {}  # of recent senders, the latest last
        self._strangers = Allowance(STRANGERS_AT_ONCE, STRANGERS_PER_S)
        self._stranger_allowances: dict[str, Allowance] = {}
        self.refused_bytes = 0
        self._dropped_before = 0  # by the kernel, at closed sockets

    @property
    def dropped(self) -> int:
        """Datagrams that the kernel has dropped because a socket's buffer was full; 0 where it does not count them."""
        if self._socket.fileno() < 0:
            return self._dropped_before
        return self._dropped_before + sum(_drops(s) for s in (self._socket, *self._connections.values()))

    def receive(self, limit: int = TURN_BYTES) -> list[tuple[str, bytes]]:
        """Datagrams that have arrived, each with the name of its sender: of aircraft first, then of strangers within their
        allowance."""
        datagrams: list[tuple[str, bytes]] = []
        now_ns = self._clock.monotonic_ns()
        for name, connection in self._connections.items():
            for _, size in self._datagrams(connection, limit):
                self._add_allowed(name, size, now_ns, datagrams)
        for address, size in self._datagrams(self._socket, limit):
            name = _name(address)
            self._remember(name, address)
            self._add_allowed(name, size, now_ns, datagrams)
        return datagrams

    def _add_allowed(self, name: str, size: int, now_ns: int, datagrams: list[tuple[str, bytes]]) -> None:
        """Add the datagram in the buffer to `datagrams`, if its sender's allowance permits."""
        aircraft = self._aircraft.get(name)
        if aircraft is not None:
            accepted = aircraft.allowance.spend(size, now_ns)
        else:
            accepted = self._stranger_allowance(name).spend(size, now_ns) and self._strangers.spend(size, now_ns)
        if accepted:
            datagrams.append((name, bytes(self._buffer[:size])))
        else:
            self.refused_bytes += size

    def _datagrams(self, connection: socket.socket, limit: int) -> Iterator[tuple[Address, int]]:
        """Sender and size of each waiting datagram, whose bytes are in the buffer; at most TURN_DATAGRAMS."""
        total = 0
        for _ in range(TURN_DATAGRAMS):
            try:
                size, address = connection.recvfrom_into(self._buffer)
            except OSError as error:
                if error.errno in _REFUSED:
                    continue  # an earlier datagram from here was not delivered
                if error.errno in _QUIET:
                    return
                raise
            yield address, size
            total += size
            if total >= limit:
                return

    def _remember(self, name: str, address: Address) -> None:
        """Store the address of the latest sender."""
        self._addresses.pop(name, None)
        self._addresses[name] = address
        if len(self._addresses) > _STRANGERS:
            self._addresses.pop(next(iter(self._addresses)))

    def _stranger_allowance(self, name: str) -> Allowance:
        allowance = self._stranger_allowances.pop(name, None) or Allowance(STRANGER_AT_ONCE, STRANGER_PER_S)
        self._stranger_allowances[name] = allowance  # the latest one last
        if len(self._stranger_allowances) > _STRANGERS:
            self._stranger_allowances.pop(next(iter(self._stranger_allowances)))
        return allowance

    # ------------------------------------------------------------------------------------------ aircraft

    def favour(self, name: str) -> None:
        """Mark a sender as an aircraft: frames go to it, and it gets its own socket while there are any."""
        address = self._addresses.get(name)
        if name in self._aircraft or address is None or len(self._aircraft) >= _STRANGERS:
            return
        self._aircraft[name] = _UdpAircraft(address, Allowance(AIRCRAFT_AT_ONCE, AIRCRAFT_PER_S))
        # a later sender takes no socket away: strangers could then displace an aircraft
        if len(self._connections) < OWN_SOCKETS:
            with contextlib.suppress(OSError):  # on a system that refuses it all senders share one buffer
                self._connections[name] = self._connected(address)

    def _connected(self, address: Address) -> socket.socket:
        """A socket on this port, connected to a sender. Raises OSError."""
        connection = socket.socket(self._socket.family, socket.SOCK_DGRAM)
        bound = (self._socket, *self._connections.values(), connection)
        try:
            connection.setblocking(False)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BUFFER)
            # SO_REUSEPORT only while the new socket is bound: otherwise another program of this user could share the port.
            for shared in bound:
                shared.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            connection.bind(self._socket.getsockname())
            connection.connect(address)
        except OSError:
            connection.close()
            raise
        finally:
            for shared in bound:
                if shared.fileno() >= 0:
                    shared.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 0)
        return connection

    def forget(self, name: str) -> None:
        """Undo `favour`."""
        self._aircraft.pop(name, None)
        if name in self._connections:
            self._close_connection(name)

    def _close_connection(self, name: str) -> None:
        connection = self._connections.pop(name)
        self._dropped_before += _drops(connection)
        connection.close()

    # ------------------------------------------------------------------------------------------ sending

    def write(self, data: bytes) -> int:
        """Send one datagram to each aircraft; without one, to the latest few senders. Returns the bytes sent."""
        targets = [a.address for a in self._aircraft.values()] or list(self._addresses.values())[-MAX_PEERS:]
        sizes = [self._send(data, address) for address in targets]
        return min(sizes, default=len(data))

    def close(self) -> None:
        for name in list(self._connections):
            self._close_connection(name)
        self._dropped_before = self.dropped
        super().close()


def _name(address: Address) -> str:
    """A sender's address and port as text."""
    return f"{address[0]}:{address[1]}"


def _drops(connection: socket.socket) -> int:
    """Datagrams that the kernel has dropped at a socket; 0 where it does not count them."""
    try:
        counters = connection.getsockopt(socket.SOL_SOCKET, _MEMORY_INFO, _MEMORY_COUNTERS.size)
    except OSError:
        return 0
    return int(_MEMORY_COUNTERS.unpack(counters)[-1]) if len(counters) == _MEMORY_COUNTERS.size else 0


def open_port(text: str, clock: GroundClock | None = None) -> BytePort:
    """Open a port by its description. clock: for the allowances of a UDP listener; this machine's by default.

    Raises PortError for a wrong description, or a port that cannot be opened.
    """
    spec = parse_port(text)
    if spec.kind != "udpin":
        return open_lasting(text)
    open_socket_port(spec).close()  # its error explains why the port cannot be opened
    try:
        return UdpListener((spec.address, spec.number), clock or SystemClock())
    except OSError as error:
        raise PortError(f"{text}: cannot be opened ({error.strerror}); is another program using it?") from error
