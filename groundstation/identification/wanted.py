"""Progress of live identification: wanted bounds, time until they are reached, excitation, and correlated derivatives."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from daq.identification.airframe import Belief
from daq.identification.estimates import EquationInformation, LiveDerivative, LiveEstimates

WEAK_TERMS = ("CY_p", "CY_r", "Cl_r", "Cl_dr", "Cn_p", "CL_q", "CL_de")
"""Small terms, with bounds of 6 to 17 % in flights that identify the others to 1 to 2 %."""
WEAK_FACTOR = 4.0  # by which their wanted share is larger
LEAST_CORRELATION = 0.95
"""From this correlation on two derivatives count as identified only together: the bound of a combination is a third of theirs."""
GAIN_S = 20.0  # [s] of flight over which the gain of information is measured


def wanted_bounds(beliefs: Mapping[str, Belief], known: Mapping[str, LiveDerivative], share: float) -> dict[str, float]:
    """Derivative -> wanted standard deviation [1/rad]: a share of the larger of its estimate and its prior belief. None for the
    constants of the equations."""
    bounds = {}
    for name in {**known, **beliefs}:
        if name.endswith("_0"):
            continue
        belief = beliefs.get(name)
        identified = name in known and known[name].told
        size = max(abs(known[name].estimate) if identified else 0.0, 0.0 if belief is None else abs(belief.value))
        bounds[name] = share * (WEAK_FACTOR if name in WEAK_TERMS else 1.0) * size
    return bounds


class TimeToBound:
    """Time until wanted bounds are reached, from the gain of information, 1 / bound^2, over the last GAIN_S of flight."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, dict[str, float]]] = deque()

    def at(self, estimates: LiveEstimates, wanted: Mapping[str, float]) -> dict[str, float]:
        """Seconds to go of each derivative with a wanted bound [1/rad]: 0 when reached, inf without gain. Call it in order of
        time."""
        information = {n: 1.0 / d.std**2 if 0.0 < d.std < math.inf else 0.0 for n, d in estimates.derivatives.items()}
        self._recent.append((estimates.time, information))
        while self._recent[0][0] < estimates.time - GAIN_S:
            self._recent.popleft()
        first_time, first_information = self._recent[0]
        elapsed = estimates.time - first_time
        seconds = {}
        for name, bound in wanted.items():
            current, required = information.get(name, 0.0), 1.0 / bound**2 if bound > 0.0 else math.inf
            gain = current - first_information.get(name, 0.0)
            if current >= required:
                seconds[name] = 0.0
            else:
                seconds[name] = (required - current) / gain * elapsed if gain > 0.0 and elapsed > 0.0 else math.inf
        return seconds


class ExcitationMeter:
    """Movement of one control over the last `window_s` seconds."""

    def __init__(self, window_s: float) -> None:
        self._window = window_s
        self._recent: deque[tuple[float, float]] = deque()

    def add(self, time: float, value: float) -> None:
        """Add a sample. time: [s], not before the last; value: deflection [rad]."""
        self._recent.append((time, value))
        while self._recent[0][0] < time - self._window:
            self._recent.popleft()

    @property
    def rms(self) -> float:
        """Standard deviation of the deflection [rad]; 0 without samples."""
        return float(np.std([value for _, value in self._recent])) if self._recent else 0.0


@dataclass(frozen=True, slots=True)
class Together:
    """Two derivatives of which only a combination is well identified, and the correlation of their errors."""

    first: str
    second: str
    correlation: float


def together(information: Mapping[str, EquationInformation]) -> tuple[Together, ...]:
    """Pairs of derivatives of one equation whose errors correlate by LEAST_CORRELATION or more, the largest first."""
    pairs = []
    for i in information.values():
        spread = np.sqrt(np.diag(i.covariance))
        rho = i.covariance / np.outer(spread, spread)
        names = i.names
        pairs += [
            Together(names[a], names[b], float(rho[a, b]))
            for a in range(len(names))
            for b in range(a + 1, len(names))
            if abs(rho[a, b]) >= LEAST_CORRELATION
        ]
    return tuple(sorted(pairs, key=lambda t: -abs(t.correlation)))
