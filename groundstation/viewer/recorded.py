"""Any file as a rerun recording: flights, raw recordings, recordings of rerun itself."""

import math
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from daq.contract.recordings.messages import LogLevel
from groundstation.calibration.recording import calibrate_opened, is_raw, open_flight, open_recording
from groundstation.flight import Flight, read_flight
from groundstation.flight.beside import beside
from groundstation.flight.marks import EVENTS, marks_of, rows_of
from groundstation.flight.writing import rerun_file
from groundstation.identification.history import history_of
from groundstation.live.readouts import READOUTS
from groundstation.viewer import entities as e
from groundstation.viewer.blueprint import Layout, blueprint, fitted
from groundstation.viewer.derivatives import by_coefficient
from groundstation.viewer.derivatives import entity as curves_of
from groundstation.viewer.entities import LinkSample, drawable
from groundstation.viewer.gate import ViewerError
from groundstation.viewer.scene import Scene

if TYPE_CHECKING:
    from daq.contract.recordings.reading import Recording

StateHistory = Mapping[str, Sequence[tuple[float, str]]]
TimedText = tuple[float, str, str]

_MOST_DAMAGES = 20  # listed on the status page

_LEVELS = {
    LogLevel.UNKNOWN: "INFO",
    LogLevel.DEBUG: "TRACE",
    LogLevel.INFO: "INFO",
    LogLevel.WARNING: "WARN",
    LogLevel.ERROR: "ERROR",
    LogLevel.FATAL: "CRITICAL",
}


def as_rrd(file: Path, target: Path, layout: Layout = "full", calibration: Path | None = None) -> Path:
    """Path of an .rrd with the content of FILE: `target`, which is written, or FILE where it is an .rrd already.

    Raises ViewerError, FlightError, RecordingError or CalibrationError with one sentence.
    """
    if file.suffix == ".rrd":
        if not file.is_file():
            raise ViewerError(f"{file}: no such file")
        with file.open("rb") as stream:
            if stream.read(3) != b"RRF":
                raise ViewerError(f"{file}: not a recording of rerun (its first bytes are not 'RRF')")
        return file
    if is_raw(file):
        return _raw(file, target, layout, calibration)
    flight = read_flight(file)
    write_rrd(flight, target, layout=layout, events=_events(flight))
    return target


def both_as_rrd(
    first: Path, second: Path, target: Path, layout: Layout, by: str, calibration: Path | None = None
) -> tuple[Path, str]:
    """Two files as one view, the second moved in time onto the first: the path, and a sentence on the shift."""
    a, b = (open_flight(f, calibration) for f in (first, second))
    pair = beside(a, b, by)
    events = _events(a) + [(t + pair.shift, f"{b.name}: {text}", level) for t, text, level in _events(b)]
    write_rrd(pair.flight, target, layout=layout, events=sorted(events), status=pair.text, whose=drawable(b.name))
    return target, pair.text


def _raw(file: Path, target: Path, layout: Layout, calibration: Path | None) -> Path:
    recording, notes = open_recording(file, salvage=True)
    flight = calibrate_opened(recording, calibration)
    states: dict[str, list[tuple[float, str]]] = {}
    for scan in recording.scans():
        for group, status in scan.groups.items():
            history = states.setdefault(group, [])
            if not history or history[-1][1] != status.state.words:
                history.append((scan.time, status.state.words))
    log = [(row.time_monotonic_ns * 1e-9, f"{row.name}: {row.message}", _LEVELS[row.level]) for row in recording.log]
    events, status_page = sorted([*_events(flight), *log]), _status(recording, flight, notes)
    write_rrd(flight, target, layout=layout, states=states, events=events, link=_link(file), status=status_page)
    return target


def _link(file: Path) -> list[tuple[float, LinkSample]]:
    """Quality of the radio link, where the recording was received over one."""
    from groundstation.receiver.storage.recording import read_link

    return [
        (r["time_monotonic_s"], LinkSample.reported(r["loss"], r["scan_rate_hz"], r["rssi_dbm"], r["latency_s"]))
        for r in (read_link(file) if file.is_file() else [])
    ]


