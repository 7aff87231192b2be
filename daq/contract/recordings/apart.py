"""Scans of two sessions under one head: bytes of another file pasted into a recording, or left behind the place where a file was
cut off. A number stands for one scan of a session, and its time rises with it; where both do not hold, there are two.

Scans of one session lie on a line: a number more is a period more on the aircraft's clock. Another session, of another start of
the computer or of the logger, lies on another line.
"""

from collections.abc import Sequence
from itertools import pairwise
from statistics import median

from daq.contract.recordings.recording import RecordedMessage
from daq.contract.scan import SCAN_TOPIC

NEAR_NS = 2_000_000_000
"""How far from its session's line a scan may lie: slots are missed one by one, and no logger starts anew in two seconds."""


MOST = 64
"""Sessions told apart within one part of a file: a card has some hundred files, and not all of them in one."""


def sessions_apart(entries: Sequence[RecordedMessage]) -> list[tuple[RecordedMessage, ...]]:
    """Entries in order of the file, taken apart by session, the one that comes first in the file first; in one piece where
    nothing contradicts that they are of one session. What is no scan goes with the scan before it."""
    scans = [e for e in entries if e.topic == SCAN_TOPIC]
    if not _contradict(scans):
        return [tuple(entries)]
    period = _period(scans)
    lines: list[float] = []  # of each session, where its line was met last: time less number times period
    groups: list[list[RecordedMessage]] = []
    current = 0
    for entry in entries:
        if entry.topic == SCAN_TOPIC:
            at = entry.log_time_ns - entry.sequence * period
            near = [i for i, line in enumerate(lines) if abs(at - line) <= NEAR_NS]
            current = min(near, key=lambda i: abs(at - lines[i])) if near else min(len(lines), MOST - 1)
            if current == len(lines):
                lines.append(at)
                groups.append([])
            lines[current] = at
        if groups:
            groups[current].append(entry)
    before = entries[: next(i for i, e in enumerate(entries) if e.topic == SCAN_TOPIC)]
    groups[0][:0] = before
    return [tuple(group) for group in groups]


def _contradict(scans: Sequence[RecordedMessage]) -> bool:
    """Whether a number stands for two scans, or time does not rise with it."""
    seen: dict[int, RecordedMessage] = {}
    if any(seen.setdefault(e.sequence, e).data != e.data for e in scans):
        return True
    return any(seen[a].log_time_ns >= seen[b].log_time_ns for a, b in pairwise(sorted(seen)))


def _period(scans: Sequence[RecordedMessage]) -> float:
    """Time from one number to the next [ns], as most neighbours in the file have it."""
    steps = [b.log_time_ns - a.log_time_ns for a, b in pairwise(scans) if b.sequence == a.sequence + 1]
    return float(median(steps)) if steps else 0.0
