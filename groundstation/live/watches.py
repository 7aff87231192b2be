"""What is watched live: limits on channels (alarms), the end of a flight, and room on this computer's disk.

An alarm comes when its quantity has been beyond the limit for `hold_s`, and goes back to *latched* when the quantity is inside
by at least `hysteresis`. A latched alarm stays shown until acknowledged. Flying: airspeed above `flying_speed` for `flying_s`.
Landed: after having flown, airspeed below `still_speed` and angular rate below `still_rate` for `still_s`; channels that are not
measured are left out of the decision; with neither speed nor rate nothing is decided. Time is the flight's own [s].
"""

import math
import shutil
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, PositiveFloat, model_validator

from daq.contract.channels import COLUMN_BY_NAME
from daq.utilities.constants import RADIAN

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
    cause: str = ""  # the limit that was passed, or what is counted

    @property
    def name(self) -> str:
        return " ".join(filter(None, (self.limit.text or self.limit.channel, self.cause)))


class Alarms:
    """All limits of one aircraft. Feed values, collect changes."""

    def __init__(self, limits: Sequence[Limit]) -> None:
        self._watches = [_Watch(limit) for limit in limits]

    def update(
        self, time: float, values: Mapping[str, float], about: Mapping[str, str] | None = None
    ) -> list[AlarmChange]:
        """Changes caused by new values of some channels. A NaN neither raises nor clears an alarm.

        about: channel -> what it counts, such as names of sensors, reported in place of the number."""
        changes = []
        for watch in self._watches:
            value = values.get(watch.limit.channel, math.nan)
            words = (about or {}).get(watch.limit.channel, "")
            change = _changed(watch, time, value, words) if math.isfinite(value) else None
            changes += [] if change is None else [change]
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
        watches = [w for w in self._watches if w.state is not AlarmState.CLEAR]
        watches.sort(key=lambda w: w.state is AlarmState.LATCHED)
        return [(w.name, w.state, w.limit.level) for w in watches]


def _changed(watch: _Watch, time: float, value: float, words: str) -> AlarmChange | None:
    """The change that a value causes in the state of a watch, which is updated; None without one."""
    limit = watch.limit
    outside_limits = (limit.low is not None and value < limit.low) or (limit.high is not None and value > limit.high)
    margin = limit.hysteresis
    within_margin = (limit.low is None or value >= limit.low + margin) and (
        limit.high is None or value <= limit.high - margin
    )
    if outside_limits:
        if watch.beyond_since is None:
            watch.beyond_since = time
        watch.cause = words or _passed_limit(limit, value)
        if watch.state is not AlarmState.ACTIVE and time - watch.beyond_since >= limit.hold_s:
            watch.state = AlarmState.ACTIVE
            return _change(watch, time, "" if words else _reading(limit, value))
        return None
    watch.beyond_since = None
    if watch.state is AlarmState.ACTIVE and within_margin:
        watch.state = AlarmState.LATCHED
        return _change(watch, time, "" if watch.limit.channel in COUNTS else f"back to {_reading(limit, value)}")
    return None


SCALES = {
    "link.loss_percent": (1.0, " %"), "link.silence_s": (1.0, " s"), "ground.free_mb": (1.0, " MB"),
    "ground.minutes_left": (1.0, " min"),
}  # fmt: skip
"""Channel that is no flight column -> factor and unit in which it is reported."""
COUNTS = ("recorder.recording", "sensors.unusable")
"""Channels reported without number and limit, which would say nothing to a person."""


def _scale(channel: str) -> tuple[float, str]:
    """Factor and unit (after a space) in which a channel is reported: degrees instead of radians."""
    if channel in SCALES or channel not in COLUMN_BY_NAME:
        return SCALES.get(channel, (1.0, ""))
    unit = COLUMN_BY_NAME[channel].unit
    return (RADIAN, " " + unit.replace("rad", "deg")) if "rad" in unit else (1.0, f" {unit}")


def _reading(limit: Limit, value: float) -> str:
    """A value with its unit as it is reported; empty for a count."""
    factor, unit = _scale(limit.channel)
    return "" if limit.channel in COUNTS else f"{factor * value:.3g}{unit}"


def _passed_limit(limit: Limit, value: float) -> str:
    """The limit that a value has passed, with its unit."""
    below = limit.low is not None and value < limit.low
    reading = _reading(limit, (limit.low if below else limit.high) or 0.0)
    return f"{'below' if below else 'above'} {reading}" if reading else ""


def _change(watch: _Watch, time: float, detail: str) -> AlarmChange:
    text = f"{watch.name}: {watch.state.value}{f' ({detail})' if detail else ''}"
    return AlarmChange(time, watch.name, watch.state, watch.limit.level, text)


class Phase(StrEnum):
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
        """Take one sample; True once a flight, when it ends."""
        limits = self._limits
        speed = values.get("V", math.nan)
        rates = [abs(values[k]) for k in ("p", "q", "r") if math.isfinite(values.get(k, math.nan))]
        if self.phase is Phase.FLYING:
            measured = math.isfinite(speed) or bool(rates)
            slow = not math.isfinite(speed) or speed < limits.still_speed
            at_rest = all(rate < limits.still_rate for rate in rates)
            if self._lasted(time, measured and slow and at_rest, limits.still_s):
                self.phase, self._since = Phase.LANDED, None
                return True
        elif self._lasted(time, math.isfinite(speed) and speed > limits.flying_speed, limits.flying_s):
            self.phase, self._since = Phase.FLYING, None
        return False

    def _lasted(self, time: float, condition: bool, for_s: float) -> bool:
        """Whether a condition has been true for `for_s` seconds up to now."""
        if not condition:
            self._since = None
            return False
        if self._since is None:
            self._since = time
        return time - self._since >= for_s


PACE_SPAN_S = 60.0  # over which the use of the disk is averaged: recordings are written in pieces
SHORTEST_SPAN_S = 10.0  # before a rate is stated
LONGEST_MINUTES = 600.0  # as an alarm's value: inf would keep an alarm from ending

FREE_MB = "ground.free_mb"
MINUTES_LEFT = "ground.minutes_left"


class FreeSpace:
    """Free space of a disk [MB] and the minutes until it is full at the present rate; NaN while unknown."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, int]] = deque()
        self.megabytes = math.nan
        self.minutes = math.nan

    def update(self, time_s: float, free_bytes: int) -> None:
        """Take the free bytes at a time [s] of any steady clock. `minutes` becomes inf where nothing is being used up."""
        self.megabytes = free_bytes / 1e6
        self._samples.append((time_s, free_bytes))
        while time_s - self._samples[0][0] > PACE_SPAN_S:
            self._samples.popleft()
        start_s, start_bytes = self._samples[0]
        if time_s - start_s >= SHORTEST_SPAN_S:
            pace = (start_bytes - free_bytes) / (time_s - start_s)
            self.minutes = free_bytes / pace / 60.0 if pace > 0 else math.inf

    @property
    def values(self) -> dict[str, float]:
        """Channel of alarms -> value."""
        return {FREE_MB: self.megabytes, MINUTES_LEFT: min(self.minutes, LONGEST_MINUTES)}

    @property
    def words(self) -> str:
        if math.isnan(self.megabytes):
            return "unknown"
        duration = f", {self.minutes:.0f} min at the present rate" if math.isfinite(self.minutes) else ""
        return f"{self.megabytes:.0f} MB free{duration}"


def free_bytes(folder: Path) -> int:
    """Room for an ordinary user in the file system of a folder; OSError when it is gone."""
    return shutil.disk_usage(folder).free
