"""Connects the simulated radio to a real port, for a ground station in another process or on another computer."""

from contextlib import suppress

from daq.transport.ports import BytePort
from firmware_sim.hardware.radio import RadioPort

DATAGRAM = 1400  # bytes
_ROOM = 16_384  # bytes that a slow line may lag behind


class _PortTalker:
    """A radio port as the device behind a pseudo-terminal."""

    def __init__(self, port: RadioPort) -> None:
        self._port = port

    def bytes_until(self, now_ns: int) -> bytes:
        return self._port.read(4096)

    def receive(self, data: bytes, now_ns: int) -> None:
        self._port.write(data)


class PtyBridge:
    """The radio port as a serial device in /dev; `path` is what to open."""

    def __init__(self, port: RadioPort) -> None:
        self._terminal = PseudoTerminal(_PortTalker(port))
        self.path = self._terminal.path

    def pump(self, now_ns: int) -> None:
        """Move bytes both ways."""
        self._terminal.pump(now_ns)

    def close(self) -> None:
        """Take the device away."""
        self._terminal.close()


class UdpBridge:
    """The radio port as UDP: sends to `remote`, takes what comes to `local` (port 0: any free one)."""

    def __init__(self, port: RadioPort, remote: tuple[str, int], local: tuple[str, int] = ("127.0.0.1", 0)) -> None:
        self._port = port
        self._remote = remote
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(local)
        self._socket.setblocking(False)
        self.local: tuple[str, int] = self._socket.getsockname()
        self.unsent = 0

    def pump(self, now_ns: int) -> None:
        """Move bytes both ways."""
        while data := self._port.read(DATAGRAM):
            try:
                self._socket.sendto(data, self._remote)
            except (BlockingIOError, ConnectionRefusedError):
                self.unsent += len(data)  # nobody listens yet: as with a radio, the bytes are gone
        while True:
            try:
                data, sender = self._socket.recvfrom(65535)
            except (BlockingIOError, ConnectionRefusedError):
                return
            if sender[0] == self._remote[0]:
                self._port.write(data)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class PortBridge:
    """A radio port and a real port of `daq.transport.ports`; bytes sent while the real port is absent are lost.

    Call `pump` regularly, for instance as `SimulatedFlightRun.each_scan`.
    """

    def __init__(self, radio: RadioPort, port: BytePort) -> None:
        self._radio = radio
        self._port = port
        self._waiting = b""

    def pump(self, now_ns: int) -> None:
        """Move bytes both ways."""
        with suppress(OSError):
            self._radio.write(self._port.read())
        self._waiting = (self._waiting + self._radio.read())[-_LARGEST_BACKLOG:]
        if self._waiting:
            try:
                self._waiting = self._waiting[self._port.write(self._waiting) :]
            except OSError:
                self._waiting = b""

    def close(self) -> None:
        """Close the real port."""
        self._port.close()
