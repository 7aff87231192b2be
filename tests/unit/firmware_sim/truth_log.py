"""The truth that instruments were shown, kept in memory."""

import math

import numpy as np
from numpy.typing import NDArray

from firmware_sim.hardware.sensing.instruments import TruthSource
from firmware_sim.world.truth import TRUTH_COLUMNS, Truth

_TIME = TRUTH_COLUMNS.index("time")
_TURNING = (TRUTH_COLUMNS.index("phi"), TRUTH_COLUMNS.index("psi"))


class TruthLog:
    """A truth source that keeps the flight columns of all it has shown."""

    def __init__(self, source: TruthSource) -> None:
        self._source = source
        self._rows: list[list[float]] = []

    def advance(self, to_time: float) -> Truth:
        """The truth at `to_time` [s]."""
        truth = self._source.advance(to_time)
        self._rows.append([truth.columns()[name] for name in TRUTH_COLUMNS])
        return truth

    def at(self, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """TRUTH_COLUMNS at `times` [s], straight between the grid points, (times,) each."""
        rows = np.array(self._rows, float).T
        columns = {}
        for i, (name, values) in enumerate(zip(TRUTH_COLUMNS, rows, strict=True)):
            line = np.interp(times, rows[_TIME], np.unwrap(values) if i in _TURNING else values)
            columns[name] = (line + math.pi) % (2.0 * math.pi) - math.pi if i in _TURNING else line
        columns["time"] = np.asarray(times, float)
        return columns
