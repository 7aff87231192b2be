"""How much the ground may ask: requests of a sender, recordings, marks. What goes beyond is refused, counted and told.

Without a key anybody in range can ask; with one, a ground station that has gone wrong can. Neither may fill the card,
wear it out, or take the scan loop's time.
"""

from collections import OrderedDict

from daq.clock import NS
from daq.telemetry.config import LinkLimits

SENDERS = 16
"""Senders told apart; a further one takes the place of the one not heard for longest. A ground has one or two."""
ALL_SENDERS = 2
"""All senders together may ask this many times what one may: sender ids are free to choose where there is no key."""


class Bucket:
    """So many a second in the long run, and a burst at once."""

    def __init__(self, per_s: float, burst: float) -> None:
        self._per_s = per_s
        self._burst = max(1.0, burst)
        self._tokens = self._burst
        self._last_ns: int | None = None

    def take(self, now_ns: int) -> bool:
        """Whether one more is within the limit; if so it counts."""
        if self._last_ns is not None:
            self._tokens = min(self._burst, self._tokens + (now_ns - self._last_ns) / NS * self._per_s)
        self._last_ns = now_ns
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


class SenderLimits:
    """Requests of each sender (system, component), and of all of them."""

    def __init__(self, per_s: float) -> None:
        self._per_s = per_s
        self._all = Bucket(ALL_SENDERS * per_s, ALL_SENDERS * per_s)
        self._senders: OrderedDict[tuple[int, int], Bucket] = OrderedDict()

    def allow(self, sender: tuple[int, int], now_ns: int) -> bool:
        """Whether a request of this sender may be answered."""
        bucket = self._senders.get(sender)
        if bucket is None:
            bucket = self._senders[sender] = Bucket(self._per_s, self._per_s)
            if len(self._senders) > SENDERS:
                self._senders.popitem(last=False)
        self._senders.move_to_end(sender)
        return bucket.take(now_ns) and self._all.take(now_ns)


class CommandBudget:
    """What commands may cost on the card. Each question is answered with why not, in words; empty where nothing speaks
    against it.

    It is ending a recording that is refused, not beginning one: whatever is sent, the budget alone never leaves the
    aircraft without a recording.
    """

    def __init__(self, limits: LinkLimits) -> None:
        self._limits = limits
        self._marks = Bucket(limits.marks_per_s, limits.marks_at_once)
        self._begun = 0
        self._begun_ns: int | None = None

    def against_stop(self, now_ns: int) -> str:
        """Why the recording may not be ended."""
        least = self._limits.recording_s
        if self._begun >= self._limits.recordings:
            return f"all {self._limits.recordings} recordings that may be begun by command have been"
        if self._begun_ns is not None and now_ns - self._begun_ns < least * NS:
            return f"a recording begun by command lasts at least {least:g} s"
        return ""

    def against_start(self) -> str:
        """Why a recording may not be begun."""
        if self._begun >= self._limits.recordings:
            return f"all {self._limits.recordings} recordings that may be begun by command have been"
        return ""

    def started(self, now_ns: int) -> None:
        """A recording has been begun by command."""
        self._begun += 1
        self._begun_ns = now_ns

    def against_mark(self, now_ns: int) -> str:
        """Why no event may be marked; where nothing speaks against it, the mark counts."""
        return "" if self._marks.take(now_ns) else f"more than {self._limits.marks_per_s:g} marks a second"
