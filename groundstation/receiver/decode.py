"""From frames of one aircraft to scans and reports, with exact accounting of what is missing.

Nothing here does input or output, and no content of a frame makes it raise. Several aircraft are kept apart by giving
each system id an `AircraftDecoder` of its own.
"""

from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

from daq.contract.link.scan_map import BLOCK
from daq.contract.link.wire import SCAN_FAST_ID, SCAN_IDS, ScanPart, join_parts, layouts, unpack_scan
from daq.transport.mavlink_codec import MavlinkFrame, padded
from groundstation.receiver import events as ev
from groundstation.receiver import findings
from groundstation.receiver.continuity import LATE_NS, PendingScan, ScanRun, UnconfirmedRuns
from groundstation.receiver.link_accounting import SequenceTracker, SessionAccounting
from groundstation.receiver.timeline import NS, Allowance, ClockSync

_new_tuple: Callable[..., Any] = tuple.__new__  # without the function that names the fields: half of the time
_PARTS_KEPT = 64
_MAX_SESSIONS = 64
_TEXTS, _TEXT_PIECES = 32, 32
_RESTARTS_AT_ONCE, _RESTARTS_PER_S = 8, 1 / 60
"""A logger that starts anew eight times in a row and then once a minute is followed; each session is a file."""
_TEXTS_AT_ONCE, _TEXTS_PER_S = 100, 5.0
_CLAIMS, _CLAIM_NS = 3, 8 * NS  # reports of a new run without scans that are believed: they come every five seconds
_MAX_CLAIMS = 8
MAX_AIRCRAFT_TIME_NS = 2**56 - 1
"""What a packed scan can say; two years."""
_STATUS_COUNTS = ("slots", "written", "dropped", "lost", "missed", "queue", "lateness_p99_us", "write_errors")
_STATISTICS_COUNTS = (
    *("first_number", "last_number", "scans_offered", "scans_sent", "scans_dropped"),
    *("frames_sent", "rejected_frames", "rejected_commands"),
)
_WARNING = 4  # as in syslog
_FOREIGN_CHANNELS = (
    "ground: the aircraft sends laboratory channels that no package installed here describes, or another version of it"
    " does; install the aircraft's package. All other channels are received"
)


