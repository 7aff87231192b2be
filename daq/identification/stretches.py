"""Which samples are identified from: in flight, and about where a control moves.

On its wheels, or in a hand, an aircraft does not move as its derivatives say; and minutes of cruise tell nothing of them,
but bring gusts, climbs and turns into the residuals that the bounds are made of. So a stretch begins a second before a
control moves, and ends when none has moved for some seconds and the free motion has died away.
"""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator

from daq.identification.airframe import CONTROLS, Sample

BEFORE = 1.0  # s before a control moves
AFTER = 6.0  # s after it moved last: a Dutch roll of half a hertz has died away
WITHIN = 1.0  # s within which a control's travel counts as one movement
TRAVEL = math.radians(1.0)  # rad of travel that is a movement: ten noise levels, and less than anybody flies on purpose


class ManoeuvreDetector:
    """Feed samples in order of time; late ones afterwards, they are judged by what was found before.

    speed: airspeed [m/s] above which the aircraft flies, once it was for `since` [s].
    """

    def __init__(self, speed: float, since: float) -> None:
        self._speed, self._since = speed, since
        self._fast_from = math.inf
        self._moved_at = -math.inf
        self._latest = -math.inf
        self._recent: deque[Sample] = deque()  # of the last second
        self._waiting: deque[Sample] = deque()  # in flight, and not given: a control may be about to move
        self._begins: list[float] = []
        self._ends: list[float] = []

    @property
    def found(self) -> tuple[tuple[float, float], ...]:
        """Begin and end of each stretch so far [s]."""
        return tuple(zip(self._begins, self._ends, strict=True))

    def take(self, sample: Sample) -> Iterator[Sample]:
        """Samples to identify from, now that this one is known: none, this one, or those of the last second too."""
        if sample.time <= self._latest:
            if self._within(sample.time):
                yield sample
            return
        if not sample.credible:
            return
        self._latest = sample.time
        self._note(sample)
        if not self._flies(sample):
            self._waiting.clear()
            return
        self._waiting.append(sample)
        if sample.time - self._moved_at <= AFTER:
            begin = self._waiting[0].time
            if not self._begins or begin - self._ends[-1] > BEFORE:
                self._begins.append(begin)
                self._ends.append(begin)
            self._ends[-1] = sample.time
            yield from self._waiting
            self._waiting.clear()
        while self._waiting and self._waiting[0].time < sample.time - BEFORE:
            self._waiting.popleft()

    def _within(self, time: float) -> bool:
        at = bisect_right(self._begins, time) - 1
        return at >= 0 and time <= self._ends[at]

    def _flies(self, sample: Sample) -> bool:
        self._fast_from = min(self._fast_from, sample.time) if self._speed < sample.V else math.inf
        return sample.time - self._fast_from >= self._since

    def _note(self, sample: Sample) -> None:
        self._recent.append(sample)
        while self._recent[0].time < sample.time - WITHIN:
            self._recent.popleft()
        for signal in CONTROLS.values():
            values = [getattr(s, signal) for s in self._recent]
            if max(values) - min(values) > TRAVEL:
                self._moved_at = sample.time
