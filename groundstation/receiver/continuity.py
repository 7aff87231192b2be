"""Which scans can follow those before: number and time of an aircraft rise together, and no faster than its clock goes.

Nobody but the aircraft knows which run of its logger a scan belongs to, and without a key anybody can send one. A scan that
does not go on from the last one is held back. If more follow it, and none goes on from the last one any more, the aircraft
really is there: its logger has started anew, or this computer's clock stood still. Else what was held back is not believed.
"""

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from daq.contract.link.wire import SCAN_FAST_ID, ScanPart
from groundstation.receiver.timeline import NS

AHEAD_NS = 2 * NS
"""A scan may be so much further on the aircraft's clock than this computer's says: more than any queue on the way holds."""
DRIFT = 1.02
"""Two clocks differ by less: quartz by 0.01 %, an uncalibrated oscillator by 1 %."""
LATE_NS = 10 * NS
"""Reordering and queues on the way are a matter of seconds; a scan older than that is of another run."""
FASTEST_HZ = 2000.0
"""The highest scan rate that a logger's configuration allows."""
SHORTEST_NS = 50_000
"""Between two scans: a tenth of the shortest period, for one that starts late."""
USUAL_HZ = 100.0
"""Believed of any logger, so that pauses in its scans do not make it look slow."""
NUMBERS_AT_ONCE = 24
PROVEN_SCANS, PROVEN_NS = 4, NS
"""So many scans of a new run, over so long, and none of the old: at the lowest downlink rate, 2 Hz, two would have come."""
_NEIGHBOURS = 4096
"""Scans of a run whose numbers and times are known, for late ones to stand between: LATE_NS of them at 400 Hz."""
_MAX_CANDIDATES = 8
_MAX_PARTS = 256


