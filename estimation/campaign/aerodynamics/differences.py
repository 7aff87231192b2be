"""Differences between two groups at the same conditions: did the new rudder change Cn_dr, and what could have been told?

Flights of both groups share their curves over the conditions and the variances between flights; a shift of each parameter is
the difference. So another speed is not taken for another rudder, and where only one group flew at a condition the bound grows.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.campaign import pooling
from estimation.campaign.aerodynamics.pooled import GroupFlights, PooledCurves, envelope


@dataclass(frozen=True)
class Difference:
    """Second group less first. value: of the first at its conditions; between: standard deviation between flights; tests:
    parameters that were compared; form: of the curve."""

    parameter: str
    flights: int
    value: float
    value_std: float
    change: float
    std: float
    freedom: int
    between: float
    tests: int
    form: str

    @property
    def probability(self) -> float:
        """Of a difference as large by chance, heeding all parameters."""
        return min(1.0, pooling.two_sided(self.change / self.std, self.freedom) * self.tests)

    @property
    def detectable(self) -> float:
        """The least difference that these flights would have told four times in five."""
        return pooling.detectable(self.std, self.freedom, self.tests)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % of this one parameter."""
        half = pooling.t_quantile(1.0 - pooling.LEVEL / 2.0, self.freedom) * self.std
        return self.change - half, self.change + half

    def power(self, share: float) -> float:
        """Probability that a change of such a share of the value would be found."""
        return pooling.power(share * self.value, self.std, self.freedom, self.tests)


def differences(both: GroupFlights, second: NDArray[np.bool_]) -> tuple[Difference, ...]:
    """Of every parameter that both groups tell. both: flights of both groups; second: (flights,) which are of the second."""
    curves = envelope(both, second.astype(float)[:, None])
    if curves is None:
        return ()
    told = [(j, s) for j in range(len(curves.of.parameters)) if (s := curves.shift(j, 0)) is not None]
    return tuple(_difference(curves, j, change, std, len(told)) for j, (change, std) in told)


def _difference(curves: PooledCurves, j: int, change: float, std: float, tests: int) -> Difference:
    first = curves.shifts[:, 0] <= 0.0
    here = np.median(np.nan_to_num(curves.of.conditions[first]), axis=0)[None, :]
    value, value_std = curves.at(j, here)
    lowest = float(curves.shifts[:, 0].min())
    freedom = int(curves.fit.freedom[j])
    return Difference(
        curves.of.parameters[j],
        int(curves.of.data.known[curves.sound, j].sum()),
        float(value[0]) + lowest * change,
        float(value_std[0]),
        change,
        std,
        freedom,
        float(np.sqrt(curves.fit.tau2[j])),
        tests,
        curves.forms[j].words,
    )
