"""Input shapes: doublets, 1-2-1, 3-2-1-1, chirps and orthogonal phase-optimised multisines.

Every shape starts and ends at zero. Multisines: u(t) = sum_k A_k cos(2 pi k t / T + phi_k), the harmonics k dealt in turn to
the controls, so that inputs of different controls are orthogonal over whole periods T. Phases make the relative peak factor
(max - min) / (2 sqrt(2) rms) small (1 is a single sine). Sources: Schroeder, IEEE Trans. Information Theory 16 (1970) 85;
Guillaume et al., IEEE Trans. Instrumentation and Measurement 40 (1991) 982 (p-norms of rising order); Morelli, AIAA 2003-5617
(harmonics dealt to controls, shift to a zero crossing).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.flight import Array

PATTERNS: Mapping[str, tuple[float, ...]] = {
    "doublet": (1.0, -1.0),
    "121": (1.0, -1.0, -1.0, 1.0),
    "3211": (1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0),
}
"""Signs of successive steps of unit width."""

_POWERS = (4, 8, 16, 32, 64)  # exponents of the p-norms, as published: each search starts from the one before
_GRID = 1024  # samples of a period in the search for peaks: 25 a cycle of the 40th harmonic
GOOD_PEAK = 1.05
"""Relative peak factor at which the search for phases ends; the best published ones lie between 0.96 and 1.02."""
STARTS = 8  # of the search for phases: Schroeder's and random ones
_FREEDOM = 0.345  # of log amplitudes, either way: 3 dB


@dataclass(frozen=True)
class Multisine:
    """One control's sum of sines: harmonics (K,) of 1/period, amplitudes (K,) [rad], phases (K,) [rad], period [s]."""

    period: float
    harmonics: NDArray[np.int64]
    amplitudes: Array
    phases: Array

    def values(self, time: Array) -> Array:
        """(N,) input at each time [rad]."""
        angle = 2.0 * math.pi / self.period * np.outer(time, self.harmonics) + self.phases
        return np.asarray(np.cos(angle) @ self.amplitudes)

    def slope(self, time: float) -> float:
        """Rate of the input at an instant [rad/s]."""
        speed = 2.0 * math.pi / self.period * self.harmonics
        return -float(np.sin(speed * time + self.phases) @ (self.amplitudes * speed))

    def scaled(self, factor: float) -> "Multisine":
        """The wave with amplitudes times `factor`."""
        return Multisine(self.period, self.harmonics, factor * self.amplitudes, self.phases)


def pattern(name: str, time: Array, start: float, width: float, amplitude: float, rate: float) -> Array:
    """(N,) a pattern of PATTERNS from `start` on, steps of `width` [s] and `amplitude` [rad], no faster than `rate` [rad/s].

    Edges are ramps centred on the instants of the steps, so that each step has the area of its width.
    """
    signs = np.array([0.0, *PATTERNS[name], 0.0])
    edges = start + width * np.arange(signs.size - 1)
    half = 0.5 * np.abs(np.diff(signs)) * amplitude / rate
    knots = np.column_stack([edges - half, edges + half]).ravel()
    levels = np.column_stack([signs[:-1], signs[1:]]).ravel()
    return np.asarray(amplitude * np.interp(time, knots, levels, left=0.0, right=0.0))


def chirp(time: Array, start: float, length: float, band: tuple[float, float], amplitude: float) -> Array:
    """(N,) a logarithmic sweep through `band` [Hz] of `length` [s], faded in and out over a tenth of it each, as in CIFER."""
    relative_time = (time - start) / length
    during_sweep = (relative_time >= 0.0) & (relative_time <= 1.0)
    low, high = band
    ratio = high / low
    phase = 2.0 * math.pi * low * length * (ratio**relative_time - 1.0) / math.log(ratio)
    fade = np.clip(10.0 * np.minimum(relative_time, 1.0 - relative_time), 0.0, 1.0)
    return np.where(during_sweep, amplitude * fade * np.sin(phase), 0.0)


def deal(count: int, period: float, band: tuple[float, float]) -> list[NDArray[np.int64]]:
    """Harmonics of 1/period inside `band` [Hz], dealt in turn to `count` controls. ValueError where one would get none."""
    first, last = math.ceil(band[0] * period - 1e-9), math.floor(band[1] * period + 1e-9)
    harmonics = np.arange(max(1, first), last + 1)
    if harmonics.size < count:
        raise ValueError(f"only {harmonics.size} harmonics of {period:g} s between {band[0]:g} and {band[1]:g} Hz")
    return [harmonics[i::count] for i in range(count)]


def relative_peak_factor(values: Array) -> float:
    """(max - min) / (2 sqrt(2) rms); NaN for an input that is zero throughout."""
    rms = float(np.sqrt(np.mean(values**2)))
    return float(np.ptp(values)) / (2.0 * math.sqrt(2.0) * rms) if rms > 0.0 else math.nan