class ScanRun:
    """One run of scans: where it began, where it was last, and what can follow."""

    def __init__(self, part: ScanPart, now_ns: int) -> None:
        self.boot = part.boot
        self.first = self.number = part.number
        self.first_ns = self.time_ns = part.time_monotonic_ns
        self.heard_ns = now_ns
        self._numbers, self._times = [part.number], [part.time_monotonic_ns]  # of the last scans, both ascending

    def follows(self, part: ScanPart, now_ns: int) -> bool:
        """Whether a part goes on from here, or belongs to a scan that came before."""
        number_step, time_step_ns = part.number - self.number, part.time_monotonic_ns - self.time_ns
        if part.boot != self.boot:
            return False
        if number_step > 0:
            return number_step * SHORTEST_NS <= time_step_ns <= self._most_ns(now_ns) and self.in_step(part)
        if number_step == 0:
            return time_step_ns == 0
        return -LATE_NS <= time_step_ns < 0 and self._stands_between(part)

    def _stands_between(self, part: ScanPart) -> bool:
        """Whether a late part's time lies between those of its neighbours by number, or is that of its own scan."""
        place = bisect_left(self._numbers, part.number)
        if self._numbers[place] == part.number:
            return self._times[place] == part.time_monotonic_ns
        after_earlier = not place or self._times[place - 1] < part.time_monotonic_ns
        return after_earlier and part.time_monotonic_ns < self._times[place]

    def is_older(self, part: ScanPart) -> bool:
        """Whether a part of the same boot was made before the last one, by number and by time."""
        return part.boot == self.boot and part.number < self.number and part.time_monotonic_ns < self.time_ns

    def in_step(self, part: ScanPart) -> bool:
        """Whether the number has not risen faster than the time allows."""
        if part.number - self.number <= NUMBERS_AT_ONCE:
            return True
        time_step_ns = part.time_monotonic_ns - self.time_ns
        return part.number - self.number <= self._rate_hz() * time_step_ns / NS + NUMBERS_AT_ONCE

    def advance(self, part: ScanPart, now_ns: int) -> None:
        """A part that follows has come."""
        if part.number > self.number:
            self.number, self.time_ns, self.heard_ns = part.number, part.time_monotonic_ns, now_ns
            self._numbers.append(part.number)
            self._times.append(part.time_monotonic_ns)
            if len(self._numbers) > _NEIGHBOURS:
                del self._numbers[: _NEIGHBOURS // 2], self._times[: _NEIGHBOURS // 2]
        elif part.number < self.number:
            place = bisect_left(self._numbers, part.number)
            if self._numbers[place] != part.number:
                self._numbers.insert(place, part.number)
                self._times.insert(place, part.time_monotonic_ns)

    def reach(self, now_ns: int) -> int:
        """The highest number that the aircraft can have given by now."""
        return self.number + NUMBERS_AT_ONCE + int(self._rate_hz() * self._most_ns(now_ns) / NS)

    def fits(self, number: int, time_ns: int) -> bool:
        """Whether a scan of that number can have been made at that time, as far as this run is known."""
        not_too_early = number < self.first or time_ns >= self.first_ns - LATE_NS
        not_too_late = number > self.number or time_ns <= self.time_ns + LATE_NS
        slowest = self.time_ns + LATE_NS + max(0, number - self.number) * 10 * NS  # nobody scans less than every 10 s
        return not_too_early and not_too_late and 0 <= time_ns <= slowest

    def _most_ns(self, now_ns: int) -> int:
        return AHEAD_NS + int(DRIFT * max(0, now_ns - self.heard_ns))

    def _rate_hz(self) -> float:
        span = self.time_ns - self.first_ns
        return FASTEST_HZ if span < NS else max(USUAL_HZ, 2 * NS * (self.number - self.first) / span)


class PendingScan(NamedTuple):
    """A scan part that waits for others to prove it: with the component that sent it and the ground's clocks."""

    part: ScanPart
    component: int
    now_ns: int
    utc_ns: int


@dataclass
class _Candidate:
    run: ScanRun
    since_ns: int
    lost: int  # frames counted as lost when it began: the jump to it is no loss
    parts: deque[PendingScan] = field(default_factory=lambda: deque(maxlen=_MAX_PARTS))
    scans: int = 0


@dataclass(frozen=True)
class ConfirmedRun:
    """A run that has proven itself: its parts in order, and the count of lost frames when it began."""

    parts: tuple[PendingScan, ...]
    lost: int


class UnconfirmedRuns:
    """Parts that follow nothing known, by run, a bounded number of them."""

    def __init__(self) -> None:
        self.candidates: list[_Candidate] = []

    @property
    def count(self) -> int:
        return sum(len(c.parts) for c in self.candidates)

    def hold(self, pending: PendingScan, lost_frames: int) -> tuple[ConfirmedRun | None, int]:
        """Keep a part. Returns the run it proves, if it does, and how many other parts had to be given up for it."""
        given_up = 0
        now_ns = pending.now_ns
        candidate = next((c for c in self.candidates if c.run.follows(pending.part, now_ns)), None)
        if candidate is None:
            if len(self.candidates) >= _MAX_CANDIDATES:
                weakest = min(self.candidates, key=lambda c: c.scans)
                self.candidates.remove(weakest)
                given_up = len(weakest.parts)
            candidate = _Candidate(ScanRun(pending.part, now_ns), now_ns, lost_frames)
            self.candidates.append(candidate)
        given_up += len(candidate.parts) == _MAX_PARTS
        candidate.run.advance(pending.part, now_ns)
        candidate.parts.append(pending)
        candidate.scans += pending.part.msg_id == SCAN_FAST_ID
        if candidate.scans < PROVEN_SCANS or now_ns - candidate.since_ns < PROVEN_NS:
            return None, given_up
        self.candidates.remove(candidate)
        return ConfirmedRun(tuple(candidate.parts), candidate.lost), given_up + self.clear()

    def clear(self) -> int:
        """The known run goes on: what waits is not believed. Returns how many parts that were."""
        count = self.count
        self.candidates.clear()
        return count
