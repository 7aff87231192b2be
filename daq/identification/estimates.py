"""What the recursive estimator says: derivatives with their bounds, and the information behind them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.identification.airframe import Belief

Array = NDArray[np.float64]

USEFUL = 0.3  # a bound wider than this part of what is believed tells nothing new
BEYOND_DOUBT = 0.2  # but five bounds from zero is told, however small it was believed to be


@dataclass(frozen=True, slots=True)
class LiveDerivative:
    """One derivative now [1/rad]. std: honest bound, one standard deviation; white: the bound as if
    residuals were white. `why` says why the number is not fit to be shown
    yet; where there is none at all, estimate is NaN and std infinite."""

    name: str
    estimate: float
    std: float
    white: float
    why: str = ""

    @property
    def told(self) -> bool:
        """Whether there is a number to show."""
        return not self.why


@dataclass(frozen=True)
class LiveEstimates:
    """What is known at `time` [s]. span: seconds of flight in it; still: controls that have not moved, as signals."""

    time: float
    span: float
    rows: int
    derivatives: Mapping[str, LiveDerivative]
    still: tuple[str, ...]


@dataclass(frozen=True)
class EquationInformation:
    """One equation. names: its derivatives; columns: theirs in the regression; normal: (n, n) sum of products of its columns over
    the rows [Pa2 s2]; covariance: (n, n) the honest one."""

    names: tuple[str, ...]
    columns: tuple[int, ...]
    normal: Array
    covariance: Array

    @property
    def noise(self) -> float:
        """Variance of white noise of a row [Pa2 s2] that would explain the bounds: mean over the columns, in logarithms."""
        ratio = np.diag(self.covariance) / np.diag(np.linalg.inv(self.normal))
        return float(np.exp(np.mean(np.log(ratio))))


def joined(parts: Sequence[LiveEstimates]) -> LiveEstimates:
    """Of several regressions over the same flight: flight time and rows of the one that has most."""
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
    """The widest bound with which a number is worth showing beside what is believed; the laboratory's rule for its own."""
    beyond_doubt = BEYOND_DOUBT * abs(value)
    if belief is None:
        return abs(value)
    return max(USEFUL * abs(belief.value) if belief.value else belief.std, beyond_doubt)
