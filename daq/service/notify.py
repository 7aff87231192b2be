"""Talk to systemd over its notification socket: ready, alive, stopping. Without systemd nothing is sent.

Protocol: sd_notify(3). The watchdog is fed from the scan loop itself, so a loop that hangs is restarted.
"""

import os
import socket
from collections.abc import Mapping


class Notifier:
    """Sends state to the socket named in the environment that systemd sets up."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        name = environment.get("NOTIFY_SOCKET", "")
        # A name that begins with @ is an abstract socket, which the kernel writes with a zero byte.
        self._address = "\0" + name[1:] if name.startswith("@") else name
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if name else None
        if self._socket is not None:
            self._socket.setblocking(False)
        self.lost = 0

    def ready(self, status: str) -> None:
        """The logger records."""
        self._send(f"READY=1\nSTATUS={status}")

    def alive(self, status: str = "") -> None:
        """The scan loop runs; to be said more often than WatchdogSec."""
        self._send("WATCHDOG=1" + (f"\nSTATUS={status}" if status else ""))

    def stopping(self) -> None:
        """The logger ends its recording."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Release the socket."""
        if self._socket is not None:
            self._socket.close()

    def _send(self, text: str) -> None:
        if self._socket is None:
            return
        try:
            self._socket.sendto(text.encode(), self._address)
        except (BlockingIOError, ConnectionRefusedError, FileNotFoundError):
            self.lost += 1  # systemd is restarting itself; the next message will do
