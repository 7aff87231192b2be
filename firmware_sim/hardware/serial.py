"""Serial ports of the simulated aircraft: the calls of `pyserial`, in memory or over a real pseudo-terminal.

The device behind a port is a `Talker`, which sends bytes as time passes and takes bytes. In memory, bytes are available by
simulated time; over a pseudo-terminal they are pushed as the clock advances, and a program that has opened the other side
(pyserial, a ground station) reads them as from a wire.
"""

import errno
import os
import select
import termios
import tty
from collections.abc import Callable
from typing import Protocol

BUFFER_BYTES = 4095  # a Linux tty's buffer


class Talker(Protocol):
    """A device at the far end of a serial line."""

    def bytes_until(self, now_ns: int) -> bytes:
        """Bytes that have arrived since the last call."""
        ...

    def receive(self, data: bytes, now_ns: int) -> None:
        """Process bytes sent to the device."""
        ...


class SimulatedSerial:
    """An open serial port in memory, with the calls of `serial.Serial` and timeout=0.

    overrun: bytes lost because the buffer was full, as in a tty.
    """

    def __init__(self, talker: Talker, monotonic_ns: Callable[[], int], port: str = "simulated") -> None:
        self.port = port
        self.timeout: float | None = 0.0
        self.is_open = True
        self.overrun = 0
        self._talker = talker
        self._now = monotonic_ns
        self._buffer = bytearray()

    @property
    def in_waiting(self) -> int:
        """Received bytes that can be read at once."""
        self._pump()
        return len(self._buffer)

    def read(self, size: int = 1) -> bytes:
        """Return at most `size` bytes without blocking."""
        self._pump()
        data = bytes(self._buffer[:size])
        del self._buffer[:size]
        return data

    def write(self, data: bytes) -> int:
        """Send bytes to the device."""
        self._check_open()
        self._talker.receive(bytes(data), self._now())
        return len(data)

    def flush(self) -> None:
        """Do nothing: written bytes are with the device already."""

    def close(self) -> None:
        """Close the port."""
        self.is_open = False

    def _pump(self) -> None:
        self._check_open()
        self._buffer += self._talker.bytes_until(self._now())
        excess = len(self._buffer) - BUFFER_BYTES
        if excess > 0:
            del self._buffer[BUFFER_BYTES:]
            self.overrun += excess

    def _check_open(self) -> None:
        if not self.is_open:
            raise OSError(errno.EBADF, "the serial port is closed")


class PseudoTerminal:
    """A real pseudo-terminal with a Talker behind it; a program opens `path` as its serial port.

    Call `pump(now_ns)` after every advance of time, for instance from `SimulatedClock.on_advance`.
    """

    def __init__(self, talker: Talker) -> None:
        self._talker = talker
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        attributes = termios.tcgetattr(self._slave)
        attributes[4] = attributes[5] = termios.B115200
        termios.tcsetattr(self._slave, termios.TCSANOW, attributes)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self.overrun = 0
        self._closed = False

    def pump(self, now_ns: int) -> None:
        """Transfer the bytes of both directions up to this time [ns]."""
        if self._closed:
            return
        data = self._talker.bytes_until(now_ns)
        if data:
            self.overrun += len(data) - self._push(data)
        while select.select([self._master], [], [], 0.0)[0]:
            received = os.read(self._master, 4096)
            if not received:
                break
            self._talker.receive(received, now_ns)

    def close(self) -> None:
        """Close both sides; a reader of `path` then sees the end of the line."""
        if not self._closed:
            self._closed = True
            os.close(self._master)
            os.close(self._slave)

    def _push(self, data: bytes) -> int:
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0  # nobody reads: the line's buffer is full
