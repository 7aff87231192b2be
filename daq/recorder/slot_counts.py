"""The books of a recording session: every scan slot is in exactly one count."""

from dataclasses import dataclass, field
from typing import Any

from daq.contract.ranges import ranges


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
        """Scans in memory."""
        return self.offered - self.written - self.dropped - self.lost

    def counts(self) -> dict[str, Any]:
        """The books as fields of a `Statistics` report."""
        return {
            "first_number": self.first or 0,
            "next_number": self.next,
            "written": self.written,
            "dropped": self.dropped,
            "lost": self.lost,
            "missed": self.missed,
            "pending": self.pending,
            "absent": tuple(self.absent),
            "write_errors": self.write_errors,
            "queue_high_water": self.high_water,
        }

    def reach(self, number: int) -> None:
        """The slots before `number` are over; those of which no scan was offered were missed. The first call begins the books."""
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
