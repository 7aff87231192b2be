"""From frames of one aircraft to scans and reports, with exact accounting of what is missing.

Nothing here does input or output, and no content of a frame makes it raise. Several aircraft are kept apart by giving
each system id an `AircraftDecoder` of its own.
"""

import hashlib
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from typing import Any

from daq.contract.mavlink_codec import Frame, padded
from daq.contract.scan_map import BLOCK, ScanMap
from daq.contract.wire import SCAN_FAST_ID, SCAN_RARE_ID, SCAN_SLOW_ID, ScanPart, join_parts, layouts, unpack_scan
from groundstation import events as ev
from groundstation.timeline import NS, ClockSync

_SCAN_IDS = (SCAN_FAST_ID, SCAN_SLOW_ID, SCAN_RARE_ID)
_PARTS_KEPT = 64
_SETTLE_JUMP_NS = 10 * NS
_MAX_SESSIONS = 64
_TEXT_PIECES = 32


class SequenceTracker:
    """Counts frames lost, late and duplicated from the 8-bit sequence numbers of one sender."""

    def __init__(self) -> None:
        self.received = 0
        self.lost = 0
        self.duplicates = 0
        self._next: int | None = None
        self._missing: set[int] = set()
        self._recent: OrderedDict[int, bytes] = OrderedDict()
        self._last_ns = 0
        self._rate = 0.0

    def take(self, frame: Frame, now_ns: int) -> bool:
        """Count a frame; False for a duplicate of a recent one."""
        sequence = frame.sequence
        digest = hashlib.blake2b(frame.raw, digest_size=8).digest()
        if self._recent.get(sequence) == digest:
            self.duplicates += 1
            return False
        self._recent.pop(sequence, None)
        self._recent[sequence] = digest
        if len(self._recent) > 128:  # a sequence number may return after that many
            self._recent.popitem(last=False)
        self.received += 1
        step = 0 if self._next is None else (sequence - self._next) & 255
        if step >= 128 and sequence in self._missing:
            self._missing.discard(sequence)
            self.lost -= 1
            return True
        if step:
            self._count_gap(step, now_ns)
        if self._last_ns and now_ns > self._last_ns:
            rate = (step + 1) * NS / (now_ns - self._last_ns)
            self._rate += 0.02 * (min(rate, 1e4) - self._rate)
        self._next = (sequence + 1) & 255
        self._missing.discard(sequence)
        self._last_ns = now_ns
        return True

    def _count_gap(self, step: int, now_ns: int) -> None:
        assert self._next is not None
        self._missing = {(self._next + i) & 255 for i in range(step)} | {
            m for m in self._missing if (m - self._next) & 255 >= 128
        }
        # After an outage of more than 256 frames the count has gone round; time tells how often.
        expected = (now_ns - self._last_ns) / NS * self._rate
        rounds = max(0, round((expected - step) / 256)) if expected > 256 else 0
        self.lost += step + 256 * rounds


