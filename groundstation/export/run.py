"""Any flight or recording to any format that the ending of the output's name chooses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from daq.contract.durable import whole
from daq.contract.errors import UserError
from groundstation.flight import Flight, read_flight

if TYPE_CHECKING:
    from groundstation.flight.tables import ColumnTable

TABLES = (".csv", ".parquet", ".mat")
FORMATS = (*TABLES, ".kml", ".gpx", ".rrd", ".mcap")


class ExportError(UserError):
    """An export that cannot be made."""


@dataclass(frozen=True)
class ExportSummary:
    """What was written, and what a person should know of it."""

    path: Path
    notes: tuple[str, ...] = ()


def export_file(
    file: Path, out: Path, *, units_row: bool = False, raw: bool = False, calibration: Path | None = None
) -> ExportSummary:
    """Write FILE, a flight or a raw recording, in the format of `out`'s ending.

    units_row: a second line of units in a CSV. raw: counts instead of calibrated columns (recordings, tables only).
    calibration: directory in place of the embedded set. Raises UserError with one sentence.
    """
    check_output(file, out)
    out.parent.mkdir(parents=True, exist_ok=True)
    suffix = out.suffix.lower()
    if suffix == ".rrd":
        from groundstation.viewer.recorded import as_rrd

        as_rrd(file, out, calibration=calibration)
        return ExportSummary(out)
    if raw:
        return _export_counts(file, out, units_row)
    flight = open_flight(file, calibration)
    writer: dict[str, Callable[[Flight, Path], Sequence[str]]] = {
        ".kml": _kml,
        ".gpx": _gpx,
        ".mcap": _foxglove,
    }
    notes = writer[suffix](flight, out) if suffix in writer else _write_table(flight, out, units_row)
    return ExportSummary(out, tuple(notes))


def check_output(file: Path, out: Path) -> None:
    """Refuse a format that nobody knows and an output that is the input."""
    if out.suffix.lower() not in FORMATS:
        raise ExportError(f"{out}: no known format; end the name in one of {' '.join(FORMATS)}")
    if out.exists() and file.exists() and out.samefile(file):
        raise ExportError(f"{out}: that is the file to export; give another name")


def open_flight(file: Path, calibration: Path | None = None) -> Flight:
    """A flight file as it is, a raw recording (file or directory of segments) calibrated, as `sideslip calibrate` does."""
    from groundstation.viewer.recorded import is_raw

    if file.is_dir() or (file.suffix == ".mcap" and is_raw(file)):
        from groundstation.calibration.recording import calibrate_recording

        return calibrate_recording(file, calibration, salvage=True)
    return read_flight(file)


def _export_counts(file: Path, out: Path, units_row: bool) -> ExportSummary:
    from daq.contract.recordings.reading import read_recording
    from groundstation.calibration.scan_table import scan_table
    from groundstation.export.writers import raw_table

    if out.suffix.lower() not in TABLES:
        raise ExportError(f"{out}: counts are written as tables only; end the name in one of {' '.join(TABLES)}")
    recording = read_recording(file, salvage=True)
    scans = scan_table(recording.scans())
    return ExportSummary(out, tuple(_write(raw_table(scans, recording.path.stem), out, units_row)))


def _write_table(flight: Flight, out: Path, units_row: bool) -> list[str]:
    from groundstation.export.timescale import with_utc
    from groundstation.flight.tables import flight_table

    return _write(with_utc(flight_table(flight), flight), out, units_row)


def _write(table: "ColumnTable", out: Path, units_row: bool) -> list[str]:
    from groundstation.export import writers

    match out.suffix.lower():
        case ".csv":
            writers.write_csv(table, out, units_row=units_row)
        case ".parquet":
            import pyarrow.parquet as pq

            from groundstation.flight.tables import arrow_table

            with whole(out) as new:
                pq.write_table(arrow_table(table), new)
        case _:
            left = writers.write_matlab(table, out)
            return [f"column {name}: no name that MATLAB takes, left out" for name in left]
    return []


def _kml(flight: Flight, out: Path) -> list[str]:
    from groundstation.export.tracks import write_kml

    write_kml(flight, out)
    return _untimed(flight)


def _gpx(flight: Flight, out: Path) -> list[str]:
    from groundstation.export.tracks import write_gpx

    write_gpx(flight, out)
    return _untimed(flight)


def _foxglove(flight: Flight, out: Path) -> list[str]:
    from groundstation.export.foxglove import write_foxglove

    write_foxglove(flight, out)
    return _untimed(flight)


def _untimed(flight: Flight) -> list[str]:
    from groundstation.export.timescale import utc_offset

    if utc_offset(flight) is not None:
        return []
    return ["the flight does not know UTC: times count from the aircraft's start"]
