"""How the ground station is connected: `[link]` of the configuration, its ports, and a listening UDP port without crowding.

All datagrams of a UDP port share one buffer in the kernel, and a sender at loopback speed fills it in a millisecond: what then
comes from the aircraft is gone before anybody has seen it. So the senders of aircraft get sockets of their own: bound to the
same port and connected to that sender, which the kernel prefers, buffer and all. The port stays closed to other programs.
What strangers send is read to the end, so that a new aircraft gets through, but only as much of it is kept as is allowed.
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
    bandwidth, `all` fetches every scan in full (at the end of a flight), `off` asks for nothing.
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


READ_BYTES = 65536
TURN_DATAGRAMS, TURN_BYTES = 4096, 1 << 24
"""Read from one socket in a turn at most: ten milliseconds of work."""
STRANGER_AT_ONCE, STRANGER_PER_S = 1 << 16, 100_000
"""Bytes of one sender that is not known for an aircraft: ten times what a radio carries."""
STRANGERS_AT_ONCE, STRANGERS_PER_S = 1 << 18, 400_000
"""Bytes of all of them together. Looking for frames in noise takes a microsecond a byte."""
AIRCRAFT_AT_ONCE, AIRCRAFT_PER_S = 1 << 19, 400_000
"""Bytes of one aircraft: two hundred times the default budget of its radio link, for a fast one."""
OWN_SOCKETS = 16  # for as many aircraft as are served
_STRANGERS = 64
_MEMORY_INFO, _DROPS_AT = 55, 8 * 4  # SO_MEMINFO of Linux: nine counters, the last one datagrams dropped
_QUIET = (errno.EAGAIN, errno.EWOULDBLOCK, errno.EINTR)
_REFUSED = (errno.ECONNREFUSED, errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENETDOWN)
Address = tuple[str | int, ...]


@dataclass(frozen=True)
class _UdpAircraft:
    address: Address
    allowance: Allowance


class UdpListener(UdpPort):
    """A port that anybody may send to. `favour` says who has proven to be an aircraft."""

    def __init__(self, local: tuple[str, int], clock: GroundClock) -> None:
        super().__init__(local=local)
        self._clock = clock
        self._buffer = bytearray(READ_BYTES)
        self._connections: dict[str, socket.socket] = {}  # sender's name -> socket connected to it
        self._aircraft: dict[str, _UdpAircraft] = {}
        self._addresses: dict[str, Address] = {}  # of senders heard lately
        self._strangers = Allowance(STRANGERS_AT_ONCE, STRANGERS_PER_S)
        self._stranger_allowances: dict[str, Allowance] = {}
        self.refused_bytes = 0
        self._dropped_before = 0  # by the kernel, at sockets that are closed

    @property
    def dropped(self) -> int:
        """Datagrams that the kernel has dropped because a socket's buffer was full; 0 where it does not say."""
        if self._socket.fileno() < 0:
            return self._dropped_before
        return self._dropped_before + sum(_drops(s) for s in (self._socket, *self._connections.values()))

    def receive(self, limit: int = TURN_BYTES) -> list[tuple[str, bytes]]:
        """Datagrams that have arrived, with a name of their sender; aircraft first, and of strangers what is allowed."""
        datagrams: list[tuple[str, bytes]] = []
        now_ns = self._clock.monotonic_ns()
        for name, connection in self._connections.items():
            for _, size in self._datagrams(connection, limit):
                self._keep(name, size, now_ns, datagrams)
        for address, size in self._datagrams(self._socket, limit):
            name = _name(address)
            self._remember(name, address)
            self._keep(name, size, now_ns, datagrams)
        return datagrams

    def _keep(self, name: str, size: int, now_ns: int, datagrams: list[tuple[str, bytes]]) -> None:
        """Take what is in the buffer, if its sender may send so much."""
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
        """Sender and size of each datagram waiting, its bytes in the buffer; bounded, so that a turn has an end."""
        total = 0
        for _ in range(TURN_DATAGRAMS):
            try:
                size, address = connection.recvfrom_into(self._buffer)
            except OSError as error:
                if error.errno in _REFUSED:
                    continue  # something sent before has not arrived
                if error.errno in _QUIET:
                    return
                raise
            yield address, size
            total += size
            if total >= limit:
                return

    def _remember(self, name: str, address: Address) -> None:
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
        """This sender is an aircraft's: it is answered, and gets a socket of its own while there are any."""
        address = self._addresses.get(name)
        if name in self._aircraft or address is None or len(self._aircraft) >= _STRANGERS:
            return
        self._aircraft[name] = _UdpAircraft(address, Allowance(AIRCRAFT_AT_ONCE, AIRCRAFT_PER_S))
        if len(self._connections) < OWN_SOCKETS:  # nobody loses one to a later one: that would be a way to crowd it out
            with contextlib.suppress(OSError):  # a system that cannot do it: all share one buffer, as on any UDP port
                self._connections[name] = self._connected(address)

    def _connected(self, address: Address) -> socket.socket:
        connection = socket.socket(self._socket.family, socket.SOCK_DGRAM)
        bound = (self._socket, *self._connections.values(), connection)
        try:
            connection.setblocking(False)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            # Only while the new socket is bound: otherwise another program of this user could take the port too.
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
        """This sender is no aircraft's any more."""
        self._aircraft.pop(name, None)
        if name in self._connections:
            self._give_up(name)

    def _give_up(self, name: str) -> None:
        connection = self._connections.pop(name)
        self._dropped_before += _drops(connection)
        connection.close()

    # ------------------------------------------------------------------------------------------ sending

    def write(self, data: bytes) -> int:
        """Send one datagram to each aircraft; while there is none, to the latest few who have sent anything."""
        targets = [a.address for a in self._aircraft.values()] or list(self._addresses.values())[-MAX_PEERS:]
        sizes = [self._send(data, address) for address in targets]
        return min(sizes, default=len(data))

    def close(self) -> None:
        for name in list(self._connections):
            self._give_up(name)
        self._dropped_before = self.dropped
        super().close()


def _name(address: Address) -> str:
    return f"{address[0]}:{address[1]}"


def _drops(connection: socket.socket) -> int:
    try:
        counters = connection.getsockopt(socket.SOL_SOCKET, _MEMORY_INFO, 9 * 4)
    except OSError:
        return 0
    return int(struct.unpack_from("=I", counters, _DROPS_AT)[0]) if len(counters) >= 9 * 4 else 0


def open_port(text: str, clock: GroundClock | None = None) -> BytePort:
    """Open a port by its description; PortError says what is wrong with the description or the port.

    clock: by which a listener allows strangers so much a second; this machine's by default.
    """
    spec = parse_port(text)
    if spec.kind != "udpin":
        return open_lasting(text)
    open_socket_port(spec).close()  # says in words why it cannot be had
    try:
        return UdpListener((spec.address, spec.number), clock or SystemClock())
    except OSError as error:
        raise PortError(f"{text}: cannot be opened ({error.strerror}); is another program using it?") from error