def low_peak_multisine(
    period: float, harmonics: NDArray[np.int64], weights: Array, rng: np.random.Generator, starts: int = STARTS
) -> Multisine:
    """A multisine of rms 1 of low peak that starts at a zero crossing; power shares within 3 dB of `weights` (K,).

    The search starts from Schroeder's phases, then from random ones until the relative peak factor is below GOOD_PEAK or `starts`
    were tried; the best is returned.
    """
    weights = weights / weights.sum()
    search = _PeakSearch(harmonics, np.sqrt(2.0 * weights))
    earlier_power = np.cumsum(weights) - weights
    best_phases = search.lowered(-2.0 * math.pi * np.cumsum(earlier_power))  # Schroeder 1970, eq 11
    for _ in range(starts - 1):
        if search.peak(best_phases) < GOOD_PEAK:
            break
        best_phases = min(best_phases, search.lowered(rng.uniform(0.0, 2.0 * math.pi, harmonics.size)), key=search.peak)
    amplitudes, phases = search.parts(best_phases)
    return shifted_to_zero_crossings(Multisine(period, harmonics, amplitudes, phases))[0]


class _PeakSearch:
    """Phases, and amplitudes within 3 dB, of low peak by p-norms of rising order.

    Phases alone suffice for harmonics dealt to two controls. Of those dealt to three, the ones of remainder 1 or 2 modulo 3
    repeat their envelope three times a period with turned phases and stay above 1.10; 3 dB of freedom bring them to 1.04.
    """

    def __init__(self, harmonics: NDArray[np.int64], amplitudes: Array) -> None:
        angles = 2.0 * math.pi * np.outer(np.arange(_GRID) / _GRID, harmonics)
        self._cos, self._sin = np.cos(angles), np.sin(angles)
        self._wanted = amplitudes
        self._count = harmonics.size

    def parts(self, unknowns: Array) -> tuple[Array, Array]:
        """(amplitudes for an rms of 1, phases)."""
        raw = self._wanted * np.exp(unknowns[: self._count])
        return raw / math.sqrt(0.5 * raw @ raw), unknowns[self._count :]

    def peak(self, unknowns: Array) -> float:
        amplitudes, phases = self.parts(unknowns)
        return relative_peak_factor(self._wave(amplitudes, phases))

    def lowered(self, phases: Array) -> Array:
        """Unknowns (log amplitude changes, phases) of low peak, searched from `phases`."""
        from scipy.optimize import minimize

        unknowns = np.concatenate([np.zeros(self._count), phases])
        bounds = [(-_FREEDOM, _FREEDOM)] * self._count + [(None, None)] * self._count
        for power in _POWERS:
            minimum = minimize(self._norm, unknowns, args=(power,), jac=True, method="L-BFGS-B", bounds=bounds)
            unknowns = minimum.x
        return unknowns

    def _wave(self, amplitudes: Array, phases: Array) -> Array:
        return np.asarray(self._cos @ (amplitudes * np.cos(phases)) - self._sin @ (amplitudes * np.sin(phases)))

    def _norm(self, unknowns: Array, power: int) -> tuple[float, Array]:
        """Logarithm of the p-norm, which is well scaled for every power, and its gradient."""
        amplitudes, phases = self.parts(unknowns)
        u = self._wave(amplitudes, phases)
        top = float(np.abs(u).max())
        powers = (u / top) ** (power - 1)
        power_sum = float(powers @ u) / top
        along_cos, along_sin = powers @ self._cos / (top * power_sum), powers @ self._sin / (top * power_sum)
        by_phase = -amplitudes * (along_sin * np.cos(phases) + along_cos * np.sin(phases))
        direct_slope = amplitudes * (along_cos * np.cos(phases) - along_sin * np.sin(phases))
        by_size = direct_slope - direct_slope.sum() * 0.5 * amplitudes**2  # the rms stays 1
        return math.log(power_sum) / power + math.log(top), np.concatenate([by_size, by_phase])


def shifted_to_zero_crossings(wave: Multisine) -> list[Multisine]:
    """The wave shifted in time to each of its zero crossings, the one of least slope (the softest entry) first.

    A shift leaves peak and orthogonality as they are, and changes how the answers of several controls add up.
    """
    fine = np.linspace(0.0, wave.period, 8 * _GRID, endpoint=False)
    u = wave.values(fine)
    following = np.roll(u, -1)
    crossings = np.flatnonzero(np.sign(u) != np.sign(following))
    shifted_waves = []
    for crossing in crossings[np.argsort(np.abs(following - u)[crossings])].tolist():
        instant = fine[crossing] + fine[1] * u[crossing] / (u[crossing] - following[crossing])
        for _ in range(3):  # Newton's steps from this near converge to rounding
            instant -= float(wave.values(np.array([instant]))[0]) / wave.slope(instant)
        shift = 2.0 * math.pi * wave.harmonics * instant / wave.period
        shifted_waves.append(replace(wave, phases=(wave.phases + shift) % (2.0 * math.pi)))
    return shifted_waves


def equal_shares(count: int) -> Array:
    """(K,) equal power shares."""
    return np.full(count, 1.0 / count)


def wave_columns(waves: Sequence[Multisine], time: Array) -> Array:
    """(N, nu) values of the waves, a column for each control."""
    return np.column_stack([w.values(time) for w in waves])
