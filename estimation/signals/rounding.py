"""Signals that a converter of few bits has rounded.

Ten bits over the travel of a potentiometer are steps of a quarter of a degree. A control that stays on one level shows no noise
from sample to sample, but it may be anywhere within the step, and stays there: its errors are neither absent nor white. Taken for
exact, a potentiometer with steps of 0.6 deg looks like a late or sticking servo in 10 of 10 simulated sets of flights.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST_LEVELS = 6  # distinct values that show a grid: a command of exact steps has fewer
REPEATED = 0.5  # of the samples of a rounded signal at least have a value that others have too
SAME_VALUE = 1e-6  # of the range of a signal: values as close differ by the rounding of arithmetic
HELD = 0.25  # of its levels a rounded signal holds for two samples or more (0.34 to 0.88); exact ramps between steps hold few
EVEN = 0.2  # of a step: a calibration may stretch the grid
UNIFORM = 1.0 / 12.0  # variance of an error that is uniform over one step
COARSE = 0.5  # of the noise: with less, noise moves a signal from level to level in most samples
SMOOTH = 0.02  # s, half of the time constant of the servos of small aircraft
STAYS = 5  # samples on one level: noise of a third of a step or more moves a control to the next before


@dataclass(frozen=True, slots=True)
class Grid:
    """The even grid of a recorded signal. step, origin: in its unit."""

    step: float
    origin: float

    @property
    def noise(self) -> float:
        """Standard deviation of an error that is uniform over one step."""
        return self.step * sqrt(UNIFORM)

    def is_coarse(self, noise: float) -> bool:
        """Whether rounding makes so much of the noise of a signal that its errors are not white. noise: with the rounding."""
        return self.noise > COARSE * noise

    def rounded(self, values: Array) -> Array:
        """(N,) values on the grid."""
        return np.asarray(self.origin + self.step * np.round((values - self.origin) / self.step))

    def noise_before(self, noise: float) -> float:
        """Standard deviation of the noise before rounding of a signal that has `noise` after it."""
        return sqrt(max(noise**2 - self.noise**2, 0.0))


def grid_of(values: Array) -> Grid | None:
    """The grid on which a recorded signal (N,) lies, NaN where not measured; None where there is none, or too few values show
    it."""
    finite = values[np.isfinite(values)]
    measured = np.sort(finite)
    gaps = np.diff(measured)
    gaps = gaps[gaps > SAME_VALUE * (measured[-1] - measured[0])] if measured.size else gaps
    if not FEWEST_LEVELS <= gaps.size + 1 <= REPEATED * measured.size:
        return None
    step = float(np.median(gaps))
    steps = np.maximum(np.round(gaps / step), 1.0)
    even = np.abs(gaps - steps * step) <= EVEN * steps * step
    levels = np.round((finite - measured[0]) / step)
    held = np.unique(levels[1:][np.diff(levels) == 0.0]).size
    return Grid(step, float(measured[0])) if even.all() and held >= HELD * np.unique(levels).size else None


def rounding_noise(values: Array) -> float:
    """Standard deviation of the error of a rounded signal (N,), NaN where not measured; zero where it is not rounded."""
    grid = grid_of(values)
    return grid.noise if grid else 0.0


def draw_level_errors(errors: NDArray[np.float32], measured: Array, grid: Grid, rng: np.random.Generator) -> None:
    """Replace draws of errors (N, draws), in place, where a signal (N,) stays on one level: it may be anywhere within the step.

    Each stay has its own draw: a control that returns to rest may return to another place. Where it does not, bounds are up to
    twice too large.
    """
    starts = np.concatenate([[0], np.flatnonzero(np.diff(measured)) + 1, [measured.size]])
    for a, b in zip(starts[:-1], starts[1:], strict=True):
        if b - a >= STAYS:
            errors[a:b] = grid.step * rng.uniform(-0.5, 0.5, errors.shape[1])


def near_edges(measured: Array, grid: Grid | None, interval: float) -> Array:
    """(N,) a measured control, samples `interval` [s] apart, as it is used near its edges: a rounded one without stairs."""
    return measured if grid is None else without_stairs(measured, interval)


def without_stairs(values: Array, interval: float, least: int = 0) -> Array:
    """(N,) a rounded control, samples `interval` [s] apart, averaged over `SMOOTH` to either side, or over `least` samples, with
    falling weights: no servo moves in stairs. Unchanged where samples are farther apart, and next to missing values (NaN)."""
    reach = max(round(SMOOTH / interval), least)
    weights = 1.0 + reach - np.abs(np.arange(-reach, reach + 1))
    smooth = np.convolve(np.pad(values, reach, mode="edge"), weights / weights.sum(), "valid")
    return np.where(np.isfinite(smooth), smooth, values)
