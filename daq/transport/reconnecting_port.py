"""Ports that reconnect: to a TCP peer that restarts, to a serial adapter that is unplugged and plugged in again.

Opening may take long (a host that does not answer, a slow driver), so it runs in a thread of its own; reading and writing never
block. While the port is away both raise OSError with a sentence for the user.
"""

import errno
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Protocol

from daq.transport.ports import (
    BytePort,
    PortError,
    SerialPort,
    connected,
    open_serial_port,
    open_socket_port,
    parse_port,
)

FIRST_RETRY_NS = 500_000_000  # pause before the first attempt to reopen; it doubles up to the longest
LONGEST_RETRY_NS = 8_000_000_000
OPEN_TIMEOUT_S = 1.0
"""Longest wait for an attempt to open a port, at start and on closing; a name server may take longer to answer."""
_READ_BYTES = 65536
_NOBODY_THERE = (
    errno.ECONNREFUSED,
    errno.ENETUNREACH,
    errno.EHOSTUNREACH,
    errno.ENETDOWN,
    errno.ETIMEDOUT,
    errno.EAGAIN,
)


class ClosingPort(BytePort, Protocol):
    """A port that detects when its other end, or its device, has gone."""

    @property
    def is_open(self) -> bool:
        """Whether its other end, or its device, is still there."""


class ReconnectingPort:
    """A port that is opened again, with growing pauses, whenever it is lost.

    open_again: opens a port, or raises OSError or PortError; called in a thread. port: the opened port, None while there is none.
    reason: why there is none. attempt: a running attempt to open it. now_ns: the monotonic clock.
    """

    def __init__(
        self,
        open_again: Callable[[], ClosingPort],
        port: ClosingPort | None,
        *,
        reason: str = "",
        attempt: "_Attempt | None" = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._open_again = open_again
        self._now_ns = now_ns
        self._port = port
        self._reason = reason
        self._pause_ns = FIRST_RETRY_NS
        self._next_ns = now_ns() + FIRST_RETRY_NS
        self._attempt = attempt

    @property
    def is_open(self) -> bool:
        return self._port is not None

    @property
    def why_away(self) -> str:
        """Why the port is away, or ""."""
        return "" if self.is_open else self._reason

    def read(self, limit: int = _READ_BYTES) -> bytes:
        """At most `limit` bytes that have arrived. Raises OSError while the port is away."""
        port = self._usable()
        try:
            data = port.read(limit)
        except OSError as error:
            raise self._port_lost(error.strerror or str(error)) from error
        if not data and not port.is_open:
            raise self._port_lost("the other end has gone")
        if data:
            self._pause_ns = FIRST_RETRY_NS
        return data

    def write(self, data: bytes) -> int:
        """Send bytes; returns how many the port has taken. Raises OSError while the port is away."""
        port = self._usable()
        try:
            count = port.write(data)
        except OSError as error:
            raise self._port_lost(error.strerror or str(error)) from error
        if not port.is_open:
            raise self._port_lost("the other end has gone")
        return count

    def close(self) -> None:
        """Close the port; a running attempt to open it closes its own when it ends."""
        if self._attempt is not None:
            self._attempt.abandon()
            self._attempt = None
        if self._port is not None:
            self._port.close()
            self._port = None

    def _usable(self) -> ClosingPort:
        if self._port is None:
            self._try()
        if self._port is None:
            raise self._away_error()
        return self._port

    def _try(self) -> None:
        if self._attempt is not None:
            if self._attempt.thread.is_alive():
                return
            self._port, self._attempt = self._attempt.port, None
        elif self._now_ns() >= self._next_ns:
            self._next_ns = self._now_ns() + self._pause_ns
            self._pause_ns = min(LONGEST_RETRY_NS, 2 * self._pause_ns)
            self._attempt = _Attempt(self._open_again)

    def _port_lost(self, reason: str) -> OSError:
        if self._port is not None:
            self._port.close()
        self._port, self._reason = None, reason
        self._next_ns = self._now_ns() + self._pause_ns
        return self._away_error()

    def _away_error(self) -> OSError:
        return OSError(errno.ENOTCONN, f"away ({self._reason}); it is opened again as soon as it is back")


class _Attempt:
    """One attempt to open a port, in a thread."""

    def __init__(self, open_again: Callable[[], ClosingPort]) -> None:
        self.port: ClosingPort | None = None
        self.error: Exception | None = None
        self._open_again = open_again
        self._lock = threading.Lock()
        self._abandoned = False
        self.thread = threading.Thread(target=self._run, name="port-opening", daemon=True)
        self.thread.start()

    def abandon(self) -> None:
        """Close the port if the attempt ends within OPEN_TIMEOUT_S; otherwise its thread closes it later."""
        self.thread.join(OPEN_TIMEOUT_S)
        with self._lock:
            self._abandoned = True
            if self.port is not None:
                self.port.close()

    def _run(self) -> None:
        try:
            port = self._open_again()
        except (OSError, ValueError, PortError) as error:
            self.error = error
            return
        with self._lock:
            if self._abandoned:
                port.close()
            else:
                self.port = port


def open_lasting(
    text: str, open_serial: Callable[[str, int], SerialPort] = open_serial_port, *, wait: bool = False
) -> BytePort:
    """Open a port by its description (`DownlinkConfig.port`). Raises PortError for a faulty description, or a port that cannot
    be opened.

    A TCP peer that is absent is no error: the port connects later. wait: nor is any other thing that may appear later, such as a
    serial adapter, a network or a host name, because on an aircraft devices start in any order.
    """
    spec = parse_port(text)
    if spec.kind == "serial":
        open_again: Callable[[], ClosingPort] = partial(open_serial, spec.address, spec.number)
    else:
        open_again = partial(connected, spec)
    first = _Attempt(open_again)
    first.thread.join(OPEN_TIMEOUT_S if wait else None)
    port, error = first.port, first.error
    if port is not None:
        return port if spec.kind in ("udp", "udpin", "tcpin") else ReconnectingPort(open_again, port)
    if wait and (error is None or (isinstance(error, OSError) and not _is_final(error))):
        return ReconnectingPort(open_again, None, reason=_cause_text(error), attempt=first if error is None else None)
    if spec.kind == "tcp" and (isinstance(error, TimeoutError) or getattr(error, "errno", None) in _NOBODY_THERE):
        return ReconnectingPort(open_again, None, reason=_cause_text(error))
    if spec.kind != "serial":
        return open_socket_port(spec)  # raises with the reason in words
    raise PortError(f"serial port {spec.address} cannot be opened ({error}); check the name, or who uses it") from error


def _cause_text(error: Exception | None) -> str:
    return (getattr(error, "strerror", None) or str(error)) if error is not None else "no answer yet"


def _is_final(error: OSError) -> bool:
    """Whether waiting cannot help: another program uses the address, or this user may not use it."""
    return error.errno in (errno.EADDRINUSE, errno.EACCES)
