"""What the ground may ask: how many requests, recordings and marks, and what only at rest. The rest is refused and told.

Without a key anybody in range can ask; with one, a ground station that has gone wrong can. Neither may fill the card,
wear it out, or take the scan loop's time.
"""

import logging
from collections import OrderedDict
from collections.abc import Callable, Sequence

from daq.clock import NS
from daq.contract.scan import Scan
from daq.sensors.standstill import PITOT_PASCAL, pitot_unrest, unrest
from daq.telemetry.config import LinkLimits

_LOG = logging.getLogger("sideslip.uplink")

SENDERS = 16
"""Senders told apart; a further one takes the place of the one not heard for longest. A ground has one or two."""
ALL_SENDERS = 2
"""All senders together may ask this many times what one may: sender ids are free to choose where there is no key."""

REPORT_NS = 5 * NS  # who is refused a thousand times a second is not told so each time
_KINDS = 3  # sentences told at a time: two STATUSTEXT each, they take under 80 bytes/s of the link
_WARNING = 4


class Bucket:
    """So many a second in the long run, and a burst at once."""

    def __init__(self, per_s: float, burst: float) -> None:
        self._per_s = per_s
        self._burst = max(1.0, burst)
        self._tokens = self._burst
        self._last_ns: int | None = None

    def allows(self, now_ns: int) -> bool:
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
        return bucket.allows(now_ns) and self._all.allows(now_ns)


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
        shortest_s = self._limits.recording_s
        if self._begun >= self._limits.recordings:
            return f"all {self._limits.recordings} recordings that may be begun by command have been"
        if self._begun_ns is not None and now_ns - self._begun_ns < shortest_s * NS:
            return f"a recording begun by command lasts at least {shortest_s:g} s"
        return ""

    def against_start(self) -> str:
        """Why a recording may not be begun."""
        if self._begun >= self._limits.recordings:
            return f"all {self._limits.recordings} recordings that may be begun by command have been"
        return ""

    def started(self, now_ns: int) -> None:
        self._begun += 1
        self._begun_ns = now_ns

    def against_mark(self, now_ns: int) -> str:
        """Why no event may be marked; where nothing speaks against it, the mark counts."""
        return "" if self._marks.allows(now_ns) else f"more than {self._limits.marks_per_s:g} marks a second"


class Refusals:
    """Collects sentences and tells each kind once with the number of its repetitions, at most every five seconds.

    Of very many kinds some are told, and the others are in the number of the last. text: takes severity and words for the
    ground.
    """

    def __init__(self, text: Callable[[int, str], None]) -> None:
        self._text = text
        self._reported_ns: int | None = None
        self._unreported: dict[str, int] = {}

    def note(self, words: str) -> None:
        if words not in self._unreported and len(self._unreported) >= _KINDS:
            words = next(reversed(self._unreported))
        self._unreported[words] = self._unreported.get(words, 0) + 1

    def report(self, now_ns: int) -> None:
        """Say what has been refused, if it is time to."""
        if not self._unreported or (self._reported_ns is not None and now_ns - self._reported_ns < REPORT_NS):
            return
        for words, count in self._unreported.items():
            sentence = words + (f" (and {count - 1} more)" if count > 1 else "")
            _LOG.warning("%s", sentence)
            self._text(_WARNING, sentence)
        self._reported_ns, self._unreported = now_ns, {}


def flight_evidence(scans: Sequence[Scan], pitot_pascal: float = PITOT_PASCAL) -> str | None:
    """Why the aircraft may not be standing still, in words; None when nothing speaks for motion.

    Too little data speaks for motion: a command that must not act in flight then does nothing.
    """
    pitot = [s.values["pitot_pressure"] for s in scans if "pitot_pressure" in s.values]
    without_imu = not any("gyro_x" in s.values for s in scans)
    return (unrest(scans) if scans else None) or pitot_unrest(pitot, level_tells=without_imu, pascal=pitot_pascal)
