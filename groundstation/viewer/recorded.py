"""Any file a person may have, as a rerun recording: flights, raw recordings, recordings of rerun itself."""

from pathlib import Path

from groundstation.flight import Flight, read_flight
from groundstation.viewer.blueprint import Layout
from groundstation.viewer.live import ViewerError
from groundstation.viewer.replay import write_rrd


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
    if file.is_dir() or (file.suffix == ".mcap" and _is_raw(file)):
        return _raw(file, target, layout, calibration)
    flight = read_flight(file)
    write_rrd(flight, target, layout=layout, events=_events(flight))
    return target


def _is_raw(file: Path) -> bool:
    from daq.contract.scan import SCAN_TOPIC

    return file.is_file() and SCAN_TOPIC.encode() in file.read_bytes()[:65536]


def _raw(file: Path, target: Path, layout: Layout, calibration: Path | None) -> Path:
    from daq.contract.reading import read_recording
    from groundstation.calibration.recording import calibrate_recording

    flight = calibrate_recording(file, calibration, salvage=True)
    states: dict[str, list[tuple[float, str]]] = {}
    for scan in read_recording(file, salvage=True).scans():
        for group, status in scan.groups.items():
            history = states.setdefault(group, [])
            if not history or history[-1][1] != status.state.words:
                history.append((scan.time, status.state.words))
    write_rrd(flight, target, layout=layout, states=states, events=_events(flight))
    return target


def _events(flight: Flight) -> list[tuple[float, str, str]]:
    """Event marks and manoeuvres that the flight carries."""
    found = [
        (float(e["time"]), f"event ({e['origin']}): {e['text']}", "INFO")
        for e in flight.provenance.detail.get("events", [])
    ]
    for m in flight.provenance.detail.get("manoeuvres", []):
        found.append((float(m["start"]), f"manoeuvre: {m['title']}", "INFO"))
    return sorted(found)
