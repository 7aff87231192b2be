"""Clocks that are passed in, so that the same logger runs in real time, faster than real time, or in lockstep.

Two time scales, both in integer nanoseconds. Monotonic time never steps; deadlines and sample times use it. UTC is the operating
system's and may step when the network or a GPS corrects it; their relation is estimated (`daq.sensors.timebase`) and recorded.
"""

import threading
import time
from collections.abc import Callable
from typing import Protocol

NS = 1_000_000_000
"""Nanoseconds in a second."""


class Clock(Protocol):
    """The clock of a logger."""

    def monotonic_ns(self) -> int:
        """Time since an arbitrary start, never stepping back [ns]."""

    def utc_ns(self) -> int:
        """UTC since 1970 by this machine's clock [ns]."""

    def sleep_until(self, monotonic_ns: int) -> None:
        """Return once monotonic time has reached `monotonic_ns`; at once if it has passed."""


class RealClock:
    """The clock of the machine."""

    monotonic_ns = staticmethod(time.monotonic_ns)  # called some sixty times a scan: no Python frame in between
    utc_ns = staticmethod(time.time_ns)

    def sleep_until(self, monotonic_ns: int) -> None:
        remaining = monotonic_ns - time.monotonic_ns()
        if remaining > 0:
            time.sleep(remaining / NS)  # sleeps at least as long, restarted by Python after a signal


class SimulatedClock:
    """A clock that one thread drives: where that thread would sleep, time jumps instead.

    The driver is the thread that created the clock. `sleep_until` in the driver advances time; in any other thread it waits until
    the driver has advanced it so far, so that a simulated stall of a card lasts simulated seconds. Threads that work for the
    driver (a recorder) register with `follow`: time does not advance while such a thread is busy and not asleep on this clock. A
    run at any speed therefore gives the results of a run in real time.

    start_utc_ns: UTC at the start [ns]. start_monotonic_ns: monotonic time at the start [ns]. speed: simulated seconds per real
    second; None for as fast as possible.
    """

    def __init__(self, start_utc_ns: int = 0, *, speed: float | None = None, start_monotonic_ns: int = 0) -> None:
        self._now = start_monotonic_ns
        self._utc_offset = start_utc_ns - start_monotonic_ns
        self._speed = speed
        self._real_origin = time.monotonic_ns()
        self._origin = start_monotonic_ns
        self._driver = threading.get_ident()
        self._moved = threading.Condition()
        self._sleepers = 0
        self._on_advance: list[Callable[[int], None]] = []
        self._followers: list[Callable[[], bool]] = []

    def monotonic_ns(self) -> int:
        return self._now

    def utc_ns(self) -> int:
        return self._now + self._utc_offset

    def sleep_until(self, monotonic_ns: int) -> None:
        if threading.get_ident() == self._driver:
            self.advance_to(monotonic_ns)
            return
        with self._moved:
            self._sleepers += 1
            self._moved.notify_all()
            self._moved.wait_for(lambda: self._now >= monotonic_ns)
            self._sleepers -= 1

    def advance(self, duration_ns: int) -> None:
        """Advance time by `duration_ns`, as a bus transfer or a conversion does."""
        self.advance_to(self._now + duration_ns)

    def advance_to(self, monotonic_ns: int) -> None:
        """Advance time to `monotonic_ns` and call the callbacks; does nothing if it has passed."""
        if monotonic_ns <= self._now:
            return
        self._wait_for_followers()
        self._pace(monotonic_ns)
        with self._moved:
            self._now = monotonic_ns
            self._moved.notify_all()
        for callback in self._on_advance:
            callback(monotonic_ns)

    def step_utc(self, by_ns: int) -> None:
        """Step UTC by `by_ns` as a network time correction would; monotonic time is unaffected."""
        self._utc_offset += by_ns

    def on_advance(self, callback: Callable[[int], None]) -> None:
        """Register `callback(monotonic_ns)`, called after every advance in the driver's thread."""
        self._on_advance.append(callback)

    def follow(self, busy: Callable[[], bool]) -> None:
        """Do not advance time while `busy()` is true and no thread sleeps on this clock; `busy` may be called at any time."""
        self._followers.append(busy)

    def unpaced(self) -> None:
        """Run as fast as possible from now on."""
        self._speed = None

    def drive(self) -> None:
        """Make the calling thread the driver."""
        self._driver = threading.get_ident()

    def _wait_for_followers(self) -> None:
        for busy in self._followers:
            while busy():
                with self._moved:
                    if self._sleepers or self._moved.wait_for(lambda: self._sleepers > 0, timeout=0.001):
                        break

    def _pace(self, monotonic_ns: int) -> None:
        if self._speed is None:
            return
        due = self._real_origin + round((monotonic_ns - self._origin) / self._speed)
        remaining = due - time.monotonic_ns()
        if remaining > 0:
            time.sleep(remaining / NS)
