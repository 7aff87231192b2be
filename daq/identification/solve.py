"""Estimates and honest bounds of one equation from running sums.

theta = (sum z phi')^-1 sum z y. Its covariance is A^-1 M A^-T with A = sum z phi' and M = sum over lags k of c_k sum z_i
z_(i+k)', where c_k is the autocovariance of the residuals: their colour is counted, once for all rows and not row by row,
which would need more rows than there are.
"""

from collections.abc import Sequence
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
        share, instrument_share = self.cross[0] / energy, self.cross[:, 0] / energy
        projection, instrument_projection = np.eye(TOTAL), np.eye(WIDTH)
        projection[:, 0] -= share
        instrument_projection[:, 0] -= instrument_share
        return Sums(
            self.rows,
            self.span,
            instrument_projection @ self.cross @ projection.T,
            projection @ self.measured @ projection.T,
            instrument_projection @ self.instruments @ instrument_projection.T,
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


SIDE = 0  # number of the side-force equation, whose columns stand apart
SHORT = 4.0  # s; a bound from T seconds is widened by sqrt(1 + SHORT / T): its own scatter, found by simulation
FEWEST_ROWS = 24  # beyond the columns
SINGULAR = 1e-10  # reciprocal condition of the scaled normal matrix below which columns are dependent
ROUNDING = 1e-12  # of the left sides' energy: less is lost in the sums' own digits
LEAST_SHARE = (
    0.15  # of the white bound's variance that is kept where neighbouring residuals cancel (differenced gyro noise)
)

_BARTLETT = np.concatenate([[1.0], 2.0 * (1.0 - np.arange(1, LAGS + 1) / (LAGS + 1.0))])
"""Weights of the lags, each for both directions; falling so that a covariance stays positive."""


@dataclass(frozen=True)
class RegressionSolution:
    """values: (n,) of the columns `columns`; covariance: (n, n), honest; white: the same as if residuals were white.

    scatter: of the sum of the left side's residuals, per row.
    """

    equation: int
    columns: tuple[int, ...]
    values: Array
    covariance: Array
    white: Array
    scatter: float

    def constant(self, level: Array) -> tuple[float, float]:
        """The equation's constant and its variance. level: (TOTAL,) the constant's row of the crossed sums."""
        equation_columns = own_columns(self.equation, self.columns)
        mean = level[equation_columns] / level[0]
        value = float(level[2 * WIDTH + self.equation] / level[0] - mean @ self.values)
        return value, float(self.scatter / level[0] + mean @ self.covariance @ mean)


def own_columns(equation: int, columns: Sequence[int]) -> list[int]:
    """Where the measured columns of an equation stand in a row."""
    return [c + (WIDTH if equation == SIDE else 0) for c in columns]


def solve(sums: Sums, equation: int, columns: Sequence[int]) -> RegressionSolution | None:
    """Derivatives of one equation (0 CY, 1 Cl, 2 Cn) for the given columns; None where these rows cannot tell them.

    sums: without their constant.
    """
    instruments, n = list(columns), len(columns)
    if not n or sums.rows < n + FEWEST_ROWS:
        return None
    equation_columns = own_columns(equation, instruments)
    scale_z = np.sqrt(np.diag(sums.instruments[0])[instruments])
    scale = np.sqrt(np.diag(sums.measured[0])[equation_columns])
    if not (np.all(scale_z > 0.0) and np.all(scale > 0.0)):
        return None
    scaled = sums.cross[np.ix_(instruments, equation_columns)] / scale_z[:, None] / scale
    if not np.linalg.cond(scaled) < 1.0 / SINGULAR:
        return None
    inverse = np.linalg.inv(scaled) / scale_z / scale[:, None]
    values = inverse @ sums.cross[instruments, 2 * WIDTH + equation]
    residual = _residual_products(sums, equation, equation_columns, values)
    freedom = sums.rows - n
    white = inverse @ (residual[0] / freedom * sums.instruments[0][np.ix_(instruments, instruments)]) @ inverse.T
    widened = 1.0 + SHORT / max(sums.span, 1e-9)
    coloured = inverse @ _score(sums, instruments, residual, freedom) @ inverse.T
    floor = np.maximum(LEAST_SHARE * np.diag(white) - np.diag(coloured), 0.0)
    scatter = max(float(_BARTLETT @ residual), LEAST_SHARE * residual[0]) / freedom
    return RegressionSolution(
        equation, tuple(instruments), values, widened * (coloured + np.diag(floor)), white, widened * scatter
    )


def _residual_products(sums: Sums, equation: int, own: list[int], values: Array) -> Array:
    """(LAGS + 1,) sums of the residual of a row times that of the row so many later."""
    v, left_side = np.zeros(TOTAL), 2 * WIDTH + equation
    v[own], v[left_side] = -values, 1.0
    products: Array = np.einsum("i,kij,j->k", v, sums.measured, v)
    products[0] = max(products[0], ROUNDING * sums.measured[0, left_side, left_side])
    return products


def _score(sums: Sums, pick: list[int], residual: Array, freedom: int) -> Array:
    """Covariance of sum z e of residuals coloured over LAGS rows."""
    products = sums.instruments[:, pick][:, :, pick]
    symmetric = 0.5 * (products + products.transpose(0, 2, 1))
    return np.asarray(np.einsum("k,kij->ij", _BARTLETT * residual / freedom, symmetric))
