"""Responses from windowed, overlapped transforms of one window length, with their random error.

Every window k gives transforms X_k (one column an input) and Y_k = X_k H + V_k (P. D. Welch 1967); H is their least
squares solution, which for one input is Gxy / Gxx and for several the conditioned response (J. S. Bendat and A. G.
Piersol, Random Data, 4th ed., chapters 6 and 7). Windows overlap by four fifths and so share noise: with R their
overlap correlations,

    E v v* = S R,    cov H = S (X*X)^-1 X*R X (X*X)^-1,    S = v*v / tr((I - P) R),    P = X (X*X)^-1 X*

which for n independent windows is Bendat and Piersol's random error (section 9.2), |H| sqrt(1 - g2) / (|g| sqrt(2 n)),
less the degrees of freedom of the fit. The input need not be stationary: doublets and sweeps, which fill few windows, count
by those windows.

A window w truncates the impulse response by the window's autocorrelation, which broadens a lightly damped peak. Expanding w(t)
about w(t - tau), F{w y} = H F{w x} + j H' F{w' x} - H''/2 F{w'' x} + ...: with the last two terms as further columns, where there
are windows enough, that bias is removed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.signal import czt
from scipy.special import stdtrit

from daq.utilities.constants import NORMAL_95
from estimation.frequency.records import DetrendedStretch
from estimation.signals.curves import Complex
from groundstation.flight import Array

OVERLAP = 0.8  # of a window, as CIFER takes (Tischler and Remple, chapter 7)
MOST_WINDOWS = 1000  # of one length: a longer flight has as many with less overlap
FEWEST_FREEDOM = 3.0  # complex degrees of freedom from which an error can be estimated
LEAST_RESIDUAL_FREEDOM = 0.1  # of the residuals; with less their variance is undefined
CONDITION_LIMIT = 1e10  # condition number of the columns, beyond which inputs are not separable


@dataclass(frozen=True)
class FrequencyGrid:
    """Frequencies first + k spacing [rad/s]; chosen: the indices k, spaced evenly in the logarithm of frequency."""

    first: float
    spacing: float
    chosen: NDArray[np.intp]

    @property
    def omega(self) -> Array:
        return np.asarray(self.first + self.spacing * self.chosen)


@dataclass(frozen=True)
class WindowResponse:
    """Of one window length [s], each (frequencies,). H: complex response to the first input; std: of its real and of
    its imaginary part, such that +-1.96 of it covers 95 %; coherence: with the first input, the others taken off;
    freedom: complex degrees of freedom; power: of the first input, mean |X|^2 over the energy of the window. shift: bias by the
    shape of the window that was removed, relative to H; None where there were too few windows for that."""

    length: float
    H: Complex
    std: Array
    coherence: Array
    freedom: Array
    power: Array
    shift: Array | None = None

    @property
    def corrected(self) -> bool:
        return self.shift is not None


@dataclass(frozen=True)
class _Transforms:
    """X: (terms, windows, frequencies, inputs), Y: (windows, frequencies), of one origin of time; R: (windows, windows)
    correlation."""

    X: Complex
    Y: Complex
    R: Array


def respond(stretches: Sequence[DetrendedStretch], length: float, grid: FrequencyGrid) -> WindowResponse | None:
    """The response by windows of `length` [s]; None where there are too few for an estimate of its error."""
    long = [s for s in stretches if s.duration >= length]
    parts = [_transforms(s, length, grid, max(MOST_WINDOWS // len(long), 1)) for s in long]
    if not parts:
        return None
    X = np.concatenate([p.X for p in parts], axis=1)
    Y = np.concatenate([p.Y for p in parts])
    R = block_diag(*[p.R for p in parts])
    direct_response, corrected = _solved(X[:1], Y, R, length), _solved(X, Y, R, length)
    if corrected is None or direct_response is None:
        return direct_response
    return replace(corrected, shift=np.abs(1.0 - direct_response.H / corrected.H))


def windows(stretch: DetrendedStretch, length: float, most: int = MOST_WINDOWS) -> tuple[int, NDArray[np.intp]]:
    """(samples of a window, indices of the first samples of all windows) of a stretch."""
    size = min(round(length / stretch.step) + 1, len(stretch.y))
    last = len(stretch.y) - size
    count = min(1 + int(last / max((1.0 - OVERLAP) * size, 1.0)), most)
    return size, np.unique(np.linspace(0, last, count).round().astype(np.intp))


def tapers(size: int) -> Array:
    """(3, size) Hann window and its first two derivatives by time in units of the window's length."""
    angles = 2 * np.pi * np.arange(size) / (size - 1)
    return np.stack([0.5 * (1 - np.cos(angles)), np.pi * np.sin(angles), 2 * np.pi**2 * np.cos(angles)])


