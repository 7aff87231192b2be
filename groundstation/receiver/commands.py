"""What goes up to an aircraft: commands, sent until acknowledged, and manoeuvres for its sequencer."""

import zlib
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from daq.contract.link import commands as c
from daq.contract.link import manoeuvre_wire as wire
from daq.contract.link.wire import SCAN_FAST_ID
from daq.contract.manoeuvre import Manoeuvre
from groundstation.receiver import events as ev
from groundstation.receiver.timeline import NS

TRIES = 5
RETRY_NS = NS


@dataclass
class _Pending:
    system: int
    command: int
    parameters: tuple[float, ...]
    sent: int = 0
    due_ns: int = 0


class Commander:
    """Sends each command up to five times, a second apart, until its COMMAND_ACK comes.

    Repeating is harmless: the aircraft answers a repeated command without acting again.
    """

    def __init__(self) -> None:
        self._pending: deque[_Pending] = deque()
        self._mark = 0

    def start_recording(self, system: int) -> None:
        self._send(system, c.LOGGING_START)

    def stop_recording(self, system: int) -> None:
        self._send(system, c.LOGGING_STOP)

    def mark(self, system: int) -> int:
        """Mark an event; returns the number it will carry."""
        self._mark += 1
        self._send(system, c.EVENT_MARK, float(self._mark))
        return self._mark

    def set_rate(self, system: int, rate_hz: float) -> None:
        """Wish for a downlink rate [Hz]; 0 for the configured one."""
        self._send(system, c.SET_MESSAGE_INTERVAL, float(SCAN_FAST_ID), 1e6 / rate_hz if rate_hz > 0 else 0.0)

    def zero_pitot(self, system: int) -> None:
        """Zero the pitot; the aircraft refuses unless it is clearly at rest."""
        self._send(system, c.PREFLIGHT_CALIBRATION, 0.0, 0.0, 0.0, 0.0, 0.0, c.AIRSPEED_CALIBRATION)

    def start_manoeuvre(self, system: int, digest: str) -> None:
        """Start the armed manoeuvre with this digest; the aircraft obeys a signed wish only, with its pilot's switch at go."""
        self._send(system, c.SEQUENCER, 1.0, float(int(digest[:6], 16)))

    def stop_manoeuvre(self, system: int) -> None:
        self._send(system, c.SEQUENCER, 0.0)

    def _send(self, system: int, command: int, *parameters: float) -> None:
        self._pending.append(_Pending(system, command, parameters + (0.0,) * (7 - len(parameters))))

    def due(self, now_ns: int) -> tuple[list[tuple[int, dict[str, Any]]], list[ev.CommandResult]]:
        """COMMAND_LONG fields to send now, by system, and commands given up."""
        send, given_up, busy = [], [], set()
        for p in list(self._pending):
            key = (p.system, p.command)
            if key in busy:
                continue
            busy.add(key)
            if now_ns < p.due_ns:
                continue
            if p.sent >= TRIES:
                self._pending.remove(p)
                given_up.append(ev.CommandResult(p.system, p.command, "no answer", False, now_ns))
                continue
            fields = {f"param{i + 1}": v for i, v in enumerate(p.parameters)}
            send.append((p.system, {"command": p.command, "confirmation": p.sent, "target_system": p.system, **fields}))
            p.sent += 1
            p.due_ns = now_ns + RETRY_NS
        return send, given_up

    def acknowledge(self, system: int, command: int, result: int, now_ns: int) -> list[ev.CommandResult]:
        """Use a COMMAND_ACK; empty when nothing was waiting for it."""
        for p in self._pending:
            if p.sent and (p.system, p.command) == (system, command):
                self._pending.remove(p)
                words = c.RESULT_WORDS.get(result, f"result {result}")
                return [ev.CommandResult(system, command, words, result == c.ACCEPTED, now_ns)]
        return []


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
        numbers = [i for i in order if i in self._missing][:_AT_ONCE] or [count - 1]
        self._place = (numbers[-1] + 1) % count
        common = {"checksum": self._checksum, "fragments": count}
        pieces = [(i, self._fragments[i]) for i in numbers]
        return [
            ("MANOEUVRE_DATA", {**common, "fragment": i, "length": len(p), "data": p.ljust(wire.FRAGMENT_BYTES, b"\0")})
            for i, p in pieces
        ]

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
