"""Flights from files: MCAP, CSV and Parquet, within bounds, with notes on what was corrected or left out."""

import hashlib
import struct
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from daq.contract.channels import COLUMN_BY_NAME
from daq.contract.recordings.flight_rows import as_mapping, json_object
from daq.utilities.input_files import check_file
from daq.utilities.plain_words import listed, one_line, plain_name
from groundstation.flight.errors import FlightError
from groundstation.flight.files.csv_columns import read_csv
from groundstation.flight.files.parquet_columns import read_parquet
from groundstation.flight.findings import Finding, from_meta, unknown_columns
from groundstation.flight.flight import GAP_FACTOR, Array, Flight, Provenance
from groundstation.flight.writing import FLIGHT_TOPIC, METADATA_NAME, value_digest

LARGEST = 1e12
"""No quantity of a flight in SI units is as large; squares and sums of smaller values do not overflow."""
FOREIGN = "if another program wrote the file, convert it with 'sideslip import'"

_MOST_NOTES = 30  # on columns that are not numeric
_Read = tuple[dict[str, Array], Provenance, list[Finding | str]]


def read_flight(path: str | Path, *, gap_factor: float = GAP_FACTOR) -> Flight:
    """Read a flight from .mcap, .csv or .parquet.

    Unknown columns are kept and named in a note. Raises FlightError with one sentence for anything unusable.
    """
    path = Path(path)
    readers = {".mcap": _read_mcap, ".csv": _read_csv, ".parquet": _read_parquet}
    if path.suffix.lower() not in readers:
        raise FlightError(
            f"{path}: not a flight file; give .mcap, .csv or .parquet, or convert it with 'sideslip import'"
        )
    check_file(path, error=FlightError)
    columns, provenance, notes = readers[path.suffix.lower()](path)
    if "time" not in columns:
        raise FlightError(f"{path}: no column 'time' [s]; found {listed(columns) or 'nothing'}; {FOREIGN}")
    time = columns.pop("time")
    segment = columns.pop("segment", None)
    if segment is not None and not (np.all(np.isfinite(segment)) and np.all(segment == np.round(segment))):
        raise FlightError(
            f"{path}: column segment has empty cells or fractions; give an integer in each row or leave the column out"
        )
    if segment is not None and np.any(np.abs(segment) > 2**31):
        raise FlightError(f"{path}: column segment holds {np.max(np.abs(segment)):g}; number segments from 0")
    columns = plain_names(columns)
    columns, value_notes = credible_values(columns)
    notes += value_notes
    unknown = [c for c in columns if c not in COLUMN_BY_NAME]
    if unknown:
        notes.append(unknown_columns({c: c for c in unknown}))
    provenance = replace(provenance, path=str(path), sha256=hashlib.sha256(path.read_bytes()).hexdigest())
    return Flight.build(
        path.stem, time, columns, segment=segment, provenance=provenance, notes=notes, gap_factor=gap_factor
    )


def named_aircraft(path: Path) -> str:
    """The aircraft that a flight's file names, empty where it names none; the rows of an .mcap and of a table are not read.

    Raises FlightError as `read_flight`, or where the file is no flight.
    """
    match path.suffix.lower():
        case ".csv":
            return ""  # a table of numbers
        case ".mcap":
            return _provenance_from(_mcap_origin(path)).aircraft
        case _:
            return read_flight(path).provenance.aircraft