class SessionBooks:
    """What is known of the scans of one run of the aircraft's logger."""

    def __init__(self, session: ev.Session) -> None:
        self.session = session
        self.received = ScanMap()
        self.sent = ScanMap()
        self.absent = ScanMap()
        self.backfilled = ScanMap()
        self.settled: dict[int, int] = {}  # block -> number up to which its map is settled
        self.first: int | None = None
        self.last = -1
        self.last_time_ns = 0
        self.statistics: ev.AircraftStatistics | None = None

    def see(self, number: int) -> None:
        """A scan of this number exists."""
        self.first = number if self.first is None else min(self.first, number)
        self.last = max(self.last, number)

    def take_map(self, first: int, settled: int, sent: int, absent: int) -> None:
        """Use a SENT_MAP."""
        block, top = first // BLOCK, first + BLOCK - 1
        if settled < first or settled < self.settled.get(block, -1):
            return
        known = min(settled, top)
        mask = (1 << (known - first + 1)) - 1
        if block not in self.settled and len(self.settled) > 65536:
            return
        self.settled[block] = known
        self.sent.set_word(block, self.sent.word(block) | sent & mask)
        self.absent.set_word(block, self.absent.word(block) | absent & mask)

    def open_blocks(self) -> list[int]:
        """Blocks up to the last scan whose map is not settled."""
        span = self._span()
        if span is None:
            return []
        first, last = span
        return [
            b
            for b in range(first // BLOCK, last // BLOCK + 1)
            if self.settled.get(b, -1) < min(last, b * BLOCK + BLOCK - 1)
        ]

    def _span(self) -> tuple[int, int] | None:
        """First and last scan known of; believed only as far as a flight can last."""
        if self.first is None:
            return None
        first, last = self.first, self.last
        if self.statistics is not None and self.statistics.scans_offered:
            first, last = min(first, self.statistics.first_number), max(last, self.statistics.last_number)
        return first, min(last, first + BLOCK * 65536)

    def accounting(self) -> ev.Accounting:
        """Where all scans went."""
        span = self._span()
        if span is None:
            return ev.Accounting(self.session, 0, -1, 0, 0)
        lost, missing, unknown, absent, never = ScanMap(), ScanMap(), ScanMap(), ScanMap(), 0
        sent_known = 0
        first, last = span
        for block in range(first // BLOCK, last // BLOCK + 1):
            low, high = max(first, block * BLOCK), min(last, block * BLOCK + BLOCK - 1)
            inside = _mask(low, high, block)
            settled = _mask(low, min(high, self.settled.get(block, -1)), block)
            received = self.received.word(block)
            sent = (self.sent.word(block) & settled) | received
            sent_known += (sent & inside).bit_count()
            lost.set_word(block, sent & ~received & inside)
            missing.set_word(block, lost.word(block) & ~self.backfilled.word(block))
            gone = self.absent.word(block) & settled
            absent.set_word(block, gone)
            unknown.set_word(block, inside & ~settled & ~received)
            never += (inside & settled & ~sent & ~gone).bit_count()
        return ev.Accounting(
            self.session,
            first,
            last,
            len(self.received),
            sent_known,
            lost.ranges(),
            never,
            absent.ranges(),
            unknown.ranges(),
            missing.ranges(),
            len(self.backfilled),
        )


def _mask(low: int, high: int, block: int) -> int:
    if high < low:
        return 0
    return ((1 << (high - low + 1)) - 1) << (low - block * BLOCK)


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
        books = self._session_of(part, now_ns)
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

    def _session(self, boot: int, now_ns: int) -> SessionBooks:
        """The session of a report that carries a boot id."""
        for books in reversed(self.sessions):
            if books.session.boot == boot:
                return books
        return self._new_session(boot, now_ns)

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
        session = self._session(f["boot"], now_ns).session
        names = ("slots", "written", "dropped", "lost", "missed", "queue", "lateness_p99_us", "write_errors")
        self._out.append(
            ev.LoggerStatus(
                session,
                recording=bool(f["recording"]),
                in_flight=bool(f["in_flight"]),
                free_bytes=None if f["free_bytes"] == 2**64 - 1 else f["free_bytes"],
                received_ns=now_ns,
                **{n: f[n] for n in names},
            )
        )

    def _link_statistics(self, frame: Frame, f: Mapping[str, Any], now_ns: int) -> None:
        books = self._session(f["boot"], now_ns)
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
        books = self._session(f["boot"], now_ns)
        first = f["first_number"]
        if first % BLOCK == 0:
            sent, absent = (int.from_bytes(bytes(f[n]), "little") for n in ("sent", "absent"))
            books.take_map(first, f["last_number"], sent, absent)

    def _scan_event(self, frame: Frame, f: Mapping[str, Any], now_ns: int) -> None:
        session = self._session(f["boot"], now_ns).session
        time_ns, number = f["time_monotonic_ns"], f["number"]
        self._out.append(ev.EventMarked(session, time_ns, number, f["origin"], f["text"], now_ns))

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


class RateMeter:
    """Shares and rates between reports of one decoder."""

    def __init__(self, decoder: AircraftDecoder) -> None:
        self._decoder = decoder
        self._last = (0, 0)
        self._last_ns: int | None = None
        self._radio: deque[Mapping[str, int]] = deque(maxlen=1)

    def radio(self, fields: Mapping[str, Any]) -> None:
        """Remember the radio's own report."""
        self._radio.append(dict(fields))

    def report(self, now_ns: int) -> ev.LinkStatistics | None:
        """Link statistics since the last report; None before the aircraft has sent a scan."""
        books = self._decoder.books
        if books is None:
            return None
        tracker = self._decoder.tracker
        received, lost = tracker.received - self._last[0], tracker.lost - self._last[1]
        self._last = (tracker.received, tracker.lost)
        span = (now_ns - self._last_ns) / NS if self._last_ns is not None else 0.0
        self._last_ns = now_ns
        scans, self._decoder.scans_since_report = self._decoder.scans_since_report, 0
        relation = self._decoder.sync.best
        return ev.LinkStatistics(
            books.session,
            now_ns,
            loss=max(0, lost) / max(1, received + max(0, lost)),
            frames_received=tracker.received,
            frames_lost=tracker.lost,
            scan_rate_hz=scans / span if span > 0 else 0.0,
            latency_s=self._decoder.latency_s,
            round_trip_s=None if relation is None else relation.round_trip_ns / NS,
            clock_offset_s=None if relation is None else relation.offset_ns / NS,
            **self._radio_values(),
        )

    def _radio_values(self) -> dict[str, Any]:
        if not self._radio:
            return {}
        f = self._radio[0]
        return {
            "rssi_dbm": _sik_dbm(f["rssi"]),
            "remote_rssi_dbm": _sik_dbm(f["remrssi"]),
            "noise_dbm": _sik_dbm(f["noise"]),
            "remote_noise_dbm": _sik_dbm(f["remnoise"]),
            "txbuf_percent": min(100, f["txbuf"]),
        }


def _sik_dbm(value: int) -> float | None:
    """SiK signal value to dBm (SiK firmware documentation: value / 1.9 - 127)."""
    return None if value == 255 else value / 1.9 - 127.0
