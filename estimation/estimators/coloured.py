"""Covariance of estimates when residuals are coloured, by the spectrum of an autoregression.

V. Klein and E. A. Morelli, Aircraft System Identification, 2nd ed., section 6.4 (Morelli and Klein, Journal of Aircraft
34(1), 1997): with M the information matrix and S_i the sensitivities, Cov = M^-1 B M^-1 with
B = sum_i sum_j S_i' R^-1 Rvv(i-j) R^-1 S_j. Two refinements, both needed for nominal coverage on 30 s flights:

- Rvv is from an autoregression of all outputs: a lag window with enough averaging would flatten the Dutch-roll peak, where most
  of the information lies;
- the residuals of a fit are smaller than the noise, above all in the directions of the parameters. Simulation gives the ratio:
  noise with the spectrum of the residuals is projected in the same way, and the spectrum is raised by the ratio.

Spectra are of residuals in units of their standard deviation; time series are (N, ny).
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]

LONGEST_ORDER = 10  # of the autoregression
SAMPLES_PER_COEFFICIENT = 6  # of the autoregression and output: fewer would not determine it
DRAWS = 10  # of noise for the ratio, each as long as the record
ROUNDS = 2  # of raising the spectrum
LARGEST_RAISE = 4.0  # of the spectrum in one round, so that a direction that the fit absorbs entirely does not diverge
NOISE_SEED = 20  # fixed, so that a fit always gives the same bounds


@dataclass(frozen=True)
class ResidualSegment:
    """One segment. residual: (N, ny) and jacobian: (N ny, n) in units of the noise, zero where not measured; nuisance: (N ny, k)
    columns of initial states; known: (N, ny) what was measured."""

    residual: Array
    jacobian: Array
    nuisance: Array
    known: NDArray[np.bool_]


def score_covariance(pieces: list[ResidualSegment], inverse: Array, nuisance_inverse: list[Array]) -> Array:
    """B (n, n) of one flight in the coordinates of `jacobian` with the nuisance projected out.

    inverse: (n, n) covariance of the parameters; nuisance_inverse: inverse information of each piece's initial states.
    """
    pieces, nuisance_inverse = non_empty_pieces([measured_part(p) for p in pieces], nuisance_inverse)
    projected = without_nuisance(pieces, nuisance_inverse)
    spectrum = noise_spectrum(pieces, projected, inverse, nuisance_inverse)
    return filtered_covariance(pieces, projected, spectrum)


Item = TypeVar("Item")


def non_empty_pieces(pieces: list[ResidualSegment], items: list[Item]) -> tuple[list[ResidualSegment], list[Item]]:
    """The pieces with at least one sample, and the item of each; in a short piece no output may be measured at all."""
    pairs = [(p, i) for p, i in zip(pieces, items, strict=True) if p.residual.size]
    return [p for p, _ in pairs], [i for _, i in pairs]


def measured_part(piece: ResidualSegment) -> ResidualSegment:
    """The piece without samples at which no output is measured, so that on a grid finer than the log the orders of the
    autoregression span as much time as on the log's own samples."""
    rows = piece.known.any(axis=1)
    jacobian, nuisance = measured_rows_of(piece, piece.jacobian), measured_rows_of(piece, piece.nuisance)
    return ResidualSegment(piece.residual[rows], jacobian, nuisance, piece.known[rows])


def measured_rows_of(piece: ResidualSegment, columns: Array) -> Array:
    """Columns (N ny, m) of a piece without samples at which no output is measured."""
    rows = piece.known.any(axis=1)
    count, ny = piece.residual.shape
    return columns.reshape(count, ny, columns.shape[1])[rows].reshape(int(rows.sum()) * ny, columns.shape[1])


def filtered_covariance(pieces: list[ResidualSegment], projected: list[Array], spectrum: Spectrum) -> Array:
    """(n, n) covariance of the inner products of columns (N ny, n) with noise of a spectrum."""
    n = projected[0].shape[1]
    total = np.zeros((n, n))
    for piece, J in zip(pieces, projected, strict=True):
        if n:  # none where all parameters are fixed
            total += _quadratic(J.reshape(piece.residual.shape[0], -1, n), spectrum)
    return total


def white_products(piece: ResidualSegment, columns: Array, inverse_spectrum: Spectrum) -> Array:
    """Inner products of nuisance, jacobian, columns (N ny, m) and residual, in that order, weighted by the inverse spectrum of
    the noise."""
    stacked = np.concatenate([piece.nuisance, piece.jacobian, columns, piece.residual.reshape(-1, 1)], axis=1)
    return _quadratic(stacked.reshape(piece.residual.shape[0], -1, stacked.shape[1]), inverse_spectrum)


