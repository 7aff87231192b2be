"""A raw recording to a flight: with the calibration it carries, or with another one in its place."""

import hashlib
from pathlib import Path

from daq.contract.channels import GROUP_NAMES
from daq.contract.link.commands import parse_pitot_zero
from daq.contract.recordings.accounting import verify_recording
from daq.contract.recordings.reading import Recording, read_recordings, sound
from daq.contract.recordings.recording import AIRCRAFT_ATTACHMENT
from daq.contract.scan import SCAN_TOPIC
from daq.utilities.errors import UserError
from daq.utilities.input_files import parse_toml
from daq.utilities.ranges import count
from groundstation.calibration.apply import calibrate
from groundstation.calibration.calibration_set import CalibrationSet, load_calibration
from groundstation.calibration.facts import Reported, reported
from groundstation.calibration.schema import CalibrationError
from groundstation.flight import AIRCRAFT_FILE, Flight, Provenance, read_flight

_MOST_NOTES = 20  # of one kind on a flight, each refused fact or damage with its own
_HEAD_BYTES = 65536  # of a recording: its channels are declared within these


def calibrate_recording(
    path: str | Path,
    calibration: CalibrationSet | str | Path | None = None,
    *,
    align: bool | None = None,
    salvage: bool = False,
) -> Flight:
    """The flight in a raw recording (file, or directory of its segments).

    calibration: a set or directory instead of the embedded one. salvage: use the intact part of a damaged recording. Of several
    sessions in one file the one with most scans is used, and a note says so.
    Raises RecordingError or CalibrationError with one sentence.
    """
    if Path(path).suffix.lower() == ".tlog":
        raise CalibrationError(
            f"{path}: a telemetry log, not a recording; 'sideslip ground CONFIG --replay {path}' makes recording and flight of it"
        )
    recording, notes = open_recording(path, salvage=salvage)
    flight = calibrate_opened(recording, calibration, align=align, salvage=salvage)
    return flight.with_notes(*notes)


def open_recording(path: str | Path, *, salvage: bool = False) -> tuple[Recording, list[str]]:
    """The recording at `path` (of several sessions in one file the one with most scans), and notes on the sessions left out.

    Raises RecordingError when there is none or, unless `salvage`, when it is damaged.
    """
    recordings = read_recordings(path)
    largest = max(recordings, key=lambda r: len(r.numbers))
    left_out = ", ".join(f"{r.info.session} ({len(r.numbers)} scans)" for r in recordings if r is not largest)
    notes = [
        f"{len(recordings)} sessions in one file: {largest.info.session} ({len(largest.numbers)} scans) taken, "
        f"{left_out} left out; 'sideslip recover {path} -o OUT.mcap' writes each to a file of its own"
    ]
    return largest if salvage else sound(largest), notes if left_out else []


def calibrate_opened(
    recording: Recording,
    calibration: CalibrationSet | str | Path | None = None,
    *,
    align: bool | None = None,
    salvage: bool = False,
) -> Flight:
    """The flight in a raw recording that has been opened; see `calibrate_recording`."""
    calibration_set = _calibration_set(recording, calibration)
    details = {**recording.info.details, **_pitot_zero(recording)}
    facts = reported(details) if salvage else Reported(details, {})
    flight = calibrate(
        recording.scans(),
        calibration_set,
        name=recording.path.stem,
        facts=facts.facts,
        align=align,
        provenance=_provenance(recording),
    )
    notes = [f"{reason}: what the calibration set says is used in its place" for reason in facts.refused.values()]
    return flight.with_notes(*notes[:_MOST_NOTES], *_unknown_group_notes(recording), *_damage_notes(recording))


def is_raw(file: Path) -> bool:
    """Whether a path is a raw recording: a folder of segments, or a .mcap that declares scans in its first bytes."""
    if file.is_dir():
        return True
    if file.suffix != ".mcap" or not file.is_file():
        return False
    with file.open("rb") as stream:
        return SCAN_TOPIC.encode() in stream.read(_HEAD_BYTES)


def open_flight(file: Path, calibration: Path | None = None) -> Flight:
    """A flight file as it is, a raw recording (file or directory of segments) calibrated, as `sideslip calibrate` does."""
    return calibrate_recording(file, calibration, salvage=True) if is_raw(file) else read_flight(file)


def _unknown_group_notes(recording: Recording) -> list[str]:
    """A note for each sensor group of the aircraft that no package installed here describes."""
    try:
        sensors = parse_toml(recording.info.config_text, "configuration").get("sensors", {})
    except UserError:
        return []
    unknown = sorted(set(sensors.get("extra", {})) - set(GROUP_NAMES))
    return [
        f"sensor group {group} is described by no package installed here: its channels are in the recording and not in the"
        " flight; install the laboratory's package and calibrate again"
        for group in unknown
    ]


def _damage_notes(recording: Recording) -> list[str]:
    """Notes on what is damaged or missing in the recording."""
    damages = recording.damages
    notes = [
        f"{d.what} at byte {d.at_byte} of {path.name}: what is intact is used" for path, d in damages[:_MOST_NOTES]
    ]
    if len(damages) > _MOST_NOTES:
        notes.append(f"{len(damages) - _MOST_NOTES} more damaged places, see 'sideslip verify': what is intact is used")
    state = verify_recording(recording)
    if state.given_up:
        names = ", ".join(path.name for path in state.given_up)
        missing = f"{count(state.missing)} scans are missing" if state.missing else "no scan is missing"
        notes.append(
            f"{names} given up by the logger after a write error, the recording goes on in the next file; {missing}"
        )
    return notes


def _pitot_zero(recording: Recording) -> dict[str, str]:
    """The last zeroing of the pitot before flight, as a fact: it removes the sensor's turn-on offset."""
    counts = [parse_pitot_zero(e.text) for e in recording.events]
    zero_counts = [c for c in counts if c is not None]
    return {"pitot.zero_count": f"{zero_counts[-1]!r}"} if zero_counts else {}


def embedded_calibration(recording: Recording) -> CalibrationSet:
    """The calibration set a recording carries. Raises CalibrationError when it has none."""
    try:
        texts = {n: data.decode("utf-8") for n, data in recording.info.calibration.items() if n.endswith(".toml")}
    except UnicodeDecodeError as error:
        raise CalibrationError(
            f"{recording.path}: the calibration embedded in it is not text ({error.reason}); give one with --calibration DIR"
        ) from error
    if not texts:
        raise CalibrationError(
            f"{recording.path}: no calibration is embedded in this recording; give one with --calibration DIR (or 'cdfp')"
        )
    try:
        return CalibrationSet.from_texts("embedded", texts)
    except RecursionError as error:
        raise CalibrationError(
            f"{recording.path}: the calibration embedded in it is nested beyond reading; give one with --calibration DIR"
        ) from error


def _calibration_set(recording: Recording, calibration: CalibrationSet | str | Path | None) -> CalibrationSet:
    if calibration is None:
        return embedded_calibration(recording)
    return calibration if isinstance(calibration, CalibrationSet) else load_calibration(calibration)


def recording_sha256(recording: Recording) -> str:
    """SHA-256 of a recording's files, one after the other, in hexadecimal."""
    digest = hashlib.sha256()
    for file in recording.files:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _provenance(recording: Recording) -> Provenance:
    info = recording.info
    aircraft = info.attachments.get(AIRCRAFT_ATTACHMENT)
    return Provenance(
        source=info.source,
        path=str(recording.path),
        sha256=recording_sha256(recording),
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
