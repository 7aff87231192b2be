"""One aircraft at the receiver: decodes and records what it sends, and requests what is missing."""

from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any

from daq.contract.link.scan_map import BLOCK
from daq.transport.mavlink_codec import MavlinkFrame
from daq.transport.ports import BytePort
from groundstation.receiver import events as ev
from groundstation.receiver import findings
from groundstation.receiver.backfill import BackfillClient, Mode, Request
from groundstation.receiver.commands import ManoeuvreSender
from groundstation.receiver.decode import AircraftDecoder
from groundstation.receiver.downloads import LogFetcher
from groundstation.receiver.findings import Faults, ReceptionFindings
from groundstation.receiver.frame_input import Sender
from groundstation.receiver.link_quality import RateMeter
from groundstation.receiver.senders import Senders
from groundstation.receiver.storage.sessions import Sessions
from groundstation.receiver.timeline import NS

_SYNC_FAST_NS, _SYNC_FAST_COUNT, _SYNC_NS = NS // 2, 6, 5 * NS
"""Times between time syncs: the first few in fast sequence, to relate the clocks soon, then rarely, to leave the radio free."""
_MAP_NS, _MAPS_AT_ONCE = 2 * NS, 4
"""Time between two turns of requests for maps of sent scans, and requests in one turn."""
_QUIET_NS = 2 * NS  # without a scan: the aircraft then completes no further block, and sends no further map


class TrackedAircraft:
    """sender: first heard of this aircraft, on `port`. sessions: the recorders of its sessions; None records nothing."""

    def __init__(
        self,
        system: int,
        port: BytePort,
        sender: Sender,
        sessions: Sessions | None,
        backfill_mode: Mode,
        faults: Faults,
        reception_findings: ReceptionFindings,
    ) -> None:
        self.system = system
        self.port = port
        self.first_sender = sender
        self.sessions = sessions
        self.decoder = AircraftDecoder(system, reception_findings)
        self.senders = Senders(system, reception_findings)
        self.meter = RateMeter(self.decoder)
        self.backfill: BackfillClient | None = None
        self.logs = LogFetcher(system)
        self.manoeuvre = ManoeuvreSender(system)
        self._backfill_mode = backfill_mode
        self._faults = faults
        self._findings = reception_findings
        self._next_sync_ns = 0
        self._syncs = 0
        self._next_map_ns = 0

    def begin_session(self, session: ev.Session) -> None:
        """Begin to record a session and to fetch what it lacks, where recordings are kept."""
        accounting = next((a for a in self.decoder.sessions if a.session == session), None)
        if self.sessions is not None and accounting is not None:
            self.backfill = BackfillClient(self.sessions.recorder(session), accounting, self._backfill_mode)

    def record(self, event: ev.ScanReceived | ev.EventMarked) -> None:
        """Hand an event to the recorder of its session."""
        if isinstance(event, ev.ScanReceived) and self.backfill is not None:
            self.backfill.note_sensors(event.scan.groups)
        if self.sessions is not None and not self.sessions.keep(event):
            self._findings.doubt(self.system, findings.EVENTS)

    def take_answer(self, frame: MavlinkFrame, now_ns: int) -> list[ev.Event]:
        """Use an answer to a request; returns the events that follow from it."""
        match frame.name:
            case "BACKFILL_DATA" | "BACKFILL_SUMMARY" if self.backfill is not None:
                fields, accounting = frame.fields(), self.decoder.accounting
                if accounting is not None and fields["boot"] == accounting.session.boot:
                    with self._faults.watch("backfill"):
                        return self._take_backfill(self.backfill, accounting.session, frame.name, fields, now_ns)
            case "MANOEUVRE_STATUS":
                return [*self.manoeuvre.take_status(frame.fields(), now_ns)]
            case "LOG_ENTRY" | "LOG_DATA":
                with self._faults.watch("download"):
                    self.logs.take_answer(frame.name, frame.fields(), now_ns)
        return []

    def _take_backfill(
        self, client: BackfillClient, session: ev.Session, name: str, f: Mapping[str, Any], now_ns: int
    ) -> list[ev.Event]:
        if name == "BACKFILL_SUMMARY":
            client.take_summary(f)
            return []
        refused_before = client.refused
        client.take_data(f, now_ns)
        self._findings.doubt(self.system, findings.PAPERS, client.refused - refused_before)
        return [ev.ScanFetched(session, data, now_ns) for data in client.take_fetched()]

    def due(self, now_ns: int) -> Iterator[Request]:
        """Messages to send now: name, and fields without the target."""
        accounting = self.decoder.accounting
        if accounting is None:
            return
        if now_ns >= self._next_sync_ns:
            self._syncs += 1
            self._next_sync_ns = now_ns + (_SYNC_FAST_NS if self._syncs < _SYNC_FAST_COUNT else _SYNC_NS)
            yield "TIMESYNC", {"ts1": self.decoder.sync.ask(now_ns)}
        if now_ns >= self._next_map_ns:
            self._next_map_ns = now_ns + _MAP_NS
            # The aircraft sends the map of each complete block by itself; only overdue maps are requested.
            quiet = now_ns - self.decoder.last_scan_ns > _QUIET_NS
            open_blocks = (b for b in accounting.open_blocks() if b < accounting.last // BLOCK or quiet)
            for block in islice(open_blocks, _MAPS_AT_ONCE):
                yield "SENT_MAP_REQUEST", {"first_number": block * BLOCK, "boot": accounting.session.boot}
        if self.backfill is not None:
            yield from self.backfill.due(now_ns)
        yield from self.logs.due(now_ns)
        yield from self.manoeuvre.due(now_ns)

    def report(self, now_ns: int) -> list[ev.Event]:
        """Quality of the link, which is also recorded, and progress of backfill; empty before the first scan."""
        report = self.meter.report(now_ns)
        if report is None:
            return []
        if self.sessions is not None:
            self.sessions.keep(report)
        progress = None if self.backfill is None else self.backfill.progress(now_ns)
        return [report] if progress is None else [report, progress]

    def look_after(self) -> None:
        """Continue the journals after a failure of the disk, and request again what it lost."""
        if self.sessions is not None:
            self.sessions.look_after()
        if self.backfill is not None:
            self.backfill.look_after()

    def states_on_disk(self) -> list[tuple[int, int]]:
        """By session: numbers of received scans that are on the disk, and that are not."""
        if self.sessions is None:
            return []
        states = (self.sessions.state(accounting) for accounting in self.decoder.sessions)
        return [state for state in states if state is not None]
