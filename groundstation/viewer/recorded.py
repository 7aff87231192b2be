"""Any file a person may have, as a rerun recording: flights, raw recordings, recordings of rerun itself."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daq.contract.recordings.messages import LogLevel
from groundstation.flight import Flight, read_flight
from groundstation.flight.marks import marks_of
from groundstation.viewer.beside import beside
from groundstation.viewer.blueprint import Layout
from groundstation.viewer.glyphs import drawable
from groundstation.viewer.live import ViewerError
from groundstation.viewer.replay import write_rrd
from groundstation.viewer.scene import LinkSample

if TYPE_CHECKING:
    from daq.contract.recordings.reading import Recording

_TOLD = 20  # damages on the status page
_LATEST_S = 2**63 * 1e-9  # what rerun's nanoseconds can hold

_LEVELS = {
    LogLevel.UNKNOWN: "INFO",
    LogLevel.DEBUG: "TRACE",
    LogLevel.INFO: "INFO",
    LogLevel.WARNING: "WARN",
    LogLevel.ERROR: "ERROR",
    LogLevel.FATAL: "CRITICAL",
}


def as_rrd(file: Path, target: Path, layout: Layout = "full", calibration: Path | None = None) -> Path:
    """Path of an .rrd with what FILE holds; `target` is written unless FILE is one already.

    Raises ViewerError, FlightError, RecordingError or CalibrationError with one sentence.
    """
    if file.suffix == ".rrd":
        if not file.is_file():
            raise ViewerError(f"{file}: no such file")
        with file.open("rb") as opened:
            if opened.read(3) != b"RRF":
                raise ViewerError(f"{file}: not a recording of rerun (its first bytes are not 'RRF')")
        return file
    if file.is_dir() or (file.suffix == ".mcap" and is_raw(file)):
        return _raw(file, target, layout, calibration)
    flight = read_flight(file)
    write_rrd(flight, target, layout=layout, events=_events(flight))
    return target


def both_as_rrd(
    first: Path, second: Path, target: Path, layout: Layout, by: str, calibration: Path | None = None
) -> tuple[Path, str]:
    """Two files as one view, the second laid on the first in time; the path, and how the second was moved."""
    a, b = (_flight(f, calibration) for f in (first, second))
    found = beside(a, b, by)
    marks = [(t + found.shift, f"{b.name}: {text}", level) for t, text, level in _events(b)]
    write_rrd(
        found.flight,
        target,
        layout=layout,
        events=sorted([*_events(a), *marks]),
        status=found.text,
        whose=drawable(b.name),
    )
    return target, found.text


def _flight(file: Path, calibration: Path | None) -> Flight:
    """A flight, or a raw recording calibrated."""
    if file.is_dir() or (file.suffix == ".mcap" and is_raw(file)):
        from groundstation.calibration.recording import calibrate_recording

        return calibrate_recording(file, calibration, salvage=True)
    return read_flight(file)


def is_raw(file: Path) -> bool:
    """Whether a .mcap file holds scans as counts, told by its first bytes; a flight does not."""
    from daq.contract.scan import SCAN_TOPIC

    if not file.is_file():
        return False
    with file.open("rb") as opened:
        return SCAN_TOPIC.encode() in opened.read(65536)


def _raw(file: Path, target: Path, layout: Layout, calibration: Path | None) -> Path:
    from groundstation.calibration.recording import calibrate_opened, open_recording

    recording, notes = open_recording(file, salvage=True)
    flight = calibrate_opened(recording, calibration)
    states: dict[str, list[tuple[float, str]]] = {}
    for scan in recording.scans():
        for group, status in scan.groups.items():
            history = states.setdefault(group, [])
            if not history or history[-1][1] != status.state.words:
                history.append((scan.time, status.state.words))
    said = [
        (line.time_monotonic_ns * 1e-9, f"{line.name}: {line.message}", _LEVELS[line.level]) for line in recording.log
    ]
    write_rrd(
        flight,
        target,
        layout=layout,
        states=states,
        events=sorted([*_events(flight), *said]),
        link=_link(file),
        status=_status(recording, flight, notes),
    )
    return target


def _link(file: Path) -> list[tuple[float, LinkSample]]:
    """Quality of the radio link, where the recording was received over one."""
    from groundstation.receiver.kept.recording import read_link

    def known(value: float | None) -> float:
        return math.nan if value is None else value

    return [
        (
            r["time_monotonic_s"],
            LinkSample(100 * r["loss"], r["scan_rate_hz"], known(r["rssi_dbm"]), known(r["latency_s"])),
        )
        for r in (read_link(file) if file.is_file() else [])
    ]


def _status(recording: "Recording", flight: Flight, notes: list[str]) -> str:
    """The status page: what this recording is, and how it went."""
    info = recording.info
    how = f"{info.source}, received by radio" if info.role == "received" else info.source
    lines = [
        f"**{info.aircraft or 'aircraft'}**, session {info.session}",
        "",
        f"- {len(recording.numbers)} scans, {flight.time[-1] - flight.time[0]:.1f} s, {how}",
        f"- software {info.software}",
    ]
    lines += [f"- {note}" for note in notes]
    s = recording.last_statistics
    if s is not None:
        lines.append(f"- {s.written} scans written, {s.dropped} dropped, {s.lost} lost, {s.missed} slots missed")
    damages = recording.damages
    lines += [f"- damaged: {p.name} byte {d.at_byte}: {d.what}" for p, d in damages[:_TOLD]] or ["- no damage found"]
    lines += [f"- damaged in {len(damages) - _TOLD} more places"] if len(damages) > _TOLD else []
    return "\n".join(lines)


def _events(flight: Flight) -> list[tuple[float, str, str]]:
    """Event marks and manoeuvres that the flight carries; what is none (a flight may come from anybody) is left out."""
    found = []
    for e in _listed(flight, "events", ("time", "origin", "text")):
        found.append((float(e["time"]), f"event ({e['origin']}): {e['text']}", "INFO"))
    for m in _listed(flight, "manoeuvres", ("start", "title")):
        found.append((float(m["start"]), f"manoeuvre: {m['title']}", "INFO"))
    marks = marks_of(flight)
    found += [(m.start, f"mode: {m.name}", "INFO") for m in marks.modes if abs(m.start) <= _LATEST_S]
    found += [(m.time, f"message ({m.origin}): {m.text}", "INFO") for m in marks.messages if abs(m.time) <= _LATEST_S]
    return sorted(found)


def _listed(flight: Flight, key: str, fields: tuple[str, ...]) -> list[dict[str, Any]]:
    """The objects of a list in the flight's provenance that have all `fields`, the first of them a finite number."""
    rows = flight.provenance.detail.get(key, [])
    return [
        row
        for row in (rows if isinstance(rows, list) else [])
        if isinstance(row, dict) and row.keys() >= set(fields)
        if isinstance(row[fields[0]], int | float) and abs(row[fields[0]]) <= _LATEST_S
    ]
