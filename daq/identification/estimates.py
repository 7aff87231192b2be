"""Results of the recursive estimator: derivatives with their bounds, and the information matrices."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Belief

Array = NDArray[np.float64]

USEFUL = 0.3  # largest useful bound, relative to the prior value
BEYOND_DOUBT = 0.2  # or relative to the estimate: five bounds from zero, however small the prior value


@dataclass(frozen=True, slots=True)
class LiveDerivative:
    """The present estimate of one derivative [1/rad]. std: standard deviation for coloured residuals; white: that for white ones.
    why: why the estimate should not be shown, empty when it may; without any estimate it is NaN, and std infinite."""

    name: str
    estimate: float
    std: float
    white: float
    why: str = ""

    @property
    def told(self) -> bool:
        """Whether the estimate may be shown."""
        return not self.why


@dataclass(frozen=True)
class LiveEstimates:
    """The estimates at `time` [s]. span: flight time used [s]; rows: of the regression; still: signals of the controls that have
    not moved."""

    time: float
    span: float
    rows: int
    derivatives: Mapping[str, LiveDerivative]
    still: tuple[str, ...]


@dataclass(frozen=True)
class EquationInformation:
    """Information on the derivatives `names` of one equation. columns: theirs in the regression; normal: (n, n) sums of products
    of the columns over the rows [Pa2 s2]; covariance: (n, n) of the estimates, for coloured residuals."""

    names: tuple[str, ...]
    columns: tuple[int, ...]
    normal: Array
    covariance: Array

    @property
    def noise(self) -> float:
        """Variance of white noise per row [Pa2 s2] that gives the same bounds: geometric mean over the columns."""
        ratio = np.diag(self.covariance) / np.diag(np.linalg.inv(self.normal))
        return float(np.exp(np.mean(np.log(ratio))))


def joined(parts: Sequence[LiveEstimates]) -> LiveEstimates:
    """Join the estimates of several regressions over the same flight; time, span and rows are the largest of each."""
    if len(parts) == 1:
        return parts[0]
    return LiveEstimates(
        max(e.time for e in parts),
        max(e.span for e in parts),
        max(e.rows for e in parts),
        {n: d for e in parts for n, d in e.derivatives.items()},
        tuple(signal for e in parts for signal in e.still),
    )


def useful_bound(value: float, belief: Belief | None) -> float:
    """The largest bound of an estimate `value` that is useful beside its prior, None for a laboratory's own derivative."""
    beyond_doubt = BEYOND_DOUBT * abs(value)
    if belief is None:
        return abs(value)
    return max(USEFUL * abs(belief.value) if belief.value else belief.std, beyond_doubt)
