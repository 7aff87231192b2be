"""What a reconstructed airspeed may be off moves every derivative of a flight alike, and no residual shows it: it is counted in
the corrected bounds.

A coefficient is a force over rho V^2 S / 2, so a derivative is wrong by twice the relative error of V (those by a rate by up to
once more or less, which is left out). Pitot and wind have errors that last for a flight and may last for a day: flights of a
joint estimate are taken to share them.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.estimators.result import Estimate, Result
from estimation.models.base import ParameterRole
from groundstation.flight import RECONSTRUCTED, Flight

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
    stated = flight.provenance.detail.get(RECONSTRUCTED)
    stds = stated.get("std") if isinstance(stated, Mapping) else None
    std = stds.get("V") if isinstance(stds, Mapping) else None
    if not isinstance(std, int | float) or not 0.0 < std < math.inf:
        return 0.0
    return POWER * float(std) / float(np.nanmedian(flight["V"]))
