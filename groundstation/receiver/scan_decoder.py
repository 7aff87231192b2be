"""From the scan frames of one aircraft to scans and sessions, with exact accounting of missing scans.

No input or output happens here, and no content of a frame raises an exception.
"""

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from daq.contract.link.scan_map import BLOCK
from daq.contract.link.wire import SCAN_FAST_ID, ScanPart, join_parts, layouts, unpack_scan
from daq.transport.mavlink_codec import MavlinkFrame, padded
from groundstation.receiver import events as ev
from groundstation.receiver import findings
from groundstation.receiver.continuity import LATE_NS, PendingScan, ScanRun, UnconfirmedRuns
from groundstation.receiver.link_accounting import SequenceTracker, SessionAccounting
from groundstation.receiver.timeline import NS, Allowance, ClockSync

_new_tuple: Callable[..., Any] = tuple.__new__  # makes a named tuple in half the time of its constructor
_PARTIAL_SCANS = 64  # scans whose parts are stored until they are complete
_MAX_SESSIONS = 64  # that are remembered
_RECENT_SESSIONS = 3  # before the present one, from which a late scan may come
_RESTARTS_AT_ONCE, _RESTARTS_PER_S = 8, 1 / 60
"""Restarts of a logger that are accepted: eight at once and then one a minute, since each session is a file."""
_WARNING = 4  # as in syslog
_FOREIGN_CHANNELS = (
    "ground: the aircraft sends laboratory channels that no package installed here describes, or another version of it"
    " does; install the aircraft's package. All other channels are received"
)


