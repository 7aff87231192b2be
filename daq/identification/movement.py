"""Selection of samples for identification: whether a control has moved, from its signal alone, and the stretches around
movements.

A control at rest makes a singular column, whose derivative would be noise over noise. Minutes of cruise do not identify
derivatives, but add gusts, climbs and turns to the residuals from which the bounds are computed; on its wheels, or carried, an
aircraft does not follow its derivatives. A stretch therefore begins a second before a control moves, and ends when none has
moved for some seconds and the free motion has decayed.
"""

import math
import statistics
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Sequence

from daq.identification.airframe import Sample
from daq.identification.regression import LATERAL, PlaneRegression

MOVED = 3.0  # least rms movement, in units of the sensor's noise, of a control that counts as moved
LEAST = math.radians(0.1)  # rad rms; smaller movement identifies nothing on any aircraft
LEAP = 4.0  # standard deviations of the noise beyond which a difference is movement: 1 in 16 000 samples of noise
CREEP = 0.1  # weight of a new sample in the running mean of a surface at rest
BLOCK = 20  # second differences that give one estimate of the noise
MEDIAN = 0.4549  # of the square of a normal variable, in units of its mean
BLOCKS = 60  # estimates of the noise in memory
QUIET = 0.5  # mean of the lowest quarter of such estimates over the variance, for white noise


class ControlSignal:
    """Noise and movement of one control surface, updated scan by scan [rad]."""

    def __init__(self) -> None:
        self._last: deque[float] = deque(maxlen=3)
        self._block: list[float] = []
        self._noise_estimates: deque[float] = deque(maxlen=BLOCKS)  # variances [rad2]
        self._count, self._mean, self._square = 0, 0.0, 0.0  # square: sum of squared deviations from the mean
        self._resting = math.nan

    def add(self, value: float) -> float:
        """Add a sample. Returns the value for the instruments: the running mean while the surface rests, the sample itself while
        it moves."""
        self._count += 1
        step = value - self._mean
        self._mean += step / self._count
        self._square += step * (value - self._mean)
        self._add_difference(value)
        if not abs(value - self._resting) <= LEAP * self.noise:
            self._resting = value
        else:
            self._resting += CREEP * (value - self._resting)
        return self._resting

    def restart(self) -> None:
        """Begin after missing scans: no difference is taken across them."""
        self._last.clear()
        self._resting = math.nan

    def _add_difference(self, value: float) -> None:
        self._last.append(value)
        if len(self._last) < 3:
            return
        a, b, c = self._last
        self._block.append((a - 2.0 * b + c) ** 2 / 6.0)
        if len(self._block) == BLOCK:
            self._noise_estimates.append(_noise_of(self._block))
            self._block.clear()

    @property
    def noise(self) -> float:
        """Standard deviation of the sensor's noise [rad], from the lowest quarter of the blocks, for the surface moves in
        others."""
        if not self._noise_estimates:
            return 0.0
        quiet = sorted(self._noise_estimates)[: max(1, len(self._noise_estimates) // 4)]
        return math.sqrt(sum(quiet) / len(quiet) / QUIET)

    @property
    def movement(self) -> float:
        """Root mean square movement about the mean [rad]."""
        return math.sqrt(self._square / self._count) if self._count else 0.0

    @property
    def moved(self) -> bool:
        """Whether it has moved enough to identify its derivatives."""
        return self.movement > max(MOVED * self.noise, LEAST)

    @property
    def doubtful(self) -> bool:
        """Whether it may have moved: by more than LEAST, but not distinguishably from noise."""
        return not self.moved and self.movement > LEAST


def _noise_of(squares: Sequence[float]) -> float:
    """Variance of the noise from the median of squared differences, which ignores the few large ones at the edges of a
    multi-step. From their mean for a sensor so coarse that most differences are zero."""
    middle = statistics.median(squares)
    return middle / MEDIAN if middle > 0.0 else sum(squares) / len(squares)


BEFORE = 1.0  # s before a control moves
AFTER = 6.0  # s after its last movement: a Dutch roll of half a hertz has decayed
WITHIN = 1.0  # s within which a control's travel counts as one movement
TRAVEL = math.radians(1.0)  # rad, least travel of a movement: ten times the noise, and less than any intended manoeuvre


class ManoeuvreDetector:
    """Finds the stretches of manoeuvring. Takes samples in order of time; late ones belong to the stretches found already.

    speed: airspeed above which the aircraft flies [m/s], after at least `since` [s]. regressions: those whose controls count.
    """

    def __init__(self, speed: float, since: float, regressions: Sequence[PlaneRegression] = (LATERAL,)) -> None:
        self._speed, self._since = speed, since
        self._regressions = tuple(regressions)
        self._signals = tuple(signal for r in regressions for signal in r.controls.values())
        self._fast_from = math.inf
        self._moved_at = -math.inf
        self._latest = -math.inf
        self._recent: deque[Sample] = deque()  # of the last second
        self._pending: deque[Sample] = deque()  # flight before a possible movement, not yielded yet
        self._begins: list[float] = []
        self._ends: list[float] = []

    @property
    def found(self) -> tuple[tuple[float, float], ...]:
        """Start and end of each stretch so far [s]."""
        return tuple(zip(self._begins, self._ends, strict=True))

    def take(self, sample: Sample) -> Iterator[Sample]:
        """Add a sample, and yield those to identify from: none, this one, or also those of the second before it."""
        if sample.time <= self._latest:
            if self._within(sample.time):
                yield sample
            return
        if not any(r.credible(sample) for r in self._regressions):
            return
        self._latest = sample.time
        self._note(sample)
        if not self._in_flight(sample):
            self._pending.clear()
            return
        self._pending.append(sample)
        if sample.time - self._moved_at <= AFTER:
            begin = self._pending[0].time
            if not self._begins or begin - self._ends[-1] > BEFORE:
                self._begins.append(begin)
                self._ends.append(begin)
            self._ends[-1] = sample.time
            yield from self._pending
            self._pending.clear()
        while self._pending and self._pending[0].time < sample.time - BEFORE:
            self._pending.popleft()

    def _within(self, time: float) -> bool:
        index = bisect_right(self._begins, time) - 1
        return index >= 0 and time <= self._ends[index]

    def _in_flight(self, sample: Sample) -> bool:
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