def without_nuisance(pieces: list[ResidualSegment], nuisance_inverse: list[Array]) -> list[Array]:
    """Jacobian (N ny, n) of each piece with the columns of its initial states projected out."""
    projected = []
    for piece, covariance in zip(pieces, nuisance_inverse, strict=True):
        J = piece.jacobian
        if piece.nuisance.shape[1]:
            J = J - piece.nuisance @ (covariance @ (piece.nuisance.T @ J))
        projected.append(J)
    return projected


def noise_spectrum(
    pieces: list[ResidualSegment],
    projected: list[Array],
    inverse: Array,
    nuisance_inverse: list[Array],
    known_lags: Array | None = None,
) -> Spectrum:
    """Spectrum (size/2 + 1, ny, ny) of the noise of one flight, in units of R: that of the residuals, raised by what the fit
    absorbed. size: even, at least twice the longest piece.

    known_lags: (lags, ny, ny) autocovariance that a cause accounted for elsewhere gives the residuals; it is subtracted.
    """
    size = _fast_length(2 * max(p.residual.shape[0] for p in pieces))
    lags = autocovariance([p.residual for p in pieces], [p.known for p in pieces])
    order = order_for(lags, sum(p.residual.shape[0] for p in pieces))
    if known_lags is not None:
        lags = _without(lags, known_lags, order)
    observed = autoregressive_spectrum(lags, order, size)
    spectrum = observed
    rng = np.random.default_rng(NOISE_SEED)
    for _ in range(ROUNDS):
        after_fit = _after_fit(spectrum, pieces, projected, inverse, nuisance_inverse, order, size, rng)
        raise_by = np.real(np.einsum("fii->f", observed)) / np.real(np.einsum("fii->f", after_fit))
        spectrum = spectrum * np.clip(raise_by, 1.0 / LARGEST_RAISE, LARGEST_RAISE)[:, None, None]
    return spectrum


def _fast_length(shortest: int) -> int:
    """The smallest of 2^k, 3 2^k and 5 2^k that is at least `shortest`: lengths with a fast Fourier transform."""
    return min(a << max(1, int(np.ceil(np.log2(shortest / a)))) for a in (1, 3, 5))


