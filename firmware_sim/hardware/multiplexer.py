"""What stands between two sources of servo pulses and the servos: a monostable, and a multiplexer the pilot switches.

The monostable is kept up by edges of the heartbeat. It enables the servo driver (OE) and lets SEL pulses through to the
multiplexer. The multiplexer goes by SEL alone: wide pulses choose its second source; lost pulses choose the first.
"""

from bisect import bisect_right
from collections.abc import Callable

MONOSTABLE_NS = 60_000_000
SEL_LOST_NS = 35_000_000
"""The multiplexer takes SEL for lost after so long. With the monostable's time: below 0.1 s."""
FRAME_NS = 20_000_000
THRESHOLD_US = 1700.0
_KEPT = 4096  # edges; at 50 a second more than anybody looks back


class Monostable:
    """Retriggerable, with a clear input; also the heartbeat as the software sees it. now_ns: of the clock edges come by."""

    def __init__(self, now_ns: Callable[[], int], width_ns: int = MONOSTABLE_NS) -> None:
        self._now = now_ns
        self._width_ns = width_ns
        self._edges: list[int] = []
        self._clears: list[int] = []
        self.broken = lambda time_ns: False  # whether the line is cut at a time [ns]

    def beat(self) -> None:
        """A rising edge."""
        now = self._now()
        if not self.broken(now):
            self._edges.append(now)
            del self._edges[:-_KEPT]

    def release(self) -> None:
        """The clear input."""
        self._clears.append(self._now())
        del self._clears[:-_KEPT]

    def up(self, time_ns: int) -> bool:
        """Whether its output is up at a time [ns]."""
        last = bisect_right(self._edges, time_ns) - 1
        if last < 0 or time_ns - self._edges[last] >= self._width_ns:
            return False
        cleared = bisect_right(self._clears, time_ns) - 1
        return cleared < 0 or self._clears[cleared] < self._edges[last]

    @property
    def last_edge_ns(self) -> int | None:
        """When the last edge came; None before the first."""
        return self._edges[-1] if self._edges else None


class Multiplexer:
    """switch_us: width of the receiver's switch channel at a time [ns], 0 without pulses. gate: lets SEL pulses through."""

    def __init__(
        self, switch_us: Callable[[int], float], gate: Callable[[int], bool], sel_lost_ns: int = SEL_LOST_NS
    ) -> None:
        self._switch_us, self._gate = switch_us, gate
        self._sel_lost_ns = sel_lost_ns

    def selects_second(self, time_ns: int) -> bool:
        """Whether the second source, the servo driver, reaches the servos at a time [ns]."""
        frame = time_ns // FRAME_NS * FRAME_NS
        while frame >= 0 and time_ns - frame <= self._sel_lost_ns:
            width = self._switch_us(frame)
            if width > 0.0 and self._gate(frame):
                return width > THRESHOLD_US
            frame -= FRAME_NS
        return False
