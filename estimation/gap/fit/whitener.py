"""The whitener: the operator S(f)^(-1/2) of one record, with the unknowns that it marginalises over (its slack).

Multiplying by S(f)^(-1/2) makes residuals white and keeps them aligned in time and channel. `noise` has S(f).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import solve_triangular

from estimation.engine.kernel import Array

Complex = NDArray[np.complex128]
AT_ONCE = 64  # columns of one Fourier transform: theirs stay in the processor's cache


@dataclass(frozen=True)
class Slack:
    """Unknowns that the whitener marginalises over. rows: (rows, m) white rows of what one prior standard deviation of each does.

    Marginalised over them white rows have the covariance I + E E' with E = rows, whose inverse is I - E (I + E'E)^-1 E'.
    """

    rows: Array

    @cached_property
    def _information(self) -> Array:
        """(m, m) I + E'E."""
        return self.rows.T @ self.rows + np.eye(self.rows.shape[1])

    @cached_property
    def _lower(self) -> Array:
        """(m, m) lower triangular L with L L' = I + E'E.

        Of large and nearly equal columns, as of a growing motion, rounding loses the I; then eigenvalues below 1 are set to 1.
        """
        try:
            return np.asarray(np.linalg.cholesky(self._information))
        except np.linalg.LinAlgError:
            values, vectors = np.linalg.eigh(self._information)
            return np.asarray(np.linalg.qr((vectors * np.sqrt(np.maximum(values, 1.0))).T)[1].T)

    @cached_property
    def mix(self) -> Array:
        """(m, m) B for which I - E B E' is the symmetric root of that inverse: 1/(1 + v + sqrt(1 + v)), v eigenvalues of E'E."""
        values, vectors = np.linalg.eigh(self._information)
        values = np.maximum(values, 1.0)
        return np.asarray((vectors / (values + np.sqrt(values))) @ vectors.T)

    @property
    def log_determinant(self) -> float:
        """Of the covariance I + E E'."""
        return 2.0 * float(np.sum(np.log(np.abs(np.diag(self._lower)))))

    def forgiven(self, rows: Array) -> Array:
        """(m, k) coordinates F of white rows R (rows, k) in the slack: R'(I + E E')^-1 R = R'R - F'F."""
        projections = rows.T @ self.rows  # in this order the long columns are read in the order of memory
        return np.asarray(solve_triangular(self._lower, projections.T, lower=True, check_finite=False))


@dataclass(frozen=True)
class White:
    """White columns of a record for inner products, which take the slack into account without changing the rows.

    rows: (rows, k) without slack; forgiven: (m, k) from `Slack.forgiven`, or None.
    """

    rows: Array
    forgiven: Array | None = None

    def products(self, other: "White") -> Array:
        """(columns of this, columns of the other) inner products."""
        products = self.rows.T @ other.rows
        if self.forgiven is not None and other.forgiven is not None:
            products -= self.forgiven.T @ other.forgiven
        return np.asarray(products)

    def squares(self) -> Array:
        """(columns,) the inner product of each with itself."""
        squares = np.einsum("ij,ij->j", self.rows, self.rows)
        if self.forgiven is not None:
            squares -= np.einsum("ij,ij->j", self.forgiven, self.forgiven)
        return np.asarray(squares)

    @classmethod
    def beside(cls, whites: Sequence["White"]) -> "White":
        """The columns of several, side by side."""
        forgiven = [w.forgiven for w in whites if w.forgiven is not None]
        return cls(
            np.concatenate([w.rows for w in whites], axis=1), np.concatenate(forgiven, axis=1) if forgiven else None
        )

    def some(self, columns: NDArray[np.intp]) -> "White":
        """Some of the columns."""
        return White(self.rows[:, columns], None if self.forgiven is None else self.forgiven[:, columns])


