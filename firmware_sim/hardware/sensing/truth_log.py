"""The truth that the instruments were shown, in a file beside the flight."""

import csv
import math
from bisect import bisect_right
from collections import deque
from contextlib import ExitStack
from pathlib import Path

from daq.utilities.durable import whole_text
from firmware_sim.hardware.sensing.instruments import GRID_S, HISTORY_S, TruthSource
from firmware_sim.world.truth import TRUTH_COLUMNS, Truth

_TIME = TRUTH_COLUMNS.index("time")
_TURNING = (TRUTH_COLUMNS.index("phi"), TRUTH_COLUMNS.index("psi"))


def _row(truth: Truth) -> list[float]:
    columns = truth.columns()
    return [columns[name] for name in TRUTH_COLUMNS]


class TruthFile:
    """A truth source that remembers the flight columns of its last seconds, and writes them down where asked."""

    def __init__(self, source: TruthSource, path: Path) -> None:
        self.path = path
        self._source = source
        self._rows: deque[list[float]] = deque(maxlen=round(2.0 * HISTORY_S / GRID_S))
        self._path = path
        self._closing = ExitStack()
        self._file = self._closing.enter_context(whole_text(path))
        self._writer = csv.writer(self._file)
        self._writer.writerow(TRUTH_COLUMNS)

    def advance(self, to_time: float) -> Truth:
        """The truth at `to_time` [s]."""
        truth = self._source.advance(to_time)
        self._rows.append(_row(truth))
        return truth

    def at(self, time: float) -> list[float]:
        """TRUTH_COLUMNS at a time of the last seconds [s], straight between the grid points."""
        k = bisect_right(self._rows, time, key=lambda row: row[_TIME])
        second_row = self._rows[min(k, len(self._rows) - 1)]
        first_row = self._rows[max(k - 1, 0)]
        span = second_row[_TIME] - first_row[_TIME]
        share = (time - first_row[_TIME]) / span if span > 0.0 else 0.0
        row = [a + share * (b - a) for a, b in zip(first_row, second_row, strict=True)]
        for i in _TURNING:  # the short way round
            row[i] = first_row[i] + share * math.remainder(second_row[i] - first_row[i], 2.0 * math.pi)
        row[_TIME] = time
        return row

    def write(self, time: float) -> None:
        """Put the truth of `time` into the file."""
        try:
            self._writer.writerow([f"{value:.10g}" for value in self.at(time)])
        except OSError as error:
            error.filename = str(self._path)  # a write names no file
            raise

    def close(self) -> None:
        """End the file."""
        self._closing.close()