def _mcap_origin(path: Path) -> dict[str, Any]:
    """The provenance of a flight file, as its metadata hold it."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    try:
        with path.open("rb") as file:
            texts = [m.metadata.get("json", "") for m in make_reader(file).iter_metadata() if m.name == METADATA_NAME]
    except (OSError, ValueError, struct.error, McapError) as error:
        raise FlightError(f"{path}: its metadata cannot be read ({error})") from error
    if not texts:
        raise FlightError(f"{path}: no calibrated flight in this file")
    return json_object(texts[0])


def _read_csv(path: Path) -> _Read:
    try:
        return read_csv(path, FlightError), Provenance(), []
    except FlightError as error:
        raise FlightError(f"{error}; {FOREIGN}") from error


def _read_parquet(path: Path) -> _Read:
    content = read_parquet(path, FlightError)
    notes: list[Finding | str] = [
        f"column {plain_name(name)} is not numeric: left out" for name in (*content.words, *content.dates)
    ]
    if len(notes) > _MOST_NOTES:
        notes = [*notes[:_MOST_NOTES], f"{len(notes) - _MOST_NOTES} more columns are not numeric: left out"]
    meta = content.footer.get(METADATA_NAME.encode())
    origin = json_object(meta) if meta else {}
    if meta and not origin:
        notes.append("what the file says of its origin cannot be read: taken as not known")
    return content.numeric, _provenance_from(origin) if origin else Provenance(), notes


def _provenance_from(meta: Mapping[str, Any]) -> Provenance:
    return Provenance(
        source=one_line(str(meta.get("source", "imported")), 40),
        aircraft=plain_name(str(meta.get("aircraft", ""))),
        software=plain_name(str(meta.get("software", ""))),
        calibration={k: str(v) for k, v in as_mapping(meta.get("calibration")).items()},
        detail={**as_mapping(meta.get("detail")), "derived_from": as_mapping(meta.get("derived_from"))},
    )


def _read_mcap(path: Path) -> _Read:
    from daq.contract.recordings.flight_rows import described, flight_rows
    from daq.contract.recordings.profile import OURS, mcap_profile
    from daq.contract.recordings.recording import RecordingError
    from daq.contract.recordings.segments import read_parts

    try:
        flights = read_parts(path)
    except RecordingError as error:
        raise FlightError(f"{error}; damaged, or no flight at all") from error
    flight = flights[0]
    profile = mcap_profile(path)
    if profile is not None and profile != OURS:
        raise FlightError(
            f"{path}: a bag of another program; 'sideslip import {path} -o FLIGHT.mcap' makes a flight of it"
        )
    if any(s.entries for s in flights) or (
        all(s.sound for s in flights) and not any(FLIGHT_TOPIC in s.auxiliary for s in flights)
    ):
        raise FlightError(
            f"{path}: no calibrated flight in this file; a raw recording must pass 'sideslip calibrate' first"
        )
    for damage in (d for s in flights for d in s.damages):
        raise FlightError(
            f"{path}: damaged or not an MCAP file (byte {damage.at_byte}: {damage.what}); "
            "try 'sideslip recover' on the raw recording"
        )
    if len(flights) > 1:
        raise FlightError(f"{path}: {len(flights)} flights one behind the other in one file; calibrate each by itself")
    table = flight_rows(flight)
    meta, text, digest = described(flight)
    if digest != value_digest(text, table.names, table.values):
        raise FlightError(
            f"{path}: damaged: the values are not those that were written; calibrate the raw recording again"
        )
    columns = {n: table.values[:, i] for i, n in enumerate(table.names)}
    return columns, _provenance_from(meta), [*from_meta(meta)]


def credible_values(columns: Mapping[str, Array]) -> tuple[dict[str, Array], list[str]]:
    """The columns with NaN for infinities and, in known columns, values beyond LARGEST; and notes on these."""
    credible, notes = dict(columns), []
    for name, values in columns.items():
        for problem, mask in (
            ("infinite values", np.isinf(values)),
            (f"values beyond {LARGEST:g}", np.isfinite(values) & (np.abs(values) > LARGEST)),
        ):
            if mask.any() and (name in COLUMN_BY_NAME or problem.startswith("inf")):
                credible[name] = np.where(mask, np.nan, credible[name])
                notes.append(f"column {name}: {int(mask.sum())} {problem} taken as not measured")
    return credible, notes


def plain_names(columns: Mapping[str, Array]) -> dict[str, Array]:
    """The columns under unique names that can be shown anywhere."""
    renamed: dict[str, Array] = {}
    for name, values in columns.items():
        label = plain_name(name)
        while label in renamed:
            label = f"{label[:100]}_{len(renamed)}"
        renamed[label] = values
    return renamed
