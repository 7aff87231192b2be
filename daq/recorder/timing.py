"""Histograms of times: how late scans begin, how long writes take.

The bins are fixed so that reports of one flight and another can be added and compared.
"""

from bisect import bisect_right
from collections.abc import Sequence
from typing import Any

from daq.contract.recordings.messages import Statistics

EDGES_US: tuple[int, ...] = (
    *(m * 10**e for e in range(1, 7) for m in (1, 2, 5)),  # 10 us to 5 s
    10_000_000,
    30_000_000,
)
"""Bin edges [us]: bin i holds times from edge i-1 up to below edge i; the first is below 10 us, the last over 30 s."""


class Histogram:
    """Counts of times over `EDGES_US`, with the largest."""

    def __init__(self) -> None:
        self.counts = [0] * (len(EDGES_US) + 1)
        self.largest_us = 0

    def add(self, time_us: int) -> None:
        """Count one time; negative ones count as their magnitude."""
        time_us = abs(time_us)
        if time_us > self.largest_us:
            self.largest_us = time_us
        self.counts[bisect_right(EDGES_US, time_us)] += 1

    def percentile(self, percent: float) -> float:
        """Upper edge of the bin that holds the percentile, at most the largest time seen [us]; 0 when empty."""
        return percentile(self.counts, percent, self.largest_us)


def percentile(counts: Sequence[int], percent: float, largest_us: int | None = None) -> float:
    """Upper edge of the bin of `counts` that holds the percentile [us]; 0 when nothing was counted."""
    total = sum(counts)
    if not total:
        return 0.0
    reached = 0
    for edge, n in zip((*EDGES_US, EDGES_US[-1] if largest_us is None else largest_us), counts, strict=True):
        reached += n
        if reached >= total * percent / 100:
            return float(edge if largest_us is None else min(edge, largest_us))
    raise AssertionError("unreachable: the counts add up to their total")


def describe(statistics: Statistics) -> list[tuple[str, float, float]]:
    """(name, median, 99th percentile) [us] of each histogram in a report that has counts."""
    names = ("lateness", "interval_error", "scan_duration", "write_latency", "sync_latency")
    rows = [(name, getattr(statistics, name)) for name in names]
    return [(name, percentile(c, 50), percentile(c, 99)) for name, c in rows if sum(c)]


class LoopTiming:
    """Timing of the scan loop: filled by the loop, read by the recorder for its reports.

    lateness: start of a scan after its deadline. interval_error: deviation of the time between two successive scans
    from the period. scan_duration: how long reading all sensors took. late: scans that began later than a tenth of
    a period after their deadline.
    """

    def __init__(self) -> None:
        self.lateness = Histogram()
        self.interval_error = Histogram()
        self.scan_duration = Histogram()
        self.late = 0

    def counts(self) -> dict[str, Any]:
        """The histograms as fields of a `Statistics` report."""
        return {
            "late_scans": self.late,
            "edges_us": EDGES_US,
            "lateness": tuple(self.lateness.counts),
            "interval_error": tuple(self.interval_error.counts),
            "scan_duration": tuple(self.scan_duration.counts),
        }