class ScanDecoder:
    """The scans and sessions of one aircraft (system id). trackers: by component; latency_s: of the last scan."""

    def __init__(self, system: int, reception_findings: findings.ReceptionFindings | None = None) -> None:
        self.system = system
        self._findings = reception_findings or findings.ReceptionFindings()
        self.trackers: dict[int, SequenceTracker] = {}
        self.sync = ClockSync()
        self.sessions: list[SessionAccounting] = []
        self.latency_s: float | None = None
        self.scans_since_report = 0
        self.last_scan_ns = 0
        self._unconfirmed = UnconfirmedRuns()
        # boot -> time of the first report of it [ns], and number of its reports
        self._claims: OrderedDict[int, tuple[int, int]] = OrderedDict()
        self._restart_allowance = Allowance(_RESTARTS_AT_ONCE, _RESTARTS_PER_S)
        self._parts: dict[int, list[ScanPart]] = {}  # by scan number
        self._layouts = layouts()
        self._events: list[ev.Event] = []
        self._foreign_channels_reported = False
        self._scan_component = -1  # the component of the latest accepted scan

    @property
    def tracker(self) -> SequenceTracker:
        """The tracker that represents the link: of the component that sends the scans; before the first scan, of the one that
        sends most."""
        if self._scan_component in self.trackers:
            return self.trackers[self._scan_component]
        if not self.trackers:
            return SequenceTracker()
        return max(self.trackers.values(), key=lambda t: t.received)

    @property
    def accounting(self) -> SessionAccounting | None:
        """The present session; None before the first."""
        return self.sessions[-1] if self.sessions else None

    @property
    def pending_parts(self) -> int:
        """Scan parts that do not continue a known run, and are held back until more of theirs come."""
        return self._unconfirmed.count

    def _take_scan(self, frame: MavlinkFrame, now_ns: int, utc_ns: int) -> None:
        """Use a scan frame: accept its part, hold it back, or drop a late copy."""
        part = self._part(frame, now_ns)
        if part is None:
            return
        late_session = None if len(self.sessions) < 2 else self._session_of_late_part(part)
        if late_session is not None:
            late_session.see(part.number)  # counted, but not reported as a scan
            if part.msg_id == SCAN_FAST_ID:
                late_session.received.add(part.number)
            return
        accounting = self.accounting
        if accounting is None or accounting.run is None:
            self._begin(PendingScan(part, frame.component, now_ns, utc_ns), accounting)
            return
        if accounting.run.follows(part, now_ns):
            self._accept(accounting, part, frame.component, now_ns, utc_ns)
            if self._unconfirmed.candidates:
                self._findings.doubt(self.system, findings.NUMBERS, self._unconfirmed.clear())
            return
        late_copy = accounting.run.is_older(part) and part.number in accounting.received
        if not late_copy:
            self._hold(accounting, PendingScan(part, frame.component, now_ns, utc_ns))

    def _session_of_late_part(self, part: ScanPart) -> SessionAccounting | None:
        """The earlier session to which a delayed part of another boot belongs; None where there is none."""
        if self.accounting is None or part.boot == self.accounting.session.boot:
            return None
        for earlier in self.sessions[-1 - _RECENT_SESSIONS : -1]:
            close = abs(part.time_monotonic_ns - earlier.last_time_ns) < LATE_NS
            if earlier.session.boot == part.boot and close and part.number <= earlier.last + BLOCK:
                return earlier
        return None

    def _begin(self, pending: PendingScan, accounting: SessionAccounting | None) -> None:
        """Begin the run of a session with its first scan: of a new session, or of one known by a report."""
        if accounting is None or accounting.session.boot != pending.part.boot:
            if accounting is not None and not self._restart_allowance.spend(1, pending.now_ns):
                self._findings.doubt(self.system, findings.RESTARTS)
                return
            accounting = self._new_session(pending.part.boot, pending.now_ns)
        accounting.run = ScanRun(pending.part, pending.now_ns)
        self._accept(accounting, *pending)

    def _hold(self, accounting: SessionAccounting, pending: PendingScan) -> None:
        """Hold back a scan that does not continue the known run, until more of its own run come and none of the known one."""
        confirmed, rejected_parts = self._unconfirmed.hold(pending, self.trackers[pending.component].lost)
        self._findings.doubt(self.system, findings.NUMBERS, rejected_parts)
        if confirmed is None:
            return
        first = confirmed.parts[0].part
        run = accounting.run
        if run is not None and first.boot == run.boot and first.number > run.number and run.in_step(first):
            run.advance(first, confirmed.parts[0].now_ns)  # this computer was suspended, or the link was interrupted
        elif self._restart_allowance.spend(1, pending.now_ns):
            accounting = self._new_session(first.boot, pending.now_ns)
            accounting.run = ScanRun(first, confirmed.parts[0].now_ns)
            self._restart_trackers(pending.component, confirmed.lost)
        else:
            self._findings.doubt(self.system, findings.RESTARTS)
            return
        for part in confirmed.parts:
            self._accept(accounting, *part)

    def _restart_trackers(self, component: int, lost_at_jump: int) -> None:
        """Restart the trackers of all components with the logger. Those of other components than the scans' may continue with any
        sequence number, because an autopilot does not restart with the logger."""
        for number, tracker in self.trackers.items():
            tracker.restart(lost_at_jump if number == component else tracker.lost)
            if number != component:
                tracker.expect_any()

    def _accept(self, accounting: SessionAccounting, part: ScanPart, component: int, now_ns: int, utc_ns: int) -> None:
        """Count a part of the present run, and report its scan with the fast part, or again with a later slow one."""
        assert accounting.run is not None
        accounting.run.advance(part, now_ns)
        if self._claims:
            self._claims.clear()
        self._scan_component = component
        for tracker in self.trackers.values():
            tracker.settled = tracker.lost
        accounting.see(part.number)
        parts = self._parts.get(part.number)
        if parts is None:
            parts = self._parts[part.number] = []
        elif any(p.msg_id == part.msg_id for p in parts):
            return
        is_late = part.time_monotonic_ns < accounting.last_time_ns
        parts.append(part)
        while len(self._parts) > _PARTIAL_SCANS:
            self._parts.pop(next(iter(self._parts)))
        if part.msg_id == SCAN_FAST_ID:
            if not accounting.received.add(part.number):
                return
            self.scans_since_report += 1
            self.last_scan_ns = now_ns
        elif all(p.msg_id != SCAN_FAST_ID for p in parts):
            return  # the slow part comes first; the scan is reported with its fast part
        else:
            is_late = True
        if part.time_monotonic_ns > accounting.last_time_ns:
            accounting.last_time_ns = part.time_monotonic_ns
        relation = self.sync.best
        latency = None
        if relation is not None:
            latency = (now_ns + relation.offset_ns - part.time_monotonic_ns) / NS
            self.latency_s = latency
        scan = join_parts(parts)
        fields = accounting.session, scan, now_ns, utc_ns, latency, is_late
        self._events.append(_new_tuple(ev.ScanReceived, fields))

    def _part(self, frame: MavlinkFrame, now_ns: int) -> ScanPart | None:
        """The content of a scan message; None, reported once, for laboratory channels that no installed package describes."""
        layout = self._layouts.get(frame.msg_id)
        if layout is not None:
            try:
                return unpack_scan(layout, padded(frame.payload, layout.size))
            except ValueError:  # a part of another channel table, reported below
                pass
        if not self._foreign_channels_reported:
            self._foreign_channels_reported = True
            self._events.append(ev.StatusText(self.system, _WARNING, _FOREIGN_CHANNELS, now_ns))
        return None

    def _new_session(self, boot: int, now_ns: int) -> SessionAccounting:
        """Begin a session, with an event Restarted, and reset the clock relation."""
        previous = self.sessions[-1].session if self.sessions else None
        session = SessionAccounting(ev.Session(self.system, boot, 0 if previous is None else previous.turn + 1))
        self.sessions.append(session)
        if len(self.sessions) > _MAX_SESSIONS:
            self.sessions.pop(0)
        self._parts.clear()
        self.sync.reset()
        self.latency_s = None
        self._events.append(ev.Restarted(session.session, previous, now_ns))
        return session

    def _session(self, boot: int) -> SessionAccounting | None:
        """The latest session with a boot id; None for an unknown one."""
        return next((s for s in reversed(self.sessions) if s.session.boot == boot), None)
