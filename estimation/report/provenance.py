"""Where the numbers of a page come from: recording, calibration, version."""

import hashlib
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

from estimation.report.tables import ReportTable

if TYPE_CHECKING:
    from groundstation.flight import Flight


def provenance_table(flights: Sequence["Flight"]) -> ReportTable:
    """One row a flight: file and its hash, the raw recording it was calibrated from, the calibration, the program."""
    rows = []
    for flight in flights:
        p = flight.provenance
        raw = p.detail.get("derived_from")
        raw_hash = str(raw.get("sha256", "")) if isinstance(raw, dict) else ""
        rows.append((flight.name, p.source, p.path or "in memory", p.sha256[:16], raw_hash[:16], calibration_digest(flight),
                     p.software, str(len(flight)), f"{flight.time[-1] - flight.time[0]:.1f}"))  # fmt: skip
    return ReportTable(
        "provenance", "Where the flights come from",
        ("flight", "source", "file", "sha-256 of file", "of raw recording", "of calibration", "calibrated by", "samples",
         "duration [s]"), tuple(rows), symbols=False, texts=(2,),
        note="First 16 digits of each SHA-256; that of the calibration is over all its files' names and hashes together.",
    )  # fmt: skip


def calibration_digest(flight: "Flight") -> str:
    """First 16 digits of the SHA-256 over the calibration files' names and hashes; empty where none is stated."""
    files = dict(flight.provenance.calibration)
    if not files:
        return ""
    return hashlib.sha256(json.dumps(files, sort_keys=True).encode()).hexdigest()[:16]


def simulated(flights: Sequence["Flight"]) -> bool:
    """Whether any of the flights was made by a simulator."""
    return any(f.provenance.source == "simulated" for f in flights)
