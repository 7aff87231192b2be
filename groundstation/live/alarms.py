"""Alarms on calibrated channels and on the state of link, sensors and recorder: with hysteresis, latched.

An alarm comes when its quantity has been beyond the limit for `hold_s`, and goes back to *latched* when the quantity
is inside by at least `hysteresis`. A latched alarm stays shown until acknowledged. Time is the flight's own [s].
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, model_validator

Level = Literal["WARN", "ERROR", "CRITICAL"]


class Limit(BaseModel):
    """One limit from the configuration, in the column's own SI unit."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    channel: str
    low: float | None = None
    high: float | None = None
    hysteresis: float = 0.0
    hold_s: float = 0.0
    level: Level = "WARN"
    text: str = ""

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        if self.low is None and self.high is None:
            raise ValueError(f"alarm on {self.channel}: give low, high or both")
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"alarm on {self.channel}: low {self.low:g} is not below high {self.high:g}")
        if self.hysteresis < 0 or self.hold_s < 0:
            raise ValueError(f"alarm on {self.channel}: hysteresis and hold_s must not be negative")
        return self


class AlarmState(StrEnum):
    """Where an alarm stands."""

    CLEAR = "clear"
    ACTIVE = "active"
    LATCHED = "latched"  # was active, is over, nobody has acknowledged it


@dataclass(frozen=True, slots=True)
class AlarmChange:
    """An alarm that came, went or was acknowledged."""

    time: float
    name: str
    state: AlarmState
    level: Level
    text: str


@dataclass(slots=True)
class _Watch:
    limit: Limit
    state: AlarmState = AlarmState.CLEAR
    beyond_since: float | None = None


class Alarms:
    """All limits of one aircraft. Feed values, collect changes."""

    def __init__(self, limits: Sequence[Limit]) -> None:
        self._watches = [_Watch(limit) for limit in limits]

    def update(self, time: float, values: Mapping[str, float]) -> list[AlarmChange]:
        """Changes that new values of some channels bring. A NaN neither raises nor clears an alarm."""
        changes = []
        for watch in self._watches:
            value = values.get(watch.limit.channel, math.nan)
            if math.isfinite(value):
                change = _step(watch, time, value)
                if change is not None:
                    changes.append(change)
        return changes

    def acknowledge(self, time: float) -> list[AlarmChange]:
        """Clear what is latched; what is still active stays."""
        changes = []
        for watch in self._watches:
            if watch.state is AlarmState.LATCHED:
                watch.state = AlarmState.CLEAR
                changes.append(_change(watch, time, "acknowledged"))
        return changes

    def in_force(self) -> list[tuple[str, AlarmState, Level]]:
        """Names, states and levels of everything active or latched, active first."""
        held = [w for w in self._watches if w.state is not AlarmState.CLEAR]
        held.sort(key=lambda w: w.state is AlarmState.LATCHED)
        return [(_name(w.limit), w.state, w.limit.level) for w in held]


def _step(watch: _Watch, time: float, value: float) -> AlarmChange | None:
    limit = watch.limit
    beyond = (limit.low is not None and value < limit.low) or (limit.high is not None and value > limit.high)
    margin = limit.hysteresis
    inside = (limit.low is None or value >= limit.low + margin) and (limit.high is None or value <= limit.high - margin)
    if beyond:
        if watch.beyond_since is None:
            watch.beyond_since = time
        if watch.state is not AlarmState.ACTIVE and time - watch.beyond_since >= limit.hold_s:
            watch.state = AlarmState.ACTIVE
            return _change(watch, time, f"{value:.4g}")
        return None
    watch.beyond_since = None
    if watch.state is AlarmState.ACTIVE and inside:
        watch.state = AlarmState.LATCHED
        return _change(watch, time, f"back to {value:.4g}")
    return None


def _name(limit: Limit) -> str:
    if limit.text:
        return limit.text
    low = "" if limit.low is None else f" below {limit.low:g}"
    high = "" if limit.high is None else f" above {limit.high:g}"
    return f"{limit.channel}{low}{' or' if low and high else ''}{high}"


def _change(watch: _Watch, time: float, detail: str) -> AlarmChange:
    text = f"{_name(watch.limit)}: {watch.state.value} ({detail})"
    return AlarmChange(time, _name(watch.limit), watch.state, watch.limit.level, text)
