"""Exports a flight or recording in the format that the ending of the output's name chooses."""

import csv
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.contract.channels import CHANNEL_BY_NAME
from daq.utilities.durable import whole, whole_file, whole_text
from daq.utilities.errors import UserError
from daq.utilities.packages import optional
from groundstation.calibration.recording import open_flight
from groundstation.flight.tables import ColumnTable, TableColumn, flight_table

if TYPE_CHECKING:
    from groundstation.calibration.scan_table import ScanTable

TABLES = (".csv", ".parquet", ".mat")
FORMATS = (*TABLES, ".kml", ".gpx", ".rrd", ".mcap")


class ExportError(UserError):
    """An export that cannot be made."""


@dataclass(frozen=True)
class ExportSummary:
    """The file written, and notes on it for a person."""

    path: Path
    notes: tuple[str, ...] = ()


def export_file(
    file: Path, target: Path, *, units_row: bool = False, raw: bool = False, calibration: Path | None = None
) -> ExportSummary:
    """Write FILE, a flight or a raw recording, in the format of `target`'s ending.

    units_row: a second line of units in a CSV. raw: counts instead of calibrated columns (recordings, tables only).
    calibration: directory in place of the embedded set. Raises UserError with one sentence.
    """
    check_output(file, target)
    target.parent.mkdir(parents=True, exist_ok=True)
    suffix = target.suffix.lower()
    if suffix == ".rrd":
        from groundstation.viewer.recorded import as_rrd

        if file.suffix.lower() == ".rrd":
            raise ExportError(f"{file}: a recording of rerun already; copy it")
        as_rrd(file, target, calibration=calibration)
        return ExportSummary(target)
    if raw:
        return ExportSummary(target, _export_counts(file, target, units_row))
    from groundstation.export import foxglove, tracks

    flight = open_flight(file, calibration)
    writers = {".kml": tracks.write_kml, ".gpx": tracks.write_gpx, ".mcap": foxglove.write_foxglove}
    if suffix not in writers:
        return ExportSummary(target, save_table(tracks.with_utc(flight_table(flight), flight), target, units_row))
    writers[suffix](flight, target)
    untimed = "the flight does not know UTC: times count from the aircraft's start"
    return ExportSummary(target, (untimed,) if tracks.utc_offset(flight) is None else ())


def check_output(file: Path, target: Path) -> None:
    """Raise ExportError for an unknown format, or an output that is the input."""
    if target.suffix.lower() not in FORMATS:
        raise ExportError(f"{target}: no known format; end the name in one of {' '.join(FORMATS)}")
    if target.exists() and file.exists() and target.samefile(file):
        raise ExportError(f"{target}: that is the file to export; give another name")


def _export_counts(file: Path, target: Path, units_row: bool) -> tuple[str, ...]:
    from daq.contract.recordings.reading import read_recording
    from groundstation.calibration.scan_table import scan_table

    if target.suffix.lower() not in TABLES:
        raise ExportError(f"{target}: counts are written as tables only; end the name in one of {' '.join(TABLES)}")
    recording = read_recording(file, salvage=True)
    return save_table(raw_table(scan_table(recording.scans()), recording.path.stem), target, units_row)


def save_table(table: ColumnTable, target: Path, units_row: bool) -> tuple[str, ...]:
    """Write a table in the format of `target`'s ending; notes for a person."""
    match target.suffix.lower():
        case ".csv":
            write_csv(table, target, units_row=units_row)
        case ".parquet":
            from groundstation.flight.tables import arrow_table

            pq = optional("pyarrow.parquet", "writing Parquet")
            with whole_file(target) as new:
                pq.write_table(arrow_table(table), new)
        case _:
            nameless = write_matlab(table, target)
            return tuple(f"column {name}: no name that MATLAB takes, left out" for name in nameless)
    return ()


_MATLAB_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
"""Names that MATLAB accepts for a field; 63 characters are its `namelengthmax`."""


def raw_table(scans: "ScanTable", name: str) -> ColumnTable:
    """Scan number, time and every raw channel as counts; NaN where a sensor was not usable."""
    columns = [
        TableColumn("scan", scans.number.astype(float), "1", "scan number", whole=True),
        TableColumn("time", scans.time, "s", "time on the aircraft's clock"),
    ]
    columns += [TableColumn(c, v, "count", CHANNEL_BY_NAME[c].meaning) for c, v in scans.raw.items()]
    return ColumnTable(tuple(columns), {"name": name, "notes": json.dumps(list(scans.notes))})


def write_csv(table: ColumnTable, path: Path, *, units_row: bool = False) -> None:
    """Write a CSV; with `units_row` a second line holds the units. Empty cells were not measured."""
    with whole_text(path) as handle:
        writer = csv.writer(handle)
        writer.writerow([c.name for c in table.columns])
        if units_row:
            writer.writerow([c.unit for c in table.columns])
        listed = [(c.values.astype(np.int64) if c.whole else c.values).tolist() for c in table.columns]
        for row in zip(*listed, strict=True):
            writer.writerow(["" if v != v else v for v in row])


def write_matlab(table: ColumnTable, path: Path) -> list[str]:
    """Write a MATLAB 5 file with one struct `flight`: a column vector per column, structs `units`, `meaning` and `about`.

    Returns the names of columns left out because MATLAB does not accept them.
    """
    from scipy.io import savemat

    columns = [c for c in table.columns if _MATLAB_NAME.fullmatch(c.name)]
    struct: dict[str, Any] = {c.name: c.values.reshape(-1, 1) for c in columns}
    struct["units"] = {c.name: c.unit for c in columns}
    struct["meaning"] = {c.name: c.meaning for c in columns}
    struct["about"] = dict(table.about)
    with whole(path) as new:
        savemat(new, {"flight": struct}, appendmat=False, long_field_names=True, do_compression=True, oned_as="column")
    return [c.name for c in table.columns if not _MATLAB_NAME.fullmatch(c.name)]
