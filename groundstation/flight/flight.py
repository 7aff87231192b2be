"""The calibrated flight: named columns over time, in SI and radians, with segments and provenance.

This is the hand-over between the ground station and the estimation package. A flight is read from MCAP (as written by
`sideslip calibrate`, `import` and `ground`), CSV or Parquet; columns and signs are those of `daq.contract.channels`.
NaN means "not measured". Time is checked on reading: unsorted rows are sorted, repeated instants dropped, and gaps split the
flight into segments; `notes` report each of these.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.plain_words import did_you_mean, plain_name
from groundstation.flight.arrays import Array
from groundstation.flight.errors import FlightError, MissingColumnError
from groundstation.flight.findings import Finding, FindingKind, as_finding, without_repeats

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

GAP_FACTOR = 4.5  # a step in time longer than this many median sample intervals is a gap: never integrated across
LATEST = 9e9  # latest time [s] of a sample, either way: what 64 bits of nanoseconds hold, 285 years
FASTEST = 1e9  # largest rate [Hz] of a column: stamps of recordings count nanoseconds
MOST_GAPS = 5  # gaps that notes name one by one

AIRCRAFT_FILE = "aircraft_file"
"""Key of a provenance's detail under which the text of the aircraft's file travels with the flight."""
CHANNELS = "channels"  # key of a provenance's detail: where each column comes from, see `Flight.channels`
CHANNEL_KINDS = ("measured", "computed", "assumed")
"""Measured by a sensor, computed by another program, or assumed."""
HELD, INTERVAL, BACK = "held", "interval_s", "dated_back_s"
"""Keys of a channel's entry: whether it is a command, which holds until the next one; the interval of its records [s]; the time
by which it was dated back [s]."""
DATED_BACK = 0.5
"""Share of the interval by which a recorded command is dated back: it changed at any time since the last record."""
RECONSTRUCTED = "reconstructed"
"""Key of a provenance's detail: columns that were reconstructed from others, with their sources and accuracy."""
AIR_DATA, WIND = ("V", "alpha", "beta"), ("wind_n", "wind_e", "wind_d")
"""Columns that can be reconstructed from the motion, and the columns of wind that then come with them."""


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a flight's numbers come from, so that every result can be traced."""

    source: str = "imported"  # real | simulated | replayed | imported
    path: str = ""
    sha256: str = ""
    aircraft: str = ""
    software: str = ""
    calibration: Mapping[str, str] = field(default_factory=dict)  # calibration file -> sha256
    detail: Mapping[str, Any] = field(default_factory=dict)  # JSON-able extras (alignment, delays, noise, ...)


