"""Time on the ground: the clock that is passed in, the aircraft's clock against it, and how much may come in a second."""

import time
from collections import deque
from dataclasses import dataclass
from typing import Protocol

NS = 1_000_000_000


class GroundClock(Protocol):
    """What the ground station asks about time."""

    def monotonic_ns(self) -> int:
        """Time since an arbitrary start, never stepping back [ns]."""
        ...

    def utc_ns(self) -> int:
        """UTC since 1970 [ns]."""
        ...


class SystemClock:
    def monotonic_ns(self) -> int:
        return time.monotonic_ns()

    def utc_ns(self) -> int:
        return time.time_ns()


@dataclass(frozen=True, slots=True)
class ClockRelation:
    """Aircraft clock = ground clock + offset, at best as well as half the round trip."""

    offset_ns: int
    round_trip_ns: int


class ClockSync:
    """Estimates the clock relation from TIMESYNC exchanges.

    The exchange with the shortest round trip of the last few is the best: queueing on a radio only ever adds time.
    Only answers to questions asked here are believed.
    """

    WINDOW = 12
    OUTSTANDING = 8

    def __init__(self) -> None:
        self._asked: deque[int] = deque(maxlen=self.OUTSTANDING)
        self._samples: deque[ClockRelation] = deque(maxlen=self.WINDOW)
        self.best: ClockRelation | None = None
        """The best estimate so far; None before the first answer."""

    def ask(self, now_ns: int) -> int:
        """The ts1 of a new question."""
        self._asked.append(now_ns)
        return now_ns

    def answer(self, asked_ns: int, aircraft_ns: int, now_ns: int) -> ClockRelation | None:
        """Use an answer; None when nobody asked."""
        if asked_ns not in self._asked:
            return None
        self._asked.remove(asked_ns)
        trip = now_ns - asked_ns
        self._samples.append(ClockRelation(aircraft_ns - (asked_ns + trip // 2), trip))
        self.best = min(self._samples, key=lambda s: s.round_trip_ns)
        return self.best

    def reset(self) -> None:
        """Forget everything: the aircraft's clock has started anew."""
        self._samples.clear()
        self.best = None
        self._asked.clear()


class Allowance:
    """at_once: what is there in the beginning, and at most. per_s: what comes back in a second."""

    def __init__(self, at_once: float, per_s: float) -> None:
        self._capacity, self._per_s = at_once, per_s
        self._available = at_once
        self._last_ns: int | None = None

    def spend(self, amount: float, now_ns: int) -> bool:
        """Use some of it; False, and nothing used, when there is not enough."""
        if self._last_ns is not None:
            self._available = min(self._capacity, self._available + max(0, now_ns - self._last_ns) / NS * self._per_s)
        self._last_ns = now_ns
        if amount > self._available:
            return False
        self._available -= amount
        return True
