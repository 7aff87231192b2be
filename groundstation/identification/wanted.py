"""How far each derivative is from what is wanted of it: bounds, time to go, excitation, and what is not told apart."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from daq.identification.airframe import Belief
from daq.identification.estimates import EquationInformation, LiveDerivative, LiveEstimates

WEAK = 4.0  # times the wanted share, of the terms that move an aircraft little
WEAK_TERMS = (
    "CY_p",
    "CY_r",
    "Cl_r",
    "Cl_dr",
    "Cn_p",
    "CL_q",
    "CL_de",
)  # stay at 6 to 17 % in flights that tell the others to 1 to 2 %
TOGETHER = (
    0.95  # correlation from which two derivatives count as told only together: a combination is three times surer
)
PACE_S = 20.0  # s of flight over which the gain of information is looked at


def wanted_bounds(beliefs: Mapping[str, Belief], known: Mapping[str, LiveDerivative], share: float) -> dict[str, float]:
    """Bound [1/rad], one standard deviation, that is wanted of each derivative: a share of its size.

    The size is the larger of what is told and what is believed; constants are not aimed at.
    """
    bounds = {}
    for name in {**known, **beliefs}:
        if name.endswith("_0"):
            continue
        belief = beliefs.get(name)
        is_told = name in known and known[name].told
        size = max(abs(known[name].estimate) if is_told else 0.0, 0.0 if belief is None else abs(belief.value))
        bounds[name] = share * (WEAK if name in WEAK_TERMS else 1.0) * size
    return bounds


class TimeToBound:
    """Seconds until a wanted bound at the pace of the last seconds: information, 1 / bound^2, grows with what is flown."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, dict[str, float]]] = deque()

    def at(self, estimates: LiveEstimates, wanted: Mapping[str, float]) -> dict[str, float]:
        """Seconds to go of each derivative that has a wanted bound: 0 when there, inf where nothing is being gained."""
        information = {n: 1.0 / d.std**2 if 0.0 < d.std < math.inf else 0.0 for n, d in estimates.derivatives.items()}
        self._seen.append((estimates.time, information))
        while self._seen[0][0] < estimates.time - PACE_S:
            self._seen.popleft()
        first_time, first_information = self._seen[0]
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
    """Movement of one control over the last seconds."""

    def __init__(self, window_s: float) -> None:
        self._window = window_s
        self._seen: deque[tuple[float, float]] = deque()

    def add(self, time: float, value: float) -> None:
        """One sample [s], [rad]."""
        self._seen.append((time, value))
        while self._seen[0][0] < time - self._window:
            self._seen.popleft()

    @property
    def rms(self) -> float:
        """About its mean [rad]."""
        return float(np.std([value for _, value in self._seen])) if self._seen else 0.0


@dataclass(frozen=True, slots=True)
class Together:
    """Two derivatives that are told only together."""

    first: str
    second: str
    correlation: float


def together(information: Mapping[str, EquationInformation]) -> tuple[Together, ...]:
    """Pairs of derivatives whose errors go together, the closest first."""
    pairs = []
    for i in information.values():
        spread = np.sqrt(np.diag(i.covariance))
        rho = i.covariance / np.outer(spread, spread)
        names = i.names
        pairs += [
            Together(names[a], names[b], float(rho[a, b]))
            for a in range(len(names))
            for b in range(a + 1, len(names))
            if abs(rho[a, b]) >= TOGETHER
        ]
    return tuple(sorted(pairs, key=lambda t: -abs(t.correlation)))
