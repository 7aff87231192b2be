"""Numbers that bear on an estimate: process noise, scatter over flights, and what a reconstructed airspeed may be off.

A coefficient is a force over rho V^2 S / 2, so a derivative is wrong by twice the relative error of V (those by a rate by up to
once more or less, which is left out); no residual shows it, so it is counted in the corrected bounds. Pitot and wind have errors
that last for a flight and may last for a day: flights of a joint estimate are taken to share them.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.estimators.result import Estimate, Result
from estimation.models.base import ParameterRole
from estimation.models.dependence import driven_outputs
from groundstation.flight import RECONSTRUCTED, Array, Flight

CHANCE = 0.999  # probability at which a gain is believed
FEWEST = 20  # samples of a channel from which its residuals tell anything


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Whether process noise drives the residuals of output error, the sentence that says so, and one that says why none does."""

    present: bool
    text: str
    quiet: str = "no process noise to speak of: filter error gains little over it"


WHOLLY = 0.99  # r2 of an output of which hardly anything is left: noise of sound instruments alone leaves 0.95 to 0.99


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
    from scipy.special import chdtri  # here: whoever only describes a session needs no scipy

    total, values = 0.0, 0
    for a, b in _channels(ml, fem):
        measured = np.isfinite(a) & np.isfinite(b)
        count = int(measured.sum())
        if count >= FEWEST:
            ratio = float(np.mean(a[measured] ** 2) / max(float(np.mean(b[measured] ** 2)), 1e-300))
            total += count * float(np.log(max(ratio, 1e-300)))
            values += count
    gains = sum(len(row) for row in fem.extra.get("gain", {}).values())
    return FilterErrorGain(total, float(chdtri(max(gains, 1), 1.0 - CHANCE)), total / max(values, 1))


def corrected_states(results: Mapping[str, Result]) -> str:
    """The parameters by which some result has the record of a state late or of another scale, which regressions cannot."""
    instruments = ((n, r.model) for r in results.values() for n in r.names if n.startswith(("delay_", "scale_")))
    return " and ".join(sorted({n for n, model in instruments if n.partition("_")[2] in model.state_names}))


def beneath_instruments(ml: Result) -> bool:
    """Whether output error leaves less of every output than the noise of sound instruments, and next to nothing of its motion.

    What a filter error takes up there is how inputs go between samples, or rounding, as in a simulation's record without noise;
    the bounds of coloured residuals count it.
    """
    from groundstation.flight.quality.report import SENSOR_NOISE

    for column, output in enumerate(ml.model.outputs):
        residuals = [f.residuals[:, column] for f in ml.flights]
        left = np.concatenate([r[np.isfinite(r)] for r in residuals])
        explained = all(f.fit[output.name].r2 >= WHOLLY for f in ml.flights if output.name in f.fit)
        if not explained or float(np.sqrt(np.mean(left**2))) > SENSOR_NOISE.get(output.source, 0.0):
            return False
    return True


def _channels(a: Result, b: Result) -> Iterator[tuple[Array, Array]]:
    """Residuals of both results, channel by channel over all flights, of the outputs that process noise drives."""
    outputs = driven_outputs(a.model)
    for c in (c for c, name in enumerate(a.model.output_names) if name in outputs):
        yield (
            np.concatenate([f.residuals[:, c] for f in a.flights]),
            np.concatenate([f.residuals[:, c] for f in b.flights]),
        )


def neighbour_correlations(result: Result) -> dict[str, float]:
    """Output -> correlation of neighbouring residuals."""
    correlations = {}
    for c, name in enumerate(result.model.output_names):
        products, power, pairs = 0.0, 0.0, 0
        for f in result.flights:
            r = f.residuals[:, c]
            measured = np.isfinite(r[1:]) & np.isfinite(r[:-1])
            first, second = r[:-1][measured], r[1:][measured]
            products += float(first @ second)
            power += 0.5 * float(first @ first + second @ second)
            pairs += int(measured.sum())
        if pairs >= FEWEST and power > 0.0:
            correlations[name] = products / power
    return correlations


