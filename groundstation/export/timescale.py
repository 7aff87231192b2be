"""A flight's time as other programs want it: nanoseconds of UTC where the flight knows it."""

from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from groundstation.flight import Flight
from groundstation.flight.utc import UTC_KEY, offset_in, stamps

__all__ = ["UTC_KEY", "iso", "stamps_ns", "utc_offset"]


def utc_offset(flight: Flight) -> float | None:
    """UTC minus flight time [s]; None where the flight does not know UTC."""
    return offset_in(flight.provenance.detail)


def stamps_ns(flight: Flight) -> NDArray[np.int64]:
    """(N,) nanoseconds: UTC since 1970 where known, else flight time; never negative, rising with the samples."""
    return stamps(flight.time, utc_offset(flight))


def iso(stamp_ns: int) -> str:
    """A UTC stamp as ISO 8601 with milliseconds, as KML and GPX want it."""
    return datetime.fromtimestamp(stamp_ns / 1e9, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
