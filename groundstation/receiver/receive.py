"""The receiver: from the bytes of all ports to events.

`poll` never waits; call it often (a serial port's buffer holds under a second). Each port and sender has its own decoder, each
aircraft its own accounting. Every byte goes to the telemetry log, every scan to the session's recorder. All methods may be called
from any thread.
"""

import threading
from collections.abc import Mapping
from contextlib import ExitStack, closing
from itertools import chain
from pathlib import Path
from typing import Any

from daq.contract.link.wire import SCAN_IDS
from daq.contract.manoeuvre import Manoeuvre, ManoeuvreError
from daq.transport.mavlink_codec import FIRST_OWN_ID, RADIO_STATUS_ID, FrameEncoder, MavlinkFrame, message_types
from daq.transport.ports import BytePort
from groundstation.receiver import events as ev
from groundstation.receiver import findings
from groundstation.receiver.aircraft import TrackedAircraft
from groundstation.receiver.backfill import Mode
from groundstation.receiver.commands import Commander
from groundstation.receiver.downloads import LogFetcher
from groundstation.receiver.events import ReceptionFindingKind
from groundstation.receiver.findings import Faults, ReceptionFindings
from groundstation.receiver.frame_input import FrameInput, Sender
from groundstation.receiver.link_quality import counters
from groundstation.receiver.ports import LinkConfig, open_port
from groundstation.receiver.senders import SIGNING_STATE, SignatureGate, make_signer
from groundstation.receiver.storage.lasting_log import Disk
from groundstation.receiver.storage.recording import SessionRecorder
from groundstation.receiver.storage.sessions import RECORDING, Sessions
from groundstation.receiver.timeline import NS, GroundClock

_HEARTBEAT_NS = NS
_REPORT_NS = NS
MAX_AIRCRAFT, MAX_OF_ONE_SENDER = 16, 8
"""Aircraft served at once, where `systems` does not list them: each takes files, a view and memory."""
_DISK = "disk"  # name of its fault
_RECORDED = (ev.ScanReceived, ev.EventMarked)
_FIXED_WING, _GCS, _NO_AUTOPILOT = 1, 6, 8  # MAV_TYPE and MAV_AUTOPILOT of heartbeats


