"""Tables with units for other programs: CSV with a row of units, MATLAB structs; counts of raw recordings as a table."""

import csv
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.contract.channels import CHANNEL_BY_NAME
from daq.contract.durable import whole, whole_text
from groundstation.flight.tables import ColumnTable, TableColumn

if TYPE_CHECKING:
    from groundstation.calibration.scan_table import ScanTable

_MATLAB_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
"""What MATLAB takes as the name of a field; 63 characters are its `namelengthmax`."""


def raw_table(scans: "ScanTable", name: str) -> ColumnTable:
    """Scan number, time and every raw channel as counts; NaN where a sensor was not in order."""
    columns = [
        TableColumn("scan", scans.number.astype(float), "1", "scan number", whole=True),
        TableColumn("time", scans.time, "s", "time on the aircraft's clock"),
    ]
    columns += [TableColumn(c, v, "count", CHANNEL_BY_NAME[c].meaning) for c, v in scans.raw.items()]
    return ColumnTable(tuple(columns), {"name": name, "notes": json.dumps(list(scans.notes))})


def write_csv(table: ColumnTable, path: Path, *, units_row: bool = False) -> None:
    """A CSV; with `units_row` a second line holds the units. Empty cells were not measured."""
    with whole_text(path) as handle:
        writer = csv.writer(handle)
        writer.writerow([c.name for c in table.columns])
        if units_row:
            writer.writerow([c.unit for c in table.columns])
        listed = [(c.values.astype(np.int64) if c.whole else c.values).tolist() for c in table.columns]
        for row in zip(*listed, strict=True):
            writer.writerow(["" if v != v else v for v in row])


def write_matlab(table: ColumnTable, path: Path) -> list[str]:
    """A MATLAB 5 file with one struct `flight`: a column vector per column, structs `units`, `meaning` and `about`.

    Gives the names of columns that MATLAB cannot name and that are left out.
    """
    from scipy.io import savemat

    named = [c for c in table.columns if _MATLAB_NAME.fullmatch(c.name)]
    struct: dict[str, Any] = {c.name: c.values.reshape(-1, 1) for c in named}
    struct["units"] = {c.name: c.unit for c in named}
    struct["meaning"] = {c.name: c.meaning for c in named}
    struct["about"] = dict(table.about)
    with whole(path) as new:
        savemat(new, {"flight": struct}, appendmat=False, long_field_names=True, do_compression=True, oned_as="column")
    return [c.name for c in table.columns if not _MATLAB_NAME.fullmatch(c.name)]
