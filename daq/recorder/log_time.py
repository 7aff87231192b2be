"""Which time the messages of a segment are filed under: UTC as soon as anything knows it.

A segment has one offset from the aircraft's monotonic clock to UTC, chosen with its first message. So intervals in a
file are those of the monotonic clock, and log times never jump, whatever GPS or the system's clock do meanwhile.
"""

from daq.clock import NS, Clock
from daq.contract.recordings.recording import COMPUTER, GPS, LogTime, RecordedMessage, utc_of_scan

CLOCK_SET_NS = 1_735_689_600 * NS
"""The system's clock has been set when it stands at 2025 or later: clocks without a battery begin in 1970, or when their
system was built."""
TOLERANCE_NS = NS // 10
"""A clock set from the network agrees with GPS to some 20 ms, the accuracy of a fix over a serial line; one that is off by
more than this, two scans, was not. The next segment then begins, so that it happens once in a session."""


class SessionTime:
    """What is known of UTC in a session: at first by the system's clock, if it has been set, later by GPS."""

    def __init__(self, clock: Clock) -> None:
        utc_ns = clock.utc_ns()
        known = utc_ns >= CLOCK_SET_NS
        self.best = LogTime(utc_ns - clock.monotonic_ns(), COMPUTER) if known else LogTime()

    def see(self, entry: RecordedMessage) -> None:
        """Learn from a scan that knows UTC."""
        known = utc_of_scan(entry)
        if known is not None:
            self.best = known

    def contradicts(self, used: LogTime) -> bool:
        """Whether GPS says that a segment which began before it had spoken is filed under the wrong time."""
        if used.source == GPS or self.best.source != GPS:
            return False
        return abs(self.best.offset_ns - used.offset_ns) > TOLERANCE_NS
