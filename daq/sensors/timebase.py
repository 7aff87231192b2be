"""The relation between the aircraft's monotonic clock and UTC, estimated from GPS alone.

The operating system's UTC may be unset, or step when it is corrected; the monotonic clock never steps. Scans are therefore timed
on the monotonic clock, and UTC is a line fitted to the GPS receiver's times: offset and drift, with an accuracy. Two kinds of
observation: the arrival of a fix over the serial line, late by the receiver's latency and the time to the next poll (accurate to
some 15 ms), and the edge of a pulse-per-second line (accurate to microseconds). Once there are edges, arrivals only decide which
second an edge belongs to.
"""

import math
from collections import deque
from dataclasses import dataclass

from daq.clock import NS

MS = 1_000_000
EARLIEST_UTC_NS = 1_704_067_200 * NS
"""2024-01-01: an earlier UTC comes from a receiver that has no time yet, or whose week number rolled over (`rollovers`)."""
ROLLOVER_NS = 1024 * 7 * 86_400 * NS


def rollovers(utc_ns: int) -> int:
    """How often the week number of a receiver that reports this date [ns] has rolled over: GPS sends ten bits of it."""
    return max(0, -((utc_ns - EARLIEST_UTC_NS) // ROLLOVER_NS))


@dataclass(frozen=True, slots=True)
class Relation:
    """UTC = monotonic + offset + drift * (monotonic - reference).

    reference_ns: monotonic time at the middle of the observations [ns]. drift: seconds of UTC gained per monotonic second.
    accuracy_ns: one sigma at the reference [ns]. source: `fix` or `pps`.
    """

    reference_ns: int
    offset_ns: int
    drift: float
    accuracy_ns: int
    source: str

    def utc_ns(self, monotonic_ns: int) -> int:
        """UTC at a monotonic time [ns]."""
        return monotonic_ns + self.offset_ns + round(self.drift * (monotonic_ns - self.reference_ns))


class _OffsetLine:
    """A line fitted to observed offsets, of which each second contributes the one with the shortest delay.

    An observation that differs from the line by more than `jump_ns` is not used; when `_AGREED` in a row differ equally, time has
    jumped (a leap second, a receiver that was wrong before) and the line restarts. drift_after_s: span of observations from which
    a drift is fitted [s].
    """

    _BINS = 128
    _EAGER = 16  # with fewer bins the line is fitted again at every change of the last one
    _AGREED = 5

    def __init__(self, jump_ns: int, drift_after_s: float) -> None:
        self._jump_ns = jump_ns
        self._drift_after_ns = round(drift_after_s * NS)
        self._bins: deque[tuple[int, int]] = deque(maxlen=self._BINS)  # monotonic, offset = utc - monotonic
        self._contradictions: list[tuple[int, int]] = []
        self._line = (0, 0, 0.0)  # reference, offset, drift
        self.scatter_ns = 0.0  # root mean square distance of the observations from the line [ns]

    def __len__(self) -> int:
        return len(self._bins)

    def add_offset(self, monotonic_ns: int, offset_ns: int) -> None:
        if self._bins and abs(offset_ns - self.offset_at(monotonic_ns)) > self._jump_ns:
            self._contradict(monotonic_ns, offset_ns)
            return
        self._contradictions.clear()
        bins = self._bins
        same_second = bool(bins) and monotonic_ns // NS <= bins[-1][0] // NS
        if same_second:
            if offset_ns <= bins[-1][1]:
                return
            bins.pop()  # a larger offset has a shorter delay: it replaces the one of its second
        bins.append((monotonic_ns, offset_ns))
        if not same_second or len(bins) < self._EAGER:
            self._fit()

    def _contradict(self, monotonic_ns: int, offset_ns: int) -> None:
        contradictions = self._contradictions
        if contradictions and abs(contradictions[0][1] - offset_ns) > self._jump_ns // 4:
            contradictions.clear()
        contradictions.append((monotonic_ns, offset_ns))
        if len(contradictions) >= self._AGREED:
            self._bins.clear()
            self._bins.extend(contradictions[-1:])
            contradictions.clear()
            self._fit()

    def _fit(self) -> None:
        bins = self._bins
        t0, o0 = bins[0]
        n = len(bins)
        mean_t = sum(t - t0 for t, _ in bins) / n
        mean_o = sum(o - o0 for _, o in bins) / n
        drift = 0.0
        if bins[-1][0] - t0 >= self._drift_after_ns:
            spread = sum((t - t0 - mean_t) ** 2 for t, _ in bins)
            drift = sum((t - t0 - mean_t) * (o - o0 - mean_o) for t, o in bins) / spread
        self._line = (t0 + round(mean_t), o0 + round(mean_o), drift)
        if n >= 3:  # computed here, because every scan reads it
            self.scatter_ns = math.sqrt(sum((o - self.offset_at(t)) ** 2 for t, o in bins) / n)
        else:
            self.scatter_ns = 0.0

    @property
    def line(self) -> tuple[int, int, float]:
        """Reference [ns], offset there [ns], drift."""
        return self._line

    def offset_at(self, monotonic_ns: int) -> int:
        reference, offset, drift = self._line
        return offset + round(drift * (monotonic_ns - reference))


class TimeBase:
    """Collects observations and converts between monotonic time and UTC.

    latency_ns: shortest time from a fix to its arrival [ns]. poll_ns: interval at which the serial port is read [ns]; arrivals
    are on average late by half of it.
    """

    PPS_LOST_NS = 10 * NS
    LATENCY_SIGMA_NS = 10 * MS
    PPS_SIGMA_NS = 5_000  # interrupt latency of the kernel's stamp

    def __init__(self, latency_ns: int, poll_ns: int) -> None:
        self.poll_ns = poll_ns
        self._delay_ns = latency_ns + poll_ns // 2
        self._poll_sigma_ns = poll_ns / math.sqrt(12)
        self._fixes = _OffsetLine(jump_ns=300 * MS, drift_after_s=60.0)
        self._pulses = _OffsetLine(jump_ns=200_000, drift_after_s=10.0)
        self._time_accuracy_ns = 0
        self._last_pulse_ns: int | None = None
        self._last_edge_ns: int | None = None
        self._by_fixes: Relation | None = None  # cached until the next observation, because every scan reads it
        self._by_pulses: Relation | None = None

    def observe_fix(self, monotonic_ns: int, utc_ns: int, accuracy_ns: int) -> None:
        """A fix valid at `utc_ns` (one sigma `accuracy_ns`) was received at `monotonic_ns`."""
        self._fixes.add_offset(monotonic_ns, utc_ns - (monotonic_ns - self._delay_ns))
        self._time_accuracy_ns = accuracy_ns
        self._by_fixes = self._by_pulses = None

    def observe_instant(self, monotonic_ns: int, utc_ns: int, accuracy_ns: int) -> None:
        """It was `utc_ns` (one sigma `accuracy_ns`) at `monotonic_ns`: by a sender whose own clock is related to ours."""
        self._fixes.add_offset(monotonic_ns, utc_ns - monotonic_ns)
        self._time_accuracy_ns = accuracy_ns
        self._by_fixes = self._by_pulses = None

    def observe_pulse(self, monotonic_ns: int) -> None:
        """The rising edge of the pulse-per-second line was stamped at `monotonic_ns`; edges mark whole UTC seconds."""
        if not len(self._fixes) or monotonic_ns == self._last_edge_ns:
            return
        self._last_edge_ns = monotonic_ns
        estimate = monotonic_ns + self._fixes.offset_at(monotonic_ns)
        second = (estimate + NS // 2) // NS * NS
        if abs(estimate - second) > 300 * MS:
            return  # cannot be told apart from its neighbour: no edge of this receiver
        self._pulses.add_offset(monotonic_ns, second - monotonic_ns)
        self._last_pulse_ns = monotonic_ns
        self._by_pulses = None

    def relation(self, now_ns: int) -> Relation | None:
        """The relation as known now; None before the first resolved fix."""
        last = self._last_pulse_ns
        if last is not None and now_ns - last < self.PPS_LOST_NS and len(self._pulses):
            if self._by_pulses is None:
                sigma = math.hypot(self.PPS_SIGMA_NS, self._time_accuracy_ns, self._pulses.scatter_ns)
                self._by_pulses = Relation(*self._pulses.line, accuracy_ns=round(sigma), source="pps")
            return self._by_pulses
        if self._by_fixes is None and len(self._fixes):
            delays = math.hypot(self._poll_sigma_ns, self.LATENCY_SIGMA_NS)
            sigma = math.hypot(self._time_accuracy_ns, delays, self._fixes.scatter_ns)
            self._by_fixes = Relation(*self._fixes.line, accuracy_ns=round(sigma), source="fix")
        return self._by_fixes

    def utc(self, monotonic_ns: int) -> tuple[int, int]:
        """UTC and its one-sigma accuracy at a monotonic time [ns]; (0, 0) while unknown."""
        relation = self.relation(monotonic_ns)
        if relation is None:
            return 0, 0
        return relation.utc_ns(monotonic_ns), min(relation.accuracy_ns, 2**32 - 1)

    def monotonic_ns(self, utc_ns: int) -> int | None:
        """Monotonic time of a UTC instant [ns]; None while unknown."""
        line = self._pulses if len(self._pulses) else self._fixes
        if not len(line):
            return None
        _, offset, _ = line.line
        return utc_ns - line.offset_at(utc_ns - offset)
