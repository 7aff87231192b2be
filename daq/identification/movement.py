"""What is identified from: whether a control has moved, judged from its signal alone, and which samples are about a movement.

A control that rests makes a singular column: what would be printed for it is noise over noise. And minutes of cruise tell
nothing of the derivatives, but bring gusts, climbs and turns into the residuals that the bounds are made of; on its wheels, or
in a hand, an aircraft does not move as its derivatives say. So a stretch begins a second before a control moves, and ends when
none has moved for some seconds and the free motion has died away.
"""

import math
import statistics
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Sequence

from daq.identification.airframe import Sample
from daq.identification.regression import LATERAL, PlaneRegression

MOVED = 3.0  # rms movement in units of the sensor's noise from which a control counts as moved
LEAST = math.radians(0.1)  # rad rms; smaller movement identifies nothing on any aircraft
LEAP = 4.0  # noise levels beyond which a difference is movement: 1 in 16 000 samples of noise is
CREEP = 0.1  # share by which a resting surface is averaged at each scan
BLOCK = 20  # second differences of which each gives one figure of the noise
MEDIAN = 0.4549  # of the square of a normal variable, in units of its mean
BLOCKS = 60  # figures that are remembered
QUIET = 0.5  # of the noise's variance is what the quieter quarter of such figures of white noise comes to


class ControlSignal:
    """Follows one control surface, scan by scan [rad]."""

    def __init__(self) -> None:
        self._last: deque[float] = deque(maxlen=3)
        self._block: list[float] = []
        self._figures: deque[float] = deque(maxlen=BLOCKS)
        self._count, self._mean, self._square = 0, 0.0, 0.0
        self._held = math.nan

    def add(self, value: float) -> float:
        """The value as instruments take it: where the surface rests a running mean, where it moves as measured."""
        self._count += 1
        step = value - self._mean
        self._mean += step / self._count
        self._square += step * (value - self._mean)
        self._hear(value)
        if not abs(value - self._held) <= LEAP * self.noise:
            self._held = value
        else:
            self._held += CREEP * (value - self._held)
        return self._held

    def restart(self) -> None:
        """Scans are missing: no difference leads over them."""
        self._last.clear()
        self._held = math.nan

    def _hear(self, value: float) -> None:
        self._last.append(value)
        if len(self._last) < 3:
            return
        a, b, c = self._last
        self._block.append((a - 2.0 * b + c) ** 2 / 6.0)
        if len(self._block) == BLOCK:
            self._figures.append(_noise_of(self._block))
            self._block.clear()

    @property
    def noise(self) -> float:
        """Standard deviation of the sensor's noise [rad]: the quieter quarter of the blocks, for in others it moves."""
        if not self._figures:
            return 0.0
        quiet = sorted(self._figures)[: max(1, len(self._figures) // 4)]
        return math.sqrt(sum(quiet) / len(quiet) / QUIET)

    @property
    def movement(self) -> float:
        """Root mean square movement about the mean [rad]."""
        return math.sqrt(self._square / self._count) if self._count else 0.0

    @property
    def moved(self) -> bool:
        """Whether it has moved enough to tell its derivatives."""
        return self.movement > max(MOVED * self.noise, LEAST)

    @property
    def doubtful(self) -> bool:
        """Whether it may move: more than nothing, and not yet known from noise."""
        return not self.moved and self.movement > LEAST


def _noise_of(squares: Sequence[float]) -> float:
    """Variance of the noise by the median of squared differences: the edges of a multi-step are few of them and large. A sensor
    so coarse that it mostly shows no difference at all is judged by their mean."""
    middle = statistics.median(squares)
    return middle / MEDIAN if middle > 0.0 else sum(squares) / len(squares)


BEFORE = 1.0  # s before a control moves
AFTER = 6.0  # s after it moved last: a Dutch roll of half a hertz has died away
WITHIN = 1.0  # s within which a control's travel counts as one movement
TRAVEL = math.radians(1.0)  # rad of travel that is a movement: ten noise levels, and less than anybody flies on purpose


class ManoeuvreDetector:
    """Feed samples in order of time; late ones afterwards, they are judged by what was found before.

    speed: airspeed [m/s] above which the aircraft flies, once it was for `since` [s]. regressions: whose controls count.
    """

    def __init__(self, speed: float, since: float, regressions: Sequence[PlaneRegression] = (LATERAL,)) -> None:
        self._speed, self._since = speed, since
        self._regressions = tuple(regressions)
        self._signals = tuple(signal for r in regressions for signal in r.controls.values())
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
        if not any(r.credible(sample) for r in self._regressions):
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
        index = bisect_right(self._begins, time) - 1
        return index >= 0 and time <= self._ends[index]

    def _flies(self, sample: Sample) -> bool:
        self._fast_from = min(self._fast_from, sample.time) if self._speed < sample.V else math.inf
        return sample.time - self._fast_from >= self._since

    def _note(self, sample: Sample) -> None:
        self._recent.append(sample)
        while self._recent[0].time < sample.time - WITHIN:
            self._recent.popleft()
        for signal in self._signals:
            values = [getattr(s, signal) for s in self._recent]
            if max(values) - min(values) > TRAVEL:
                self._moved_at = sample.time
