"""From simulated flights of the model to whitening and thresholds: so many false alarms an hour of manoeuvring."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Airframe
from daq.identification.monitor.bank import MonitoredEffect
from daq.identification.monitor.evidence import EffectScores, MonitorEvidence, Run, Whitening, fitted
from daq.identification.monitor.nulls import NullConditions, fly
from daq.identification.monitor.predictors import FlightsScan, Innovation, PredictorBank

Array = NDArray[np.float64]

FLIGHT_S = 90.0  # s of manoeuvring of a simulated flight
BEGIN_S = 3.0  # s in which window and predictor fill
AT_ONCE = 100  # flights side by side: more no longer fit the caches
EULER = 0.5772156649015329
HOUR_S = 3600.0
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
    rate: float = 1.0,
) -> Calibration:
    """Simulate so many hours of manoeuvring; half of the allowed false alarms to each statistic."""
    batches = max(1, round(hours * HOUR_S / FLIGHT_S / AT_ONCE))
    flown = [fly(airframe, values, effects, conditions, rng, AT_ONCE, FLIGHT_S) for _ in range(batches)]
    whitening = fitted(_innovations(airframe, values, scans) for scans in flown)
    z, energy = (
        np.concatenate(v, axis=1)
        for v in zip(*(_histories(airframe, values, effects, whitening, scans) for scans in flown), strict=True)
    )
    seen, loud = _usual(z), _usual(energy)
    seconds = FLIGHT_S - BEGIN_S
    named = exceeded(np.abs(seen.of(z)).max(axis=(0, 2, 3)), seconds, rate / 2.0)
    unnamed = exceeded(np.nanmax(loud.of(energy), axis=(0, 2)), seconds, rate / 2.0)
    return Calibration(whitening, seen, loud, named, unnamed, rate, z.shape[1] * seconds / HOUR_S)


def _usual(values: Array) -> StatisticScale:
    """values: (times, flights, ...)."""
    mean = np.nanmean(values, axis=(0, 1))
    far = np.nanquantile(np.abs(values - mean), FAR, axis=(0, 1))
    return StatisticScale(mean, far / FAR_NORMAL)


def _histories(
    airframe: Airframe,
    values: Mapping[str, float],
    effects: Sequence[MonitoredEffect],
    whitening: Whitening,
    scans: Sequence[FlightsScan],
) -> tuple[Array, Array]:
    """(times, flights, windows, effects) and (times, flights, 5) of both statistics, once there is something in the windows."""
    found = [s for t, s in scores(airframe, values, effects, whitening, scans) if t - scans[0].time >= BEGIN_S]
    return np.stack([s.z for s in found]), np.stack([np.log(s.unnamed) for s in found])


def _innovations(airframe: Airframe, values: Mapping[str, float], scans: Sequence[FlightsScan]) -> Run:
    """Of the model alone."""
    bank = PredictorBank(airframe, values, ())
    found = [f for scan in scans if (f := bank.innovation(scan)) is not None]
    later = found[20:]  # the first second still shows where it began
    return np.stack([f.wrong for f in later]), np.stack([f.kind for f in later])


def scores(
    airframe: Airframe,
    values: Mapping[str, float],
    effects: Sequence[MonitoredEffect],
    whitening: Whitening,
    scans: Sequence[FlightsScan],
) -> Iterator[tuple[float, EffectScores]]:
    """Time and score at each half second of several flights side by side."""
    bank, evidence = PredictorBank(airframe, values, effects), MonitorEvidence(effects)
    past: list[Innovation] = []
    for scan in scans:
        found = bank.innovation(scan)
        if found is None:
            continue
        past = [*past, found][-3:]
        if len(past) == 3 and evidence.add(found.time, *whitened(whitening, past)):
            yield scan.time, evidence.score()


def whitened(whitening: Whitening, three: Sequence[Innovation]) -> tuple[Array, Array]:
    """Of three in order of time the last: (5, flights) and (5, effects, flights), white."""
    earlier, before, now = three
    return (
        whitening.applied(now.wrong, before.wrong, earlier.wrong, now.kind),
        whitening.applied(now.signatures, before.signatures, earlier.signatures, now.kind),
    )


def strongest(standardised: Array) -> Array:
    """(..., windows, effects) -> (..., effects): of each effect what the window says in which it stands out most."""
    at = np.abs(standardised).argmax(axis=-2)
    return np.take_along_axis(standardised, at[..., None, :], axis=-2)[..., 0, :]


def exceeded(largest: Array, seconds: float, per_hour: float) -> float:
    """Level that the maximum over `seconds` passes so seldom that it is `per_hour` times an hour: Gumbel, by moments."""
    beta = float(np.std(largest)) * math.sqrt(6.0) / math.pi
    mode = float(np.mean(largest)) - EULER * beta
    chance = 1.0 - math.exp(-per_hour * seconds / HOUR_S)
    return mode - beta * math.log(-math.log(1.0 - chance))
