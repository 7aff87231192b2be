"""Evidence about an estimate: process noise, scatter over flights, and the error of a reconstructed airspeed.

A coefficient is a force over rho V^2 S / 2, so a derivative is wrong by twice the relative error of V (rate derivatives by one
relative error more or less, which is neglected). No residual shows that, so the corrected bounds include it. Errors of pitot and
wind last for a flight and may last for a day: the flights of a joint estimate are taken to share them.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.estimators.result import Estimate, Result
from estimation.models.base import ParameterRole
from estimation.models.dependence import driven_outputs
from groundstation.flight import RECONSTRUCTED, Array, Flight

CHANCE = 0.999  # probability of a smaller gain by chance, from which a gain is believed
FEWEST = 20  # samples of a channel from which a statistic of its residuals is computed
TINY = 1e-300  # keeps ratios of variances finite


@dataclass(frozen=True, slots=True)
class ProcessNoise:
    """Whether process noise drives the residuals of output error. text: the sentence where it does; quiet: where it does not."""

    present: bool
    text: str
    quiet: str = "no process noise to speak of: filter error gains little over it"


EXPLAINED = 0.99  # r2 above which an output is fully explained: noise of sound instruments alone leaves 0.95 to 0.99


@dataclass(frozen=True, slots=True)
class FilterErrorGain:
    """What filter error gains over output error. gain: in twice the log likelihood; chance: what as many filter gains reach by
    chance in one of a thousand records without process noise; size: mean log ratio of the residual variances."""

    gain: float
    chance: float
    size: float

    @property
    def beyond_chance(self) -> bool:
        """Whether the gain is more than chance."""
        return self.gain > self.chance


def gain_of_filter(ml: Result, fem: Result) -> FilterErrorGain:
    """Likelihood ratio of filter error against output error, its special case with all gains zero.

    Residuals are compared channel by channel, as with a diagonal R. Filter error also estimates the correlation of the channels,
    which is no sign of process noise.
    """
    from scipy.special import chdtri  # imported late: describing a session needs no scipy

    total, values = 0.0, 0
    for a, b in _channels(ml, fem):
        measured = np.isfinite(a) & np.isfinite(b)
        count = int(measured.sum())
        if count >= FEWEST:
            ratio = float(np.mean(a[measured] ** 2) / max(float(np.mean(b[measured] ** 2)), TINY))
            total += count * float(np.log(max(ratio, TINY)))
            values += count
    gains = sum(len(row) for row in fem.extra.get("gain", {}).values())
    return FilterErrorGain(total, float(chdtri(max(gains, 1), 1.0 - CHANCE)), total / max(values, 1))


def corrected_states(results: Mapping[str, Result]) -> str:
    """Names of delays and scales of recorded states that some result estimates, joined by "and"; regressions cannot have them."""
    instruments = ((n, r.model) for r in results.values() for n in r.names if n.startswith(("delay_", "scale_")))
    return " and ".join(sorted({n for n, model in instruments if n.partition("_")[2] in model.state_names}))


def beneath_instruments(ml: Result) -> bool:
    """Whether output error leaves residuals below the noise of sound instruments in every output, and explains its motion fully.

    Filter error there absorbs only how inputs move between samples, or rounding, as in a simulated record without noise. The
    bounds for coloured residuals include that.
    """
    from groundstation.flight.quality.report import SENSOR_NOISE

    for column, output in enumerate(ml.model.outputs):
        residuals = [f.residuals[:, column] for f in ml.flights]
        finite = np.concatenate([r[np.isfinite(r)] for r in residuals])
        explained = all(f.fit[output.name].r2 >= EXPLAINED for f in ml.flights if output.name in f.fit)
        if not explained or float(np.sqrt(np.mean(finite**2))) > SENSOR_NOISE.get(output.source, 0.0):
            return False
    return True


def _channels(a: Result, b: Result) -> Iterator[tuple[Array, Array]]:
    """Residuals of both results, channel by channel over all flights, for the outputs that process noise drives."""
    outputs = driven_outputs(a.model)
    for c in (c for c, name in enumerate(a.model.output_names) if name in outputs):
        yield (
            np.concatenate([f.residuals[:, c] for f in a.flights]),
            np.concatenate([f.residuals[:, c] for f in b.flights]),
        )


def neighbour_correlations(result: Result) -> dict[str, float]:
    """Output -> correlation of successive residuals; without outputs of too few samples."""
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


PREDICTABLE = 0.4  # predictability above which there is process noise: light air up to 0.19, gusts of 0.5 deg from 0.67


def predictability(result: Result) -> float:
    """Mean of -log(1 - rho^2) over driven outputs, rho the correlation of successive residuals: by how much prediction from the
    sample before lowers the log variance."""
    outputs = driven_outputs(result.model)
    rho = np.clip(np.array([v for n, v in neighbour_correlations(result).items() if n in outputs]), -0.999, 0.999)
    return float(np.mean(-np.log(1.0 - rho**2))) if rho.size else 0.0


AIRSPEED_POWER = 2.0
"""Power of V in the dynamic pressure."""


def with_airspeed_error(result: Result, flights: Sequence[Flight]) -> Result:
    """The result with the error of reconstructed airspeeds, common to its flights, in the corrected bounds of derivatives."""
    share = float(np.mean([_share(f) for f in flights])) if flights else 0.0
    if share == 0.0:
        return result
    derivatives = set(result.model.free_of(ParameterRole.DERIVATIVE))
    wider = {n: widened(e, share) if n in derivatives else e for n, e in result.parameters.items()}
    return replace(result, parameters=wider)


def widened(estimate: Estimate, share: float) -> Estimate:
    """The estimate with an independent relative error (1 sigma) in its corrected bound."""
    return replace(estimate, std_coloured=math.hypot(estimate.std_coloured, share * estimate.estimate))


def _share(flight: Flight) -> float:
    """Relative 1 sigma of every derivative from a flight's reconstructed airspeed; 0 where V was measured or no std is stated."""
    if "V" not in flight.reconstructed or not flight.measured("V"):
        return 0.0
    detail = flight.provenance.detail.get(RECONSTRUCTED)
    stds = detail.get("std") if isinstance(detail, Mapping) else None
    std = stds.get("V") if isinstance(stds, Mapping) else None
    if not isinstance(std, int | float) or not 0.0 < std < math.inf:
        return 0.0
    return AIRSPEED_POWER * float(std) / float(np.nanmedian(flight["V"]))


IMPROBABLE = 0.01  # probability of the scatter by chance, above which the bounds are not questioned


@dataclass(frozen=True)
class Scatter:
    """One parameter over flights. std: sample standard deviation; bound: rms of the flights' corrected bounds; ratio: std/bound;
    probability: of a chi-square as large if the bounds are right (None with fewer than two flights)."""

    mean: float
    std: float
    bound: float
    ratio: float
    probability: float | None
    count: int
    trim: bool = False  # a constant that differs from flight to flight with trim and sensor offsets

    @property
    def text(self) -> str:
        """A sentence where the scatter exceeds the bounds; else empty."""
        if self.trim or self.probability is None or self.probability > IMPROBABLE:
            return ""
        return f"scatter over {self.count} flights is {self.ratio:.1f} times the bounds: these bounds are too small"


def parameter_scatter(results: Sequence[Result]) -> dict[str, Scatter]:
    """Mean and scatter of each parameter over the flights in which it is identifiable, against their bounds."""
    from scipy.special import chdtrc  # imported late: describing a session needs no scipy

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
