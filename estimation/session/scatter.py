"""Mean and scatter of each parameter over flights, against the bounds that the flights state."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.estimators.result import Result
from estimation.models.base import ParameterRole


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


def scatter(results: Sequence[Result]) -> dict[str, Scatter]:
    """Mean and scatter of each parameter over the flights that could tell it, against their bounds."""
    from scipy.special import chdtrc  # here: whoever only describes a session needs no scipy

    table = {}
    for name in results[0].parameters:
        usable = [r.parameters[name] for r in results if r.converged and name in r.parameters]
        told = [e for e in usable if e.identifiable]
        if not told:
            continue
        x = np.array([e.estimate for e in told])
        bounds = np.array([e.std_coloured for e in told])
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