PREDICTABLE = 0.4  # mean of -log(1 - rho^2) of neighbouring residuals: light air up to 0.19, gusts of 0.5 deg from 0.67


def predictability(result: Result) -> float:
    """Mean of -log(1 - rho^2) over driven outputs: what the sample before would take off the log variance of residuals."""
    outputs = driven_outputs(result.model)
    rho = np.clip(np.array([v for n, v in neighbour_correlations(result).items() if n in outputs]), -0.999, 0.999)
    return float(np.mean(-np.log(1.0 - rho**2))) if rho.size else 0.0


POWER = 2.0
"""Of V in the dynamic pressure."""


def with_airspeed_error(result: Result, flights: Sequence[Flight]) -> Result:
    """The result with the common error of reconstructed airspeeds in the corrected bounds of derivatives."""
    share = float(np.mean([_share(f) for f in flights])) if flights else 0.0
    if share == 0.0:
        return result
    derivatives = set(result.model.free_of(ParameterRole.DERIVATIVE))
    wider = {n: _wider(e, share) if n in derivatives else e for n, e in result.parameters.items()}
    return replace(result, parameters=wider)


def _wider(estimate: Estimate, share: float) -> Estimate:
    return replace(estimate, std_coloured=math.hypot(estimate.std_coloured, share * estimate.estimate))


def _share(flight: Flight) -> float:
    """Relative 1 sigma of every derivative by the airspeed of a flight; 0 where it was measured, or nothing is stated."""
    if "V" not in flight.reconstructed or not flight.measured("V"):
        return 0.0
    detail = flight.provenance.detail.get(RECONSTRUCTED)
    stds = detail.get("std") if isinstance(detail, Mapping) else None
    std = stds.get("V") if isinstance(stds, Mapping) else None
    if not isinstance(std, int | float) or not 0.0 < std < math.inf:
        return 0.0
    return POWER * float(std) / float(np.nanmedian(flight["V"]))


@dataclass(frozen=True)
class Scatter:
    """One parameter over flights. std: sample standard deviation; bound: rms of the flights' corrected bounds;
    ratio: std/bound; probability: of a chi-square as large, were the bounds right (None with fewer than two flights)."""

    mean: float
    std: float
    bound: float
    ratio: float
    probability: float | None
    count: int
    trim: bool = False  # a constant that differs from flight to flight with trim and sensor offsets

    @property
    def text(self) -> str:
        """The verdict on the bounds, empty where scatter and bounds agree."""
        if self.trim or self.probability is None or self.probability > 0.01:
            return ""
        return f"scatter over {self.count} flights is {self.ratio:.1f} times the bounds: these bounds are too small"


def parameter_scatter(results: Sequence[Result]) -> dict[str, Scatter]:
    """Mean and scatter of each parameter over the flights that could tell it, against their bounds."""
    from scipy.special import chdtrc  # here: whoever only describes a session needs no scipy

    table = {}
    for name in results[0].parameters:
        usable = [r.parameters[name] for r in results if r.converged and name in r.parameters]
        identifiable = [e for e in usable if e.identifiable]
        if not identifiable:
            continue
        x = np.array([e.estimate for e in identifiable])
        bounds = np.array([e.std_coloured for e in identifiable])
        std = float(np.std(x, ddof=1)) if x.size > 1 else math.nan
        bound = float(np.sqrt(np.mean(bounds**2)))
        probability = None
        if x.size > 1 and np.all(bounds > 0):
            weighted = np.sum(x / bounds**2) / np.sum(1 / bounds**2)
            probability = float(chdtrc(x.size - 1, np.sum(((x - weighted) / bounds) ** 2)))
        table[name] = Scatter(
            float(x.mean()),
            std,
            bound,
            std / bound if bound > 0 else math.nan,
            probability,
            x.size,
            results[0].model.parameter(name).role is ParameterRole.CONSTANT,
        )
    return table
