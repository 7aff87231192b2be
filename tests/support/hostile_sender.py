"""A sender that wants the logger to fail: at full loopback speed to a UDP port, for a limited time.

Arguments: port, kind, seconds. Prints how many datagrams and bytes it got rid of. Loopback only.
"""

import json
import signal
import socket
import sys
import time
from collections.abc import Callable, Mapping
from itertools import cycle

from daq.contract.link import commands as c
from daq.transport.mavlink_codec import FrameDecoder, FrameEncoder, frames_of

_ME = FrameEncoder(255, 190)
_TURNS = 256  # different datagrams of a kind
_KNOCK_S = 5.0


def _boot(sender: socket.socket) -> int:
    """The logger's boot id, which it tells anybody who asks; 1 when it does not answer."""
    sender.settimeout(0.2)
    decoder, until = FrameDecoder(), time.monotonic() + _KNOCK_S
    while time.monotonic() < until:
        sender.send(_ME.message("BACKFILL_SUMMARY_REQUEST", through_number=2**32 - 1))
        try:
            heard = frames_of(decoder.feed(sender.recv(2048)))
        except (TimeoutError, ConnectionRefusedError):
            continue
        for frame in heard:
            if frame.name == "BACKFILL_SUMMARY":
                return int(str(frame.fields()["boot"]))
    return 1


def _papers(boot: int) -> list[bytes]:
    return [_ME.message("BACKFILL_REQUEST", fragments=2**64 - 1, boot=boot)]


def _scans(boot: int) -> list[bytes]:
    return [
        _ME.message("BACKFILL_REQUEST", first_number=i, wanted=0xFFFFFF, fragments=2**64 - 1, boot=boot)
        for i in range(_TURNS)
    ]


def _start_and_stop(_: int) -> list[bytes]:
    return [_ME.message("COMMAND_LONG", command=k) for k in (c.LOGGING_STOP, c.LOGGING_START)]


def _marks(_: int) -> list[bytes]:
    return [_ME.message("COMMAND_LONG", command=c.EVENT_MARK, param1=float(i)) for i in range(_TURNS)]


def _logs(_: int) -> list[bytes]:
    listing = _ME.message("LOG_REQUEST_LIST", end=0xFFFF)
    return [listing, _ME.message("LOG_REQUEST_DATA", id=1, count=2**32 - 1)]


def _headers(_: int) -> list[bytes]:
    """Heads of long frames of a known message, one in the other: each is worth a checksum."""
    return [b"\xfd\x21\x00\x00\x01\x01\x4c\x00\x00\x00" * 140]


def _small(_: int) -> list[bytes]:
    return [b"", b"\xfd"]


def _all(boot: int) -> list[bytes]:
    kinds = [make(boot) for name, make in KINDS.items() if name != "all"]
    return [kind[i % len(kind)] for i in range(_TURNS) for kind in kinds]


KINDS: Mapping[str, Callable[[int], list[bytes]]] = {
    "noise of 0xFD, 280 bytes": lambda _: [b"\xfd" * 280],
    "0xFD, 60 kB": lambda _: [b"\xfd" * 60_000],
    "frame heads": _headers,
    "0 and 1 byte": _small,
    "BACKFILL_REQUEST, papers": _papers,
    "BACKFILL_REQUEST, scans": _scans,
    "start and stop": _start_and_stop,
    "marks": _marks,
    "LOG_REQUEST_LIST, _DATA": _logs,
    "all": _all,
}


def _send(sender: socket.socket, data: bytes) -> None:
    try:
        sender.send(data)
    except ConnectionRefusedError:
        return  # nobody listens (any more): the datagram went all the same


def flood(port: int, kind: str, seconds: float) -> dict[str, int]:
    """Send for a time, or until SIGINT; counts of what the system took."""
    sent = size = 0
    over: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: over.append(number))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", port))
        datagrams = cycle(KINDS[kind](_boot(sender)))
        until = time.monotonic() + seconds
        while time.monotonic() < until and not over:
            for data in (next(datagrams) for _ in range(64)):
                _send(sender, data)
                sent += 1
                size += len(data)
    return {"datagrams": sent, "bytes": size}


if __name__ == "__main__":
    print(json.dumps(flood(int(sys.argv[1]), sys.argv[2], float(sys.argv[3]))))
