"""From simulated flights of the model to whitening and thresholds: so many false alarms an hour of manoeuvring."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Airframe
from daq.identification.monitor import FALSE_ALARMS
from daq.identification.monitor.bank import LATERAL_PLANE, MonitoredEffect, MonitoredPlane
from daq.identification.monitor.evidence import EffectScores, MonitorEvidence, Run, Whitening, fit_whitening
from daq.identification.monitor.nulls import NullConditions, fly
from daq.identification.monitor.predictors import FlightsScan, Innovation, PredictorBank

Array = NDArray[np.float64]

FLIGHT_S = 90.0  # s of manoeuvring of a simulated flight
BEGIN_S = 3.0  # s in which window and predictor fill
AT_ONCE = 100  # flights side by side: more no longer fit the caches
EULER = 0.5772156649015329
HOUR_S = 3600.0
ENERGY_SHARE = 0.2  # what has no name grows large; in strong gusts energy brings most of the false alarms
FAR, FAR_NORMAL = 0.999, 3.2905  # a share of all values, and how far out that of a normal variable lies


@dataclass(frozen=True)
class StatisticScale:
    """What is usual of a statistic on simulated flights: its mean, and its 99.9 % point in units of a normal one's."""

    mean: Array
    width: Array

    def of(self, values: Array) -> Array:
        """In units of what is usual, signs kept."""
        return np.asarray((values - self.mean) / self.width)


@dataclass(frozen=True)
class Calibration:
    """What the monitor needs. effects (by window), channels: what is usual of each; named, unnamed: thresholds of the largest of
    either; rate: false alarms an hour of both together that they were set for; hours: of simulated manoeuvring behind them."""

    whitening: Whitening
    effects: StatisticScale
    channels: StatisticScale
    named: float
    unnamed: float
    rate: float
    hours: float


def calibrated(
    airframe: Airframe,
    values: Mapping[str, float],
    effects: Sequence[MonitoredEffect],
    conditions: NullConditions,
    *,
    rng: np.random.Generator,
    hours: float = 2.5,
    rate: float = FALSE_ALARMS,
    plane: MonitoredPlane = LATERAL_PLANE,
) -> Calibration:
    """Simulate so many hours of manoeuvring; the energy of channels has `ENERGY_SHARE` of the allowed false alarms."""
    batches = max(1, round(hours * HOUR_S / FLIGHT_S / AT_ONCE))
    batches_of_scans = [
        fly(airframe, values, effects, conditions, rng, AT_ONCE, FLIGHT_S, plane=plane) for _ in range(batches)
    ]
    whitening = fit_whitening(
        _innovations(PredictorBank(airframe, values, (), plane), scans) for scans in batches_of_scans
    )
    bank = partial(PredictorBank, airframe, values, effects, plane)
    histories = [_histories(bank(), effects, whitening, scans) for scans in batches_of_scans]
    times = min(len(z) for z, _ in histories)  # scans that a link loses are others in each batch
    z, energy = (np.concatenate([h[k][:times] for h in histories], axis=1) for k in (0, 1))
    effect_scale, energy_scale = _usual(z), _usual(energy)
    seconds = FLIGHT_S - BEGIN_S
    effect_threshold = exceeded(np.abs(effect_scale.of(z)).max(axis=(0, 2, 3)), seconds, rate * (1.0 - ENERGY_SHARE))
    energy_threshold = exceeded(np.nanmax(energy_scale.of(energy), axis=(0, 2)), seconds, rate * ENERGY_SHARE)
    return Calibration(
        whitening, effect_scale, energy_scale, effect_threshold, energy_threshold, rate, z.shape[1] * seconds / HOUR_S
    )


def _usual(values: Array) -> StatisticScale:
    """values: (times, flights, ...)."""
    mean = np.nanmean(values, axis=(0, 1))
    far_quantile = np.nanquantile(np.abs(values - mean), FAR, axis=(0, 1))
    return StatisticScale(mean, far_quantile / FAR_NORMAL)


def _histories(
    bank: PredictorBank, effects: Sequence[MonitoredEffect], whitening: Whitening, scans: Sequence[FlightsScan]
) -> tuple[Array, Array]:
    """(times, flights, windows, effects) and (times, flights, 5) of both statistics, once there is something in the windows."""
    scores_in_time = [s for t, s in scores(bank, effects, whitening, scans) if t - scans[0].time >= BEGIN_S]
    return np.stack([s.z for s in scores_in_time]), np.stack([np.log(s.unnamed) for s in scores_in_time])


def _innovations(bank: PredictorBank, scans: Sequence[FlightsScan]) -> Run:
    """Of the model alone."""
    innovations = [f for scan in scans if (f := bank.innovation(scan)) is not None]
    after_start = innovations[20:]  # the first second still shows where it began
    return np.stack([f.wrong for f in after_start]), np.stack([f.kind for f in after_start])


def scores(
    bank: PredictorBank, effects: Sequence[MonitoredEffect], whitening: Whitening, scans: Sequence[FlightsScan]
) -> Iterator[tuple[float, EffectScores]]:
    """Time and score at each half second of several flights side by side."""
    evidence = MonitorEvidence(effects)
    last_three: list[Innovation] = []
    for scan in scans:
        innovation = bank.innovation(scan)
        if innovation is None:
            continue
        last_three = [*last_three, innovation][-3:]
        if len(last_three) == 3 and evidence.add(innovation.time, *whitened(whitening, last_three)):
            yield scan.time, evidence.score()


def whitened(whitening: Whitening, three: Sequence[Innovation]) -> tuple[Array, Array]:
    """Of three in order of time the last: (5, flights) and (5, effects, flights), white."""
    two_before, one_before, latest = three
    return (
        whitening.applied(latest.wrong, one_before.wrong, two_before.wrong, latest.kind),
        whitening.applied(latest.signatures, one_before.signatures, two_before.signatures, latest.kind),
    )


def strongest(standardised: Array) -> Array:
    """(..., windows, effects) -> (..., effects): of each effect what the window says in which it stands out most."""
    best_window = np.abs(standardised).argmax(axis=-2)
    return np.take_along_axis(standardised, best_window[..., None, :], axis=-2)[..., 0, :]


def exceeded(largest: Array, seconds: float, per_hour: float) -> float:
    """Level that the maximum over `seconds` passes so seldom that it is `per_hour` times an hour: Gumbel, by moments."""
    beta = float(np.std(largest)) * math.sqrt(6.0) / math.pi
    mode = float(np.mean(largest)) - EULER * beta
    chance = 1.0 - math.exp(-per_hour * seconds / HOUR_S)
    return mode - beta * math.log(-math.log(1.0 - chance))
