"""Tables with units for other programs: Arrow and Parquet, CSV with a row of units, MATLAB structs.

Flights give calibrated columns, raw recordings the counts as the chips delivered them.
"""

import csv
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.contract.channels import CHANNEL_BY_NAME, COLUMN_BY_NAME
from groundstation.flight import Array, Flight

if TYPE_CHECKING:
    import pyarrow as pa

    from groundstation.calibration.scan_table import ScanTable

_MATLAB_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
"""What MATLAB takes as the name of a field; 63 characters are its `namelengthmax`."""


@dataclass(frozen=True)
class TableColumn:
    """One column: (N,) values, NaN where not measured; unit "1" for pure numbers, "" where unknown; meaning with sign."""

    name: str
    values: Array
    unit: str
    meaning: str = ""
    whole: bool = False  # holds integers without gaps


@dataclass(frozen=True)
class Table:
    """Columns of equal length and what is known of them as a whole."""

    columns: tuple[TableColumn, ...]
    about: Mapping[str, str] = field(default_factory=dict)


def flight_table(flight: Flight) -> Table:
    """`time`, every column of a flight, and `segment`."""
    about = {
        "name": flight.name,
        "aircraft": flight.provenance.aircraft,
        "source": flight.provenance.source,
        "software": flight.provenance.software,
        "notes": json.dumps(list(flight.notes)),
    }
    columns = [TableColumn("time", flight.time, "s", "time")]
    for name, values in flight.columns.items():
        known = COLUMN_BY_NAME.get(name)
        columns.append(TableColumn(name, values, known.unit if known else "", known.meaning if known else ""))
    stretch = flight.segment.astype(float)
    columns.append(TableColumn("segment", stretch, "1", "stretch without a gap, counted from 0", whole=True))
    return Table(tuple(columns), about)


def raw_table(scans: "ScanTable", name: str) -> Table:
    """Scan number, time and every raw channel as counts; NaN where a sensor was not in order."""
    columns = [
        TableColumn("scan", scans.number.astype(float), "1", "scan number", whole=True),
        TableColumn("time", scans.time, "s", "time on the aircraft's clock"),
    ]
    columns += [TableColumn(c, v, "count", CHANNEL_BY_NAME[c].meaning) for c, v in scans.raw.items()]
    return Table(tuple(columns), {"name": name, "notes": json.dumps(list(scans.notes))})


def arrow_table(table: Table) -> "pa.Table":
    """An Arrow table: `unit` and `meaning` in each field's metadata; NaN is null."""
    import pyarrow as pa

    fields, arrays = [], []
    for column in table.columns:
        kind = pa.int64() if column.whole else pa.float64()
        values = column.values.astype(np.int64) if column.whole else column.values
        arrays.append(pa.array(values, kind, from_pandas=True))
        fields.append(pa.field(column.name, kind, metadata={"unit": column.unit, "meaning": column.meaning}))
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=dict(table.about)))


def write_csv(table: Table, path: Path, *, units_row: bool = False) -> None:
    """A CSV; with `units_row` a second line holds the units. Empty cells were not measured."""
    with path.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle)
        writer.writerow([c.name for c in table.columns])
        if units_row:
            writer.writerow([c.unit for c in table.columns])
        listed = [(c.values.astype(np.int64) if c.whole else c.values).tolist() for c in table.columns]
        for row in zip(*listed, strict=True):
            writer.writerow(["" if v != v else v for v in row])


def write_matlab(table: Table, path: Path) -> list[str]:
    """A MATLAB 5 file with one struct `flight`: a column vector per column, structs `units`, `meaning` and `about`.

    Gives the names of columns that MATLAB cannot name and that are left out.
    """
    from scipy.io import savemat

    named = [c for c in table.columns if _MATLAB_NAME.fullmatch(c.name)]
    struct: dict[str, Any] = {c.name: c.values.reshape(-1, 1) for c in named}
    struct["units"] = {c.name: c.unit for c in named}
    struct["meaning"] = {c.name: c.meaning for c in named}
    struct["about"] = dict(table.about)
    savemat(path, {"flight": struct}, long_field_names=True, do_compression=True, oned_as="column")
    return [c.name for c in table.columns if not _MATLAB_NAME.fullmatch(c.name)]
