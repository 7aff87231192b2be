"""Estimates of one equation and their bounds for coloured residuals, from running sums.

theta = (sum z phi')^-1 sum z y with instruments z and measured columns phi. Its covariance is A^-1 M A^-T with A = sum z phi' and
M = sum over lags k of c_k sum z_i z_(i+k)', where c_k is the autocovariance of the residuals. One autocovariance serves all rows,
for there are too few rows to estimate the colour row by row.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.identification.regression import LATERAL, PlaneRegression
from daq.identification.rows import Row

Array = NDArray[np.float64]


@dataclass
class Sums:
    """Sums over rows. rows: how many; span: time that they cover [s]; cross: (width, total) instruments by measured; measured:
    (lags + 1, total, total) and instruments: (lags + 1, width, width) products of each row with the one `lag` rows later."""

    rows: int
    span: float
    cross: Array
    measured: Array
    instruments: Array

    @classmethod
    def empty(cls, width: int, total: int, lags: int) -> "Sums":
        """The sums of no rows."""
        lagged = lags + 1
        return cls(0, 0.0, np.zeros((width, total)), np.zeros((lagged, total, total)), np.zeros((lagged, width, width)))

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
        """Sums of the rows after projecting out the constant's column, whose own entries become zero."""
        energy, (width, total) = self.cross[0, 0], self.cross.shape
        if not energy > 0.0:
            return Sums.empty(width, total, len(self.measured) - 1)
        mean, instrument_mean = self.cross[0] / energy, self.cross[:, 0] / energy
        projection, instrument_projection = np.eye(total), np.eye(width)
        projection[:, 0] -= mean
        instrument_projection[:, 0] -= instrument_mean
        return Sums(
            self.rows,
            self.span,
            instrument_projection @ self.cross @ projection.T,
            projection @ self.measured @ projection.T,
            instrument_projection @ self.instruments @ instrument_projection.T,
        )


class Block:
    """The running sums over the rows of one block."""

    def __init__(self, regression: PlaneRegression = LATERAL) -> None:
        self.sums = Sums.empty(regression.width, regression.total, regression.lags)
        self._measured = np.zeros((regression.lags + 1, regression.total))
        self._instruments = np.zeros((regression.lags + 1, regression.width))

    def add(self, row: Row) -> None:
        """Add a row."""
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
        """Begin a new run after missing rows: earlier rows are not lagged neighbours of later ones."""
        self._measured[:] = 0.0
        self._instruments[:] = 0.0


SHORT = 4.0  # s; bounds from T seconds are widened by sqrt(1 + SHORT / T), for their own scatter (by simulation)
FEWEST_ROWS = 24  # beyond the number of columns
SINGULAR = 1e-10  # reciprocal condition of the scaled normal matrix below which columns are dependent
ROUNDING = 1e-12  # of the left side's energy: a smaller residual energy is rounding of the sums
LEAST_SHARE = 0.15  # least variance over the white bound's, where neighbouring residuals cancel


def _bartlett(lags: int) -> Array:
    """(lags + 1,) Bartlett weights, each for both directions, which keep the covariance positive."""
    return np.concatenate([[1.0], 2.0 * (1.0 - np.arange(1, lags + 1) / (lags + 1.0))])


@dataclass(frozen=True)
class RegressionSolution:
    """values: (n,) of the derivatives `names`, of the instruments' columns `columns`; covariance: (n, n) for coloured residuals;
    white: (n, n) for white ones.

    places: indices of the measured columns in a row, and of the left side, last. scatter: variance of the sum of the residuals,
    per row.
    """

    names: tuple[str, ...]
    columns: tuple[int, ...]
    places: tuple[int, ...]
    values: Array
    covariance: Array
    white: Array
    scatter: float

    def widened(self, share: float) -> "RegressionSolution":
        """The solution with an additional standard deviation of `share` times each value."""
        return replace(self, covariance=self.covariance + np.diag((share * self.values) ** 2))

    def constant(self, level: Array) -> tuple[float, float]:
        """The equation's constant and its variance. level: (total,) the constant's row of `Sums.cross`."""
        mean = level[list(self.places[:-1])] / level[0]
        value = float(level[self.places[-1]] / level[0] - mean @ self.values)
        return value, float(self.scatter / level[0] + mean @ self.covariance @ mean)


def solve(sums: Sums, regression: PlaneRegression, equation: int, names: Sequence[str]) -> RegressionSolution | None:
    """Estimate the named derivatives of one equation of a regression; None where these rows do not identify them.

    sums: of rows without their constant (`Sums.without_constant`).
    """
    terms, n = regression.equations[equation].terms, len(names)
    instruments = [regression.columns.index(terms[name]) for name in names]
    if not n or sums.rows < n + FEWEST_ROWS:
        return None
    equation_columns = [c + (regression.width if regression.equations[equation].instant else 0) for c in instruments]
    left_side = 2 * regression.width + equation
    scale_z = np.sqrt(np.diag(sums.instruments[0])[instruments])
    scale = np.sqrt(np.diag(sums.measured[0])[equation_columns])
    if not (np.all(scale_z > 0.0) and np.all(scale > 0.0)):
        return None
    scaled = sums.cross[np.ix_(instruments, equation_columns)] / scale_z[:, None] / scale
    if not np.linalg.cond(scaled) < 1.0 / SINGULAR:
        return None
    inverse = np.linalg.inv(scaled) / scale_z / scale[:, None]
    values = inverse @ sums.cross[instruments, left_side]
    residual = _residual_products(sums, left_side, equation_columns, values)
    freedom = sums.rows - n
    white = inverse @ (residual[0] / freedom * sums.instruments[0][np.ix_(instruments, instruments)]) @ inverse.T
    widened = 1.0 + SHORT / max(sums.span, 1e-9)
    coloured = inverse @ _score(sums, instruments, residual, freedom) @ inverse.T
    floor = np.maximum(LEAST_SHARE * np.diag(white) - np.diag(coloured), 0.0)
    scatter = max(float(_bartlett(regression.lags) @ residual), LEAST_SHARE * residual[0]) / freedom
    return RegressionSolution(
        tuple(names),
        tuple(instruments),
        (*equation_columns, left_side),
        values,
        widened * (coloured + np.diag(floor)),
        white,
        widened * scatter,
    )


def _residual_products(sums: Sums, left_side: int, columns: list[int], values: Array) -> Array:
    """(lags + 1,) sums of products of a row's residual with that of the row `lag` rows later."""
    v = np.zeros(sums.cross.shape[1])
    v[columns], v[left_side] = -values, 1.0
    products: Array = np.einsum("i,kij,j->k", v, sums.measured, v)
    products[0] = max(products[0], ROUNDING * sums.measured[0, left_side, left_side])
    return products


def _score(sums: Sums, columns: list[int], residual: Array, freedom: int) -> Array:
    """Covariance of sum z e for residuals e with the autocovariance `residual` / `freedom`; columns: of the instruments z."""
    products = sums.instruments[:, columns][:, :, columns]
    symmetric = 0.5 * (products + products.transpose(0, 2, 1))
    return np.asarray(np.einsum("k,kij->ij", _bartlett(len(residual) - 1) * residual / freedom, symmetric))
