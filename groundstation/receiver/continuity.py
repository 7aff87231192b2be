"""Continuity of received scans: number and time must rise together, and no faster than the aircraft's clock.

A scan does not show which run of the logger it belongs to, and without a signing key anybody can send one. A scan that does not
continue the present run is held back. If more scans follow it, and none continues the present run, it begins a new run: the
logger was restarted, or this computer was suspended. Otherwise the scans held back are rejected.
"""

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from daq.contract.link.wire import SCAN_FAST_ID, ScanPart
from groundstation.receiver.timeline import NS

LARGEST_LEAD_NS = 2 * NS
"""Lead of the aircraft's clock over the time elapsed here since the last scan, at most: no queue on the link holds more."""
LARGEST_CLOCK_RATIO = 1.02
"""Ratio of two clocks' rates: quartz differs by 0.01 %, an uncalibrated oscillator by 1 %."""
LATE_NS = 10 * NS
"""Largest age of a late scan: reordering and queues take seconds. An older one is of another run."""
FASTEST_HZ = 2000.0
"""The highest scan rate that a logger's configuration allows."""
SHORTEST_PERIOD_NS = 50_000
"""Time between two scans, at least: a tenth of the shortest period, for a scan that starts late."""
LONGEST_PERIOD_NS = 10 * NS
"""Time between two scans, at most: no logger scans more slowly."""
LEAST_BELIEVED_HZ = 100.0
"""Scan rate that is accepted of any logger, since pauses lower its mean rate."""
NUMBER_MARGIN = 24  # scan numbers beyond those that the rate allows
PROVEN_SCANS, PROVEN_NS = 4, NS
"""Scans of a new run, and the time they span, that prove it: at the lowest downlink rate, 2 Hz, the old run would have sent
two."""
_NEIGHBOURS = 4096
"""Scans of a run whose numbers and times are stored, to check late ones against: those of LATE_NS at 400 Hz."""
_MAX_CANDIDATES, _MAX_PARTS = 8, 256
"""Possible new runs, and scan parts of each, that are held back: a bound on memory."""
_RATE_MARGIN = 2  # on the mean rate of a run


class ScanRun:
    """One run of the logger's scans: first and last number and time [ns, aircraft's clock]. heard_ns: arrival of the last scan
    on this computer's clock."""

    def __init__(self, part: ScanPart, now_ns: int) -> None:
        self.boot = part.boot
        self.first = self.number = part.number
        self.first_ns = self.time_ns = part.time_monotonic_ns
        self.heard_ns = now_ns
        self._numbers, self._times = [part.number], [part.time_monotonic_ns]  # of the last scans, both ascending

    def follows(self, part: ScanPart, now_ns: int) -> bool:
        """Whether a part can belong to this run: after the last scan, to that scan, or late by at most LATE_NS."""
        number_step, time_step_ns = part.number - self.number, part.time_monotonic_ns - self.time_ns
        if part.boot != self.boot:
            return False
        if number_step > 0:
            in_time = number_step * SHORTEST_PERIOD_NS <= time_step_ns <= self._largest_step_ns(now_ns)
            return in_time and self.in_step(part)
        if number_step == 0:
            return time_step_ns == 0
        return -LATE_NS <= time_step_ns < 0 and self._fits_neighbours(part)

    def _fits_neighbours(self, part: ScanPart) -> bool:
        """Whether a late part's time lies between those of its neighbours by number, or equals that of its scan."""
        place = bisect_left(self._numbers, part.number)
        if self._numbers[place] == part.number:
            return self._times[place] == part.time_monotonic_ns
        after_earlier = not place or self._times[place - 1] < part.time_monotonic_ns
        return after_earlier and part.time_monotonic_ns < self._times[place]

    def is_older(self, part: ScanPart) -> bool:
        """Whether a part of the same boot precedes the last one, by number and by time."""
        return part.boot == self.boot and part.number < self.number and part.time_monotonic_ns < self.time_ns

    def in_step(self, part: ScanPart) -> bool:
        """Whether the number has risen no faster than the run's scan rate allows."""
        if part.number - self.number <= NUMBER_MARGIN:
            return True
        time_step_ns = part.time_monotonic_ns - self.time_ns
        return part.number - self.number <= self._rate_hz() * time_step_ns / NS + NUMBER_MARGIN

    def advance(self, part: ScanPart, now_ns: int) -> None:
        """Take in a part that `follows`, received at `now_ns`."""
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
        """The highest scan number that the aircraft can have reached at `now_ns`."""
        return self.number + NUMBER_MARGIN + int(self._rate_hz() * self._largest_step_ns(now_ns) / NS)

    def fits(self, number: int, time_ns: int) -> bool:
        """Whether a scan of that number can have been made at `time_ns` in this run."""
        not_too_early = number < self.first or time_ns >= self.first_ns - LATE_NS
        not_too_late = number > self.number or time_ns <= self.time_ns + LATE_NS
        latest = self.time_ns + LATE_NS + max(0, number - self.number) * LONGEST_PERIOD_NS
        return not_too_early and not_too_late and 0 <= time_ns <= latest

    def _largest_step_ns(self, now_ns: int) -> int:
        """Largest step of the aircraft's clock from the last scan to `now_ns` [ns]."""
        return LARGEST_LEAD_NS + int(LARGEST_CLOCK_RATIO * max(0, now_ns - self.heard_ns))

    def _rate_hz(self) -> float:
        """Highest credible scan rate: _RATE_MARGIN times the mean of the run; in its first second that of any logger."""
        span = self.time_ns - self.first_ns
        if span < NS:
            return FASTEST_HZ
        return max(LEAST_BELIEVED_HZ, _RATE_MARGIN * NS * (self.number - self.first) / span)


class PendingScan(NamedTuple):
    """A scan part that is held back, with the component that sent it and the times of its arrival on the ground's clocks."""

    part: ScanPart
    component: int
    now_ns: int
    utc_ns: int


@dataclass
class _Candidate:
    """A possible new run. lost: frames counted as lost when it began, since the jump to it is no loss."""

    run: ScanRun
    since_ns: int
    lost: int
    parts: deque[PendingScan] = field(default_factory=lambda: deque(maxlen=_MAX_PARTS))
    scans: int = 0


@dataclass(frozen=True)
class ConfirmedRun:
    """A new run with enough scans: its parts in order, and the count of lost frames when it began."""

    parts: tuple[PendingScan, ...]
    lost: int


class UnconfirmedRuns:
    """Scan parts held back, by possible run; their number is bounded."""

    def __init__(self) -> None:
        self.candidates: list[_Candidate] = []

    @property
    def count(self) -> int:
        """Number of parts held back."""
        return sum(len(c.parts) for c in self.candidates)

    def hold(self, pending: PendingScan, lost_frames: int) -> tuple[ConfirmedRun | None, int]:
        """Hold back a part. Returns the run that it confirms, or None, and the number of other parts that were dropped."""
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
        """Reject all parts held back, since the present run continues. Returns their number."""
        count = self.count
        self.candidates.clear()
        return count