class Receiver:
    """Receives from any number of aircraft over any number of ports.

    folder: for telemetry.tlog and the sessions' files; None records nothing, and fetches nothing. faults, findings: present
    faults, and counts of unused data; heard_ns: time of the last frame of an aircraft.
    """

    def __init__(
        self, config: LinkConfig, ports: Mapping[str, BytePort], clock: GroundClock, *, folder: Path | None = None
    ) -> None:
        self.config = config
        self.clock = clock
        self.commander = Commander()
        self._ports = dict(ports)
        self._folder = folder
        self._lock = threading.RLock()
        self.faults = Faults()
        self.findings = ReceptionFindings()
        self._gate = SignatureGate(make_signer(config, clock), self.faults, self.findings)
        if self._gate.signer is not None and self._gate.signer.notice:
            self.faults.note(SIGNING_STATE, OSError(self._gate.signer.notice))
        self._known_messages = frozenset(message_types())
        self._encoder = FrameEncoder(config.system_id, config.component_id, self._gate.signer)
        self._frame_input = FrameInput(self._ports, folder, self.faults)
        self._disk = Disk()
        self._aircraft: dict[int, TrackedAircraft] = {}
        self._next_heartbeat_ns = 0
        self._next_report_ns = 0
        self._written: list[Path] = []
        self._closed = False
        self.heard_ns = 0

    @classmethod
    def open(cls, config: LinkConfig, clock: GroundClock, *, folder: Path | None = None) -> "Receiver":
        """A receiver on the ports of its configuration. Raises PortError for a port that cannot be opened, SigningError for a key
        that cannot be used."""
        with ExitStack() as opened:
            ports = {text: opened.enter_context(closing(open_port(text, clock))) for text in config.ports}
            receiver = cls(config, ports, clock, folder=folder)
            opened.pop_all()
        return receiver

    # ------------------------------------------------------------------------------------------ receiving

    def poll(self) -> list[ev.Event]:
        """Use all that has arrived and send what is due; returns the events."""
        with self._lock:
            if self._closed:
                return []
            events: list[ev.Event] = []
            now_ns, utc = self.clock.monotonic_ns(), self.clock.utc_ns()
            for sender, frame in self._frame_input.frames(now_ns, utc):
                try:
                    self._take_frame(frame, sender, now_ns, utc, events)
                except Exception as error:  # noqa: BLE001  no frame may end the reception
                    self.findings.quarantine_error(frame.system, f"a frame of {frame.name}", error)
            events += self.findings.reports(now_ns, ReceptionFindingKind.REFUSED)
            events += self._second_sender_reports(now_ns)
            self._record(events)
            with self.findings.guard(findings.NOBODY, "due messages and reports"):
                self._send_due(now_ns, events)
            events += self.findings.reports(now_ns, ReceptionFindingKind.DOUBTED, ReceptionFindingKind.QUARANTINED)
            return events + self.faults.changes(now_ns)

    @property
    def port_faults(self) -> dict[str, str]:
        """Ports, and files of the ground station, that fail at present, with the system's message."""
        with self._lock:
            return dict(self.faults.present)

    def _take_frame(self, frame: MavlinkFrame, sender: Sender, now_ns: int, utc: int, events: list[ev.Event]) -> None:
        """Use a frame of an accepted sender; adds its events to `events`."""
        if frame.msg_id not in self._known_messages or frame.system in (0, self.config.system_id):
            return
        if self._gate.signer is not None and not self._gate.allows(frame):
            return
        port = self._ports[sender.port]
        if frame.msg_id == RADIO_STATUS_ID:
            fields = frame.fields()
            for aircraft in self._aircraft.values():
                if aircraft.port is port:
                    aircraft.meter.radio = fields
            return
        source = self._aircraft.get(frame.system) or self._new_aircraft(frame, sender)
        if source is None or not self._accepts(source, frame, sender, now_ns):
            return
        source.port, self.heard_ns = port, now_ns
        events += source.decoder.decode_frame(frame, now_ns, utc)
        if frame.msg_id in SCAN_IDS:
            return
        if frame.name == "COMMAND_ACK":
            f: Mapping[str, Any] = frame.fields()
            if f["target_system"] in (0, self.config.system_id):
                events += self.commander.acknowledge(frame.system, f["command"], f["result"], now_ns)
        else:
            events += source.take_answer(frame, now_ns)

    def _new_aircraft(self, frame: MavlinkFrame, sender: Sender) -> TrackedAircraft | None:
        """The aircraft of a first frame; None where the sender is no aircraft, or one too many."""
        if self.config.systems and frame.system not in self.config.systems:
            return None
        if not _is_aircraft(frame):
            return None
        of_sender = sum(a.first_sender == sender for a in self._aircraft.values())
        room = len(self._aircraft) < MAX_AIRCRAFT and of_sender < MAX_OF_ONE_SENDER
        if not self.config.systems and not room:
            self.findings.doubt(findings.NOBODY, findings.AIRCRAFT)
            return None
        sessions = None if self._folder is None else Sessions(self._folder, self.faults)
        port, backfill = self._ports[sender.port], self.config.backfill
        aircraft = TrackedAircraft(frame.system, port, sender, sessions, backfill, self.faults, self.findings)
        self._aircraft[frame.system] = aircraft
        return aircraft

    def _accepts(self, aircraft: TrackedAircraft, frame: MavlinkFrame, sender: Sender, now_ns: int) -> bool:
        """Whether a frame's sender is accepted for the aircraft: with a key always, since the signature is valid."""
        is_own_message, unsigned = frame.msg_id >= FIRST_OWN_ID, self._gate.signer is None
        if unsigned and aircraft.senders.confirmed(sender, frame.component, is_own_message, now_ns):
            return True
        previous = aircraft.senders.speaker(sender.port) if is_own_message else None
        if unsigned:
            if not aircraft.senders.allows(sender, frame.component, is_own_message, now_ns):
                return False
        elif is_own_message:
            aircraft.senders.accept_signed(sender, now_ns)
        if is_own_message and previous != sender:
            if previous is not None:
                self._frame_input.forget(previous)
            self._frame_input.favour(sender)
        return True

    def _second_sender_reports(self, now_ns: int) -> list[ev.ReceptionFinding]:
        """Due reports of second senders; the first one of each also goes to the recording."""
        reports = self.findings.reports(now_ns, ReceptionFindingKind.CONTESTED)
        for report in reports:
            aircraft = self._aircraft[report.system]
            accounting = aircraft.decoder.accounting
            if report.first and aircraft.sessions is not None and accounting is not None:
                aircraft.sessions.note(accounting.session, report.text)
        return reports

    def _record(self, events: list[ev.Event]) -> None:
        """Hand events to the recorders of their sessions."""
        for event in events:
            if isinstance(event, ev.Restarted):
                system = event.session.system
                with self.findings.guard(system, "its new session"), self.faults.watch(RECORDING):
                    self._aircraft[system].begin_session(event.session)
            elif isinstance(event, _RECORDED):
                try:
                    self._aircraft[event.session.system].record(event)
                except Exception as error:  # noqa: BLE001  an event that cannot be recorded must not stop the next ones
                    subject = f"a {type(event).__name__} in the recording"
                    self.findings.quarantine_error(event.session.system, subject, error)

    # ------------------------------------------------------------------------------------------ sending

    def _send_due(self, now_ns: int, events: list[ev.Event]) -> None:
        """Send all due messages, and report once a second; adds events to `events`."""
        if now_ns >= self._next_report_ns:
            self._next_report_ns = now_ns + _REPORT_NS
            self._report(now_ns, events)
        self._gate.keep_state(now_ns)
        if not self.config.transmit:
            return
        if now_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns = now_ns + _HEARTBEAT_NS
            beat = self._encoder.message("HEARTBEAT", type=_GCS, autopilot=_NO_AUTOPILOT, mavlink_version=3)
            for port in self._ports.values():
                self._write(port, beat)
        send, given_up = self.commander.due(now_ns)
        events += given_up
        for system, fields in send:
            target = self._aircraft.get(system)
            if target is not None:
                self._send(target, "COMMAND_LONG", fields)
        for aircraft in self._aircraft.values():
            events += aircraft.manoeuvre.given_up(now_ns)
            for name, fields in aircraft.due(now_ns):
                self._send(aircraft, name, fields)

    def _send(self, aircraft: TrackedAircraft, name: str, fields: Mapping[str, Any]) -> None:
        targets = {} if name == "TIMESYNC" else {"target_system": aircraft.system}
        self._write(aircraft.port, self._encoder.message(name, **{**targets, **fields}))

    def _write(self, port: BytePort, frame: bytes) -> None:
        """Send a frame. One that a busy port does not take is lost, like one lost on the link, and its request is repeated."""
        name = next((n for n, p in self._ports.items() if p is port), "?")
        if name in self.faults.present:
            return  # its fault is reported already
        with self.faults.watch(f"{name} (sending)"):
            size = port.write(frame)
            while 0 < size < len(frame):  # never leave half a frame in the stream
                piece = port.write(frame[size:])
                if not piece:
                    break
                size += piece

    def _report(self, now_ns: int, events: list[ev.Event]) -> None:
        """Add reports of links and backfill to `events`; write and sync files, and count refused bytes."""
        for aircraft in self._aircraft.values():
            events += aircraft.report(now_ns)
        self._frame_input.flush()
        for aircraft in self._aircraft.values():
            aircraft.look_after()
        for kind, count in (
            (findings.BYTES, self._frame_input.refused_bytes),
            (findings.DATAGRAMS, self._frame_input.datagrams_dropped),
        ):
            self.findings.doubt(findings.NOBODY, kind, count - self.findings.doubt_count(kind))
        with self.faults.watch(_DISK):
            journals = (r.journal.file for sessions in self._session_stores() for r in sessions.recorders.values())
            self._disk.sync([*self._frame_input.logs, *journals])

    # ------------------------------------------------------------------------------------------ for the station

    def set_backfill(self, mode: Mode, system: int | None = None) -> None:
        """Set the mode of backfill for one aircraft, or all."""
        with self._lock:
            for number, aircraft in self._aircraft.items():
                if aircraft.backfill is not None and system in (None, number):
                    aircraft.backfill.mode = mode

    def backfill_agreed(self, system: int) -> bool:
        """Whether air and ground agree by count and hash on all scans of the present session."""
        with self._lock:
            aircraft = self._aircraft.get(system)
            return aircraft is not None and aircraft.backfill is not None and aircraft.backfill.agreed

    @property
    def systems(self) -> list[int]:
        """Aircraft heard so far."""
        with self._lock:
            return sorted(self._aircraft)

    def logs(self, system: int) -> LogFetcher:
        """Log listing and download of one aircraft. Raises KeyError for one that has not been heard."""
        with self._lock:
            return self._aircraft[system].logs

    def send_manoeuvre(self, system: int, manoeuvre: Manoeuvre) -> None:
        """Send a manoeuvre to an aircraft's sequencer; the result is an event ManoeuvreSent.

        Raises ManoeuvreError where it is too long for the link, or without a key, since an aircraft obeys signed commands only.
        """
        with self._lock:
            if self._gate.signer is None:
                raise ManoeuvreError(
                    "a manoeuvre goes up a signed link only; set the key file of both ends (docs/link.md)"
                )
            self._aircraft[system].manoeuvre.send(manoeuvre)

    def accounting(self) -> list[ev.Accounting]:
        """The accounting of all sessions of all aircraft."""
        with self._lock:
            return [session.totals() for a in self._aircraft.values() for session in a.decoder.sessions]

    def session_recorders(self) -> dict[ev.Session, SessionRecorder]:
        """The open recorders of all aircraft."""
        with self._lock:
            return {s: r for sessions in self._session_stores() for s, r in sessions.recorders.items()}

    def _session_stores(self) -> list[Sessions]:
        return [a.sessions for a in self._aircraft.values() if a.sessions is not None]

    def write_recordings(self) -> list[Path]:
        """Write the recordings of all sessions as they are now; returns their paths.

        One that cannot be written is in `port_faults`; its scans stay in the journal.
        """
        with self._lock:
            self._written = list(chain.from_iterable(sessions.write() for sessions in self._session_stores()))
            return list(self._written)

    def summary(self) -> dict[str, Any]:
        """The counters of `ground --json`."""
        with self._lock:
            trackers = [t for a in self._aircraft.values() for t in a.decoder.trackers.values()]
            counts = counters(
                self.accounting(), self._frame_input.totals(), trackers, self._gate.rejected, self._written
            )
            return counts | self._unused_counts() | self._disk_counts()

    def _disk_counts(self) -> dict[str, Any]:
        """Numbers of received scans on the disk and not on it, for `ground --json`."""
        counts = [state for a in self._aircraft.values() for state in a.states_on_disk()]
        return {
            "scans_on_disk": sum(on_disk for on_disk, _ in counts),
            "scans_not_on_disk": sum(missing for _, missing in counts),
            "telemetry_bytes_refused": sum(log.refused for log in self._frame_input.logs),
        }

    def _unused_counts(self) -> dict[str, Any]:
        """Counts of received data that were not used, for `ground --json`."""
        pending_parts = sum(a.decoder.pending_parts for a in self._aircraft.values())
        return {
            "bytes_refused": self._frame_input.refused_bytes,
            "datagrams_dropped": self._frame_input.datagrams_dropped,
            "frames_contested": sum(a.senders.contested for a in self._aircraft.values()),
            "second_senders": [row for system in self._aircraft for row in self.findings.second_senders(system)],
            "scans_doubted": self.findings.doubt_count(findings.NUMBERS) + pending_parts,
            "doubted": self.findings.doubts(),
            "quarantined": self.findings.quarantines(),
        }

    def close(self) -> None:
        """Write the recordings and close all files and ports. Failures are in `port_faults`."""
        with self._lock:
            if self._closed:
                return
            self._frame_input.close(self.clock.utc_ns())
            self.write_recordings()
            self._closed = True
            self._gate.close()
            for sessions in self._session_stores():
                sessions.close()
            self._disk.close()
            for aircraft in self._aircraft.values():
                aircraft.logs.close()
            for port in self._ports.values():
                port.close()


def _is_aircraft(frame: MavlinkFrame) -> bool:
    """Whether a frame is of a logger or an autopilot."""
    if frame.msg_id >= FIRST_OWN_ID:
        return True
    if frame.name != "HEARTBEAT":
        return False
    # The logger's heartbeat has no autopilot, as those of ground stations, cameras and radios: its type shows the aircraft.
    heartbeat = frame.fields()
    return heartbeat["autopilot"] != _NO_AUTOPILOT or heartbeat["type"] == _FIXED_WING