def _status(recording: "Recording", flight: Flight, notes: list[str]) -> str:
    """The status page as Markdown: identity, counters and damages of the recording."""
    info = recording.info
    source = f"{info.source}, received by radio" if info.role == "received" else info.source
    lines = [
        f"**{info.aircraft or 'aircraft'}**, session {info.session}",
        "",
        f"- {len(recording.numbers)} scans, {flight.time[-1] - flight.time[0]:.1f} s, {source}",
        f"- software {info.software}",
    ]
    lines += [f"- {note}" for note in notes]
    s = recording.last_statistics
    if s is not None:
        lines.append(f"- {s.written} scans written, {s.dropped} dropped, {s.lost} lost, {s.missed} slots missed")
    damages = recording.damages
    lines += [f"- damaged: {p.name} byte {d.at_byte}: {d.what}" for p, d in damages[:_MOST_DAMAGES]] or [
        "- no damage found"
    ]
    lines += [f"- damaged in {len(damages) - _MOST_DAMAGES} more places"] if len(damages) > _MOST_DAMAGES else []
    return "\n".join(lines)


def _events(flight: Flight) -> list[TimedText]:
    """Events, manoeuvres, modes and messages that the flight carries, as time [s], text, level; malformed ones are left out."""
    detail, marks = flight.provenance.detail, marks_of(flight)
    timed = [
        (r["time"], f"event ({r.get('origin', '')}): {r['text']}") for r in rows_of(detail, EVENTS, ("time",), "text")
    ]
    timed += [(r["start"], f"manoeuvre: {r['title']}") for r in rows_of(detail, "manoeuvres", ("start",), "title")]
    timed += [(m.start, f"mode: {m.name}") for m in marks.modes]
    timed += [(m.time, f"message ({m.origin}): {m.text}") for m in marks.messages]
    return sorted((float(time), text, "INFO") for time, text in timed)


def write_rrd(
    flight: Flight,
    path: Path,
    *,
    layout: Layout = "full",
    states: StateHistory | None = None,
    events: Sequence[TimedText] = (),
    link: Sequence[tuple[float, LinkSample]] = (),
    status: str = "",
    whose: str = "model",
) -> None:
    """Write a flight as .rrd with its blueprint. whose: word for the origin of the columns `<name>_model`.

    states: sensor group -> (time [s], state in words). events: (time [s], text, level). link: (time [s], quality).
    status: the status page as Markdown.
    Raises ViewerError when the file cannot be written.
    """
    run = f"{drawable(flight.name)}-{uuid.uuid4().hex[:8]}"
    stream = rr.RecordingStream(e.APPLICATION, recording_id=run)
    histories = states or {}
    filled = filled_entities(flight, histories, events, link, status)
    coefficients = _identified(flight)
    page = blueprint(layout, live=False, identified=bool(coefficients), coefficients=coefficients)
    try:
        with rerun_file(stream, path, fitted(page, live=False, filled=filled, layout=layout)):
            scene = Scene(stream, tuple(flight.columns), whose)
            scene.flight(flight)
            for group, history in histories.items():
                for time, state in history:
                    scene.states(time, {group: state})
            for time, text, level in events:
                scene.event(time, text, level)
            for time, sample in link:
                scene.link(time, sample)
            if status:
                scene.status(float(flight.time[0]), status)
    except OSError as error:
        raise ViewerError(f"{path}: cannot be written ({error.strerror or error})") from error


def filled_entities(
    flight: Flight,
    states: StateHistory,
    events: Sequence[TimedText],
    link: Sequence[tuple[float, LinkSample]],
    status: str,
) -> set[str]:
    """Entities of the layout for which this flight has data; panes without any are not drawn."""
    columns = [c for c in flight.columns if flight.measured(c)]
    filled = {group.entity for group in (*e.series_groups(columns), *e.model_groups(columns))}
    fixed = [np.isfinite(flight[c]) for c in ("latitude", "longitude") if c in flight]
    tracked = len(fixed) == 2 and bool(np.any(fixed[0] & fixed[1]))
    has_content_of = {
        e.CHASED: {"phi", "theta", "psi"} <= set(columns),
        e.TRACK: tracked,
        e.MAP_TRACK: tracked,
        e.READOUTS: any(r.column in columns for r in READOUTS),
        e.EVENTS: bool(events or flight.notes),
        e.HEALTH: any(states.values()),
        e.STATUS: bool(status),
    }
    filled |= {entity for entity, has_content in has_content_of.items() if has_content}
    for _, sample in link:
        filled |= {entity for entity, value in sample.by_entity().items() if math.isfinite(value)}
    return filled | {curves_of(c) for c in _identified(flight)}


def _identified(flight: Flight) -> tuple[str, ...]:
    """Coefficients of the derivatives whose history a flight carries."""
    history = history_of(flight.provenance.detail)
    return () if history is None else tuple(by_coefficient(n for n in history[1] if not n.endswith("_0")))
