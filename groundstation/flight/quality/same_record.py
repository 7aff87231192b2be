"""Whether two flights are one record, whole or in part, under whatever names.

Sensors have noise: two flights never show the same numbers for a second. Where they do, a joint fit counts them twice, and a
flight held out proves nothing.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from groundstation.flight.flight import Flight
from groundstation.flight.quality.repeats import SENSED

WINDOW = 20  # rows in a row that have to be the same
MOVING = 0.5  # of them have to differ from the row before: aircraft at rest and simulated trims look alike
SHARED = 0.25  # of the shorter flight: flights simulated without noise may begin alike
FEWEST = 3  # columns that all have measured


def one_record_twice(flights: Sequence[Flight]) -> tuple[int, int] | None:
    """Indices of the first two flights that share a quarter of the shorter one's samples; None where no two do."""
    columns = [c for c in SENSED if all(f.measured(c) for f in flights)]
    if len(columns) < FEWEST:
        return None
    windows = [_windows(f, columns) for f in flights]
    for a, b in combinations(range(len(flights)), 2):
        shared = len(windows[a] & windows[b])
        if shared and shared >= SHARED * min(len(flights[a]), len(flights[b])):
            return a, b
    return None


def _windows(flight: Flight, columns: Sequence[str]) -> set[int]:
    """A number for the contents of every window of rows that move."""
    # single precision, so that a file of seven digits is the same; bits, so that what is not measured is; zero and minus zero are
    rows = np.column_stack([flight[c].astype(np.float32) + np.float32(0.0) for c in columns]).view(np.uint32)
    moved = np.concatenate([[0], np.cumsum((rows[1:] != rows[:-1]).any(axis=1))])
    return {
        hash(rows[end - WINDOW : end].tobytes())
        for end in range(WINDOW, len(rows) + 1)
        if moved[end - 1] - moved[end - WINDOW] >= MOVING * WINDOW
    }
