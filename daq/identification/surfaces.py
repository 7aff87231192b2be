"""A control surface between two scans, as a curve that is integrated into the rows of the regression.

Without a servo's lag: the monotone cubic through the samples, which does not overshoot where a servo's edge is steep (slopes
after Fritsch and Butland, SIAM J. Sci. Stat. Comput. 5 (1984), as scipy's `PchipInterpolator` inside a record). With it, an edge
within an interval is found from the scans about it: a step of the command at an unknown instant within the interval from t1 to
t2 leaves a first-order servo on exponentials. With the target before it (c) and after it (d, from the next scan),
E = exp(-(t2 - t1)/lag) and u = exp(-(t2 - edge)/lag):

    delta(t2) = d + (c - d) u + (delta(t1) - c) E        so that u, and the instant of the edge, follow.

At 11.5 Hz such an edge, drawn through the scans, would be worth 5 to 10 % of the rolling derivatives.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray


class CubicCurve(NamedTuple):
    """A cubic over one interval of `h` seconds. first, last: values at its ends; rise, fall: slopes there [1/s]."""

    h: float
    first: float
    last: float
    rise: float
    fall: float

    def at(self, part: float) -> float:
        """Value where `part` of the interval has passed."""
        rest = 1.0 - part
        return rest * rest * ((1.0 + 2.0 * part) * self.first + part * self.h * self.rise) + part * part * (
            (1.0 + 2.0 * rest) * self.last - rest * self.h * self.fall
        )

    @property
    def integral(self) -> float:
        """Over the interval."""
        return 0.5 * self.h * (self.first + self.last) + self.h * self.h * (self.rise - self.fall) / 12.0


def slope(h0: float, h1: float, y0: float, y1: float, y2: float) -> float:
    """Slope in the middle of three samples, steps h0 and h1 apart: zero at a peak."""
    slope_before, slope_after = (y1 - y0) / h0, (y2 - y1) / h1
    if slope_before * slope_after <= 0.0:
        return 0.0
    weight_before, weight_after = 2.0 * h1 + h0, h1 + 2.0 * h0
    return (weight_before + weight_after) / (weight_before / slope_before + weight_after / slope_after)


def middle_curve(t: tuple[float, float, float, float], y: tuple[float, float, float, float]) -> CubicCurve:
    """The curve between the middle two of four samples."""
    h0, h, h2 = t[1] - t[0], t[2] - t[1], t[3] - t[2]
    return CubicCurve(h, y[1], y[2], slope(h0, h, y[0], y[1], y[2]), slope(h, h2, y[1], y[2], y[3]))


Array = NDArray[np.float64]
Four = tuple[float, float, float, float]

EDGE = math.radians(0.5)  # rad beyond what the servo would do by itself: several noise levels of any surface's sensor
SURE = 0.25  # least u that tells when the edge was: below, noise of 0.07 deg is worth 4 ms of a 2 deg step and more
LONG = 0.12  # s, interval within which an edge that no lag explains may be anywhere
SLACK = 0.1  # by which u may lie outside what an edge within the interval gives, for noise


class Between(Protocol):
    """A surface over one interval."""

    def at(self, part: float) -> float:
        """Value where `part` of the interval has passed."""
        ...

    @property
    def integral(self) -> float:
        """Over the interval [rad s]."""
        ...


class ServoEdge(NamedTuple):
    """A servo that runs towards `before` until `edge` seconds into the interval of `h` seconds, then towards `after`."""

    h: float
    lag: float
    first: float
    before: float
    after: float
    edge: float

    @property
    def _turn(self) -> float:
        return self.before + (self.first - self.before) * math.exp(-self.edge / self.lag)

    def at(self, part: float) -> float:
        """Value where `part` of the interval has passed."""
        t = part * self.h
        if t <= self.edge:
            return self.before + (self.first - self.before) * math.exp(-t / self.lag)
        return self.after + (self._turn - self.after) * math.exp((self.edge - t) / self.lag)

    @property
    def integral(self) -> float:
        """Over the interval."""
        rest = self.h - self.edge
        return (
            self.before * self.edge
            + (self.first - self.before) * self.lag * (1.0 - math.exp(-self.edge / self.lag))
            + self.after * rest
            + (self._turn - self.after) * self.lag * (1.0 - math.exp(-rest / self.lag))
        )


class SurfaceCurves:
    """The curves of one surface, interval by interval. lag: of its servo [s], None where not known.

    sure: whether the last curve is known well enough that its interval may be a row. That is judged by the surface alone, so
    that leaving the row out favours no value of any derivative.
    """

    def __init__(self, lag: float | None) -> None:
        self._lag = lag
        self._target: float | None = None
        self.sure = True

    def restart(self) -> None:
        """Scans are missing: where the servo runs to is not known."""
        self._target = None

    def middle(self, t: Four, y: Four) -> Between:
        """The curve between the middle two of four scans at times t [s]."""
        h, first, last = t[2] - t[1], y[1], y[2]
        # a control that moves before and after may have gone and come back in between: such a row was 20 standard deviations off
        rests = h <= LONG or abs(y[1] - y[0]) <= EDGE or abs(y[3] - y[2]) <= EDGE
        if self._lag is None:
            self.sure = rests and (h <= LONG or abs(last - first) <= EDGE)
            return middle_curve(t, y)
        fade = math.exp(-h / self._lag)
        target = first if self._target is None else self._target
        if abs(last - target - (first - target) * fade) > EDGE:
            edge = self._edge(t, y, target, fade)
            if edge is not None:
                self._target = edge.after
                return edge
            self._target, self.sure = None, h <= LONG
            return middle_curve(t, y)
        self.sure = rests
        if abs(first - target) > EDGE:  # still on its way
            self._target = (last - first * fade) / (1.0 - fade)
            return ServoEdge(h, self._lag, first, self._target, self._target, 0.0)
        self._target = None
        return middle_curve(t, y)

    def _edge(self, t: Four, y: Four, target: float, fade: float) -> ServoEdge | None:
        assert self._lag is not None
        next_fade = math.exp(-(t[3] - t[2]) / self._lag)
        next_target = (y[3] - y[2] * next_fade) / (1.0 - next_fade)
        if abs(next_target - target) < EDGE:
            return None
        u = (y[2] - next_target - (y[1] - target) * fade) / (target - next_target)
        if not fade - SLACK <= u <= 1.0 + SLACK:
            return None
        h, self.sure = t[2] - t[1], u >= SURE
        u = min(max(u, fade), 1.0)
        return ServoEdge(h, self._lag, y[1], target, next_target, h + self._lag * math.log(u))


def cubic_weights(t0: float, t1: float, t2: float, t3: float) -> Array:
    """(4,) weights [s]: their product with samples at t0 < t1 < t2 < t3 is the integral from t1 to t2."""
    h = t2 - t1
    a, b = (t0 - t1) / h, (t3 - t1) / h  # the outer scans where the inner ones are 0 and 1
    ends = -1.0 / 12.0
    return h * np.array(
        [
            (ends + b / 6.0) / (a * (a - 1.0) * (a - b)),
            (ends + (a + b) / 6.0 - a * b / 2.0) / (-a * b),
            (0.25 - (a + b) / 3.0 + a * b / 2.0) / ((1.0 - a) * (1.0 - b)),
            (ends + a / 6.0) / (b * (b - 1.0) * (b - a)),
        ]
    )
