"""The end of a flight: from recordings to a calibrated, split and checked flight for the estimation package."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.linalg import LinAlgError

from daq.contract.recordings.recording import RecordingError
from daq.utilities.errors import UserError
from daq.utilities.outputs import write_json
from groundstation.calibration.recording import calibrate_opened, open_recording
from groundstation.calibration.schema import CalibrationError
from groundstation.flight import Flight, FlightError, write_flight
from groundstation.flight.findings import Finding
from groundstation.flight.manoeuvres import ManoeuvreStretch, cut_to_manoeuvres, find_manoeuvres
from groundstation.flight.quality.report import quality_report
from groundstation.identification.history import DETAIL as LIVE_IDENTIFICATION

if TYPE_CHECKING:
    from groundstation.live.station import Station


class HandoverError(UserError):
    """No flight can be made of what was received."""


@dataclass(frozen=True)
class Handover:
    """A flight written for the estimation. path: the complete flight. manoeuvres_path: its manoeuvres, each a segment; None
    without any. origin: of its recording."""

    path: Path
    manoeuvres_path: Path | None
    flight: Flight
    manoeuvres: tuple[ManoeuvreStretch, ...]
    findings: tuple[Finding, ...]
    origin: str

    def lines(self) -> list[str]:
        """The flight, its manoeuvres and findings as lines for a person."""
        seconds = self.flight.time[-1] - self.flight.time[0]
        lines = [f"flight {self.path}: {len(self.flight)} samples, {seconds:.1f} s, from {self.origin}"]
        lines += [f"  manoeuvre {m.start:7.1f} to {m.stop:7.1f} s  {m.title}" for m in self.manoeuvres]
        lines += [f"  {f.severity}: {f.kind}: {f.text}" for f in self.findings if f.severity != "ok"]
        return lines


def onboard_recording(directory: Path | None, session: str) -> Path | None:
    """The configured directory where it holds the aircraft's own recording of a session, else None."""
    if directory is None or not directory.is_dir():
        return None
    recordings = sorted(p for p in directory.glob("*.mcap") if p.name.startswith(session))
    return directory if recordings else None


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

    identified: what was identified live (`LiveIdentifications.result`), stored in the flight's provenance.
    Raises HandoverError when the recording holds no usable flight.
    """
    try:
        opened, notes = open_recording(recording, salvage=True)
        try:
            flight = calibrate_opened(opened, salvage=True)
        except CalibrationError:
            # the aircraft's own calibration was not received: the station's set is used, and a note says so
            flight = calibrate_opened(opened, fallback_calibration, salvage=True)
            note = f"calibrated with the station's set {fallback_calibration!r}: the aircraft's own is not in the recording"
            notes = [*notes, note]
        del opened  # frees some kilobytes per second of flight
        flight = flight.with_notes(*notes)
    except (FlightError, CalibrationError, RecordingError, LinAlgError) as error:  # LinAlgError: impossible times
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
    manoeuvres_path = folder / f"{name}_manoeuvres.mcap" if manoeuvres else None
    if manoeuvres_path is not None:
        write_flight(cut_to_manoeuvres(flight, manoeuvres, manoeuvres_path.stem), manoeuvres_path)
    handover = Handover(path, manoeuvres_path, flight, manoeuvres, findings, origin)
    summary = {"flight": str(path), "origin": origin, "manoeuvres": listed, "quality": [f.to_json() for f in findings]}
    write_json(summary, folder / f"{name}.json")
    return handover


def hand_over_sessions(station: "Station", folder: Path, say: Callable[[str], None]) -> list[Handover]:
    """Hand over every session that holds a flight, and the replayed recording. say: prints a line."""
    settings = station.config
    handovers = []
    if station.replayed is not None:
        identified = None if station.replayed_as is None else station.identifications.result(station.replayed_as)
        handovers.append(
            hand_over(station.replayed, folder, origin=f"replay of {station.replayed}", identified=identified)
        )
    sessions = [(s, r) for s, r in station.receiver.session_recorders().items() if r.path.is_file()]
    sessions.sort(key=lambda pair: pair[1].path.stat().st_size, reverse=True)
    for number, (session, recorder) in enumerate(sessions):
        name = "flight" if number == 0 and not handovers else f"flight_{session.name}"
        onboard = onboard_recording(settings.handover.onboard, recorder.info().session)
        source, origin = (
            (recorder.path, "telemetry and backfill") if onboard is None else (onboard, "the onboard recording")
        )
        say(f"{session.name}: a flight is made of {recorder.journal.total} scans from {origin}")
        try:
            handovers.append(
                hand_over(
                    source,
                    folder,
                    origin=origin,
                    fallback_calibration=settings.calibration.directory,
                    name=name,
                    identified=station.identifications.result(session),
                )
            )
        except HandoverError as error:
            say(f"{session.name}: {error}")
        except OSError as error:
            say(f"{session.name}: the flight cannot be written ({error.strerror or error})")
        except Exception as error:  # noqa: BLE001  data of one sender must not keep the other flights from being written
            say(f"{session.name}: no flight can be made of it ({type(error).__name__}: {error}); its recording stays")
    if any(not r.path.is_file() for r in station.receiver.session_recorders().values() if r.has_scans):
        advice = f"sideslip ground CONFIG --replay {folder / 'telemetry.tlog'} --speed max --out ELSEWHERE"
        say(f"not everything received could be written as a recording; make room and play it again: {advice}")
    return handovers
