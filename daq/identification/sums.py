"""Running sums that the estimates are solved from; their size does not grow with the flight.

Rows are summed in blocks. Of each block the part along the constant's column is taken out, so that every block has
constants of its own: trim, fuel and sensor offsets may drift from one to the next.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from daq.identification.rows import TOTAL, WIDTH, Row

Array = NDArray[np.float64]

LAGS = 12  # rows over which residuals are taken to be correlated: half a second and more


def _zeros(*shape: int) -> Array:
    return np.zeros(shape)


@dataclass
class Sums:
    """Sums over rows. cross: (WIDTH, TOTAL) instruments by measured; measured: (LAGS + 1, TOTAL, TOTAL) and
    instruments: (LAGS + 1, WIDTH, WIDTH) products of each row with the one so many rows later; span: [s] covered."""

    rows: int = 0
    span: float = 0.0
    cross: Array = field(default_factory=lambda: _zeros(WIDTH, TOTAL))
    measured: Array = field(default_factory=lambda: _zeros(LAGS + 1, TOTAL, TOTAL))
    instruments: Array = field(default_factory=lambda: _zeros(LAGS + 1, WIDTH, WIDTH))

    def plus(self, other: "Sums") -> "Sums":
        """Sums over the rows of both."""
        return Sums(
            self.rows + other.rows,
            self.span + other.span,
            self.cross + other.cross,
            self.measured + other.measured,
            self.instruments + other.instruments,
        )

    def without_constant(self) -> "Sums":
        """Sums of the rows less what the constant's column explains of them (its own entries are zero then)."""
        energy = self.cross[0, 0]
        if not energy > 0.0:
            return Sums(self.rows, self.span)
        share, own = self.cross[0] / energy, self.cross[:, 0] / energy
        take, take_z = np.eye(TOTAL), np.eye(WIDTH)
        take[:, 0] -= share
        take_z[:, 0] -= own
        return Sums(
            self.rows,
            self.span,
            take_z @ self.cross @ take.T,
            take @ self.measured @ take.T,
            take_z @ self.instruments @ take_z.T,
        )


class Block:
    """Rows of one block as they come."""

    def __init__(self) -> None:
        self.sums = Sums()
        self._measured = _zeros(LAGS + 1, TOTAL)
        self._instruments = _zeros(LAGS + 1, WIDTH)

    def add(self, row: Row) -> None:
        """One more row."""
        for history, values in ((self._measured, row.measured), (self._instruments, row.instruments)):
            history[1:] = history[:-1]
            history[0] = values
        s = self.sums
        s.rows += 1
        s.span += row.span
        s.cross += row.instruments[:, None] * row.measured
        s.measured += self._measured[:, :, None] * row.measured
        s.instruments += self._instruments[:, :, None] * row.instruments

    def interrupt(self) -> None:
        """Rows are missing here: those before have no neighbours behind."""
        self._measured[:] = 0.0
        self._instruments[:] = 0.0
