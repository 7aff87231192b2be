"""The uplink to an aircraft: commands, sent until acknowledged, and manoeuvres for its sequencer."""

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
_PARAMETERS = 7  # of a COMMAND_LONG
_DIGEST_DIGITS = 6  # hexadecimal ones of a manoeuvre: 24 bits are exact in a parameter of single precision

_TURN_NS = NS // 4
_AT_ONCE = 2
"""Fragments of a manoeuvre in a turn: 8 a second are 1.8 kB/s, what a radio at 57600 baud has left beside the downlink."""
_PATIENCE_NS = 20 * NS
"""Time without an answer, after which a manoeuvre is given up: the aircraft may be out of range for a turn."""
_WORDS = {wire.TAKEN: "taken", wire.REFUSED: "refused by the aircraft, which says why"}


@dataclass
class _Pending:
    """A command without an acknowledgement. sent: how often; due_ns: time of the next try."""

    system: int
    command: int
    parameters: tuple[float, ...]
    sent: int = 0
    due_ns: int = 0


class Commander:
    """Sends each command up to TRIES times, RETRY_NS apart, until its COMMAND_ACK comes.

    Repetition is harmless: the aircraft answers a repeated command without acting again.
    """

    def __init__(self) -> None:
        self._pending: deque[_Pending] = deque()
        self._mark = 0

    def start_recording(self, system: int) -> None:
        self._send(system, c.LOGGING_START)

    def stop_recording(self, system: int) -> None:
        self._send(system, c.LOGGING_STOP)

    def mark(self, system: int) -> int:
        """Mark an event; returns its number."""
        self._mark += 1
        self._send(system, c.EVENT_MARK, float(self._mark))
        return self._mark

    def set_rate(self, system: int, rate_hz: float) -> None:
        """Request a downlink rate [Hz]; 0 for the configured one."""
        self._send(system, c.SET_MESSAGE_INTERVAL, float(SCAN_FAST_ID), 1e6 / rate_hz if rate_hz > 0 else 0.0)

    def zero_pitot(self, system: int) -> None:
        """Zero the pitot; the aircraft refuses unless it is at rest."""
        self._send(system, c.PREFLIGHT_CALIBRATION, 0.0, 0.0, 0.0, 0.0, 0.0, c.AIRSPEED_CALIBRATION)

    def start_manoeuvre(self, system: int, digest: str) -> None:
        """Start the armed manoeuvre with this digest; the aircraft obeys a signed command only, with its pilot's switch at go."""
        self._send(system, c.SEQUENCER, 1.0, float(int(digest[:_DIGEST_DIGITS], 16)))

    def stop_manoeuvre(self, system: int) -> None:
        self._send(system, c.SEQUENCER, 0.0)

    def _send(self, system: int, command: int, *parameters: float) -> None:
        self._pending.append(_Pending(system, command, parameters + (0.0,) * (_PARAMETERS - len(parameters))))

    def due(self, now_ns: int) -> tuple[list[tuple[int, dict[str, Any]]], list[ev.CommandResult]]:
        """COMMAND_LONG messages to send now (system, fields), and commands given up. One command of a kind is sent at a time."""
        send, given_up, in_progress = [], [], set()
        for p in list(self._pending):
            key = (p.system, p.command)
            if key in in_progress:
                continue
            in_progress.add(key)
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
        """Use a COMMAND_ACK; empty where no command waits for it."""
        for p in self._pending:
            if p.sent and (p.system, p.command) == (system, command):
                self._pending.remove(p)
                words = c.RESULT_WORDS.get(result, f"result {result}")
                return [ev.CommandResult(system, command, words, result == c.ACCEPTED, now_ns)]
        return []


class ManoeuvreSender:
    """Sends one manoeuvre at a time; a new one replaces the one in progress."""

    def __init__(self, system: int) -> None:
        self._system = system
        self._digest = ""
        self._checksum = 0
        self._fragments: list[bytes] = []
        self._missing: set[int] = set()
        self._next_ns: int | None = None  # time of the next fragments; None without a manoeuvre in progress
        self._heard_ns: int | None = None
        self._place = 0

    def send(self, manoeuvre: Manoeuvre) -> None:
        """Begin to send a manoeuvre. Raises ManoeuvreError where it is too long for the link."""
        data = wire.pack(manoeuvre)
        self._digest, self._checksum = manoeuvre.digest, zlib.crc32(data)
        self._fragments = wire.fragments(data)
        self._missing = set(range(len(self._fragments)))
        self._next_ns, self._heard_ns, self._place = 0, None, 0

    def due(self, now_ns: int) -> list[tuple[str, dict[str, Any]]]:
        """Fragments to send now, in turn: those not confirmed; the last one again while only the result is missing."""
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
        """Use a MANOEUVRE_STATUS; returns the result of the manoeuvre, where it states one."""
        if self._next_ns is None or fields["checksum"] != self._checksum:
            return []
        self._heard_ns = now_ns
        self._missing = {i for i in range(len(self._fragments)) if not fields["held"] >> i & 1}
        words = _WORDS.get(fields["result"])
        return [] if words is None else [self._finish(words, fields["result"] == wire.TAKEN, now_ns)]

    def given_up(self, now_ns: int) -> list[ev.ManoeuvreSent]:
        """The result of a manoeuvre without an answer for _PATIENCE_NS; empty otherwise."""
        if self._next_ns is None or self._heard_ns is None or now_ns - self._heard_ns < _PATIENCE_NS:
            return []
        return [self._finish("given up: no answer", False, now_ns)]

    def _finish(self, words: str, accepted: bool, now_ns: int) -> ev.ManoeuvreSent:
        """End the sending; returns the result."""
        self._next_ns = None
        return ev.ManoeuvreSent(self._system, self._digest, words, accepted, now_ns)
