"""Whether a control has moved, judged from its signal alone, and its signal with the noise of its sensor mostly off.

A control that rests makes a singular column: what would be printed for it is noise over noise. It is decided from the
signal, before any regression, whether a control has moved.
"""

import math
import statistics
from collections import deque
from collections.abc import Sequence

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
