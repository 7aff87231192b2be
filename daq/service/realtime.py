"""Make the operating system leave the scan loop alone: scheduling class, locked memory, garbage collection.

All of it is optional. On an ordinary kernel the loop keeps its deadlines within milliseconds without.
"""

import ctypes
import gc
import os
import socket
from collections.abc import Mapping

from daq.config import ConfigError, ScanConfig

# What is touched stays in memory; what never is takes none (Linux 4.4). Without the last flag the process grows to
# everything its libraries map, over 160 MB.
_MCL_CURRENT, _MCL_FUTURE, _MCL_ON_FAULT = 1, 2, 4
_COLLECT_EVERY, _FULL_COLLECTION_EVERY = 10, 120


def prepare_process(config: ScanConfig) -> None:
    """Apply what `[scan]` asks for. Raises ConfigError naming the key and the missing right."""
    if config.realtime_priority:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(config.realtime_priority))
        except PermissionError as error:
            raise ConfigError(
                f"scan.realtime_priority {config.realtime_priority}: not permitted; "
                "run as the systemd service (it grants CAP_SYS_NICE) or set it to 0"
            ) from error
    if config.lock_memory:
        _lock_memory()


def _lock_memory() -> None:
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ON_FAULT) != 0:
        reason = os.strerror(ctypes.get_errno())
        raise ConfigError(
            f"scan.lock_memory: not permitted ({reason}); run as the systemd service (it sets LimitMEMLOCK) or set it to false"
        )


class GarbageDiscipline:
    """Collects garbage in the slack after a scan instead of whenever Python feels like it.

    What the start has built is frozen before the first scan: collections look only at what came after it.
    """

    def __init__(self, *, enabled: bool) -> None:
        self._enabled = enabled
        self._turn = 0

    def __enter__(self) -> "GarbageDiscipline":
        if self._enabled:
            gc.disable()
        return self

    def __exit__(self, *_: object) -> None:
        if self._enabled:
            gc.enable()
            gc.unfreeze()

    def freeze(self) -> None:
        """Collect once, thoroughly, and exempt all that is left: to be called when everything has been built."""
        if self._enabled:
            gc.collect()
            gc.freeze()

    def collect(self) -> None:
        """To be called once a second. Reference counting frees all but cycles: those are looked for every ten seconds
        among the young objects and every two minutes among all.
        """
        if not self._enabled:
            return
        self._turn += 1
        if self._turn % _COLLECT_EVERY == 0:
            gc.collect(2 if self._turn % _FULL_COLLECTION_EVERY == 0 else 1)


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
