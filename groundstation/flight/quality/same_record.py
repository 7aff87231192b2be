"""Whether two flights are one record, whole or in part, under whatever names.

Sensors have noise: two flights never show the same numbers for a second. Where they do, a joint fit counts them twice, and a
flight held out proves nothing.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from groundstation.flight.flight import Flight
from groundstation.flight.quality.repeats import SENSED

WINDOW = 20  # rows in a row that have to be the same
MOVING = 0.5  # of them have to differ from the row before: aircraft at rest and simulated trims look alike
SHARED = 0.25  # of the shorter flight: flights simulated without noise may begin alike
FEWEST = 3  # columns that both have measured
SEED = 20261125


def one_record_twice(flights: Sequence[Flight]) -> tuple[int, int] | None:
    """Indices of the first two flights that share a quarter of the shorter one's samples; None where no two do."""
    for a, b in combinations(range(len(flights)), 2):
        one, two = flights[a], flights[b]
        columns = [c for c in SENSED if one.measured(c) and two.measured(c)]
        if len(columns) >= FEWEST:
            first, second = _windows(one, columns), _windows(two, columns)
            shared = np.intersect1d(first, second).size
            if shared and shared >= SHARED * min(len(one), len(two)):
                return a, b
    return None


def _windows(flight: Flight, columns: Sequence[str]) -> NDArray[np.uint64]:
    """One number for the contents of every window of rows that move."""
    if len(flight) < WINDOW:
        return np.zeros(0, np.uint64)
    rng = np.random.default_rng(SEED)
    by_column = rng.integers(1, 2**63, len(columns), dtype=np.uint64) | np.uint64(1)
    by_row = rng.integers(1, 2**63, WINDOW, dtype=np.uint64) | np.uint64(1)
    # as single precision, so that a file of seven digits is the same; zero and minus zero are
    bits = np.column_stack([flight[c].astype(np.float32) + np.float32(0.0) for c in columns]).view(np.uint32)
    mixed = (bits.astype(np.uint64) * by_column).sum(axis=1, dtype=np.uint64)
    rows = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    moved = np.concatenate([[False], rows[1:] != rows[:-1]])
    each = np.lib.stride_tricks.sliding_window_view(rows, WINDOW)
    moving = np.lib.stride_tricks.sliding_window_view(moved, WINDOW).mean(axis=1) >= MOVING
    return np.asarray((each[moving] * by_row).sum(axis=1, dtype=np.uint64))
