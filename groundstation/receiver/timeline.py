"""Time on the ground: the clock, its relation to the aircraft's clock, and allowances per second."""

import time
from collections import deque
from dataclasses import dataclass
from typing import Protocol

NS = 1_000_000_000


class GroundClock(Protocol):
    """The clocks of the ground station."""

    def monotonic_ns(self) -> int:
        """Time since an arbitrary start, never stepping back [ns]."""
        ...

    def utc_ns(self) -> int:
        """UTC since 1970 [ns]."""
        ...


class SystemClock:
    """The clocks of this computer."""

    def monotonic_ns(self) -> int:
        return time.monotonic_ns()

    def utc_ns(self) -> int:
        return time.time_ns()


@dataclass(frozen=True, slots=True)
class ClockRelation:
    """Aircraft clock = ground clock + offset; the error is half the round trip at most."""

    offset_ns: int
    round_trip_ns: int


class ClockSync:
    """Estimates the clock relation from TIMESYNC exchanges.

    best: of the last few exchanges that with the shortest round trip, since queues on a radio only add time; None before the
    first answer. Only answers to own requests are used.
    """

    WINDOW = 12  # exchanges that are compared
    OUTSTANDING = 8  # requests that wait for an answer

    def __init__(self) -> None:
        self._outstanding: deque[int] = deque(maxlen=self.OUTSTANDING)
        self._samples: deque[ClockRelation] = deque(maxlen=self.WINDOW)
        self.best: ClockRelation | None = None

    def ask(self, now_ns: int) -> int:
        """The ts1 of a new request."""
        self._outstanding.append(now_ns)
        return now_ns

    def answer(self, request_ns: int, aircraft_ns: int, now_ns: int) -> ClockRelation | None:
        """Use an answer; returns the best relation, or None where there was no such request."""
        if request_ns not in self._outstanding:
            return None
        self._outstanding.remove(request_ns)
        round_trip = now_ns - request_ns
        self._samples.append(ClockRelation(aircraft_ns - (request_ns + round_trip // 2), round_trip))
        self.best = min(self._samples, key=lambda s: s.round_trip_ns)
        return self.best

    def reset(self) -> None:
        """Forget all exchanges, since the aircraft's clock has restarted."""
        self._samples.clear()
        self.best = None
        self._outstanding.clear()


class Allowance:
    """A token bucket. at_once: its capacity, available at the start; per_s: refilled in a second."""

    def __init__(self, at_once: float, per_s: float) -> None:
        self._capacity, self._per_s = at_once, per_s
        self._available = at_once
        self._last_ns: int | None = None

    def spend(self, amount: float, now_ns: int) -> bool:
        """Use an amount; False, and none used, where less is available."""
        if self._last_ns is not None:
            self._available = min(self._capacity, self._available + max(0, now_ns - self._last_ns) / NS * self._per_s)
        self._last_ns = now_ns
        if amount > self._available:
            return False
        self._available -= amount
        return True
