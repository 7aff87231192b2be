"""Least-squares fits of one signal to others, with a standard error that allows for coloured residuals."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from groundstation.flight.arrays import MAD_TO_SIGMA, Array

Columns = Mapping[str, Array]

BLOCK = 1.0  # [s] over which signals are averaged: longer than half a Dutch roll, shorter than a turn
WINDOW = 60.0  # [s] within which wind and slow errors are taken as constant
FEWEST_BLOCKS = 8  # of a fit; also the fewest values of a column that counts as measured
FULL_SHARE = 0.5  # of the usual number of samples, that a block must have
LEAST_DENOMINATOR = 0.3  # of the median, below which a ratio is mostly noise
SAMPLES_PER_INDEPENDENT = 4.0  # samples of a ratio that count as one, since neighbours correlate
LARGEST_CORRELATION = 0.9  # of neighbouring residuals; it widens a variance by (1 + 0.9) / (1 - 0.9) = 19


@dataclass(frozen=True, slots=True)
class FitWithError:
    """A fitted number and its 1 sigma."""

    value: float
    std: float

    def differs_from(self, other: float, tolerance: float, sigmas: float) -> bool:
        """Whether it is further from another number than a tolerance, and than `sigmas` standard deviations."""
        distance = abs(self.value - other)
        return distance > tolerance and distance > sigmas * self.std


def block_means(time: Array, *signals: Array) -> tuple[Array, tuple[Array, ...]]:
    """Window number (m,) of each block of BLOCK seconds, and the means (m,) of each signal (N,), over the samples at which all
    signals are finite."""
    finite = np.all([np.isfinite(s) for s in signals], axis=0) & np.isfinite(time)
    if finite.sum() < FEWEST_BLOCKS:
        return np.zeros(0), tuple(np.zeros(0) for _ in signals)
    t = time[finite]
    number = np.floor((t - t[0]) / BLOCK).astype(np.int64)
    _, label, count = np.unique(number, return_inverse=True, return_counts=True)
    full = count >= FULL_SHARE * np.median(count)
    means = tuple((np.bincount(label, s[finite]) / count)[full] for s in signals)
    centre = (np.bincount(label, t) / count)[full]
    return np.floor((centre - t[0]) / WINDOW), means


def within_windows(window: Array, *values: Array) -> tuple[Array, ...]:
    """The values (m,) less their mean over each window, which removes a constant for each. window: (m,) number."""
    _, label, count = np.unique(window, return_inverse=True, return_counts=True)
    return tuple(v - (np.bincount(label, v) / count)[label] for v in values)


def least_squares(design: Array, target: Array, windows: int) -> tuple[Array, Array] | None:
    """Coefficients (k,) and their covariance (k, k), widened by the correlation of neighbouring residuals; None where
    undetermined. design: (m, k); target: (m,); windows: number of constants already removed from both."""
    rows, unknown = design.shape
    freedom = rows - unknown - windows
    if freedom < FEWEST_BLOCKS // 2 or np.linalg.matrix_rank(design) < unknown:
        return None
    normal = design.T @ design
    solved = np.linalg.solve(normal, design.T @ target)
    residual = target - design @ solved
    spread = float(residual @ residual)
    neighbours = float(residual[1:] @ residual[:-1]) / spread if spread > 0 else 0.0
    rho = min(max(neighbours, 0.0), LARGEST_CORRELATION)
    variance = spread / freedom * (1.0 + rho) / (1.0 - rho)
    return np.asarray(solved, float), np.asarray(variance * np.linalg.inv(normal), float)


def horizontal_airspeed(c: Columns) -> Array:
    """(N,) horizontal component of V [m/s], by the sink rate of GNSS or, without it, by pitch; no vertical wind."""
    climb = c["vd"] if "vd" in c else c["V"] * np.sin(c["theta"]) if "theta" in c else np.zeros_like(c["V"])
    return np.asarray(np.sqrt(np.maximum(c["V"] ** 2 - climb**2, 0.0)))


def scale_by_ground(time: Array, c: Columns) -> tuple[FitWithError, FitWithError] | None:
    """Factor on V and turn added to psi [rad] that best give the ground velocity, less a constant wind in each window. None where
    columns are missing or the headings do not determine it."""
    if not all(n in c for n in ("V", "psi", "vn", "ve")):
        return None
    speed = horizontal_airspeed(c)
    window, (north, east, vn, ve) = block_means(
        time, speed * np.cos(c["psi"]), speed * np.sin(c["psi"]), c["vn"], c["ve"]
    )
    if window.size < FEWEST_BLOCKS:
        return None
    north, east, vn, ve = within_windows(window, north, east, vn, ve)
    design = np.concatenate([np.column_stack([north, -east]), np.column_stack([east, north])])
    solved = least_squares(design, np.concatenate([vn, ve]), 2 * np.unique(window).size)
    if solved is None:
        return None
    (a, b), covariance = solved
    size = float(np.hypot(a, b))
    if size == 0.0:
        return None
    std = float(np.sqrt(np.array([a, b]) @ covariance @ np.array([a, b]))) / size
    turn_std = float(np.sqrt(np.array([-b, a]) @ covariance @ np.array([-b, a]))) / size**2
    return FitWithError(size, std), FitWithError(float(np.arctan2(b, a)), turn_std)


def ratio_of(first: Array, second: Array) -> FitWithError | None:
    """Median of first / second and its 1 sigma, over the finite samples at which the second exceeds LEAST_DENOMINATOR of its
    median; None for too few of them."""
    if not np.isfinite(second).any():
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(second > LEAST_DENOMINATOR * np.nanmedian(second), first / second, np.nan)
    ratio = ratio[np.isfinite(ratio)]
    if ratio.size < FEWEST_BLOCKS:
        return None
    middle = float(np.median(ratio))
    return FitWithError(
        middle, MAD_TO_SIGMA * float(np.median(np.abs(ratio - middle))) / np.sqrt(ratio.size / SAMPLES_PER_INDEPENDENT)
    )