def _transforms(stretch: DetrendedStretch, length: float, grid: FrequencyGrid, most: int) -> _Transforms:
    size, starts = windows(stretch, length, most)
    shapes = tapers(size)
    cut = np.stack([np.concatenate([stretch.x, stretch.y[:, None]], axis=1)[s : s + size] for s in starts])
    cut = cut - np.einsum("n,wnc->wc", shapes[0], cut)[:, None] / shapes[0].sum()
    ratio, begin = np.exp(-1j * grid.spacing * stretch.step), np.exp(1j * grid.first * stretch.step)
    count = int(grid.chosen[-1]) + 1
    unit = np.sqrt(stretch.step / float(np.sum(shapes[0] ** 2)))  # power becomes that of a spectral density
    # phases from the first sample of the stretch
    phased_unit = unit * np.exp(-1j * grid.omega * stretch.step * starts[:, None])
    transforms = []
    for shape in shapes:
        zoomed = czt(shape[:, None] * cut, m=count, w=ratio, a=begin, axis=1)
        transforms.append(zoomed[:, grid.chosen] * phased_unit[:, :, None])
    X = np.stack(transforms)[..., :-1]
    return _Transforms(X, transforms[0][..., -1], _overlap(shapes[0], starts))


def _overlap(taper: Array, starts: NDArray[np.intp]) -> Array:
    """(windows, windows) correlation of white noise between windows."""
    autocorrelation = np.correlate(taper, taper, "full")[taper.size - 1 :] / float(np.sum(taper**2))
    lag = np.abs(starts[:, None] - starts[None, :])
    return np.where(lag < taper.size, autocorrelation[np.minimum(lag, taper.size - 1)], 0.0)


def _solved(X: Complex, Y: Complex, R: Array, length: float) -> WindowResponse | None:
    """Least squares at every frequency; None where the windows are too few. X: (terms, windows, frequencies, inputs)."""
    terms, count, frequencies, inputs = X.shape
    columns = np.transpose(X, (2, 1, 0, 3)).reshape(frequencies, count, terms * inputs)
    size = np.sqrt(np.mean(np.abs(columns) ** 2, axis=1, keepdims=True))
    A, y = columns / np.maximum(size, 1e-300), Y.T
    star = A.conj().transpose(0, 2, 1)
    G = star @ A
    if count <= terms * inputs + 1 or not np.all(np.linalg.cond(G) < CONDITION_LIMIT):
        return None
    inverse = np.linalg.inv(G)
    H = (inverse @ (star @ y[..., None]))[..., 0]
    v = y - (A @ H[..., None])[..., 0]
    shared, shared_twice = star @ (R @ A), star @ (R @ (R @ A))
    PR = inverse @ shared
    residual_freedom = count - np.trace(PR, axis1=1, axis2=2).real
    spread = float(np.sum(R * R)) - 2 * np.trace(inverse @ shared_twice, axis1=1, axis2=2).real
    spread = spread + np.trace(PR @ PR, axis1=1, axis2=2).real
    freedom = residual_freedom**2 / np.maximum(spread, 1e-12)
    if not np.all(freedom >= FEWEST_FREEDOM) or not np.all(residual_freedom > LEAST_RESIDUAL_FREEDOM):
        return None
    rest = np.sum(np.abs(v) ** 2, axis=1)
    variance = rest / residual_freedom * (PR @ inverse)[:, 0, 0].real
    explained = np.abs(H[:, 0]) ** 2 / inverse[:, 0, 0].real
    first = size[:, 0, 0]
    std = np.sqrt(0.5 * variance) * stdtrit(2 * freedom, 0.975) / NORMAL_95
    return WindowResponse(length, H[:, 0] / first, std / first, explained / (explained + rest), freedom, first**2)
