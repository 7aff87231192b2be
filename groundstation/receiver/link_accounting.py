"""Exact accounting of frames and scans: sent, received, lost, repeated, and not known yet."""

from collections.abc import Iterator

from daq.contract.link.scan_map import BLOCK, MAX_BLOCKS, ScanMap
from daq.transport.mavlink_codec import MavlinkFrame
from groundstation.receiver import events as ev
from groundstation.receiver.continuity import ScanRun
from groundstation.receiver.timeline import NS

LAST_NUMBER = 2**32 - 1  # largest scan number that a message can carry
_RATE_SPAN_NS = 10 * NS  # over which the rate of frames is measured
_COPY_NS, _RECENT = 2 * NS, 128
"""Time and number of frames within which an equal frame is a copy that came by another way: later, a slow sender's sequence
number has come round."""
_HALF = 128  # of the sequence numbers: a larger step forward is a step back


class SequenceTracker:
    """Counts frames lost, late and duplicated from the 8-bit sequence numbers of one sender.

    settled: frames lost up to the latest accepted scan; a restart of the sender does not change them.
    """

    def __init__(self) -> None:
        self.received = 0
        self.lost = 0
        self.duplicates = 0
        self.settled = 0
        self._next: int | None = None
        self._missing: set[int] = set()
        self._recent: list[tuple[int, int, int]] = [(0, 0, -_RECENT)] * 256  # by sequence: hash, time, frame count
        self._last_ns = 0
        self._anchor: tuple[int, int] | None = None  # time and number of frames from which the rate is measured
        self._rate = 0.0

    def count_frame(self, frame: MavlinkFrame, now_ns: int) -> bool:
        """Count a frame; False for a duplicate of a recent one."""
        sequence = frame.sequence
        digest, count = hash(frame.raw), self.received
        last_digest, last_ns, last_count = self._recent[sequence]
        if last_digest == digest and now_ns - last_ns < _COPY_NS and count - last_count < _RECENT:
            self.duplicates += 1
            return False
        self._recent[sequence] = digest, now_ns, count
        self.received += 1
        step = 0 if self._next is None else (sequence - self._next) & 255
        if step >= _HALF and sequence in self._missing:
            self._missing.discard(sequence)
            self.lost -= 1
            return True
        if step:
            self._count_gap(step, now_ns)
        if self._anchor is None or now_ns - self._anchor[0] >= _RATE_SPAN_NS:
            self._measure_rate(now_ns)
        self._next = (sequence + 1) & 255
        if self._missing:
            self._missing.discard(sequence)
        self._last_ns = now_ns
        return True

    def restart(self, lost_at_jump: int) -> None:
        """Remove the jump of a sender's restart, after which it counts from 0, from the frames lost.

        lost_at_jump: count of lost frames just after the jump; those lost since then stay counted.
        """
        self.lost = self.settled + self.lost - lost_at_jump
        self._missing.clear()

    def expect_any(self) -> None:
        """Accept any next sequence number without a gap."""
        self._next = None

    def _measure_rate(self, now_ns: int) -> None:
        """Measure the rate of frames since the anchor [Hz], and set the anchor here."""
        total = self.received + self.lost
        if self._anchor is not None:
            self._rate = (total - self._anchor[1]) * NS / (now_ns - self._anchor[0])
        self._anchor = (now_ns, total)

    def _count_gap(self, step: int, now_ns: int) -> None:
        """Count the frames lost before one that is `step` beyond the expected sequence number."""
        assert self._next is not None
        earlier = {number for number in self._missing if (number - self._next) & 255 >= _HALF}
        self._missing = {(self._next + i) & 255 for i in range(step)} | earlier
        # After an outage of more than 256 frames the sequence has come round: the time shows how often.
        frames_due = (now_ns - self._last_ns) / NS * self._rate
        rounds = max(0, round((frames_due - step) / 256)) if frames_due > 256 else 0
        self.lost += step + 256 * rounds


