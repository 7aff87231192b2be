"""From a flight's time, the aircraft's monotonic clock, to UTC."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

UTC_KEY = "utc_offset_s"
"""In a flight's provenance: UTC [s since 1970] minus flight time [s]; absent where the aircraft never learnt it."""

LAST_UTC_S = 4.0e9
"""In 2096: a receiver that says more is wrong, and nanoseconds would soon no longer fit into 64 bits."""


def offset_in(detail: Mapping[str, Any]) -> float | None:
    """UTC minus flight time [s] by the detail of a provenance; None where it does not say, or says what cannot be."""
    value = detail.get(UTC_KEY)
    return float(value) if isinstance(value, int | float) and 0 <= value < LAST_UTC_S else None


def stamps(time: NDArray[np.float64], offset: float | None) -> NDArray[np.int64]:
    """(N,) nanoseconds: UTC since 1970 where the offset is known, else flight time; never negative, rising with the samples."""
    return np.maximum(np.round(time * 1e9).astype(np.int64) + round((offset or 0.0) * 1e9), 0)
