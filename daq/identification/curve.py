"""A surface between scans: the monotone cubic through its samples, which does not overshoot where a servo's edge is steep.

Slopes after Fritsch and Butland, SIAM J. Sci. Stat. Comput. 5 (1984), as scipy's `PchipInterpolator` inside a record.
"""

from typing import NamedTuple


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
    before, after = (y1 - y0) / h0, (y2 - y1) / h1
    if before * after <= 0.0:
        return 0.0
    first, second = 2.0 * h1 + h0, h1 + 2.0 * h0
    return (first + second) / (first / before + second / after)


def middle_curve(t: tuple[float, float, float, float], y: tuple[float, float, float, float]) -> CubicCurve:
    """The curve between the middle two of four samples."""
    h0, h, h2 = t[1] - t[0], t[2] - t[1], t[3] - t[2]
    return CubicCurve(h, y[1], y[2], slope(h0, h, y[0], y[1], y[2]), slope(h, h2, y[1], y[2], y[3]))