class AircraftDecoder:
    """Everything that is known of one aircraft (system id), from its frames alone."""

    def __init__(self, system: int, reception_findings: findings.ReceptionFindings | None = None) -> None:
        self.system = system
        self._findings = reception_findings or findings.ReceptionFindings()
        self.trackers: dict[int, SequenceTracker] = {}  # by component
        self.sync = ClockSync()
        self.sessions: list[SessionAccounting] = []
        self.latency_s: float | None = None
        self.scans_since_report = 0
        self.partial_scans = 0
        self.last_scan_ns = 0
        self._unconfirmed = UnconfirmedRuns()
        self._claims: OrderedDict[int, tuple[int, int]] = OrderedDict()  # boot -> first report of it, and how many
        self._restart_allowance = Allowance(_RESTARTS_AT_ONCE, _RESTARTS_PER_S)
        self._text_allowance = Allowance(_TEXTS_AT_ONCE, _TEXTS_PER_S)
        self._parts: OrderedDict[int, list[ScanPart]] = OrderedDict()
        self._texts: OrderedDict[int, dict[int, tuple[int, str]]] = OrderedDict()
        self._layouts = layouts()
        self._events: list[ev.Event] = []
        self._foreign_channels_reported = False
        self._scan_component = -1  # the component of the latest scan that was believed

    @property
    def tracker(self) -> SequenceTracker:
        """The tracker of the component that sends the scans, for the link is judged by the logger's numbers; before there are
        any, of the one that sends most.
        """
        if self._scan_component in self.trackers:
            return self.trackers[self._scan_component]
        if not self.trackers:
            return SequenceTracker()
        return max(self.trackers.values(), key=lambda t: t.received)

    @property
    def accounting(self) -> SessionAccounting | None:
        return self.sessions[-1] if self.sessions else None

    def decode_frame(self, frame: MavlinkFrame, now_ns: int, utc_ns: int) -> list[ev.Event]:
        """Use a frame of this system; returns what it means, nothing for a repeated frame."""
        self._events = []
        tracker = self.trackers.get(frame.component)
        if tracker is None:
            tracker = self.trackers[frame.component] = SequenceTracker()
        if not tracker.count_frame(frame, now_ns):
            return []
        if frame.msg_id in SCAN_IDS:
            self._take_scan(frame, now_ns, utc_ns)
            return self._events
        handler = _HANDLERS.get(frame.name)
        if handler is not None:
            handler(self, frame, frame.fields(), now_ns)
        return self._events

    # ------------------------------------------------------------------------------------------ scans

    @property
    def pending_parts(self) -> int:
        """Scan parts that follow nothing known and wait for others to prove them."""
        return self._unconfirmed.count

    def _take_scan(self, frame: MavlinkFrame, now_ns: int, utc_ns: int) -> None:
        part = self._part(frame, now_ns)
        if part is None:
            return
        pending: PendingScan = _new_tuple(PendingScan, (part, frame.component, now_ns, utc_ns))
        straggled = None if len(self.sessions) < 2 else self._straggled(part)
        if straggled is not None:
            straggled.see(part.number)  # counted, not shown
            if part.msg_id == SCAN_FAST_ID:
                straggled.received.add(part.number)
            return
        accounting = self.accounting
        if accounting is None or accounting.run is None:
            self._begin(pending, accounting)
            return
        if accounting.run.follows(part, now_ns):
            self._believe(accounting, pending)
            self._findings.doubt(self.system, findings.NUMBERS, self._unconfirmed.clear())
            return
        long_on_its_way = accounting.run.is_older(part) and part.number in accounting.received  # a late copy
        if not long_on_its_way:
            self._hold(accounting, pending)

    def _straggled(self, part: ScanPart) -> SessionAccounting | None:
        """The earlier session that a part of another boot is a late one of."""
        if self.accounting is None or part.boot == self.accounting.session.boot:
            return None
        for earlier in self.sessions[-4:-1]:
            close = abs(part.time_monotonic_ns - earlier.last_time_ns) < LATE_NS
            if earlier.session.boot == part.boot and close and part.number <= earlier.last + BLOCK:
                return earlier
        return None

    def _begin(self, pending: PendingScan, accounting: SessionAccounting | None) -> None:
        """The first scan of all, or the first since a report made its session known."""
        if accounting is None or accounting.session.boot != pending.part.boot:
            if accounting is not None and not self._restart_allowance.spend(1, pending.now_ns):
                self._findings.doubt(self.system, findings.RESTARTS)
                return
            accounting = self._new_session(pending.part.boot, pending.now_ns)
        accounting.run = ScanRun(pending.part, pending.now_ns)
        self._believe(accounting, pending)

    def _hold(self, accounting: SessionAccounting, pending: PendingScan) -> None:
        """Keep a scan that follows nothing, until more of its run have come and none of the known one."""
        proven, given_up = self._unconfirmed.hold(pending, self.trackers[pending.component].lost)
        self._findings.doubt(self.system, findings.NUMBERS, given_up)
        if proven is None:
            return
        first = proven.parts[0].part
        run = accounting.run
        goes_on = run is not None and first.boot == run.boot
        if goes_on and run is not None and first.number > run.number and run.in_step(first):
            run.advance(first, proven.parts[0].now_ns)  # this computer's clock stood still, or the link was away
        elif self._restart_allowance.spend(1, pending.now_ns):
            accounting = self._new_session(first.boot, pending.now_ns)
            accounting.run = ScanRun(first, proven.parts[0].now_ns)
            self._restart_trackers(pending.component, proven.lost)
        else:
            self._findings.doubt(self.system, findings.RESTARTS)
            return
        for part in proven.parts:
            self._believe(accounting, part)

    def _restart_trackers(self, component: int, lost: int) -> None:
        """The logger has started anew, and with it all its components; of an autopilot's a second's loss is forgiven."""
        for number, tracker in self.trackers.items():
            tracker.restart(lost if number == component else tracker.lost)
            if number != component:
                tracker.expect_any()

    def _believe(self, accounting: SessionAccounting, pending: PendingScan) -> None:
        part, now_ns = pending.part, pending.now_ns
        assert accounting.run is not None
        accounting.run.advance(part, now_ns)
        if self._claims:
            self._claims.clear()
        self._scan_component = pending.component
        for tracker in self.trackers.values():
            tracker.settle()
        accounting.see(part.number)
        parts = self._parts.get(part.number)
        if parts is None:
            parts = self._parts[part.number] = []
        elif any(p.msg_id == part.msg_id for p in parts):
            return
        is_late = part.time_monotonic_ns < accounting.last_time_ns
        parts.append(part)
        while len(self._parts) > _PARTS_KEPT:
            _, old_parts = self._parts.popitem(last=False)
            self.partial_scans += all(p.msg_id != SCAN_FAST_ID for p in old_parts)
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
        fields = accounting.session, scan, now_ns, pending.utc_ns, latency, is_late
        self._events.append(_new_tuple(ev.ScanReceived, fields))

    def _part(self, frame: MavlinkFrame, now_ns: int) -> ScanPart | None:
        """What a scan message says; None, told once, for laboratory channels that no package here describes."""
        layout = self._layouts.get(frame.msg_id)
        if layout is not None:
            try:
                return unpack_scan(layout, padded(frame.payload, layout.size))
            except ValueError:  # another table: told below
                pass
        if not self._foreign_channels_reported:
            self._foreign_channels_reported = True
            self._events.append(ev.StatusText(self.system, _WARNING, _FOREIGN_CHANNELS, now_ns))
        return None

    def _new_session(self, boot: int, now_ns: int) -> SessionAccounting:
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
        """The session of a report that carries a boot id; None before a scan of it has come."""
        return next((b for b in reversed(self.sessions) if b.session.boot == boot), None)

    # ------------------------------------------------------------------------------------------ reports

    def _heartbeat(self, frame: MavlinkFrame, f: Mapping[str, Any], now_ns: int) -> None:
        self._events.append(ev.Heartbeat(frame.system, frame.component, f["system_status"], now_ns))

    def _text_allowed(self, now_ns: int) -> bool:
        """Whether a text may come now; each is a line in the log."""
        if self._text_allowance.spend(1, now_ns):
            return True
        self._findings.doubt(self.system, findings.TEXTS)
        return False

    def _statustext(self, frame: MavlinkFrame, f: Mapping[str, Any], now_ns: int) -> None:
        number, index, severity, text = f["id"], f["chunk_seq"], f["severity"], f["text"]
        if index >= _TEXT_PIECES or not self._text_allowed(now_ns):
            return
        if number:
            pieces = self._texts.setdefault(number, {})
            pieces[index] = (severity, text)
            if len(self._texts) > _TEXTS:
                self._texts.popitem(last=False)
            if not any(len(t) < 50 and all(j in pieces for j in range(i)) for i, (_, t) in pieces.items()):
                return
            self._texts.pop(number)
            text = "".join(pieces[i][1] for i in sorted(pieces))
        self._events.append(ev.StatusText(frame.system, severity, text, now_ns))

    def _logger_status(self, frame: MavlinkFrame, f: Mapping[str, Any], now_ns: int) -> None:
        accounting = self._session(f["boot"])
        if accounting is None:
            return
        self._events.append(
            ev.LoggerStatus(
                accounting.session,
                recording=bool(f["recording"]),
                in_flight=bool(f["in_flight"]),
                free_bytes=None if f["free_bytes"] == 2**64 - 1 else f["free_bytes"],
                received_ns=now_ns,
                **{name: f[name] for name in _STATUS_COUNTS},
            )
        )

    def _link_statistics(self, frame: MavlinkFrame, f: Mapping[str, Any], now_ns: int) -> None:
        # This report alone makes a session known: a ground station started after the last scan must find it.
        accounting = self._session(f["boot"]) or self._claimed(f["boot"], now_ns)
        if accounting is None:
            return
        if f["scans_offered"] and not f["first_number"] <= f["last_number"] <= accounting.reach(now_ns):
            self._findings.doubt(self.system, findings.REPORTS)
            return
        counts = {name: f[name] for name in _STATISTICS_COUNTS}
        rate_hz = f["rate_centihz"] / 100
        statistics = ev.AircraftStatistics(accounting.session, **counts, rate_hz=rate_hz, received_ns=now_ns)
        if accounting.statistics is None or statistics.scans_offered >= accounting.statistics.scans_offered:
            accounting.statistics = statistics
        self._events.append(statistics)

    def _claimed(self, boot: int, now_ns: int) -> SessionAccounting | None:
        """The session that a report of an unknown run speaks of: the first at once, a further one when it is repeated
        while no scan of the known one comes."""
        if self.accounting is not None:
            first_ns, count = self._claims.pop(boot, (now_ns, 0))
            self._claims[boot] = (first_ns, count + 1)
            if len(self._claims) > _MAX_CLAIMS:
                self._claims.popitem(last=False)
            if count + 1 < _CLAIMS or now_ns - first_ns < _CLAIM_NS:
                return None
            del self._claims[boot]
            if not self._restart_allowance.spend(1, now_ns):
                self._findings.doubt(self.system, findings.RESTARTS)
                return None
        return self._new_session(boot, now_ns)

    def _sent_map(self, frame: MavlinkFrame, f: Mapping[str, Any], now_ns: int) -> None:
        accounting = self._session(f["boot"])
        if accounting is None:
            return
        first = f["first_number"]
        if f["last_number"] > accounting.reach(now_ns) or first > accounting.reach(now_ns):
            self._findings.doubt(self.system, findings.REPORTS)
        elif first % BLOCK == 0:
            sent_bits, absent = (int.from_bytes(bytes(f[n]), "little") for n in ("sent", "absent"))
            accounting.take_map(first, f["last_number"], sent_bits, absent)

    def _scan_event(self, frame: MavlinkFrame, f: Mapping[str, Any], now_ns: int) -> None:
        accounting = self._session(f["boot"])
        if accounting is None:
            return
        time_ns, number = f["time_monotonic_ns"], f["number"]
        if time_ns > MAX_AIRCRAFT_TIME_NS or number > accounting.reach(now_ns):
            self._findings.doubt(self.system, findings.REPORTS)
            return
        if not self._text_allowed(now_ns):
            return
        self._events.append(ev.EventMarked(accounting.session, time_ns, number, f["origin"], f["text"], now_ns))

    def _sequencer_status(self, frame: MavlinkFrame, f: Mapping[str, Any], now_ns: int) -> None:
        accounting = self._session(f["boot"])
        if accounting is None:
            return
        self._events.append(
            ev.SequencerStatus(
                accounting.session,
                f["time_monotonic_ns"],
                f["number"],
                f["state"],
                f["reason"],
                f["switch_position"],
                elapsed_s=f["elapsed_ms"] * 1e-3,
                increments=tuple(value * 1e-4 for value in f["increments"]),
                beating=bool(f["flags"] & 1),
                limited=bool(f["flags"] & 2),
                received_ns=now_ns,
            )
        )

    def _timesync(self, frame: MavlinkFrame, f: Mapping[str, Any], now_ns: int) -> None:
        if 0 < f["tc1"] <= MAX_AIRCRAFT_TIME_NS:
            self.sync.answer(f["ts1"], f["tc1"], now_ns)


_Handler = Callable[[AircraftDecoder, MavlinkFrame, Mapping[str, Any], int], None]
_HANDLERS: Mapping[str, _Handler] = {
    "HEARTBEAT": AircraftDecoder._heartbeat,
    "STATUSTEXT": AircraftDecoder._statustext,
    "LOGGER_STATUS": AircraftDecoder._logger_status,
    "LINK_STATISTICS": AircraftDecoder._link_statistics,
    "SENT_MAP": AircraftDecoder._sent_map,
    "SCAN_EVENT": AircraftDecoder._scan_event,
    "SEQUENCER_STATUS": AircraftDecoder._sequencer_status,
    "TIMESYNC": AircraftDecoder._timesync,
}
