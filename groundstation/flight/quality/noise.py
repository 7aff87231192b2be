"""Noise of a channel from its own samples."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MAD_TO_SIGMA = 1.482602218505602  # of a normal distribution
_THIRD_DIFFERENCE_GAIN = 20.0  # variance of y3 - 3 y2 + 3 y1 - y0 for white y of variance 1
_FEWEST = 12


def noise(values: Array) -> float | None:
    """Standard deviation of the sample-to-sample noise, None for too few samples.

    Third differences remove motion up to a parabola through four samples; their median absolute deviation is not
    moved by edges and spikes. A channel that mostly repeats its value (quantised, commanded) has noise 0.
    """
    third = np.diff(values, 3)
    third = third[np.isfinite(third)]
    if third.size < _FEWEST:
        return None
    return float(_MAD_TO_SIGMA * np.median(np.abs(third - np.median(third))) / np.sqrt(_THIRD_DIFFERENCE_GAIN))