def autocovariance(series: list[Array], known: list[NDArray[np.bool_]], lags: int | None = None) -> Array:
    """C_k = E v_t v_{t-k}' for k = 0 .. lags, (lags + 1, ny, ny), biased (so a stable autoregression follows).

    series: one (N, ny) per piece, or (N, ny, draws) for the mean over draws. lags: by default LONGEST_ORDER, or fewer in a short
    record. For one channel and all lags, `signals.goodness_of_fit.autocorrelation` is faster.
    """
    if lags is None:
        lags = min(LONGEST_ORDER, max(v.shape[0] for v in series) // 8)
    ny = series[0].shape[1]
    draws = series[0].shape[2] if series[0].ndim == 3 else 1
    sums = np.zeros((lags + 1, ny, ny))
    counts = draws * sum(k.sum() for k in known) / ny
    for v in series:
        rows = np.ascontiguousarray(np.moveaxis(v.reshape(*v.shape[:2], draws), 2, 1))  # (N, draws, ny)
        for k in range(min(lags, v.shape[0] - 1) + 1):
            sums[k] += rows[k:].reshape(-1, ny).T @ rows[: v.shape[0] - k].reshape(-1, ny)
    return sums / max(float(counts), 1.0)


def _without(lags: Array, known_lags: Array, order: int) -> Array:
    """`lags` minus those of a known cause, the latter scaled down where the difference would not be positive definite: every
    direction retains at least half the smallest eigenvalue. They are an expectation, and a single record may have less."""
    total, known_part = _toeplitz(lags, order), _toeplitz(known_lags, order)
    smallest = float(np.linalg.eigvalsh(total)[0])
    if smallest <= 0.0:
        return lags
    L = np.linalg.cholesky(total - 0.5 * smallest * np.eye(len(total)))
    half = np.linalg.solve(L, known_part)
    largest = float(np.linalg.eigvalsh(np.linalg.solve(L, half.T))[-1])
    return lags - min(1.0, 1.0 / max(largest, 1e-12)) * known_lags


def order_for(lags: Array, samples: int) -> int:
    """The longest order that the data supports. Information criteria choose far too short a one, because colour below the level
    of white noise still dominates the estimates. `_after_fit` corrects for too long an order."""
    ny = lags.shape[1]
    return int(min(lags.shape[0] - 1, samples // (SAMPLES_PER_COEFFICIENT * ny)))


def _autoregression(lags: Array, order: int) -> tuple[Array, Array]:
    """(coefficients (ny, order ny), innovation covariance) by the multichannel Yule-Walker equations."""
    ny = lags.shape[1]
    ridge = 1e-9 * np.eye(ny) * max(float(np.trace(lags[0])) / ny, 1e-300)
    if order == 0:
        return np.zeros((ny, 0)), lags[0] + ridge
    toeplitz = _toeplitz(lags, order - 1) + np.kron(np.eye(order), ridge)
    right = np.concatenate([lags[k] for k in range(1, order + 1)], axis=1)
    coefficients = np.linalg.solve(toeplitz.T, right.T).T
    innovation = lags[0] + ridge - coefficients @ right.T
    return coefficients, 0.5 * (innovation + innovation.T)


def _toeplitz(lags: Array, order: int) -> Array:
    """Covariance of order + 1 samples in a row, ((order + 1) ny, (order + 1) ny)."""
    ny = lags.shape[1]
    rows = [[lags[j - i] if j >= i else lags[i - j].T for j in range(order + 1)] for i in range(order + 1)]
    return np.asarray(rows).transpose(0, 2, 1, 3).reshape((order + 1) * ny, (order + 1) * ny)


def autoregressive_spectrum(lags: Array, order: int, size: int) -> Spectrum:
    """(size/2 + 1, ny, ny) spectral density matrix on the Fourier frequencies of `size`, covariance = its mean."""
    ny = lags.shape[1]
    coefficients, innovation = _autoregression(lags, order)
    delay = np.exp(-2j * np.pi * np.arange(size // 2 + 1) / size)  # of one sample, at each frequency
    a = np.broadcast_to(np.eye(ny, dtype=complex), (delay.size, ny, ny)).copy()
    for k in range(order):
        a -= coefficients[None, :, k * ny : (k + 1) * ny] * (delay ** (k + 1))[:, None, None]
    inverse = np.linalg.inv(a)
    return np.asarray(inverse @ innovation @ inverse.conj().transpose(0, 2, 1))


def _after_fit(
    spectrum: Spectrum,
    pieces: list[ResidualSegment],
    projected: list[Array],
    inverse: Array,
    nuisance_inverse: list[Array],
    order: int,
    size: int,
    rng: np.random.Generator,
) -> Spectrum:
    """Spectrum of the residuals of a fit to noise with `spectrum`, by simulation."""
    ny = spectrum.shape[1]
    root = square_root(spectrum)
    residuals: list[Array] = []
    for piece, J, state_covariance in zip(pieces, projected, nuisance_inverse, strict=True):
        count = piece.residual.shape[0]
        noise = coloured_noise(root, count, DRAWS, rng) * piece.known[:, :, None]
        e = noise.reshape(count * ny, DRAWS)
        residual = e - J @ (inverse @ (J.T @ e))
        if piece.nuisance.shape[1]:
            residual -= piece.nuisance @ (state_covariance @ (piece.nuisance.T @ e))
        residuals.append(residual.reshape(count, ny, DRAWS))
    return autoregressive_spectrum(autocovariance(residuals, [p.known for p in pieces]), order, size)


def square_root(spectrum: Spectrum) -> Spectrum:
    """A factor L of the matrix at each frequency, L L^H = spectrum."""
    ny = spectrum.shape[1]
    ridge = 1e-12 * np.real(np.trace(spectrum, axis1=1, axis2=2)) + 1e-300
    return np.asarray(np.linalg.cholesky(spectrum + ridge[:, None, None] * np.eye(ny)))


def coloured_noise(root: Spectrum, count: int, draws: int, rng: np.random.Generator) -> Array:
    """(count, ny, draws) stationary noise with the spectrum whose square root is given."""
    frequencies, ny = root.shape[:2]
    size = 2 * (frequencies - 1)
    white = rng.standard_normal((2, frequencies, ny, draws))
    excitation = (white[0] + 1j * white[1]) / np.sqrt(2.0)
    excitation[0], excitation[-1] = white[0, 0], white[0, -1]
    return np.asarray(np.fft.irfft(root @ excitation, size, axis=0)[:count] * np.sqrt(size))


def _quadratic(jacobian: Array, spectrum: Spectrum) -> Array:
    """sum_i sum_j J_i' Gamma(i - j) J_j by Fourier transform. jacobian: (N, ny, n)."""
    n = jacobian.shape[2]
    size = 2 * (spectrum.shape[0] - 1)
    transformed = np.fft.rfft(jacobian, size, axis=0)
    multiplicity = np.full(spectrum.shape[0], 2.0)  # of each frequency in the two-sided sum
    multiplicity[0] = multiplicity[-1] = 1.0
    weighted = (transformed.conj() * multiplicity[:, None, None]).reshape(-1, n)
    total = np.real(weighted.T @ (spectrum @ transformed).reshape(-1, n)) / size
    return np.asarray(0.5 * (total + total.T))
