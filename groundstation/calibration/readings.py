"""Physical values of the instruments before they are combined, with what is known of their instants."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Readings:
    """Physical value of each instrument axis, with what is known of its instant.

    values: name -> (N,). group: name -> sensor group. delay: name -> by which it lags [s]. lag: name -> time constant of a
    first-order low pass in front of it [s].
    extrapolated, clipped: instrument or channel -> number of samples.
    """

    values: dict[str, Array]
    group: dict[str, str]
    delay: dict[str, float]
    lag: dict[str, float]
    extrapolated: dict[str, int]
    clipped: dict[str, int]
