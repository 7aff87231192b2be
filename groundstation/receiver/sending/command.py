"""Commands to the aircraft: sent until acknowledged, one of a kind at a time."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from daq.contract.link import commands as c
from daq.contract.link.wire import SCAN_FAST_ID
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
    fields: dict[str, Any] = field(default_factory=dict)


class Commander:
    """Sends each command up to five times, a second apart, until its COMMAND_ACK comes.

    Repeating is harmless: the aircraft answers a repeated command without acting again.
    """

    def __init__(self) -> None:
        self._pending: deque[_Pending] = deque()
        self._mark = 0

    def start_recording(self, system: int) -> None:
        """Ask the logger to record."""
        self._add(system, c.LOGGING_START)

    def stop_recording(self, system: int) -> None:
        """Ask the logger to end the recording."""
        self._add(system, c.LOGGING_STOP)

    def mark(self, system: int) -> int:
        """Mark an event; returns the number it will carry."""
        self._mark += 1
        self._add(system, c.EVENT_MARK, float(self._mark))
        return self._mark

    def set_rate(self, system: int, rate_hz: float) -> None:
        """Wish for a downlink rate [Hz]; 0 for the configured one."""
        self._add(system, c.SET_MESSAGE_INTERVAL, float(SCAN_FAST_ID), 1e6 / rate_hz if rate_hz > 0 else 0.0)

    def zero_pitot(self, system: int) -> None:
        """Zero the pitot; the aircraft refuses unless it is clearly at rest."""
        self._add(system, c.PREFLIGHT_CALIBRATION, 0.0, 0.0, 0.0, 0.0, 0.0, c.AIRSPEED_CALIBRATION)

    def start_manoeuvre(self, system: int, digest: str) -> None:
        """Start the armed manoeuvre with this digest; the aircraft obeys a signed wish only, with its pilot's switch at go."""
        self._add(system, c.SEQUENCER, 1.0, float(int(digest[:6], 16)))

    def stop_manoeuvre(self, system: int) -> None:
        """End the manoeuvre under way."""
        self._add(system, c.SEQUENCER, 0.0)

    def _add(self, system: int, command: int, *parameters: float) -> None:
        filled = parameters + (0.0,) * (7 - len(parameters))
        self._pending.append(_Pending(system, command, filled))

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

    def acknowledge(self, system: int, command: int, result: int, now_ns: int) -> ev.CommandResult | None:
        """Use a COMMAND_ACK; None when nothing was waiting for it."""
        for p in self._pending:
            if p.sent and (p.system, p.command) == (system, command):
                self._pending.remove(p)
                words = c.RESULT_WORDS.get(result, f"result {result}")
                return ev.CommandResult(system, command, words, result == c.ACCEPTED, now_ns)
        return None
