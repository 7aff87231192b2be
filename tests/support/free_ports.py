"""Ports of the loopback for a program that opens them by number: each given once, no two test workers given the same.

Asking the system for a free one and closing it again is a race: until the program has opened it, anybody may get it, and with
SO_REUSEADDR, which stock clients set, two then share its datagrams.
"""

import os
import socket
from itertools import count

FIRST, EACH = 21_000, 500  # below the range from which the system gives (32768 and up), so many for a worker
_NEXT = count()


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    """A port of 127.0.0.1 that nobody has open."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    for _ in range(EACH):
        port = FIRST + EACH * (worker % 20) + next(_NEXT) % EACH
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise AssertionError(f"no free port in {FIRST + EACH * worker} and the {EACH} after it")
