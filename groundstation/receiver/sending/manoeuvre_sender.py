"""Sends a manoeuvre up to the sequencer of one aircraft, fragment by fragment until all are there and it has answered."""

import zlib
from collections.abc import Mapping
from typing import Any

from daq.contract.link import manoeuvre_wire as wire
from daq.contract.manoeuvre import Manoeuvre
from groundstation.receiver import events as ev
from groundstation.receiver.timeline import NS

_TURN_NS = NS // 4
_AT_ONCE = 2
"""Fragments a turn: 8 a second are 1.8 kB/s, what a radio at 57600 baud has left beside the downlink."""
_PATIENCE_NS = 20 * NS
"""So long without any answer, and it is given up: the aircraft may be out of range for a turn."""
_WORDS = {wire.TAKEN: "taken", wire.REFUSED: "refused by the aircraft, which says why"}


class ManoeuvreSender:
    """One manoeuvre at a time; a new one takes the place of one under way."""

    def __init__(self, system: int) -> None:
        self._system = system
        self._digest = ""
        self._checksum = 0
        self._fragments: list[bytes] = []
        self._missing: set[int] = set()
        self._next_ns: int | None = None  # when to send again; None: nothing is under way
        self._heard_ns: int | None = None
        self._place = 0

    @property
    def under_way(self) -> bool:
        """Whether a manoeuvre is being sent."""
        return self._next_ns is not None

    def send(self, manoeuvre: Manoeuvre) -> None:
        """Begin to send. Raises ManoeuvreError where it is too long for the link."""
        data = wire.pack(manoeuvre)
        self._digest, self._checksum = manoeuvre.digest, zlib.crc32(data)
        self._fragments = wire.fragments(data)
        self._missing = set(range(len(self._fragments)))
        self._next_ns, self._heard_ns, self._place = 0, None, 0

    def due(self, now_ns: int) -> list[tuple[str, dict[str, Any]]]:
        """Fragments to send now: those that the aircraft is not known to have, in turn; one of them where it has all."""
        if self._next_ns is None or now_ns < self._next_ns:
            return []
        self._heard_ns = now_ns if self._heard_ns is None else self._heard_ns
        self._next_ns = now_ns + _TURN_NS
        count = len(self._fragments)
        order = [(self._place + i) % count for i in range(count)]
        chosen = [i for i in order if i in self._missing][:_AT_ONCE] or [count - 1]
        self._place = (chosen[-1] + 1) % count
        return [("MANOEUVRE_DATA", self._fields(i)) for i in chosen]

    def _fields(self, number: int) -> dict[str, Any]:
        piece = self._fragments[number]
        return {
            "checksum": self._checksum,
            "fragment": number,
            "fragments": len(self._fragments),
            "length": len(piece),
            "data": piece.ljust(wire.FRAGMENT_BYTES, b"\0"),
        }

    def take_status(self, fields: Mapping[str, Any], now_ns: int) -> list[ev.ManoeuvreSent]:
        """Use a MANOEUVRE_STATUS; what became of the manoeuvre, where it says so."""
        if self._next_ns is None or fields["checksum"] != self._checksum:
            return []
        self._heard_ns = now_ns
        self._missing = {i for i in range(len(self._fragments)) if not fields["held"] >> i & 1}
        words = _WORDS.get(fields["result"])
        return [] if words is None else [self._ended(words, fields["result"] == wire.TAKEN, now_ns)]

    def given_up(self, now_ns: int) -> list[ev.ManoeuvreSent]:
        """That nothing has been heard of it for too long."""
        if self._next_ns is None or self._heard_ns is None or now_ns - self._heard_ns < _PATIENCE_NS:
            return []
        return [self._ended("given up: no answer", False, now_ns)]

    def _ended(self, words: str, taken: bool, now_ns: int) -> ev.ManoeuvreSent:
        self._next_ns = None
        return ev.ManoeuvreSent(self._system, self._digest, words, taken, now_ns)
