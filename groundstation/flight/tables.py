"""Flights as tables with units (Arrow, pandas, xarray, HTML), and their histories drawn.

Arrow fields carry `unit` and `meaning` as metadata; xarray variables carry `units` and `long_name`; pandas frames have the
units in `attrs["units"]`.
"""

import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.constants import RADIAN
from daq.utilities.packages import optional
from groundstation.flight.arrays import Array
from groundstation.flight.errors import FlightError, MissingColumnError
from groundstation.flight.findings import Finding, finding_texts

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
    import xarray as xr

_USUAL = ("V", "alpha", "beta", "p", "q", "r", "phi", "theta", "ay", "az", "delta_e", "delta_a", "delta_r")


class FlightView(Protocol):
    """The part of a flight that tables, plots and writers use."""

    @property
    def name(self) -> str: ...
    @property
    def time(self) -> Array: ...
    @property
    def columns(self) -> Mapping[str, Array]: ...
    @property
    def segment(self) -> NDArray[np.int64]: ...
    @property
    def segments(self) -> tuple[slice, ...]: ...
    @property
    def provenance(self) -> Any: ...
    @property
    def notes(self) -> tuple[Finding, ...]: ...


@dataclass(frozen=True)
class TableColumn:
    """One column: (N,) values, NaN where not measured; unit "1" for pure numbers, "" where unknown; meaning with sign."""

    name: str
    values: Array
    unit: str
    meaning: str = ""
    whole: bool = False  # holds integers without gaps


@dataclass(frozen=True)
class ColumnTable:
    """Columns of equal length. about: metadata of the table."""

    columns: tuple[TableColumn, ...]
    about: Mapping[str, str] = field(default_factory=dict)


def flight_table(flight: FlightView) -> ColumnTable:
    """`time`, every column of a flight, and `segment`."""
    metadata = {
        "name": flight.name,
        "aircraft": flight.provenance.aircraft,
        "source": flight.provenance.source,
        "software": flight.provenance.software,
        "notes": json.dumps(finding_texts(flight.notes)),
    }
    columns = [TableColumn("time", flight.time, "s", "time")]
    for name, values in flight.columns.items():
        channel = COLUMN_BY_NAME.get(name)
        columns.append(TableColumn(name, values, channel.unit if channel else "", channel.meaning if channel else ""))
    stretch = flight.segment.astype(float)
    columns.append(TableColumn("segment", stretch, "1", "stretch without a gap, counted from 0", whole=True))
    return ColumnTable(tuple(columns), metadata)


def arrow_table(table: ColumnTable) -> "pa.Table":
    """An Arrow table: `unit` and `meaning` in each field's metadata; NaN is null."""
    pa = optional("pyarrow", "a flight as an Arrow table")
    fields, arrays = [], []
    for column in table.columns:
        kind = pa.int64() if column.whole else pa.float64()
        values = column.values.astype(np.int64) if column.whole else column.values
        arrays.append(pa.array(values, kind, from_pandas=True))
        fields.append(pa.field(column.name, kind, metadata={"unit": column.unit, "meaning": column.meaning}))
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=dict(table.about)))


def pandas_frame(flight: FlightView) -> "pd.DataFrame":
    """A frame indexed by time [s]: every column, and `segment`; `attrs["units"]` holds the units."""
    pd = optional("pandas", "a frame of a flight")
    table = flight_table(flight)
    index = pd.Index(flight.time, name="time")
    frame = pd.DataFrame({c.name: c.values for c in table.columns[1:]}, index=index)
    frame["segment"] = flight.segment
    frame.attrs["units"] = {c.name: c.unit for c in table.columns}
    return frame


def xarray_dataset(flight: FlightView) -> "xr.Dataset":
    """A data set over time [s] with `units` and `long_name` for each variable."""
    xr = optional("xarray", "a data set of a flight")
    table = flight_table(flight)
    described = {c.name: {"units": c.unit, "long_name": c.meaning} for c in table.columns}
    variables: dict[str, Any] = {c.name: ("time", c.values, described[c.name]) for c in table.columns[1:-1]}
    variables["segment"] = ("time", flight.segment, described["segment"])
    return xr.Dataset(variables, {"time": ("time", flight.time, described["time"])}, dict(table.about))


def _measured(flight: FlightView) -> list[str]:
    return [name for name, values in flight.columns.items() if np.isfinite(values).any()]


def flight_html(flight: FlightView) -> str:
    """Name, length and the range of every measured column, as an HTML table; text is escaped."""
    rows = []
    for name in _measured(flight):
        values, channel = flight.columns[name], COLUMN_BY_NAME.get(name)
        unit, meaning = (channel.unit, channel.meaning) if channel else ("", "")
        cells = (name, unit, f"{np.nanmin(values):.4g}", f"{np.nanmax(values):.4g}", meaning)
        rows.append("<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in cells) + "</tr>")
    head = "".join(f"<th>{c}</th>" for c in ("column", "unit", "least", "most", "meaning"))
    notes = "".join(f"<li>{html.escape(n.text)}</li>" for n in flight.notes)
    return (
        f"<div><p>{html.escape(repr(flight).strip('<>'))}</p><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table><ul>{notes}</ul></div>"
    )


def plot_flight(flight: FlightView, columns: Sequence[str], ax: Any = None) -> Any:
    """Draw columns over time, one axes each; segments are not joined. Gives the array of axes, and does not show it.

    Raises FlightError where there is nothing to draw or `ax` does not match, MissingColumnError for an unknown column.
    """
    names = list(columns) or [c for c in _USUAL if c in _measured(flight)]
    if not names:
        raise FlightError(f"{flight.name}: none of the usual columns is measured; name the ones to draw")
    missing = [c for c in names if c not in _measured(flight)]
    if missing:
        raise MissingColumnError(flight.name, missing, "a plot")
    if ax is None:
        from matplotlib import pyplot as plt

        _, ax = plt.subplots(len(names), 1, sharex=True, squeeze=False, figsize=(7.0, 1.1 * len(names) + 0.6))
    axes = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
    if axes.size != len(names):
        raise FlightError(f"{axes.size} axes for {len(names)} columns; give one for each, or none")
    for axis, name in zip(axes, names, strict=True):
        channel = COLUMN_BY_NAME.get(name)
        unit = channel.unit if channel else ""
        factor, label_unit = (RADIAN, unit.replace("rad", "deg")) if "rad" in unit else (1.0, unit)
        for rows in flight.segments:
            axis.plot(flight.time[rows], factor * flight.columns[name][rows], color="C0", linewidth=1.0)
        axis.set_ylabel(f"{name} [{label_unit}]" if label_unit else name)
    axes[-1].set_xlabel("time [s]")
    return axes
