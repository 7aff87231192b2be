"""Servo outputs of an autopilot as surface deflections: trim, travel on either side, and the servo's lag.

[servos.elevon_left]
column = "RCOU.C1"
trim = 1520                               # output at which the surface stands at zero
travel = [[1100, -22.5], [1900, 25.0]]    # output and deflection at either end, measured on the aircraft
unit = "deg"
lag = 0.05                                # optional: first-order lag of the servo [s]

A mapping then uses the deflection [rad] as a column `servo.elevon_left`: alone, or mixed by `terms`.
"""

import math
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from groundstation.importers.errors import ImportDataError
from groundstation.importers.series import Array, Log, Series
from groundstation.importers.units import conversion

PREFIX = "servo."
BEYOND = 0.5
"""Outputs further outside the travel than this share of it are no position: autopilots write 0 (or 65535) for 'off'."""
LARGEST_DEFLECTION = math.radians(90.0)

_Number = Annotated[float, Field(ge=-1e6, le=1e6)]


class Servo(BaseModel):
    """One servo: output -> deflection [unit], straight from either end of the travel to the trim."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    column: str
    trim: _Number
    travel: tuple[tuple[_Number, _Number], tuple[_Number, _Number]]
    unit: str
    lag: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0

    @model_validator(mode="after")
    def _is_a_travel(self) -> "Servo":
        try:
            scale, _ = conversion(self.unit, "servo", "rad")
        except ImportDataError as error:
            raise ValueError(str(error).removeprefix("column servo: ")) from error
        (low, at_low), (high, at_high) = self.travel
        if not low < self.trim < high:
            raise ValueError(f"trim {self.trim:g} does not lie between the ends of the travel, {low:g} and {high:g}")
        if at_low * at_high >= 0.0:
            raise ValueError("travel: the deflections at its ends must be of either sign, zero being at trim")
        if max(abs(at_low), abs(at_high)) * scale > LARGEST_DEFLECTION:
            raise ValueError(
                f"travel: {max(abs(at_low), abs(at_high)):g} {self.unit} is more than 90 deg; check the unit"
            )
        return self

    def deflection(self, output: Array) -> Array:
        """(N,) [rad]; NaN where the output is no position. Beyond the travel the line goes on: a servo does, too."""
        scale, _ = conversion(self.unit, "servo", "rad")
        (low, at_low), (high, at_high) = self.travel
        below, above = at_low / (low - self.trim), at_high / (high - self.trim)
        value = np.where(output < self.trim, below, above) * (output - self.trim) * scale
        reach = BEYOND * (high - low)
        with np.errstate(invalid="ignore"):
            return np.where((output >= low - reach) & (output <= high + reach), value, np.nan)


def with_servos(log: Log, servos: dict[str, Servo]) -> tuple[Log, tuple[str, ...]]:
    """The log with a series `servo.NAME` [rad] for each servo whose output is in it; and the names of the others' columns."""
    made = {PREFIX + n: s for n, s in servos.items() if s.column in log.series}
    series = {name: _moved(log.series[s.column], s) for name, s in made.items()}
    absent = tuple(s.column for n, s in servos.items() if PREFIX + n not in made)
    units = {**log.units, **dict.fromkeys(series, "rad")}
    return log.extended(series, units), absent


def _moved(output: Series, servo: Servo) -> Series:
    angle = servo.deflection(output.values)
    return Series(output.time, _lagged(output.time, angle, servo.lag) if servo.lag else angle)


def _lagged(time: Array, commanded: Array, lag: float) -> Array:
    """What a first-order servo makes of commands that hold until the next; exact between samples."""
    out = np.empty_like(commanded)
    angle, last, before = math.nan, math.nan, math.nan
    for k, (now, target) in enumerate(zip(time.tolist(), commanded.tolist(), strict=True)):
        if math.isnan(angle) or not now >= before:
            angle = target
        elif not math.isnan(last):
            angle = last + (angle - last) * math.exp(-(now - before) / lag)
        out[k], last, before = angle, target, now
    return out
