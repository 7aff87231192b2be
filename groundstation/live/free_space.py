"""Room on the ground station's disk, and how long it lasts at the pace at which it goes."""

import math
import os
from collections import deque
from pathlib import Path

SPAN_S = 60.0
"""Over which the pace is measured: a recording goes onto the disk in pieces, and others write there too."""
LEAST_S = 10.0  # of that, before there is a pace at all

FREE = "ground.free_mb"
LEFT = "ground.minutes_left"


class FreeSpace:
    """Call `update` now and then; read what is free. `megabytes` is NaN and `minutes` too while nothing is known."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, int]] = deque()
        self.megabytes = math.nan
        self.minutes = math.nan

    def update(self, time_s: float, free_bytes: int) -> None:
        """What is free at a time [s] of any steady clock. minutes: inf where nothing is being used up."""
        self.megabytes = free_bytes / 1e6
        self._seen.append((time_s, free_bytes))
        while time_s - self._seen[0][0] > SPAN_S:
            self._seen.popleft()
        since, before = self._seen[0]
        if time_s - since >= LEAST_S:
            pace = (before - free_bytes) / (time_s - since)
            self.minutes = free_bytes / pace / 60.0 if pace > 0 else math.inf

    @property
    def values(self) -> dict[str, float]:
        """As channels of alarms. A pace that uses nothing up counts as a year, so that an alarm can end."""
        return {FREE: self.megabytes, LEFT: min(self.minutes, 525_600.0)}

    @property
    def words(self) -> str:
        """For a person."""
        if math.isnan(self.megabytes):
            return "unknown"
        left = f", {self.minutes:.0f} min at the present rate" if math.isfinite(self.minutes) else ""
        return f"{self.megabytes:.0f} MB free{left}"


def free_bytes(folder: Path) -> int:
    """Room for an ordinary user in the file system of a folder; OSError when it is gone."""
    found = os.statvfs(folder)
    return found.f_bavail * found.f_frsize