class SessionAccounting:
    """The known scans of one run of the aircraft's logger.

    received, backfilled: by scans that came; sent, absent: by the aircraft's maps; settled: block -> number up to which its map
    is final; first, last: of all known scans; run: None before the first scan.
    """

    def __init__(self, session: ev.Session) -> None:
        self.session = session
        self.received = ScanMap()
        self.sent = ScanMap()
        self.absent = ScanMap()
        self.backfilled = ScanMap()
        self.settled: dict[int, int] = {}
        self.first: int | None = None
        self.last = -1
        self.last_time_ns = 0
        self.run: ScanRun | None = None
        self.statistics: ev.AircraftStatistics | None = None

    def see(self, number: int) -> None:
        """Note that a scan of this number exists."""
        if self.first is None or number < self.first:
            self.first = number
        if number > self.last:
            self.last = number

    def reach(self, now_ns: int) -> int:
        """The highest scan number that the aircraft can have reached at `now_ns`."""
        return LAST_NUMBER if self.run is None else max(self.last, self.run.reach(now_ns))

    def fits(self, number: int, time_ns: int) -> bool:
        """Whether a scan of that number can have been made at `time_ns`; True before the first scan."""
        return self.run is None or self.run.fits(number, time_ns)

    def take_map(self, first: int, settled_number: int, sent_bits: int, absent_bits: int) -> None:
        """Use the map of a block from scan `first`, which is final up to `settled_number`; one older than the last is ignored."""
        block, top = first // BLOCK, first + BLOCK - 1
        if settled_number < first or settled_number < self.settled.get(block, -1):
            return
        if block not in self.settled and len(self.settled) >= MAX_BLOCKS:
            return
        last = min(settled_number, top)
        mask = (1 << (last - first + 1)) - 1
        self.settled[block] = last
        self.sent.set_word(block, self.sent.word(block) | sent_bits & mask)
        self.absent.set_word(block, self.absent.word(block) | absent_bits & mask)

    def open_blocks(self) -> Iterator[int]:
        """Blocks up to that of the last scan whose map is not final, ascending."""
        span = self._span()
        if span is not None:
            first, last = span
            for block in range(first // BLOCK, last // BLOCK + 1):
                if self.settled.get(block, -1) < min(last, block * BLOCK + BLOCK - 1):
                    yield block

    def _span(self) -> tuple[int, int] | None:
        """First and last known scan; None without one."""
        if self.first is None:
            return None
        first, last = self.first, self.last
        if self.statistics is not None and self.statistics.scans_offered:
            first, last = min(first, self.statistics.first_number), max(last, self.statistics.last_number)
        return first, last

    def totals(self) -> ev.Accounting:
        """The fate of all scans. Time and memory depend on the known blocks, not on the distance of forged numbers."""
        span = self._span()
        if span is None:
            return ev.Accounting(self.session, 0, -1, 0, 0)
        lost_map, missing, open_, absent, never = ScanMap(), ScanMap(), ScanMap(), ScanMap(), 0
        sent_known = 0
        first, last = span
        known_blocks = {*self.received.blocks(), *self.sent.blocks(), *self.absent.blocks(), *self.settled}
        blocks = sorted(b for b in known_blocks if first // BLOCK <= b <= last // BLOCK)
        for block in blocks:
            low, high = max(first, block * BLOCK), min(last, block * BLOCK + BLOCK - 1)
            block_mask = _mask(low, high, block)
            settled_mask = _mask(low, min(high, self.settled.get(block, -1)), block)
            received = self.received.word(block)
            sent_bits = (self.sent.word(block) & settled_mask) | received
            sent_known += (sent_bits & block_mask).bit_count()
            lost_map.set_word(block, sent_bits & ~received & block_mask)
            missing.set_word(block, lost_map.word(block) & ~self.backfilled.word(block))
            absent_bits = self.absent.word(block) & settled_mask
            absent.set_word(block, absent_bits)
            open_.set_word(block, block_mask & ~settled_mask & ~received)
            never += (block_mask & settled_mask & ~sent_bits & ~absent_bits).bit_count()
        return ev.Accounting(
            self.session,
            first,
            last,
            len(self.received),
            sent_known,
            lost_map.ranges(),
            never,
            absent.ranges(),
            _joined([*open_.ranges(), *_gaps(blocks, first, last)]),
            missing.ranges(),
            len(self.backfilled),
        )


def _gaps(blocks: list[int], first: int, last: int) -> Iterator[tuple[int, int]]:
    """Ranges of numbers from `first` to `last` that are in none of the blocks (ascending)."""
    start = first
    for block in blocks:
        if start < block * BLOCK:
            yield start, block * BLOCK - 1
        start = (block + 1) * BLOCK
    if start <= last:
        yield start, last


def _joined(ranges: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The ranges in ascending order, with adjacent ones merged."""
    joined: list[tuple[int, int]] = []
    for low, high in sorted(ranges):
        if joined and joined[-1][1] == low - 1:
            joined[-1] = (joined[-1][0], high)
        else:
            joined.append((low, high))
    return joined


def _mask(low: int, high: int, block: int) -> int:
    """Bit mask of the numbers from `low` to `high` in a block; 0 for none."""
    if high < low:
        return 0
    return ((1 << (high - low + 1)) - 1) << (low - block * BLOCK)