@dataclass(frozen=True)
class Whitener:
    """Applies S^(-1/2) to residual-like columns of one record. root: (frequencies, ny, ny) S^(-1/2); count: N samples."""

    root: Complex
    count: int
    slack: Slack | None = None

    @cached_property
    def _multiplicity(self) -> Array:
        """(frequencies,) how often each frequency of the one-sided spectrum stands in the two-sided one."""
        multiplicity = np.full(self.root.shape[0], 2.0)
        multiplicity[0] = 1.0
        if self.count % 2 == 0:
            multiplicity[-1] = 1.0
        return multiplicity

    @cached_property
    def _scale(self) -> Array:
        """(frequencies,) factors with which the one-sided spectrum has the energy of the samples (Parseval)."""
        return np.sqrt(self._multiplicity / self.count)

    @cached_property
    def _real_root(self) -> Array:
        """(frequencies, 2 ny, 2 ny) the scaled root as it acts on real parts over imaginary ones."""
        root = self.root * self._scale[:, None, None]
        return np.block([[root.real, -root.imag], [root.imag, root.real]])

    def _slack_series(self) -> Array:
        """(N ny, m) the rows of the slack as white time series."""
        assert self.slack is not None
        ny, m = self.root.shape[1], self.slack.rows.shape[1]
        parts = self.slack.rows.reshape(-1, 2, ny, m)
        spectrum = np.empty((len(parts), ny, m), complex)
        spectrum.real, spectrum.imag = parts[:, 0], parts[:, 1]
        spectrum /= self._scale[:, None, None]
        return np.asarray(np.fft.irfft(spectrum, n=self.count, axis=0).reshape(-1, m))

    @cached_property
    def log_determinant(self) -> float:
        """Of the covariance of a record; its sum with `energy` is minus twice the log-likelihood (Whittle) up to a constant."""
        of_spectrum = -2.0 * float(self._multiplicity @ np.linalg.slogdet(self.root)[1])
        return of_spectrum + (0.0 if self.slack is None else self.slack.log_determinant)

    def strict(self, spectrum: Array) -> Array:
        """(frequencies, 2 ny, k) from `spectrum_of` -> (rows, k): white rows of unit variance, without slack."""
        white = self._real_root @ spectrum
        return np.asarray(white.reshape(white.shape[0] * white.shape[1], white.shape[2]))

    def rows(self, columns: Array) -> Array:
        """(N, ny, k) or (N, ny) -> (rows, k): whitened, as real rows of unit variance."""
        rows = self.strict(spectrum_of(columns))
        if self.slack is not None:
            rows -= self.slack.rows @ (self.slack.mix @ (self.slack.rows.T @ rows))
        return rows

    def white(self, *columns: Array) -> White:
        """(N, ny, k) or (N, ny) each -> white columns for inner products, side by side."""
        rows = self.strict(spectrum_of(*columns))
        return White(rows, None if self.slack is None else self.slack.forgiven(rows))

    def gram(self, *columns: Array) -> Array:
        """(N, ny, k) or (N, ny) each -> (columns, columns): inner products of the white rows."""
        white = self.white(*columns)
        return white.products(white)

    def energy(self, residual: Array) -> float:
        """Sum of squares of the white rows of residuals (N, ny)."""
        return float(self.gram(residual)[0, 0])

    def series(self, residual: Array) -> Array:
        """(N, ny) residuals, or (N, ny, k) many of them -> white series of the same shape, aligned in time and channel."""
        block = residual[:, :, None] if residual.ndim == 2 else residual
        spectrum = np.fft.rfft(zero_filled(block), axis=0)
        series = np.fft.irfft(self.root @ spectrum, n=self.count, axis=0)
        if self.slack is not None:
            flat = series.reshape(-1, block.shape[2])
            slack_series = self._slack_series()
            series -= (slack_series @ (self.slack.mix @ (slack_series.T @ flat))).reshape(series.shape)
        return series.reshape(residual.shape)


def zero_filled(values: Array) -> Array:
    """`values` with zero for NaN; the same array where there is none."""
    return values if np.isfinite(np.sum(values)) else np.nan_to_num(values)


def spectrum_of(*columns: Array) -> Array:
    """(N, ny, k) or (N, ny) each -> (frequencies, 2 ny, columns): real parts of the spectra of all channels over imaginary ones.
    NaN counts as zero."""
    blocks = [zero_filled(c[:, :, None] if c.ndim == 2 else c) for c in columns]
    count, ny = blocks[0].shape[:2]
    parts = np.empty((count // 2 + 1, 2, ny, sum(b.shape[2] for b in blocks)))
    first = 0
    for block in blocks:
        end = first + block.shape[2]
        channels = max(AT_ONCE // max(block.shape[2], 1), 1)
        for c in range(0, ny, channels):
            transform = rfft(block[:, c : c + channels], axis=0)
            parts[:, 0, c : c + channels, first:end] = transform.real
            parts[:, 1, c : c + channels, first:end] = transform.imag
        first = end
    return parts.reshape(len(parts), 2 * ny, first)
