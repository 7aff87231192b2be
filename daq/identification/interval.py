"""Integral over one interval between scans of what is known at the four nearest scans.

The cubic through four samples, integrated between the middle two: for equal steps (-1, 13, 13, -1) h / 24. A straight line
(trapezoid) leaves 2 to 5 % on the rolling derivatives at 20 and 11.5 Hz, for rolling settles within a scan.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
