"""A flight's time as other programs want it: nanoseconds of UTC where the flight knows it."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from groundstation.flight import Flight
from groundstation.flight.tables import ColumnTable, TableColumn
from groundstation.flight.writing import UTC_KEY, provenance_utc_offset, utc_stamps

__all__ = ["UTC_KEY", "iso", "stamps_ns", "utc_offset", "with_utc"]


def utc_offset(flight: Flight) -> float | None:
    """UTC minus flight time [s]; None where the flight does not know UTC."""
    return provenance_utc_offset(flight.provenance.detail)


def stamps_ns(flight: Flight) -> NDArray[np.int64]:
    """(N,) nanoseconds: UTC since 1970 where known, else flight time; never negative, rising with the samples."""
    return utc_stamps(flight.time, utc_offset(flight))


UTC_COLUMN = "utc_time"


def with_utc(table: ColumnTable, flight: Flight) -> ColumnTable:
    """The table with a last column `utc_time` [s since 1970, to the microsecond] where the flight knows UTC."""
    offset = utc_offset(flight)
    if offset is None or any(c.name == UTC_COLUMN for c in table.columns):
        return table
    stamped = np.round(flight.time + offset, 6)
    column = TableColumn(UTC_COLUMN, stamped, "s", "UTC since 1970-01-01 00:00, leap seconds not counted")
    return replace(table, columns=(*table.columns, column))


def iso(stamp_ns: int) -> str:
    """A UTC stamp as ISO 8601 with milliseconds, as KML and GPX want it."""
    return datetime.fromtimestamp(stamp_ns / 1e9, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
