"""The end of a flight: from recordings to a calibrated, split and checked flight for the estimation package."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from numpy.linalg import LinAlgError

from daq.contract.errors import UserError
from daq.contract.outputs import write_json
from daq.contract.recordings.recording import RecordingError
from groundstation.calibration.errors import CalibrationError
from groundstation.calibration.recording import calibrate_recording
from groundstation.flight import Flight, FlightError, write_flight
from groundstation.flight.findings import Finding
from groundstation.flight.manoeuvres import ManoeuvreStretch, cut_to_manoeuvres, find_manoeuvres
from groundstation.flight.quality.report import quality_report
from groundstation.identification.history import DETAIL as LIVE_IDENTIFICATION


class HandoverError(UserError):
    """No flight can be made of what was received."""


@dataclass(frozen=True)
class Handover:
    """What was handed over. path: the whole flight; manoeuvres_path: only the manoeuvres, each a segment; None if none."""

    path: Path
    manoeuvres_path: Path | None
    flight: Flight
    manoeuvres: tuple[ManoeuvreStretch, ...]
    findings: tuple[Finding, ...]
    origin: str

    def lines(self) -> list[str]:
        """For a person."""
        seconds = self.flight.time[-1] - self.flight.time[0]
        found = [f"flight {self.path}: {len(self.flight)} samples, {seconds:.1f} s, from {self.origin}"]
        found += [f"  manoeuvre {m.start:7.1f} to {m.stop:7.1f} s  {m.title}" for m in self.manoeuvres]
        found += [f"  {f.severity}: {f.kind}: {f.text}" for f in self.findings if f.severity != "ok"]
        return found


def onboard_recording(directory: Path | None, session: str) -> Path | None:
    """The aircraft's own recording of a session, where a directory for it is configured and holds it."""
    if directory is None or not directory.is_dir():
        return None
    found = sorted(p for p in directory.glob("*.mcap") if p.name.startswith(session))
    return directory if found else None


def hand_over(
    recording: Path,
    folder: Path,
    *,
    origin: str,
    fallback_calibration: str = "cdfp",
    name: str = "flight",
    identified: Mapping[str, Any] | None = None,
) -> Handover:
    """Calibrate a raw recording and write `<name>.mcap`, its manoeuvres and a summary into `folder`.

    identified: what was identified live (`LiveIdentifications.kept`), kept in the flight's provenance.
    Raises HandoverError when the recording holds no usable flight.
    """
    try:
        try:
            flight = calibrate_recording(recording, salvage=True)
        except CalibrationError:
            # The aircraft's own calibration has not come down: the station's set stands in, and the flight says so.
            flight = calibrate_recording(recording, fallback_calibration, salvage=True)
            said = f"calibrated with the station's set {fallback_calibration!r}: the aircraft's own is not in the recording"
            flight = flight.with_notes(said)
    except (FlightError, CalibrationError, RecordingError, LinAlgError) as error:  # the last: times no aircraft has
        raise HandoverError(f"{recording}: no flight can be made of it: {error}") from error
    manoeuvres = find_manoeuvres(flight)
    findings = quality_report(flight)
    listed = [{"start": m.start, "stop": m.stop, "title": m.title, "kind": m.kind} for m in manoeuvres]
    detail = {**flight.provenance.detail, "manoeuvres": listed, "origin": origin}
    if identified is not None:
        detail[LIVE_IDENTIFICATION] = dict(identified)
    flight = replace(flight, name=name, provenance=replace(flight.provenance, detail=detail))
    path = folder / f"{name}.mcap"
    write_flight(flight, path)
    manoeuvres_path = _write_manoeuvres(flight, manoeuvres, folder / f"{name}_manoeuvres.mcap")
    handed = Handover(path, manoeuvres_path, flight, manoeuvres, findings, origin)
    summary = {"flight": str(path), "origin": origin, "manoeuvres": listed, "quality": [f.to_json() for f in findings]}
    write_json(summary, folder / f"{name}.json")
    return handed


def _write_manoeuvres(flight: Flight, manoeuvres: Sequence[ManoeuvreStretch], path: Path) -> Path | None:
    if not manoeuvres:
        return None
    write_flight(cut_to_manoeuvres(flight, manoeuvres, path.stem), path)
    return path
