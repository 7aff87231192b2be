"""The best input: power over frequencies and controls by optimal design, phases of low peak, size by the limits.

For small motion a linear aircraft answers each harmonic by itself, so the information of a multisine is the sum of that of its
harmonics times their power, M = sum w_k M_k, and so is the power of every limited signal, P_j = sum w_k P_jk. Minimising a
criterion of M under P_j <= 1 for every limit j is a convex problem. Its multiplicative algorithm: w_k <- w_k (d_k / price_k)^1/2,
d_k the gain of the criterion by harmonic k, price_k = sum_j m_j P_jk (Titterington, Annals of Statistics 4 (1976) 132; Silvey,
Titterington and Torsney, Commun. Statistics A7 (1978) 1379), with multipliers m_j that grow where a limit is exceeded.
The result is then simulated: what counts is the motion of the model, not its linearisation.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.design.limits import Limits
from estimation.design.predict import (
    INTEGRATION_STEP,
    RANK,
    DesignInformation,
    DesignSetting,
    LimitUse,
    PredictedMotion,
    fly,
    information,
    limits_used,
)
from estimation.design.shapes import (
    STARTS,
    Multisine,
    deal,
    equal_shares,
    low_peak_multisine,
    shifted_to_zero_crossings,
    wave_columns,
)
from estimation.errors import EstimationError
from groundstation.flight import Array

Criterion = Callable[[Array], tuple[float, Array]]
"""Covariance of the relative errors (n, n) -> value to make small, and its derivative with respect to the covariance."""

PROBE = math.radians(0.2)
"""Amplitude of a harmonic flown alone [rad]: small enough for linear motion, large against rounding."""
ROUNDS = 400  # of the multiplicative algorithm
RESOLUTION = 1e-4  # of the criterion: a round that changes it by less is the last
WORST_POWER = 8  # exponent of the p-norm over the relative bounds that stands for the worst of them
LEAST_SHARE = 0.02  # of the largest power: a harmonic with less only raises the peak
UNEVEN_STARTS = 3  # of the search for phases of uneven power, whose peaks do not get below GOOD_PEAK
SHIFTS = 10  # zero crossings that are tried as start of a wave
SIZES = 12  # halvings in the search for the size at the limits: to 1 in 4096, below the limit
LARGEST_SIZE = 1e3  # factor of that search


@dataclass(frozen=True)
class Designed:
    """An input with its motion and information. commands: (N, nu) increments [rad] at INTEGRATION_STEP; waves: of a multisine."""

    kind: str
    commands: Array
    motion: PredictedMotion
    information: DesignInformation
    used: tuple[LimitUse, ...]
    waves: tuple[Multisine, ...] = ()


def measure(
    setting: DesignSetting, limits: Limits, kind: str, commands: Array, waves: Sequence[Multisine] = ()
) -> Designed:
    """Simulate commands: their motion, information and use of limits. EstimationError where the model diverges."""
    motion = fly(setting, commands)
    if not motion.reached:
        raise EstimationError(f"{kind}: the model leaves all bounds in this manoeuvre; make it smaller or shorter")
    limit_use = tuple(limits_used(setting, limits, commands, motion))
    return Designed(kind, commands, motion, information(setting, motion), limit_use, tuple(waves))


def fitted_size(setting: DesignSetting, limits: Limits, commands: Array) -> float:
    """Largest factor, at most LARGEST_SIZE, at which commands stay within every limit; by halving, as motion is not linear."""

    def inside(factor: float) -> bool:
        return _within_limits(setting, limits, factor * commands)

    peaks = np.abs(commands).max(axis=0)
    amplitudes_allowed = np.array([limits.amplitude_of(c) for c in setting.controls])
    high = min(LARGEST_SIZE, float(np.min(amplitudes_allowed / np.maximum(peaks, 1e-12))))
    if inside(high):
        return high
    low = 0.0
    for _ in range(SIZES):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if inside(middle) else (low, middle)
    return low


def fitted_sizes(setting: DesignSetting, limits: Limits, commands: Array) -> Array:
    """(nu,) factors that bring commands to the limits: first all controls together, then each by itself."""
    factors = np.full(len(setting.controls), fitted_size(setting, limits, commands))
    for i in range(len(setting.controls)):
        low, high = 1.0, limits.amplitude_of(setting.controls[i]) / _peak(factors[i] * commands[:, i])
        for _ in range(SIZES if high > 1.0 + 1e-6 else 0):
            middle = 0.5 * (low + high)
            trial_factors = factors * np.where(np.arange(factors.size) == i, middle, 1.0)
            low, high = (middle, high) if _within_limits(setting, limits, trial_factors * commands) else (low, middle)
        factors[i] *= low
    return factors


def _peak(values: Array) -> float:
    return max(float(np.abs(values).max()), 1e-12)


def _within_limits(setting: DesignSetting, limits: Limits, commands: Array) -> bool:
    motion = fly(setting, commands)
    # a control at its limit may exceed it by rounding
    return motion.reached and all(u.share <= 1.0 + 1e-9 for u in limits_used(setting, limits, commands, motion))


@dataclass(frozen=True)
class Harmonics:
    """For each harmonic its control (K,), information per unit of power (K, n, n), and power in every limited signal (K, j).

    A power of 1 stands for a sine whose amplitude is the limit.
    """

    control: NDArray[np.int64]
    information: Array
    power: Array
    names: tuple[str, ...]


def simulated_harmonics(setting: DesignSetting, limits: Limits, period: float, band: tuple[float, float]) -> Harmonics:
    """Simulate every harmonic alone and small."""
    time = np.arange(0.0, period, INTEGRATION_STEP)
    controls, matrices, power = [], [], []
    names: tuple[str, ...] = ()
    for control, harmonics in enumerate(deal(len(setting.controls), period, band)):
        for k in harmonics.tolist():
            commands = np.zeros((time.size, len(setting.controls)))
            commands[:, control] = PROBE * np.sin(2.0 * math.pi * k * time / period)
            motion = fly(setting, commands)
            harmonic_information = information(setting, motion)
            names = harmonic_information.names
            controls.append(control)
            matrices.append(harmonic_information.matrix / (0.5 * PROBE**2))
            power.append([u.share**2 / (0.5 * PROBE**2) for u in limits_used(setting, limits, commands, motion)])
    return Harmonics(np.array(controls), np.array(matrices), np.array(power), names)


def allocate(harmonics: Harmonics, scale: Array, criterion: Criterion) -> Array:
    """(K,) power of each harmonic for the least criterion of the relative covariance, no limited signal above 1. scale: (n,)."""
    weights = 1.0 / harmonics.power.sum(axis=1)
    weights /= float((weights @ harmonics.power).max())
    multipliers = np.full(harmonics.power.shape[1], 1.0 / harmonics.power.shape[1])
    relative = harmonics.information * scale[None, :, None] * scale[None, None, :]
    last = math.inf
    for _ in range(ROUNDS):
        total_information = np.tensordot(weights, relative, axes=1)
        covariance = np.linalg.pinv(total_information, rcond=RANK, hermitian=True)
        value, slope = criterion(covariance)
        gain = np.einsum("ij,kji->k", covariance @ slope @ covariance, relative)
        weights = weights * np.sqrt(np.maximum(gain, 0.0) / (harmonics.power @ multipliers))
        share = weights @ harmonics.power
        weights /= float(share.max())
        multipliers = multipliers * np.sqrt(share / share.max())
        multipliers /= multipliers.sum()
        if abs(last - value) < RESOLUTION * abs(value):
            break
        last = value
    return weights


def d_optimal(covariance: Array) -> tuple[float, Array]:
    """Criterion: logarithm of the determinant of the covariance."""
    sign, volume = np.linalg.slogdet(covariance)
    return (float(volume) if sign > 0 else math.inf), np.asarray(np.linalg.pinv(covariance, hermitian=True), float)


def a_optimal(covariance: Array) -> tuple[float, Array]:
    """Criterion: sum of the squared relative bounds."""
    return float(np.trace(covariance)), np.eye(len(covariance))


def worst_of(chosen: NDArray[np.bool_]) -> Criterion:
    """Criterion: the largest of the chosen relative bounds, as a p-norm, which has a derivative."""

    def criterion(covariance: Array) -> tuple[float, Array]:
        variance = np.where(chosen, np.diag(covariance), 0.0)
        top = max(float(variance.max()), 1e-300)
        half = WORST_POWER / 2
        shares = (variance / top) ** (half - 1)
        value = top * float(np.sum((variance / top) ** half)) ** (1.0 / half)
        return value, np.diag(shares)

    return criterion


def one_parameter(index: int) -> Criterion:
    """Criterion: the squared relative bound of one parameter."""

    def criterion(covariance: Array) -> tuple[float, Array]:
        slope = np.zeros_like(covariance)
        slope[index, index] = 1.0
        return float(covariance[index, index]), slope

    return criterion


def multisine(
    setting: DesignSetting,
    limits: Limits,
    period: float,
    band: tuple[float, float],
    rng: np.random.Generator,
    weights: Mapping[int, Array] | None = None,
) -> Designed:
    """Orthogonal multisines on all controls, as large as the limits allow.

    weights: index of control -> (K,) power of its harmonics; None: equal powers, each control up to its amplitude.
    """
    harmonics_by_control = deal(len(setting.controls), period, band)
    waves = []
    for i, (control, harmonics) in enumerate(zip(setting.controls, harmonics_by_control, strict=True)):
        power = equal_shares(harmonics.size) if weights is None else weights[i]
        keep = power >= LEAST_SHARE * power.max()
        wave = low_peak_multisine(
            period, harmonics[keep], power[keep], rng, STARTS if weights is None else UNEVEN_STARTS
        )
        peak = _peak(wave.values(np.arange(0.0, period, INTEGRATION_STEP)))
        size = limits.amplitude_of(control) / peak if weights is None else math.sqrt(float(power.sum()))
        waves.append(wave.scaled(size))
    time = np.arange(0.0, period + 0.5 * INTEGRATION_STEP, INTEGRATION_STEP)
    waves = calmest_shifts(setting, limits, waves, time)
    commands = wave_columns(waves, time)
    factors = fitted_sizes(setting, limits, commands)
    waves = [w.scaled(f) for w, f in zip(waves, factors.tolist(), strict=True)]
    return measure(setting, limits, "multisine", factors * commands, waves)


def calmest_shifts(setting: DesignSetting, limits: Limits, waves: Sequence[Multisine], time: Array) -> list[Multisine]:
    """The waves, shifted in turn to the zero crossings at which the motion stays furthest within its limits."""

    def largest_share(waves: Sequence[Multisine]) -> float:
        """Of any limit of the motion."""
        commands = wave_columns(waves, time)
        motion = fly(setting, commands)
        if not motion.reached:
            return math.inf
        return max(u.share for u in limits_used(setting, limits, commands, motion) if u.name not in setting.controls)

    chosen_waves = list(waves)
    if not limits.response or largest_share(chosen_waves) <= 1.0:
        return chosen_waves
    for i in range(len(chosen_waves)):
        variants = [
            v
            for shifted in shifted_to_zero_crossings(chosen_waves[i])[:SHIFTS]
            for v in (shifted, shifted.scaled(-1.0))
        ]
        chosen_waves[i] = min(variants, key=lambda v: largest_share([*chosen_waves[:i], v, *chosen_waves[i + 1 :]]))
    return chosen_waves


def optimal(
    setting: DesignSetting,
    limits: Limits,
    period: float,
    band: tuple[float, float],
    rng: np.random.Generator,
    scale: Mapping[str, float],
    criterion: Callable[[tuple[str, ...]], Criterion],
    judge: Callable[[Designed], float],
) -> Designed:
    """The multisine of optimal power, or the one of equal powers where the simulated motion is better.

    scale: parameter -> size by which its error is measured; 1 for a parameter without one, such as a constant. criterion: names
    of the parameters -> criterion to minimise. judge: of a simulated input, smaller is better.
    """
    harmonics = simulated_harmonics(setting, limits, period, band)
    sizes = np.array([abs(scale.get(n, 0.0)) for n in harmonics.names])
    weights = allocate(harmonics, np.where(sizes > 0.0, sizes, 1.0), criterion(harmonics.names))
    shares = {i: weights[harmonics.control == i] for i in range(len(setting.controls))}
    candidates = (multisine(setting, limits, period, band, rng), multisine(setting, limits, period, band, rng, shares))
    return replace(min(candidates, key=judge), kind="optimal")
