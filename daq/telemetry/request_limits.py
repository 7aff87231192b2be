"""Limits of requests from the ground: rates of requests, recordings and marks, and commands that need an aircraft at rest.
Requests beyond them are refused and reported.

Without a key anybody in range can send requests; with one, a faulty ground station can. Neither may fill the card, wear it out,
or take up the scan loop's time.
"""

import logging
from collections import OrderedDict
from collections.abc import Callable, Sequence

from daq.clock import NS
from daq.contract.scan import Scan
from daq.sensors.standstill import PITOT_PASCAL, motion_evidence, pitot_motion_evidence
from daq.telemetry.config import LinkLimits

_LOG = logging.getLogger("sideslip.uplink")

SENDERS = 16
"""Senders with a limit of their own; a further one replaces the one silent for longest. A ground has one or two."""
ALL_SENDERS = 2
"""Limit of all senders together, as a multiple of one sender's: without a key anybody can use many sender ids."""

REPORT_NS = 5 * NS  # between two reports, however many requests are refused
_KINDS = 3  # sentences in a report: of two STATUSTEXT each, they take under 80 bytes/s of the link
_WARNING = 4  # severity of STATUSTEXT, as syslog has it


class TokenBucket:
    """A token bucket: `per_s` requests a second in the long run, `burst` at once."""

    def __init__(self, per_s: float, burst: float) -> None:
        self._per_s = per_s
        self._burst = max(1.0, burst)
        self._tokens = self._burst
        self._last_ns: int | None = None

    def allows(self, now_ns: int) -> bool:
        """Whether one more request is within the limit; if so it is counted."""
        if self._last_ns is not None:
            self._tokens = min(self._burst, self._tokens + (now_ns - self._last_ns) / NS * self._per_s)
        self._last_ns = now_ns
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


class SenderLimits:
    """Limit of the requests of each sender (system, component) and of all senders. per_s: requests a second of one sender."""

    def __init__(self, per_s: float) -> None:
        self._per_s = per_s
        self._all = TokenBucket(ALL_SENDERS * per_s, ALL_SENDERS * per_s)
        self._senders: OrderedDict[tuple[int, int], TokenBucket] = OrderedDict()

    def allow(self, sender: tuple[int, int], now_ns: int) -> bool:
        """Whether a request of this sender is within both limits; if so it is counted."""
        bucket = self._senders.get(sender)
        if bucket is None:
            bucket = self._senders[sender] = TokenBucket(self._per_s, self._per_s)
            if len(self._senders) > SENDERS:
                self._senders.popitem(last=False)
        self._senders.move_to_end(sender)
        return bucket.allows(now_ns) and self._all.allows(now_ns)


class CommandBudget:
    """Limits of the commands that write to the card. Each check returns why the command is refused, or "".

    The limit on recordings refuses to end the last one allowed, so that no sequence of commands leaves the aircraft without a
    recording.
    """

    def __init__(self, limits: LinkLimits) -> None:
        self._limits = limits
        self._marks = TokenBucket(limits.marks_per_s, limits.marks_at_once)
        self._recordings = 0  # begun by command
        self._started_ns: int | None = None

    def check_stop(self, now_ns: int) -> str:
        """Why the recording may not be ended, or ""."""
        refusal = self.check_start()
        shortest_s = self._limits.recording_s
        if not refusal and self._started_ns is not None and now_ns - self._started_ns < shortest_s * NS:
            return f"a recording begun by command lasts at least {shortest_s:g} s"
        return refusal

    def check_start(self) -> str:
        """Why a recording may not be begun, or ""."""
        if self._recordings >= self._limits.recordings:
            return f"all {self._limits.recordings} recordings that may be begun by command have been"
        return ""

    def note_start(self, now_ns: int) -> None:
        """Count a recording begun by command."""
        self._recordings += 1
        self._started_ns = now_ns

    def check_mark(self, now_ns: int) -> str:
        """Why no event may be marked, or "", in which case the mark is counted."""
        return "" if self._marks.allows(now_ns) else f"more than {self._limits.marks_per_s:g} marks a second"


class Refusals:
    """Collects refusals and reports each sentence once, with the number of its repetitions, at most every REPORT_NS.

    Beyond _KINDS different sentences, further ones are counted with the last. text: sends a severity and a text to the ground.
    """

    def __init__(self, text: Callable[[int, str], None]) -> None:
        self._text = text
        self._reported_ns: int | None = None
        self._unreported: dict[str, int] = {}

    def note(self, sentence: str) -> None:
        """Count a refusal."""
        if sentence not in self._unreported and len(self._unreported) >= _KINDS:
            sentence = next(reversed(self._unreported))
        self._unreported[sentence] = self._unreported.get(sentence, 0) + 1

    def report(self, now_ns: int) -> None:
        """Log and send what has been refused since the last report, if REPORT_NS have passed."""
        if not self._unreported or (self._reported_ns is not None and now_ns - self._reported_ns < REPORT_NS):
            return
        for sentence, count in self._unreported.items():
            line = sentence + (f" (and {count - 1} more)" if count > 1 else "")
            _LOG.warning("%s", line)
            self._text(_WARNING, line)
        self._reported_ns, self._unreported = now_ns, {}


def flight_evidence(scans: Sequence[Scan], pitot_pascal: float = PITOT_PASCAL) -> str | None:
    """Why the aircraft may be moving, in words; None when all sensors show it at rest.

    pitot_pascal: pressure of a pitot count [Pa]. Too little data counts as motion, so that a command which must not act in
    flight then does nothing.
    """
    pitot = [s.values["pitot_pressure"] for s in scans if "pitot_pressure" in s.values]
    without_imu = not any("gyro_x" in s.values for s in scans)
    return (motion_evidence(scans) if scans else None) or pitot_motion_evidence(
        pitot, check_level=without_imu, pascal=pitot_pascal
    )
