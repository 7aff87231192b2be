"""Plays a telemetry log or a recording through the ground station, at any speed."""

import threading
from pathlib import Path
from typing import TYPE_CHECKING

from daq.utilities.errors import UserError
from groundstation.receiver.timeline import NS

if TYPE_CHECKING:
    from groundstation.live.station import Station

STEP_NS = 50_000_000  # of the replay's clock: the period in which a station steps
LONGEST_SILENCE_NS = 600 * NS  # of a telemetry log; a longer one is skipped
LONGEST_WAIT_S = 1.0  # between two scans of a recording
SYSTEM = 1  # MAVLink id of the replayed aircraft: a recording holds none


class ReplayError(UserError):
    """A file that cannot be replayed."""


class ReplayClock:
    """The recording's own time: UTC as logged, monotonic from the first record."""

    def __init__(self) -> None:
        self.now_utc_ns = 0
        self._first_ns: int | None = None

    def move(self, utc_ns: int) -> None:
        """Go to an instant; never back."""
        if self._first_ns is None:
            self._first_ns = utc_ns
        self.now_utc_ns = max(self.now_utc_ns, utc_ns)

    def monotonic_ns(self) -> int:
        """Time since the first record [ns]."""
        return self.now_utc_ns - (self._first_ns or self.now_utc_ns)

    def utc_ns(self) -> int:
        return self.now_utc_ns


class ReplayPort:
    """A byte port that reads what it is fed, and discards what is written."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def feed(self, data: bytes) -> None:
        self._waiting += data

    @property
    def waiting(self) -> int:
        return len(self._waiting)

    def read(self, limit: int = 65536) -> bytes:
        data = bytes(self._waiting[:limit])
        del self._waiting[:limit]
        return data

    def write(self, data: bytes) -> int:
        """Discard the data: a recorded aircraft takes no commands."""
        return len(data)

    def close(self) -> None:
        """Do nothing: there is no port to close."""


def parse_speed(text: str) -> float | None:
    """Recorded seconds per second of replay; None for as fast as possible. Raises ReplayError for anything else."""
    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not speed > 0:
        raise ReplayError(f"--speed {text}: give a positive number, or max")
    return speed


class Replay:
    """Clock and port that a replayed station runs on."""

    def __init__(self) -> None:
        self.clock = ReplayClock()
        self.port = ReplayPort()


def replay_into(station: "Station", source: Replay, path: Path, speed: float | None) -> None:
    """Play a .tlog as bytes through the decoder, or the scans of a raw recording to the monitor.

    Raises ReplayError, TlogError or RecordingError for a file that cannot be played.
    """
    if path.suffix == ".tlog":
        _replay_tlog(station, source, path, speed)
    elif path.suffix == ".mcap" or path.is_dir():
        _replay_recording(station, path, speed)
    else:
        raise ReplayError(f"{path}: cannot be replayed; give a .tlog or a raw recording (.mcap or its folder)")


def _wait(seconds: float, speed: float | None) -> None:
    if speed is not None and seconds > 0:
        threading.Event().wait(seconds / speed)


def _replay_tlog(station: "Station", source: "Replay", path: Path, speed: float | None) -> None:
    from groundstation.receiver.tlog import read_tlog

    clock, port = source.clock, source.port
    due: int | None = None
    for utc_ns, data in read_tlog(path):
        if due is None or not 0 <= utc_ns - due <= LONGEST_SILENCE_NS:
            due = utc_ns  # the clock was set, or a long pause: skip it
        while utc_ns > due:
            step_ns = min(STEP_NS, utc_ns - due)
            _wait(step_ns / NS, speed)
            due += step_ns
            clock.move(due)
            station.step()
        port.feed(data)
    while port.waiting:
        station.step()
    station.step()


def _replay_recording(station: "Station", path: Path, speed: float | None) -> None:
    from daq.contract.recordings.reading import read_recording
    from groundstation.calibration.facts import reported
    from groundstation.calibration.recording import embedded_calibration
    from groundstation.calibration.schema import CalibrationError
    from groundstation.receiver.events import Session

    recording = read_recording(path, salvage=True)
    monitor = station.monitor(SYSTEM)
    try:
        monitor.use_calibration(embedded_calibration(recording), reported(recording.info.details).facts)
    except CalibrationError:
        monitor.use_calibration(station.calibration, reported(recording.info.details).facts)
    session = Session(SYSTEM, 0, 0)
    station.identifications.begin(session, recording.info, monitor)
    last: float | None = None
    for scan in recording.scans():
        if last is not None:
            _wait(min(scan.time - last, LONGEST_WAIT_S), speed)
        last = scan.time
        monitor.scan(scan)
        station.identifications.take_scan(session, scan, monitor)
        station.identifications.step()
    station.replayed = path
    station.replayed_as = session
