"""The recorders of one aircraft's sessions: opened at the first event, and of a bounded number."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from groundstation.receiver import events as ev
from groundstation.receiver.findings import Faults
from groundstation.receiver.link_accounting import SessionAccounting
from groundstation.receiver.storage.recording import SessionRecorder

_MAX_OPEN = 8  # recorders: later sessions close the oldest one
RECORDING = "recording"  # name of its fault


class Sessions:
    """Passes events to the recorders of their sessions. Failures of the disk are noted in `faults`."""

    def __init__(self, folder: Path, faults: Faults) -> None:
        self._folder = folder
        self._faults = faults
        self._open: dict[ev.Session, SessionRecorder] = {}
        self._closed_paths: list[Path] = []
        self._closed_states: dict[ev.Session, tuple[int, int]] = {}

    @property
    def recorders(self) -> Mapping[ev.Session, SessionRecorder]:
        """Recorders that are open."""
        return MappingProxyType(self._open)

    def recorder(self, session: ev.Session) -> SessionRecorder:
        """The recorder of a session; where too many are open, the oldest is written and closed first."""
        if session not in self._open:
            if len(self._open) >= _MAX_OPEN:
                recorder = self._open.pop(next(iter(self._open)))
                self._closed_states[recorder.session] = (recorder.journal.on_disk, 0)
                self._closed_paths += self._write(recorder)
                self._close(recorder)
            self._open[session] = SessionRecorder(self._folder, session)
        return self._open[session]

    def keep(self, event: ev.Event) -> bool:
        """Record an event in its session; False where the recorder refuses it, since there are too many."""
        if isinstance(event, ev.ScanReceived):
            try:
                (self._open.get(event.session) or self.recorder(event.session)).scan(event)
            except OSError as error:  # `look_after` clears the fault when the disk works again
                self._faults.note(RECORDING, error)
            return True
        with self._faults.watch(RECORDING):
            if isinstance(event, ev.EventMarked):
                return self.recorder(event.session).event(event)
            elif isinstance(event, ev.LinkStatistics) and event.session in self._open:
                self._open[event.session].link(event)
        return True

    def look_after(self) -> None:
        """Write waiting records of all open journals; an error becomes a fault."""
        for recorder in self._open.values():
            with self._faults.watch(RECORDING):
                recorder.journal.look_after()

    def state(self, accounting: SessionAccounting) -> tuple[int, int] | None:
        """Number of a session's scans that are on the disk, and of received ones that are not; None without a recorder."""
        recorder = self._open.get(accounting.session)
        if recorder is None:
            return self._closed_states.get(accounting.session)
        return recorder.state(accounting.received)

    def note(self, session: ev.Session, text: str) -> None:
        """Record a text on the reception in a session."""
        with self._faults.watch(RECORDING):
            self.recorder(session).note(text)

    def write(self) -> Iterator[Path]:
        """Write all recordings as they are now; yields their paths and those of closed recorders."""
        yield from self._closed_paths
        for recorder in self._open.values():
            yield from self._write(recorder)

    def _write(self, recorder: SessionRecorder) -> list[Path]:
        """Write a recording; returns its path, or none after a failure or without scans."""
        path = None
        with self._faults.watch(f"{recorder.path}"):
            path = recorder.write()
        return [] if path is None else [path]

    def close(self) -> None:
        for recorder in self._open.values():
            self._close(recorder)

    def _close(self, recorder: SessionRecorder) -> None:
        with self._faults.watch(f"{recorder.journal.path}"):
            recorder.close()