@dataclass(frozen=True, repr=False)
class Flight:
    """Calibrated columns of one flight over common time.

    time: (N,) seconds, strictly increasing. columns: name -> (N,) float64. segment: (N,) int, 0 upward in order of
    time; motion may be integrated within a segment, never from one to the next.
    """

    name: str
    time: Array
    columns: Mapping[str, Array]
    segment: NDArray[np.int64]
    provenance: Provenance = Provenance()
    notes: tuple[Finding, ...] = ()

    @classmethod
    def build(
        cls,
        name: str,
        time: Array,
        columns: Mapping[str, Array],
        *,
        segment: NDArray[Any] | None = None,
        provenance: Provenance | None = None,
        notes: Iterable[Finding | str] = (),
        gap_factor: float = GAP_FACTOR,
    ) -> "Flight":
        """A flight from raw arrays: sorts time, drops repeats, splits at gaps, and adds notes on it.

        Raises FlightError when the arrays differ in length, fewer than two samples remain or time is not finite.
        """
        time = np.asarray(time, float)
        arrays = {k: np.asarray(v, float) for k, v in columns.items()}
        for key, values in arrays.items():
            if values.shape != time.shape:
                raise FlightError(f"{name}: column {key} has {values.size} samples, time has {time.size}")
        name = plain_name(name)
        labels = np.zeros(time.size, np.int64) if segment is None else np.asarray(segment).astype(np.int64)
        order, order_notes = _order(name, time)
        time, labels = time[order], labels[order]
        arrays = {k: v[order] for k, v in arrays.items()}
        segments, gaps = _split(time, labels, gap_factor)
        # a flight read again finds the gaps it was written with
        all_notes = without_repeats([*notes, *order_notes, *gaps])
        return cls(name, time, MappingProxyType(arrays), segments, provenance or Provenance(), all_notes)

    def __repr__(self) -> str:
        provenance = self.provenance
        origin = f"{provenance.aircraft or 'unnamed aircraft'}, {provenance.source}"
        return (
            f"<Flight {self.name!r:.80}: {len(self)} samples, {self.time[-1] - self.time[0]:.2f} s at "
            f"{1.0 / self.sample_interval:.1f} Hz, {len(self.segments)} segment{'s' * (len(self.segments) > 1)}, "
            f"{sum(map(self.measured, self.columns))} columns measured, {origin:.80}>"
        )

    def _repr_html_(self) -> str:
        from groundstation.flight.tables import flight_html

        return flight_html(self)

    def __getstate__(self) -> dict[str, Any]:
        """The state with plain dictionaries in place of read-only views, which cannot be sent to another process."""
        p = self.provenance
        provenance = replace(p, calibration=dict(p.calibration), detail=dict(p.detail))
        return {**self.__dict__, "columns": dict(self.columns), "provenance": provenance}

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """The Arrow stream protocol: polars, DuckDB, pandas and pyarrow take a flight as a table."""
        from groundstation.flight.tables import arrow_table, flight_table

        return arrow_table(flight_table(self)).__arrow_c_stream__(requested_schema)

    def to_pandas(self) -> "pd.DataFrame":
        """A frame indexed by time [s], with `segment`; units in `attrs["units"]`."""
        from groundstation.flight.tables import pandas_frame

        return pandas_frame(self)

    def to_xarray(self) -> "xr.Dataset":
        """A data set over time [s] with units and meaning as attributes."""
        from groundstation.flight.tables import xarray_dataset

        return xarray_dataset(self)

    def plot(self, *columns: str, ax: Any = None) -> Any:
        """Draw histories of columns (by default the measured motion and controls); gives the axes.

        ax: one matplotlib axes, or as many as there are columns. Angles are drawn in degrees.
        """
        from groundstation.flight.tables import plot_flight

        return plot_flight(self, columns, ax)

    def save(self, path: str | Path) -> Path:
        """Write .mcap, .csv or .parquet; `read_flight` gives the same arrays."""
        from groundstation.flight.writing import write_flight

        write_flight(self, path)
        return Path(path)

    def __getitem__(self, column: str) -> Array:
        try:
            return self.columns[column]
        except KeyError:
            raise MissingColumnError(
                self.name, [column], "this step", near=did_you_mean(column, self.columns)
            ) from None

    def __contains__(self, column: object) -> bool:
        return column in self.columns

    def __len__(self) -> int:
        return int(self.time.size)

    @property
    def sample_interval(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def segments(self) -> tuple[slice, ...]:
        """Index range of each segment, in order."""
        edges = np.flatnonzero(np.diff(self.segment)) + 1
        bounds = [0, *edges.tolist(), self.time.size]
        return tuple(slice(a, b) for a, b in zip(bounds, bounds[1:], strict=False))

    def measured(self, column: str) -> bool:
        """Whether the column exists and has at least one finite value."""
        return column in self.columns and bool(np.isfinite(self.columns[column]).any())

    def require(self, columns: Iterable[str], purpose: str) -> None:
        """Raise MissingColumnError naming every one of `columns` that is absent or entirely NaN."""
        missing = [c for c in columns if not self.measured(c)]
        if missing:
            raise MissingColumnError(self.name, missing, purpose, unknown=self.unknown_columns)

    @property
    def reconstructed(self) -> tuple[str, ...]:
        """Columns that were not measured but reconstructed from others."""
        detail = self.provenance.detail.get(RECONSTRUCTED)
        columns = detail.get("columns") if isinstance(detail, Mapping) else None
        if isinstance(columns, list | tuple):
            return tuple(c for c in columns if isinstance(c, str))
        # in a table, which has no provenance, the columns that `reconstruct` adds show it
        with_wind = all(self.measured(c) for c in WIND)
        return tuple(c for c in AIR_DATA if with_wind and self.measured(c) and self.measured(f"{c}_std"))

    def native_rate(self, column: str) -> float | None:
        """Rate [Hz] of a column in its log, before an import brought all columns to one time base; None where the flight states
        no valid one."""
        rates = self.provenance.detail.get("native_hz")
        rate = rates.get(column) if isinstance(rates, Mapping) else None
        return float(rate) if isinstance(rate, float | int) and 0.0 < rate < FASTEST else None

    @property
    def channels(self) -> Mapping[str, Mapping[str, Any]]:
        """Where the columns come from, as an import states it: column -> {"from", "kind": "measured" | "computed" | "assumed",
        "rate_hz"}; without entries that are not valid."""
        channels = self.provenance.detail.get(CHANNELS)
        entries = channels.items() if isinstance(channels, Mapping) else ()
        return {str(n): dict(c) for n, c in entries if isinstance(c, Mapping) and c.get("kind") in CHANNEL_KINDS}

    def held(self, column: str) -> float | None:
        """Interval [s] at which a command was recorded: it holds in between, has no noise, and may have changed up to one
        interval before its record. None for a measured column, or where the flight states no valid interval."""
        channel = self.channels.get(column, {})
        interval = channel.get(INTERVAL)
        if channel.get(HELD) is not True or not isinstance(interval, float | int):
            return None
        return float(interval) if 0.0 < interval < LATEST else None

    def dated_back(self, column: str) -> float:
        """Time [s] by which an import dated a command back from its record; 0 where the flight states no valid one."""
        back = self.channels.get(column, {}).get(BACK)
        return float(back) if isinstance(back, float | int) and 0.0 < back < LATEST else 0.0

    @property
    def known_columns(self) -> tuple[str, ...]:
        """Columns with a name of `daq.contract.channels`."""
        return tuple(c for c in self.columns if c in COLUMN_BY_NAME)

    @property
    def unknown_columns(self) -> tuple[str, ...]:
        """Columns without a name of `daq.contract.channels`."""
        return tuple(c for c in self.columns if c not in COLUMN_BY_NAME)

    def with_columns(self, **columns: Array) -> "Flight":
        """A copy with columns added or replaced."""
        return replace(self, columns=MappingProxyType({**self.columns, **columns}))

    def with_notes(self, *notes: Finding | str) -> "Flight":
        """A copy with notes added."""
        return replace(self, notes=(*self.notes, *map(as_finding, notes)))

    def part(self, keep: slice | NDArray[np.bool_], name: str | None = None) -> "Flight":
        """A copy of the samples that a range or a mask keeps; segments are renumbered from 0.

        Where samples left out make a step in time of more than `GAP_FACTOR` intervals of the copy, a new segment begins.
        """
        rows = np.arange(self.time.size)[keep]
        time, labels = self.time[rows], self.segment[rows]
        steps = np.diff(time)
        is_hole = (np.diff(rows) > 1) & (steps > GAP_FACTOR * np.median(steps)) if steps.size else np.zeros(0, bool)
        begins = is_hole | (np.diff(labels) != 0)
        segment = _numbered(begins)[: time.size]
        columns = MappingProxyType({k: v[keep] for k, v in self.columns.items()})
        return replace(self, name=name or self.name, time=time, columns=columns, segment=segment)


def _order(name: str, time: Array) -> tuple[NDArray[np.int64], list[Finding]]:
    """Indices that make time strictly increasing, and notes on what was sorted or dropped."""
    notes: list[str] = []
    with np.errstate(invalid="ignore"):
        order = np.flatnonzero(np.abs(time) < LATEST)
    endless = int(np.sum(np.abs(time[np.isfinite(time)]) >= LATEST))
    if endless:
        notes.append(f"{endless} rows with a time beyond 285 years dropped; is time in seconds?")
    if order.size + endless < time.size:
        notes.append(f"{time.size - order.size - endless} rows without a time dropped")
    backwards = np.diff(time[order]) < 0
    if backwards.any():
        first = time[order][1:][backwards][0]
        notes.append(
            f"time runs backwards {int(backwards.sum())} times (first at t = {first:g} s): rows sorted by time"
        )
        order = order[np.argsort(time[order], kind="stable")]
    repeated = np.diff(time[order], prepend=np.nan) == 0
    if repeated.any():
        first = time[order][repeated][0]
        notes.append(f"{int(repeated.sum())} repeated instants (first at t = {first:g} s): the first row of each kept")
    order = order[~repeated]
    if order.size < 2:
        hint = " in seconds (there are times beyond 285 years)" if endless else ""
        raise FlightError(
            f"{name}: only {order.size} usable samples; a flight needs at least two rows with a time{hint}"
        )
    return order, [Finding(FindingKind.TIME_ORDER, text) for text in notes]


def _split(time: Array, labels: NDArray[np.int64], gap_factor: float) -> tuple[NDArray[np.int64], list[Finding]]:
    """Segment number of each sample from the given labels and the gaps in time."""
    steps = np.diff(time)
    gap = steps > gap_factor * np.median(steps)
    rows = np.flatnonzero(gap)
    notes = [f"gap of {steps[i]:.3g} s at t = {time[i]:g} s: split there, never integrated across" for i in rows]
    if len(notes) > MOST_GAPS:
        notes = [*notes[:MOST_GAPS], f"{len(notes) - MOST_GAPS} more gaps"]
    edge = gap | (np.diff(labels) != 0)
    return _numbered(edge), [Finding(FindingKind.GAP, text) for text in notes]


def _numbered(begins: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Segment number of each sample. begins: of every sample but the first, whether a new segment begins with it."""
    return np.concatenate([[0], np.cumsum(begins)]).astype(np.int64)
