"""A raw recording to a flight: with the calibration it carries, or with another one in its place."""

import hashlib
import tomllib
from pathlib import Path

from daq.contract.channels import GROUP_NAMES
from daq.contract.link.commands import parse_pitot_zero
from daq.contract.ranges import count
from daq.contract.recordings.accounting import verify_recording
from daq.contract.recordings.reading import Recording, read_recording
from daq.contract.recordings.recording import AIRCRAFT_ATTACHMENT
from groundstation.calibration.apply import calibrate
from groundstation.calibration.errors import CalibrationError
from groundstation.calibration.schema import CalibrationSet, load_calibration
from groundstation.flight import AIRCRAFT_FILE, Flight, Provenance


def calibrate_recording(
    path: str | Path,
    calibration: CalibrationSet | str | Path | None = None,
    *,
    align: bool | None = None,
    salvage: bool = False,
) -> Flight:
    """The flight in a raw recording (file, or directory of its segments).

    calibration: a set or directory that takes the place of the embedded one. salvage: use what is intact of a damaged
    recording. Raises RecordingError or CalibrationError with one sentence.
    """
    if Path(path).suffix.lower() == ".tlog":
        raise CalibrationError(
            f"{path}: a telemetry log, not a recording; 'sideslip ground CONFIG --replay {path}' makes recording and flight of it"
        )
    recording = read_recording(path, salvage=salvage)
    chosen = _chosen(recording, calibration)
    flight = calibrate(
        recording.scans(),
        chosen,
        name=recording.path.stem,
        facts={**recording.info.details, **_zeroed(recording)},
        align=align,
        provenance=_provenance(recording),
    )
    return flight.with_notes(*_undescribed(recording), *_gaps(recording))


def _undescribed(recording: Recording) -> list[str]:
    """Sensor groups that the aircraft was fitted with and that no package installed here describes."""
    try:
        sensors = tomllib.loads(recording.info.config_text).get("sensors", {})
    except tomllib.TOMLDecodeError:
        return []
    unknown = sorted(set(sensors.get("extra", {})) - set(GROUP_NAMES))
    return [
        f"sensor group {group} is described by no package installed here: its channels are in the recording and not in the"
        " flight; install the laboratory's package and calibrate again"
        for group in unknown
    ]


def _gaps(recording: Recording) -> list[str]:
    """What is damaged or missing in the recording, in words."""
    notes = [f"{d.what} at byte {d.at_byte} of {path.name}: what is intact is used" for path, d in recording.damages]
    state = verify_recording(recording)
    if state.given_up:
        names = ", ".join(path.name for path in state.given_up)
        missing = f"{count(state.missing)} scans are missing" if state.missing else "no scan is missing"
        notes.append(
            f"{names} given up by the logger after a write error, the recording goes on in the next file; {missing}"
        )
    return notes


def _zeroed(recording: Recording) -> dict[str, str]:
    """The last zeroing of the pitot before flight, as a fact: it takes the sensor's turn-on offset out."""
    counts = [parse_pitot_zero(e.text) for e in recording.events]
    known = [c for c in counts if c is not None]
    return {"pitot.zero_count": f"{known[-1]!r}"} if known else {}


def embedded_calibration(recording: Recording) -> CalibrationSet:
    """The calibration set a recording carries. Raises CalibrationError when it has none."""
    texts = {name: data.decode("utf-8") for name, data in recording.info.calibration.items() if name.endswith(".toml")}
    if not texts:
        raise CalibrationError(
            f"{recording.path}: no calibration is embedded in this recording; give one with --calibration DIR (or 'cdfp')"
        )
    return CalibrationSet.from_texts("embedded", texts)


def _chosen(recording: Recording, calibration: CalibrationSet | str | Path | None) -> CalibrationSet:
    if calibration is None:
        return embedded_calibration(recording)
    return calibration if isinstance(calibration, CalibrationSet) else load_calibration(calibration)


def _provenance(recording: Recording) -> Provenance:
    info = recording.info
    digest = hashlib.sha256()
    for segment in recording.segments:
        digest.update(segment.path.read_bytes())
    aircraft = info.attachments.get(AIRCRAFT_ATTACHMENT)
    return Provenance(
        source=info.source,
        path=str(recording.path),
        sha256=digest.hexdigest(),
        aircraft=info.aircraft,
        software=info.software,
        detail={
            "session": info.session,
            "role": info.role,
            **({} if aircraft is None else {AIRCRAFT_FILE: aircraft.decode("utf-8", "replace")}),
            "events": [
                {"time": e.time_monotonic_ns * 1e-9, "origin": e.origin, "text": e.text} for e in recording.events
            ],
        },
    )
