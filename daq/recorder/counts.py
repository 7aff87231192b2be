"""What is counted of a recording session: scan slots, and histograms of how late scans begin and how long writes take.

The bins are fixed so that reports of one flight and another can be added and compared.
"""

from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Any

from daq.utilities.ranges import ranges

EDGES_US: tuple[int, ...] = (
    *(m * 10**e for e in range(1, 7) for m in (1, 2, 5)),  # 10 us to 5 s
    10_000_000,
    30_000_000,
)
"""Bin edges [us]: bin i holds times from edge i-1 up to below edge i; the first is below 10 us, the last over 30 s."""


class Histogram:
    """Counts of times over `EDGES_US`."""

    def __init__(self) -> None:
        self.counts = [0] * (len(EDGES_US) + 1)

    def add(self, time_us: int) -> None:
        """Count one time; negative ones count as their magnitude."""
        self.counts[bisect_right(EDGES_US, abs(time_us))] += 1


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
        histograms = ("lateness", "interval_error", "scan_duration")
        counts = {name: tuple(getattr(self, name).counts) for name in histograms}
        return {"late_scans": self.late, "edges_us": EDGES_US, **counts}


@dataclass(slots=True)
class SlotCounts:
    """Counts of scan slots; written, dropped, lost, missed and pending add up to all of them.

    absent: (first, last) numbers of the slots that were dropped, lost or missed.
    """

    first: int | None = None
    next: int = 0
    offered: int = 0
    written: int = 0
    dropped: int = 0
    lost: int = 0
    missed: int = 0
    write_errors: int = 0
    high_water: int = 0
    absent: list[tuple[int, int]] = field(default_factory=list)

    @property
    def pending(self) -> int:
        return self.offered - self.written - self.dropped - self.lost

    def counts(self) -> dict[str, Any]:
        """The counts as fields of a `Statistics` report."""
        same = ("written", "dropped", "lost", "missed", "pending", "write_errors")
        return {name: getattr(self, name) for name in same} | {
            "first_number": self.first or 0,
            "next_number": self.next,
            "absent": tuple(self.absent),
            "queue_high_water": self.high_water,
        }

    def reach(self, number: int) -> None:
        """The slots before `number` are over; those of which no scan was offered were missed. The first call begins the
        counting."""
        if self.first is None:
            self.first = self.next = number
        if number > self.next:
            self.missed += number - self.next
            self._add_absent(self.next, number - 1)
            self.next = number

    def offer(self, number: int) -> int:
        """A scan has been made; the numbers passed over since the last one were missed. Returns how many are in memory."""
        self.reach(number)
        self.next = number + 1
        self.offered += 1
        return self.pending

    def drop(self, number: int) -> None:
        """The newest scan was refused."""
        self.dropped += 1
        self._add_absent(number, number)

    def lose(self, numbers: list[int]) -> None:
        """Scans in memory were given up."""
        self.lost += len(numbers)
        self.absent = list(ranges([*numbers, *(n for a, b in self.absent for n in range(a, b + 1))]))

    def _add_absent(self, first: int, last: int) -> None:
        if self.absent and self.absent[-1][1] == first - 1:
            self.absent[-1] = (self.absent[-1][0], last)
        else:
            self.absent.append((first, last))
