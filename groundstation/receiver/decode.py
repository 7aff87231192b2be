"""From the frames of one aircraft (system id) to scans and reports, with exact accounting of what is missing.

No input or output happens here, and no content of a frame raises an exception.
"""

from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

from daq.contract.link.scan_map import BLOCK
from daq.contract.link.wire import SCAN_IDS
from daq.transport.mavlink_codec import MavlinkFrame
from groundstation.receiver import events as ev
from groundstation.receiver import findings
from groundstation.receiver.link_accounting import SequenceTracker, SessionAccounting
from groundstation.receiver.scan_decoder import ScanDecoder
from groundstation.receiver.timeline import NS, Allowance

_TEXTS, _TEXT_PIECES = 32, 32  # incomplete long texts, and pieces of one, at most
_PIECE_LENGTH = 50  # letters of a piece of STATUSTEXT; a shorter one is the last
_TEXTS_AT_ONCE, _TEXTS_PER_S = 100, 5.0
"""Texts and events that are accepted at once, and then in a second: each is a line in the log."""
_CLAIMS, _CLAIM_NS = 3, 8 * NS
"""Reports that prove a new run without scans, and the time that they span: they come every five seconds."""
_MAX_CLAIMS = 8  # runs that may be claimed at a time
MAX_AIRCRAFT_TIME_NS = 2**56 - 1  # of a packed scan: two years
_NOT_KNOWN_BYTES = 2**64 - 1  # free bytes of LOGGER_STATUS, where the logger does not know them
_STATUS_COUNTS = ("slots", "written", "dropped", "lost", "missed", "queue", "lateness_p99_us", "write_errors")
_STATISTICS_COUNTS = (
    *("first_number", "last_number", "scans_offered", "scans_sent", "scans_dropped"),
    *("frames_sent", "rejected_frames", "rejected_commands"),
)


class AircraftDecoder(ScanDecoder):
    """Events, sessions and counts of one aircraft from its frames."""

    def __init__(self, system: int, reception_findings: findings.ReceptionFindings | None = None) -> None:
        super().__init__(system, reception_findings)
        self._text_allowance = Allowance(_TEXTS_AT_ONCE, _TEXTS_PER_S)
        self._texts: OrderedDict[int, dict[int, tuple[int, str]]] = OrderedDict()

    def decode_frame(self, frame: MavlinkFrame, now_ns: int, utc_ns: int) -> list[ev.Event]:
        """Use a frame of this system; returns its events, none for a repeated frame."""
        self._events = []
        tracker = self.trackers.get(frame.component)
        if tracker is None:
            tracker = self.trackers[frame.component] = SequenceTracker()
        if not tracker.count_frame(frame, now_ns):
            return []
        if frame.msg_id in SCAN_IDS:
            self._take_scan(frame, now_ns, utc_ns)
            return self._events
        if frame.name == "HEARTBEAT":
            fields: Mapping[str, Any] = frame.fields()
            self._events.append(ev.Heartbeat(self.system, frame.component, fields["system_status"], now_ns))
        elif frame.name in _HANDLERS:
            _HANDLERS[frame.name](self, frame.fields(), now_ns)
        return self._events

    def _text_allowed(self, now_ns: int) -> bool:
        """Whether another text is within the allowance; one beyond it is counted as a finding."""
        if self._text_allowance.spend(1, now_ns):
            return True
        self._findings.doubt(self.system, findings.TEXTS)
        return False

    def _statustext(self, f: Mapping[str, Any], now_ns: int) -> None:
        number, index, severity, text = f["id"], f["chunk_seq"], f["severity"], f["text"]
        if index >= _TEXT_PIECES or not self._text_allowed(now_ns):
            return
        if number:
            pieces = self._texts.setdefault(number, {})
            pieces[index] = (severity, text)
            if len(self._texts) > _TEXTS:
                self._texts.popitem(last=False)
            if not any(len(t) < _PIECE_LENGTH and all(j in pieces for j in range(i)) for i, (_, t) in pieces.items()):
                return
            self._texts.pop(number)
            text = "".join(pieces[i][1] for i in sorted(pieces))
        self._events.append(ev.StatusText(self.system, severity, text, now_ns))

    def _logger_status(self, f: Mapping[str, Any], now_ns: int) -> None:
        accounting = self._session(f["boot"])
        if accounting is None:
            return
        self._events.append(
            ev.LoggerStatus(
                accounting.session,
                recording=bool(f["recording"]),
                in_flight=bool(f["in_flight"]),
                free_bytes=None if f["free_bytes"] == _NOT_KNOWN_BYTES else f["free_bytes"],
                received_ns=now_ns,
                **{name: f[name] for name in _STATUS_COUNTS},
            )
        )

    def _link_statistics(self, f: Mapping[str, Any], now_ns: int) -> None:
        # This report can begin a session: a ground station started after the last scan still fetches its scans.
        accounting = self._session(f["boot"]) or self._session_by_claim(f["boot"], now_ns)
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

    def _session_by_claim(self, boot: int, now_ns: int) -> SessionAccounting | None:
        """A new session for a report of an unknown run: the first session at once, a later one after _CLAIMS reports without a
        scan of the present one; else None."""
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

    def _sent_map(self, f: Mapping[str, Any], now_ns: int) -> None:
        accounting = self._session(f["boot"])
        if accounting is None:
            return
        first = f["first_number"]
        if f["last_number"] > accounting.reach(now_ns) or first > accounting.reach(now_ns):
            self._findings.doubt(self.system, findings.REPORTS)
        elif first % BLOCK == 0:
            sent_bits, absent = (int.from_bytes(bytes(f[n]), "little") for n in ("sent", "absent"))
            accounting.take_map(first, f["last_number"], sent_bits, absent)

    def _scan_event(self, f: Mapping[str, Any], now_ns: int) -> None:
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

    def _sequencer_status(self, f: Mapping[str, Any], now_ns: int) -> None:
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

    def _timesync(self, f: Mapping[str, Any], now_ns: int) -> None:
        if 0 < f["tc1"] <= MAX_AIRCRAFT_TIME_NS:
            self.sync.answer(f["ts1"], f["tc1"], now_ns)


_Handler = Callable[[AircraftDecoder, Mapping[str, Any], int], None]
_HANDLERS: Mapping[str, _Handler] = {
    "STATUSTEXT": AircraftDecoder._statustext,
    "LOGGER_STATUS": AircraftDecoder._logger_status,
    "LINK_STATISTICS": AircraftDecoder._link_statistics,
    "SENT_MAP": AircraftDecoder._sent_map,
    "SCAN_EVENT": AircraftDecoder._scan_event,
    "SEQUENCER_STATUS": AircraftDecoder._sequencer_status,
    "TIMESYNC": AircraftDecoder._timesync,
}
"""Message -> method that uses its fields; a report that cannot be true becomes a finding."""
