"""The downlink: sends scans and status to the ground at the rate that the radio carries, without blocking the scan loop.

`offer` takes every scan; `service` follows each. Scans are chosen by time, so that their mean rate is exact. The downlink reports
which scans it has sent, so that the ground can distinguish scans lost on the link from those never sent. The rate follows the
radio's report of its buffer (RADIO_STATUS). Anybody could forge that, but it lowers the rate to 2 Hz at worst and does not affect
the heartbeat.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence

from daq.clock import NS, Clock
from daq.contract.channels import Channel
from daq.contract.link.scan_map import BLOCK, ScanMap
from daq.contract.link.wire import SCAN_FAST_ID, SCAN_LABORATORY_ID, SCAN_RARE_ID, SCAN_SLOW_ID, layouts, pack_scan
from daq.contract.recordings.messages import EventMessage, SequencerFrame, Statistics
from daq.contract.scan import Scan
from daq.telemetry.config import MIN_RATE_HZ, DownlinkConfig, max_rate
from daq.telemetry.control import Control, NoLogger
from daq.telemetry.request_limits import flight_evidence
from daq.telemetry.send_queue import Item, SendQueue, item
from daq.telemetry.standard_messages import StandardMessages, heartbeat
from daq.transport.mavlink_codec import FrameEncoder
from daq.transport.ports import BytePort
from daq.transport.signing import Signer

LOW_BUFFER, HIGH_BUFFER = 20, 90
"""RADIO_STATUS txbuf [% free] below which the rate is halved, above which it is raised."""
_STEP_UP = 1.25
_ADAPT_NS = NS // 2  # two reports closer together than this count as one
_RECOVER_NS = 5 * NS  # without reports for so long, the rate is raised again step by step
_RECENT_SCANS = 40  # by which the aircraft is judged to be at rest: two seconds at 20 Hz
_MAP_REPEATS = 3  # times that each SENT_MAP is sent, against loss
_MAP_DELAY = 64  # scans to wait after a block ends, so that queued scans have been sent or dropped
_PAUSE_NS = NS  # without scans before the maps are sent; doubled for each repetition
_FIRST_NS = 3 * NS  # one message of each kind, 600 bytes, takes as long beside scans at the default budget
_TEXT_CHARS = 50  # of one STATUSTEXT


class Downlink:
    """Sends over one radio link. Call all methods from the scan loop's thread.

    boot: random number of this start of the logger (1 to 255). facts: returns run-time facts of the sensors; called at a low
    rate. logger: the one whose state and statistics are sent.
    """

    def __init__(
        self,
        config: DownlinkConfig,
        port: BytePort,
        clock: Clock,
        *,
        boot: int,
        signer: Signer | None = None,
        facts: Callable[[], Mapping[str, str]] = dict,
    ) -> None:
        self.boot = boot & 255 or 1
        self.config = config
        self.sent = ScanMap()
        self.offered = ScanMap()
        self.rejected_frames = self.rejected_commands = 0  # by the uplink, for LINK_STATISTICS
        self.recent: deque[Scan] = deque(maxlen=_RECENT_SCANS)
        self._clock = clock
        self._layouts = layouts()
        self.logger: Control = NoLogger()
        self.messages = StandardMessages(config, lambda: self.logger.recording, facts)
        encoder = FrameEncoder(config.system_id, config.component_id, signer, private=config.data_component_id)
        self.send_queue = SendQueue(port, encoder, config.budget_bytes_per_s, config.scan_queue)
        self._requested_rate = config.rate_hz
        self._factor = 1.0
        self._adapted_ns = 0
        self._radio_ns: int | None = None
        self._next_fast = 0.0
        self._next_slow = 0.0
        self._rare = _GroupRotation(self._layouts[SCAN_RARE_ID].channels)
        laboratory_channels = self._layouts[SCAN_LABORATORY_ID].channels if SCAN_LABORATORY_ID in self._layouts else ()
        self._laboratory = _GroupRotation(laboratory_channels)
        self._laboratory_always = any(c.downlink == "fast" for c in laboratory_channels)
        self._first: int | None = None
        self._last = 0
        self._text_id = 0
        self._next_heartbeat: int | None = None
        self._timers = _Timers(
            {
                "VFR_HUD": config.display_rate_hz,
                "AOA_SSA": config.display_rate_hz,
                "GLOBAL_POSITION_INT": config.display_rate_hz,
                "ATTITUDE": config.attitude_rate_hz,
                "GPS_RAW_INT": config.gps_raw_rate_hz,
                "SYS_STATUS": config.sys_status_rate_hz,
                "BATTERY_STATUS": config.extra_rate_hz,
                "SCALED_PRESSURE": config.extra_rate_hz,
                "SERVO_OUTPUT_RAW": config.extra_rate_hz,
                "WIND_COV": config.extra_rate_hz,
                "NAMED_VALUE_FLOAT": config.display_rate_hz,
                "LINK_STATISTICS": config.statistics_rate_hz,
                "LOGGER_STATUS": config.statistics_rate_hz,
            }
        )
        self._scans_come = False  # since the last service
        self._pause_reports = 0
        self._pause_ns = 0
        self._unsettled: list[int] = []  # numbers of scans in the queue

    # -------------------------------------------------------------------------------------------------- scans

    @property
    def rate_hz(self) -> float:
        """Present scan rate [Hz]."""
        return max(MIN_RATE_HZ, self._requested_rate * self._factor)

    def set_rate(self, rate_hz: float) -> bool:
        """Set the scan rate [Hz]; False, without a change, below MIN_RATE_HZ or beyond the byte budget."""
        if not MIN_RATE_HZ <= rate_hz <= max_rate(self.config.budget_bytes_per_s):
            return False
        self._requested_rate = rate_hz
        return True

    def offer(self, scan: Scan) -> None:
        """Take a scan, and queue it if one is due."""
        number, time = scan.number, scan.time
        self.offered.add(number)
        self._scans_come = True
        self.recent.append(scan)
        if self._first is None:
            self._first = number
        self._last = number
        self.messages.offer(scan)
        if number % BLOCK == _MAP_DELAY:
            self._report_maps(number // BLOCK)
        if time < self._next_fast - 1e-6:
            return
        period = 1.0 / self.rate_hz
        is_late = time - self._next_fast > period
        self._next_fast = (time if is_late else self._next_fast) + period
        self._send_scan(scan, time)

    def _send_scan(self, scan: Scan, time: float) -> None:
        # slow parts go first, so that the scan is complete on the ground when the fast part arrives
        table = self._layouts
        items = []
        if time >= self._next_slow:
            items.append(Item(SCAN_SLOW_ID, pack_scan(table[SCAN_SLOW_ID], scan, self.boot)))
            self._next_slow = time + 1.0 / self.config.slow_rate_hz / self._factor
        if self._rare.due(scan):
            items.append(Item(SCAN_RARE_ID, pack_scan(table[SCAN_RARE_ID], scan, self.boot)))
            self._rare.next = time + 1.0 / self.config.gnss_rate_hz / self._factor
        if self._laboratory.due(scan):
            items.append(Item(SCAN_LABORATORY_ID, pack_scan(table[SCAN_LABORATORY_ID], scan, self.boot)))
            if not self._laboratory_always:
                self._laboratory.next = time + 1.0 / self.config.slow_rate_hz / self._factor
        fast = pack_scan(table[SCAN_FAST_ID], scan, self.boot)
        number = scan.number
        items.append(Item(SCAN_FAST_ID, fast, lambda: self._settle(number, True), lambda: self._settle(number, False)))
        self._unsettled.append(number)
        self.send_queue.put_scan(items)

    def _settle(self, number: int, sent: bool) -> None:
        self._unsettled.remove(number)
        if sent:
            self.sent.add(number)

    @property
    def settled(self) -> int:
        """Number of the last scan up to which all have been sent or dropped."""
        return min(self._unsettled) - 1 if self._unsettled else self._last

    def _report_maps(self, block: int) -> None:
        for i in range(max(0, block - _MAP_REPEATS), block):
            self.send_queue.put_low(self.sent_map(i))

    def sent_map(self, block: int) -> Item:
        """The SENT_MAP message of a block of scan numbers."""
        full_block = (1 << BLOCK) - 1
        absent = (~self.offered.word(block) & full_block).to_bytes(BLOCK // 8, "little")
        return item(
            "SENT_MAP",
            first_number=block * BLOCK,
            last_number=max(0, self.settled),
            boot=self.boot,
            sent=self.sent.to_bytes(block),
            absent=absent,
        )

    # -------------------------------------------------------------------------------------------------- service

    def service(self, now_ns: int) -> None:
        """Send what is due at `now_ns` (monotonic)."""
        if self._next_heartbeat is None or now_ns >= self._next_heartbeat:
            is_late = self._next_heartbeat is None or now_ns - self._next_heartbeat > NS
            self._next_heartbeat = (now_ns if is_late else self._next_heartbeat or now_ns) + NS
            self.send_queue.put_urgent(heartbeat(self.logger.recording))
        if self._factor < 1.0:
            self._recover(now_ns)
        if self._scans_come:
            self._scans_come, self._pause_reports, self._pause_ns = False, 0, now_ns
        elif self._pause_reports < _MAP_REPEATS and self.recent:
            self._report_pause(now_ns)
        if now_ns >= self._timers.soonest and not self.send_queue.has_low:
            self._queue_due(now_ns)
        self.send_queue.service(now_ns)

    def _report_pause(self, now_ns: int) -> None:
        """When scans stop, repeat the maps and statistics, so that the ground can account for all scans."""
        if now_ns >= self._pause_ns + (_PAUSE_NS << self._pause_reports):
            self._pause_reports += 1
            block = self._last // BLOCK
            self.send_queue.put_low(self.sent_map(block))
            self._report_maps(block)
            self.send_queue.put_low(self.statistics())

    def _queue_due(self, now_ns: int) -> None:
        name = self._timers.due(now_ns, self._factor)
        if name is None:
            return
        make = {"LINK_STATISTICS": self.statistics, "LOGGER_STATUS": self._logger_status}.get(name)
        message = self.messages.make(name) if make is None else make()
        if message is not None:
            self.send_queue.put_low(message)

    def statistics(self) -> Item:
        """The present LINK_STATISTICS message."""
        queue = self.send_queue
        return item(
            "LINK_STATISTICS",
            bytes_sent=queue.bytes_sent,
            first_number=self._first or 0,
            last_number=self._last,
            scans_offered=len(self.offered),
            scans_sent=len(self.sent),
            scans_dropped=queue.scans_dropped,
            frames_sent=queue.frames_sent,
            boot=self.boot,
            rate_centihz=min(65535, round(self.rate_hz * 100)),
            rejected_frames=min(65535, self.rejected_frames),
            rejected_commands=min(65535, self.rejected_commands),
        )

    def _logger_status(self) -> Item:
        statistics = self.logger.statistics() or Statistics(0, 0, "", 0)
        return item(
            "LOGGER_STATUS",
            free_bytes=statistics.extra.get("free_bytes", 2**64 - 1),
            **{name: getattr(statistics, name) for name in ("slots", "written", "dropped", "lost", "missed")},
            boot=self.boot,
            queue=min(65535, statistics.pending),
            lateness_p99_us=min(65535, _percentile(statistics.edges_us, statistics.lateness, 0.99)),
            write_errors=min(65535, statistics.write_errors),
            recording=int(self.logger.recording),
            in_flight=int(flight_evidence(self.recent, self.messages.display.pitot_pascal) is not None),
        )

    def text(self, severity: int, text: str) -> None:
        """Send a STATUSTEXT; severity as in syslog (0 emergency to 7 debug). A long text is sent in numbered pieces."""
        pieces = [text[i : i + _TEXT_CHARS] for i in range(0, len(text), _TEXT_CHARS)] or [""]
        if len(pieces) > 1 and len(pieces[-1]) == _TEXT_CHARS:
            pieces.append("")  # a piece shorter than the field ends the text
        if len(pieces) > 1:
            self._text_id = self._text_id % 65535 + 1
        for i, piece in enumerate(pieces):
            number = self._text_id if len(pieces) > 1 else 0
            self.send_queue.put_urgent(item("STATUSTEXT", severity=severity, text=piece, id=number, chunk_seq=i))

    def event(self, event: EventMessage) -> None:
        self.send_queue.put_urgent(
            item(
                "SCAN_EVENT",
                time_monotonic_ns=event.time_monotonic_ns,
                number=event.number,
                boot=self.boot,
                origin=event.origin[:16],
                text=event.text.encode()[:60].decode("utf-8", "ignore"),
            )
        )

    def sequencer(self, frame: SequencerFrame) -> None:
        self.send_queue.put_urgent(
            item(
                "SEQUENCER_STATUS",
                time_monotonic_ns=frame.time_monotonic_ns,
                number=frame.number,
                elapsed_ms=min(frame.elapsed_us // 1000, 2**32 - 1),
                boot=self.boot,
                state=frame.state,
                reason=frame.reason,
                switch_position=frame.switch,
                flags=frame.beating | frame.limited << 1,
                increments=[_increment(value) for value in (*frame.increments, 0.0, 0.0, 0.0)[:3]],
            )
        )

    # -------------------------------------------------------------------------------------------------- adaptation

    def radio_status(self, txbuf: int, now_ns: int) -> None:
        """Adapt the rate to the free share of the radio's buffer [%]."""
        if self._radio_ns is not None and now_ns - self._radio_ns < _ADAPT_NS:
            return
        self._radio_ns = self._adapted_ns = now_ns
        if txbuf < LOW_BUFFER:
            self._set_factor(self._factor / 2)
        elif txbuf > HIGH_BUFFER:
            self._set_factor(self._factor * _STEP_UP)

    def _recover(self, now_ns: int) -> None:
        if now_ns - self._adapted_ns > _RECOVER_NS:
            self._adapted_ns = now_ns
            self._set_factor(self._factor * _STEP_UP)

    def _set_factor(self, factor: float) -> None:
        lowest = MIN_RATE_HZ / self._requested_rate
        self._factor = min(1.0, max(lowest, factor))
        self.send_queue.budget = self.config.budget_bytes_per_s * self._factor


