"""Numbers that tell whether something drives an aircraft that the model does not know of: read off residuals of results."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.estimators.result import Result
from estimation.models.base import Model
from estimation.models.driven import force_states

Array = NDArray[np.float64]

CHANCE = 0.999  # probability at which a gain is believed
FEWEST = 20  # samples of a channel from which its residuals tell anything


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Whether process noise drives the residuals of output error, and the sentence that says so."""

    present: bool
    text: str


@dataclass(frozen=True, slots=True)
class FilterErrorGain:
    """What a filter error gains over output error. gain: twice the log likelihood; chance: what as many gains of the filter
    would reach by chance in one of a thousand records without process noise; size: mean log ratio of the variances."""

    gain: float
    chance: float
    size: float

    @property
    def beyond_chance(self) -> bool:
        """Whether the gain is more than chance."""
        return self.gain > self.chance


def gain_of_filter(ml: Result, fem: Result) -> FilterErrorGain:
    """Likelihood ratio of a filter error against the output error that it contains (all gains zero).

    Residuals are compared channel by channel, as for the diagonal R of either; the channels' correlation, which the filter
    error also estimates, is no sign of process noise.
    """
    from scipy.stats import chi2  # here: whoever only describes a session needs no scipy

    total, values = 0.0, 0
    for a, b in _channels(ml, fem):
        known = np.isfinite(a) & np.isfinite(b)
        count = int(known.sum())
        if count >= FEWEST:
            ratio = float(np.mean(a[known] ** 2) / max(float(np.mean(b[known] ** 2)), 1e-300))
            total += count * float(np.log(max(ratio, 1e-300)))
            values += count
    gains = sum(len(row) for row in fem.extra.get("gain", {}).values())
    return FilterErrorGain(total, float(chi2.ppf(CHANCE, max(gains, 1))), total / max(values, 1))


def driven(model: Model) -> frozenset[str]:
    """Outputs in which process noise shows: all but states that only kinematics moves, such as attitude.

    Gusts and missing terms are forces and moments. Residuals of an attitude are coloured in any air, by the slow errors of the
    filter that it comes from, which a filter error takes up as gladly.
    """
    kinematic = set(model.state_names) - set(force_states(model, model.free_names))
    return frozenset(o for o in model.output_names if o not in kinematic)


def _channels(a: Result, b: Result) -> Iterator[tuple[Array, Array]]:
    """Residuals of both results, channel by channel over all flights, of the outputs that process noise drives."""
    told = driven(a.model)
    for c in (c for c, name in enumerate(a.model.output_names) if name in told):
        yield (
            np.concatenate([f.residuals[:, c] for f in a.flights]),
            np.concatenate([f.residuals[:, c] for f in b.flights]),
        )


def neighbours(result: Result) -> dict[str, float]:
    """Output -> correlation of neighbouring residuals."""
    found = {}
    for c, name in enumerate(result.model.output_names):
        products, power, pairs = 0.0, 0.0, 0
        for f in result.flights:
            r = f.residuals[:, c]
            both = np.isfinite(r[1:]) & np.isfinite(r[:-1])
            first, second = r[:-1][both], r[1:][both]
            products += float(first @ second)
            power += 0.5 * float(first @ first + second @ second)
            pairs += int(both.sum())
        if pairs >= FEWEST and power > 0.0:
            found[name] = products / power
    return found


def predictability(result: Result) -> float:
    """Mean of -log(1 - rho^2) over driven outputs: what the sample before would take off the log variance of residuals."""
    told = driven(result.model)
    rho = np.clip(np.array([v for n, v in neighbours(result).items() if n in told]), -0.999, 0.999)
    return float(np.mean(-np.log(1.0 - rho**2))) if rho.size else 0.0
