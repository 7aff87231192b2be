"""Recognises the end of a flight: it flew, and now it stands still.

Flying: airspeed above `flying_speed` for `flying_s`. Ended: after having flown, airspeed below `still_speed` and angular
rate below `still_rate` for `still_s`. Channels that are not measured are left out of the decision; with neither speed
nor rate nothing is decided. Pure data in, decision out; time is the flight's own [s].
"""

import math
from collections.abc import Mapping
from enum import StrEnum

from pydantic import BaseModel, ConfigDict, PositiveFloat


class Phase(StrEnum):
    """Where the aircraft is in its flight."""

    BEFORE = "before flight"
    FLYING = "flying"
    LANDED = "landed"


class LandingLimits(BaseModel):
    """When a flight has begun and ended."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    flying_speed: PositiveFloat = 9.0  # m/s
    flying_s: PositiveFloat = 2.0
    still_speed: PositiveFloat = 4.0  # m/s
    still_rate: PositiveFloat = 0.1  # rad/s
    still_s: PositiveFloat = 5.0


class LandingWatch:
    """Feed calibrated samples in order of time; read the phase."""

    def __init__(self, limits: LandingLimits) -> None:
        self._limits = limits
        self._since: float | None = None
        self.phase = Phase.BEFORE

    def update(self, time: float, values: Mapping[str, float]) -> bool:
        """One sample; True exactly once a flight, when it ends."""
        limits = self._limits
        speed = values.get("V", math.nan)
        rates = [abs(values[k]) for k in ("p", "q", "r") if math.isfinite(values.get(k, math.nan))]
        if self.phase is Phase.FLYING:
            known = math.isfinite(speed) or bool(rates)
            slow = not math.isfinite(speed) or speed < limits.still_speed
            still = all(rate < limits.still_rate for rate in rates)
            if self._held(time, known and slow and still, limits.still_s):
                self.phase, self._since = Phase.LANDED, None
                return True
        elif self._held(time, math.isfinite(speed) and speed > limits.flying_speed, limits.flying_s):
            self.phase, self._since = Phase.FLYING, None
        return False

    def _held(self, time: float, true_now: bool, for_s: float) -> bool:
        if not true_now:
            self._since = None
            return False
        if self._since is None:
            self._since = time
        return time - self._since >= for_s