class _GroupRotation:
    """Chooses the scans that go with a message whose groups of channels are sampled less often than scans.

    next: when the next message is due [s]. It goes with the first scan from then on that has a value of the group whose last
    value was sent longest ago, so that no group is always missed; after a second without one it goes without.
    """

    def __init__(self, channels: Sequence[Channel]) -> None:
        self.next = 0.0
        self._names = {
            g: frozenset(c.name for c in channels if c.group == g) for g in dict.fromkeys(c.group for c in channels)
        }
        self._sent = dict.fromkeys(self._names, -math.inf)

    def due(self, scan: Scan) -> bool:
        """Whether the message goes with this scan."""
        if not self._sent or scan.time < self.next:
            return False
        next_group = min(self._sent, key=lambda g: self._sent[g])
        present = {g for g, names in self._names.items() if not names.isdisjoint(scan.values)}
        if next_group not in present and scan.time < self.next + 1.0:
            return False
        self._sent.update(dict.fromkeys((*present, next_group), scan.time))
        return True


def _increment(value: float) -> int:
    """An increment of a control [1e-4 rad]."""
    return min(max(round(value * 1e4), -32767), 32767)


def _percentile(edges_us: Sequence[int], counts: Sequence[int], share: float) -> int:
    """Upper edge of the histogram bin that holds a percentile [us]; 65535 for the last bin, which has none."""
    cumulative, total = 0, sum(counts)
    for edge, count in zip((*edges_us, 65535), counts, strict=False):
        cumulative += count
        if total and cumulative >= share * total:
            return edge
    return 0


class _Timers:
    """Chooses the periodic message that is due; of several, the one that is overdue by most of its periods."""

    def __init__(self, rates_hz: dict[str, float]) -> None:
        self._periods = {name: NS / rate for name, rate in rates_hz.items()}
        self._next: dict[str, float] = {}
        self.soonest = -math.inf  # when the next message is due [ns]

    def due(self, now_ns: int, factor: float) -> str | None:
        """Name of a message to send now, None without one. factor: by which all rates are reduced."""
        if not self._next:
            # spread, so that they do not stay bunched, but not so far that a station waits long for the rarest
            count = len(self._periods)
            self._next = {n: now_ns + min(p, _FIRST_NS) * i / count for i, (n, p) in enumerate(self._periods.items())}
        due_name, largest = None, -math.inf
        for name, due in self._next.items():
            overdue = (now_ns - due) / self._periods[name]
            if overdue >= 0 and overdue > largest:
                due_name, largest = name, overdue
        if due_name is not None:
            period = self._periods[due_name] / factor
            self._next[due_name] = max(self._next[due_name] + period, now_ns)
        self.soonest = min(self._next.values())
        return due_name
