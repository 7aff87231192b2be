"""From frames of one aircraft to scans and reports, with exact accounting of what is missing.

Nothing here does input or output, and no content of a frame makes it raise. Several aircraft are kept apart by giving
each system id an `AircraftDecoder` of its own.
"""

from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

from daq.contract.link.scan_map import BLOCK
from daq.contract.link.wire import SCAN_FAST_ID, SCAN_RARE_ID, SCAN_SLOW_ID, ScanPart, join_parts, layouts, unpack_scan
from daq.transport.mavlink_codec import Frame, padded
from groundstation.receiver import events as ev
from groundstation.receiver.link_accounting import SequenceTracker, SessionBooks
from groundstation.receiver.timeline import NS, ClockSync

_SCAN_IDS = (SCAN_FAST_ID, SCAN_SLOW_ID, SCAN_RARE_ID)
_PARTS_KEPT = 64
_SETTLE_JUMP_NS = 10 * NS
_MAX_SESSIONS = 64
_TEXT_PIECES = 32


class AircraftDecoder:
    """Everything that is known of one aircraft (system id), from its frames alone."""

    def __init__(self, system: int) -> None:
        self.system = system
        self.trackers: dict[int, SequenceTracker] = {}  # by component
        self.sync = ClockSync()
        self.sessions: list[SessionBooks] = []
        self.latency_s: float | None = None
        self.scans_since_report = 0
        self.partial_scans = 0
        self.last_scan_ns = 0
        self._parts: OrderedDict[int, list[ScanPart]] = OrderedDict()
        self._texts: OrderedDict[int, dict[int, tuple[int, str]]] = OrderedDict()
        self._out: list[ev.Event] = []

    @property
    def tracker(self) -> SequenceTracker:
        """The tracker of the component that sends most."""
        if not self.trackers:
            return SequenceTracker()
        return max(self.trackers.values(), key=lambda t: t.received)

    @property
    def books(self) -> SessionBooks | None:
        """The books of the present session."""
        return self.sessions[-1] if self.sessions else None

    def take(self, frame: Frame, now_ns: int, utc_ns: int) -> list[ev.Event]:
        """Use a frame of this system; returns what it means, nothing for a repeated frame."""
        self._out = []
        if not self.trackers.setdefault(frame.component, SequenceTracker()).take(frame, now_ns):
            return []
        if frame.msg_id in _SCAN_IDS:
            self._take_scan(frame, now_ns, utc_ns)
            return self._out
        handler = _HANDLERS.get(frame.name)
        if handler is not None:
            handler(self, frame, frame.fields(), now_ns)
        return self._out

    # ------------------------------------------------------------------------------------------ scans

    def _take_scan(self, frame: Frame, now_ns: int, utc_ns: int) -> None:
        layout = layouts()[frame.msg_id]
        part = unpack_scan(layout, padded(frame.payload, layout.size))
        before = self.books
        books = self._session_of(part, now_ns)
        tracker = self.trackers[frame.component]
        if before is not None and self.books is not before:
            tracker.restart()
        tracker.settle()
        if books is not self.sessions[-1]:
            books.see(part.number)  # a straggler of an earlier session: counted, not shown
            if part.msg_id == SCAN_FAST_ID:
                books.received.add(part.number)
            return
        books.see(part.number)
        parts = self._parts.setdefault(part.number, [])
        if any(p.msg_id == part.msg_id for p in parts):
            return
        late = part.time_monotonic_ns < books.last_time_ns
        parts.append(part)
        self._forget_old_parts()
        if part.msg_id == SCAN_FAST_ID:
            if not books.received.add(part.number):
                return
            self.scans_since_report += 1
            self.last_scan_ns = now_ns
        elif all(p.msg_id != SCAN_FAST_ID for p in parts):
            return  # the slow part comes first; the scan is reported with its fast part
        else:
            late = True
        books.last_time_ns = max(books.last_time_ns, part.time_monotonic_ns)
        relation = self.sync.best
        latency = None
        if relation is not None:
            latency = (now_ns + relation.offset_ns - part.time_monotonic_ns) / NS
            self.latency_s = latency
        scan = join_parts(parts)
        self._out.append(ev.ScanReceived(books.session, scan, now_ns, utc_ns, latency, late))

    def _forget_old_parts(self) -> None:
        while len(self._parts) > _PARTS_KEPT:
            _, parts = self._parts.popitem(last=False)
            if all(p.msg_id != SCAN_FAST_ID for p in parts):
                self.partial_scans += 1

    def _session_of(self, part: ScanPart, now_ns: int) -> SessionBooks:
        """The session a part belongs to.

        Within one run of the logger number and time rise together, and reordering is a matter of seconds. A new
        boot id, a number that falls while time rises, or both falling far, is a restart.
        """
        books = self.books
        if books is None:
            return self._new_session(part.boot, now_ns)
        if part.boot != books.session.boot:
            for earlier in self.sessions[-4:-1]:
                close = abs(part.time_monotonic_ns - earlier.last_time_ns) < _SETTLE_JUMP_NS
                if earlier.session.boot == part.boot and close and part.number <= earlier.last + BLOCK:
                    return earlier
            return self._new_session(part.boot, now_ns)
        if books.last >= 0 and part.number < books.last:
            rises = part.time_monotonic_ns > books.last_time_ns
            falls_far = books.last_time_ns - part.time_monotonic_ns > _SETTLE_JUMP_NS
            if books.last_time_ns and (rises or (falls_far and part.number not in books.received)):
                return self._new_session(part.boot, now_ns)
        return books

    def _new_session(self, boot: int, now_ns: int) -> SessionBooks:
        previous = self.sessions[-1].session if self.sessions else None
        made = SessionBooks(ev.Session(self.system, boot, 0 if previous is None else previous.turn + 1))
        self.sessions.append(made)
        if len(self.sessions) > _MAX_SESSIONS:
            self.sessions.pop(0)
        self._parts.clear()
        self.sync.reset()
        self.latency_s = None
        self._out.append(ev.Restarted(made.session, previous, now_ns))
        return made

    def _session(self, boot: int) -> SessionBooks | None:
        """The session of a report that carries a boot id; None before a scan of it has come."""
        return next((b for b in reversed(self.sessions) if b.session.boot == boot), None)

    # ------------------------------------------------------------------------------------------ reports

    def _heartbeat(self, frame: Frame, f: Mapping[str, Any], now_ns: int) -> None:
        self._out.append(ev.Heartbeat(frame.system, frame.component, f["system_status"], now_ns))

    def _statustext(self, frame: Frame, f: Mapping[str, Any], now_ns: int) -> None:
        number, index, severity, text = f["id"], f["chunk_seq"], f["severity"], f["text"]
        if number:
            pieces = self._texts.setdefault(number, {})
            pieces[index] = (severity, text)
            if len(self._texts) > _TEXT_PIECES:
                self._texts.popitem(last=False)
            if not any(len(t) < 50 and all(j in pieces for j in range(i)) for i, (_, t) in pieces.items()):
                return
            self._texts.pop(number)
            text = "".join(pieces[i][1] for i in sorted(pieces))
        self._out.append(ev.StatusText(frame.system, severity, text, now_ns))

    def _logger_status(self, frame: Frame, f: Mapping[str, Any], now_ns: int) -> None:
        books = self._session(f["boot"])
        if books is None:
            return
        names = ("slots", "written", "dropped", "lost", "missed", "queue", "lateness_p99_us", "write_errors")
        self._out.append(
            ev.LoggerStatus(
                books.session,
                recording=bool(f["recording"]),
                in_flight=bool(f["in_flight"]),
                free_bytes=None if f["free_bytes"] == 2**64 - 1 else f["free_bytes"],
                received_ns=now_ns,
                **{n: f[n] for n in names},
            )
        )

    def _link_statistics(self, frame: Frame, f: Mapping[str, Any], now_ns: int) -> None:
        # This report alone makes a session known: a ground station started after the last scan must find it.
        books = self._session(f["boot"]) or self._new_session(f["boot"], now_ns)
        names = (
            "first_number",
            "last_number",
            "scans_offered",
            "scans_sent",
            "scans_dropped",
            "frames_sent",
            "rejected_frames",
            "rejected_commands",
        )
        found = ev.AircraftStatistics(
            books.session,
            **{n: f[n] for n in names},
            rate_hz=f["rate_centihz"] / 100,
            received_ns=now_ns,
        )
        if books.statistics is None or found.scans_offered >= books.statistics.scans_offered:
            books.statistics = found
        self._out.append(found)

    def _sent_map(self, frame: Frame, f: Mapping[str, Any], now_ns: int) -> None:
        books = self._session(f["boot"])
        if books is None:
            return
        first = f["first_number"]
        if first % BLOCK == 0:
            sent, absent = (int.from_bytes(bytes(f[n]), "little") for n in ("sent", "absent"))
            books.take_map(first, f["last_number"], sent, absent)

    def _scan_event(self, frame: Frame, f: Mapping[str, Any], now_ns: int) -> None:
        books = self._session(f["boot"])
        if books is None:
            return
        time_ns, number = f["time_monotonic_ns"], f["number"]
        self._out.append(ev.EventMarked(books.session, time_ns, number, f["origin"], f["text"], now_ns))

    def _timesync(self, frame: Frame, f: Mapping[str, Any], now_ns: int) -> None:
        if f["tc1"]:
            self.sync.answer(f["ts1"], f["tc1"], now_ns)


_Handler = Callable[[AircraftDecoder, Frame, Mapping[str, Any], int], None]
_HANDLERS: Mapping[str, _Handler] = {
    "HEARTBEAT": AircraftDecoder._heartbeat,
    "STATUSTEXT": AircraftDecoder._statustext,
    "LOGGER_STATUS": AircraftDecoder._logger_status,
    "LINK_STATISTICS": AircraftDecoder._link_statistics,
    "SENT_MAP": AircraftDecoder._sent_map,
    "SCAN_EVENT": AircraftDecoder._scan_event,
    "TIMESYNC": AircraftDecoder._timesync,
}
