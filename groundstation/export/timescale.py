"""A flight's time as other programs want it: nanoseconds of UTC where the flight knows it."""

from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from groundstation.flight import Flight

UTC_KEY = "utc_offset_s"
"""In a flight's provenance: UTC [s since 1970] minus flight time [s]; absent where the aircraft never learnt it."""


def utc_offset(flight: Flight) -> float | None:
    """UTC minus flight time [s]; None where the flight does not know UTC."""
    value = flight.provenance.detail.get(UTC_KEY)
    return float(value) if isinstance(value, int | float) else None


def stamps_ns(flight: Flight) -> NDArray[np.int64]:
    """(N,) nanoseconds: UTC since 1970 where known, else flight time; never negative, rising with the samples."""
    offset_ns = round((utc_offset(flight) or 0.0) * 1e9)
    return np.maximum(np.round(flight.time * 1e9).astype(np.int64) + offset_ns, 0)


def iso(stamp_ns: int) -> str:
    """A UTC stamp as ISO 8601 with milliseconds, as KML and GPX want it."""
    return datetime.fromtimestamp(stamp_ns / 1e9, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
