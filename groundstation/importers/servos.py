"""Servo outputs of an autopilot as surface deflections: trim, travel on both sides, and the servo's lag.

[servos.elevon_left]
column = "RCOU.C1"
trim = 1520                               # output at which the surface stands at zero; SERVO1_TRIM of the log if left out
travel = [[1100, -22.5], [1900, 25.0]]    # output and deflection at either end, measured on the aircraft
# or throw = [-22.5, 25.0]                # the deflections at SERVO1_MIN and SERVO1_MAX of the log
unit = "deg"
lag = 0.05                                # optional: first-order lag of the servo [s]

A mapping then uses the deflection [rad] as a column `servo.elevon_left`: alone, or mixed by `terms`.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from groundstation.importers.errors import ImportDataError
from groundstation.importers.series import Array, Log, TimeSeries
from groundstation.importers.units import conversion

PREFIX = "servo."
BEYOND = 0.5
"""Distance from the travel, as a share of it, beyond which an output is no position: autopilots write 0 or 65535 for 'off'."""
SAME_TRIM_US = 5.0  # [us] between two trims that count as the same: half a degree of a usual servo
_OUTPUT = re.compile(r"(?:RCOU\.C|SERVO_OUTPUT_RAW\.servo)(\d+)(?:_raw)?")
"""Outputs of ArduPilot, numbered as its parameters SERVOn_TRIM, _MIN, _MAX. PX4's trims are shares of the travel, not pulses."""
LARGEST_DEFLECTION = math.radians(90.0)

_Number = Annotated[float, Field(ge=-1e6, le=1e6)]


class ServoMap(BaseModel):
    """One servo: output -> deflection [unit], linear from the trim to either end of the travel."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    column: str
    trim: _Number | None = None
    travel: tuple[tuple[_Number, _Number], tuple[_Number, _Number]] | None = None
    throw: tuple[_Number, _Number] | None = None
    unit: str
    lag: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0

    @model_validator(mode="after")
    def _ends_are_valid(self) -> "ServoMap":
        try:
            scale, _ = conversion(self.unit, "servo", "rad")
        except ImportDataError as error:
            raise ValueError(str(error).removeprefix("column servo: ")) from error
        if (self.travel is None) == (self.throw is None):
            raise ValueError(
                "give either travel, output and deflection at either end, "
                "or throw, the deflections at SERVOn_MIN and _MAX of the log"
            )
        if self.travel is None:
            self._check_ends(*(self.throw or (0.0, 0.0)), scale, "throw")
            return self
        (low, at_low), (high, at_high) = self.travel
        if self.trim is not None and not low < self.trim < high:
            raise ValueError(f"trim {self.trim:g} does not lie between the ends of the travel, {low:g} and {high:g}")
        self._check_ends(at_low, at_high, scale, "travel")
        return self

    def _check_ends(self, at_low: float, at_high: float, scale: float, key: str) -> None:
        if at_low * at_high >= 0.0:
            raise ValueError(f"{key}: the deflections at its ends must be of either sign, zero being at trim")
        if max(abs(at_low), abs(at_high)) * scale > LARGEST_DEFLECTION:
            raise ValueError(
                f"{key}: {max(abs(at_low), abs(at_high)):g} {self.unit} is more than 90 deg; check the unit"
            )

    def with_travel(self, name: str, parameters: Mapping[str, float]) -> "ServoMap":
        """A copy with the travel by the log's parameters, where the mapping has the throw only. Raises ImportDataError where the
        log lacks them, or MIN is not below MAX."""
        if self.travel is not None or self.throw is None:
            return self
        ends = [parameter_of(self.column, e) or "" for e in ("MIN", "MAX")]
        missing = [e or "SERVOn_MIN and _MAX" for e in ends if e not in parameters]
        if missing:
            raise ImportDataError(
                f"[servos.{name}] has a throw and no travel, and the log does not state {missing[0]}; write "
                "travel = [[output, deflection], [output, deflection]]"
            )
        low, high = (parameters[e] for e in ends)
        if not low < high:
            raise ImportDataError(
                f"[servos.{name}]: {ends[0]} {low:g} of the log is not below {ends[1]} {high:g}; write a travel"
            )
        return self.model_copy(update={"travel": ((low, self.throw[0]), (high, self.throw[1]))})

    @property
    def ends(self) -> "tuple[tuple[float, float], tuple[float, float]]":
        """Output and deflection at either end. Raises ImportDataError before `with_travel` where the mapping has no travel."""
        if self.travel is None:
            raise ImportDataError(f"servo output {self.column}: its travel is not known")
        return self.travel

    def deflection(self, output: Array, trim: float) -> Array:
        """(N,) deflection [rad] for an output (N,), extrapolated beyond the travel; NaN where the output is no position."""
        scale, _ = conversion(self.unit, "servo", "rad")
        (low, at_low), (high, at_high) = self.ends
        lower_slope, upper_slope = at_low / (low - trim), at_high / (high - trim)
        value = np.where(output < trim, lower_slope, upper_slope) * (output - trim) * scale
        reach = BEYOND * (high - low)
        with np.errstate(invalid="ignore"):
            return np.where((output >= low - reach) & (output <= high + reach), value, np.nan)


def parameter_of(output: str, ending: str) -> str | None:
    """The autopilot's parameter of a servo output, `SERVO1_TRIM` for `RCOU.C1`; None for an output without parameters."""
    match = _OUTPUT.fullmatch(output)
    return f"SERVO{match[1]}_{ending}" if match else None


def with_servos(log: Log, servos: dict[str, ServoMap]) -> tuple[Log, tuple[str, ...]]:
    """The log with a series `servo.NAME` [rad] for each servo whose output it has; and the output columns of the other servos.

    Raises ImportDataError where the trim of a servo is neither in the mapping nor among the log's parameters.
    """
    series, notes = {}, []
    present = {n: s for n, s in servos.items() if s.column in log.series}
    for name, servo_map in present.items():
        servo = servo_map.with_travel(name, log.parameters)
        trim, note = _trim(name, servo, log)
        if servo_map.travel is None:
            (low, _), (high, _) = servo.ends
            notes.append(f"servo {name}: travel from {low:g} to {high:g}, by the parameters of the log")
        output = log.series[servo.column]
        angle = servo.deflection(output.values, trim)
        series[PREFIX + name] = TimeSeries(output.time, angle, command=True, lag=servo.lag)
        notes += [note] if note else []
    absent = tuple(s.column for n, s in servos.items() if n not in present)
    units = {**log.units, **dict.fromkeys(series, "rad")}
    return replace(log, series={**log.series, **series}, units=units).with_notes(*notes), absent


def outputs_elsewhere(log: Log, servos: dict[str, ServoMap]) -> list[str]:
    """Notes on servos whose output is absent or off throughout; with the outputs of other instances that move, since autopilots
    have several sets of outputs (MAIN and AUX, IO and FMU)."""
    notes = []
    for name, servo in servos.items():
        deflection = log.series.get(PREFIX + name)
        if deflection is not None and np.isfinite(deflection.values).any():
            continue
        topic, _, field = servo.column.partition(".")
        pattern = re.compile(re.escape(topic.split("[")[0]) + r"(\[\d+\])?\." + re.escape(field))
        active = [n for n, s in log.series.items() if n != servo.column and pattern.fullmatch(n) and _moves(s.values)]
        problem = f"servo {name}: {servo.column} {'is not in the file' if deflection is None else 'is off throughout'}"
        if active:
            notes.append(f"{problem}, while {', '.join(active)} moves: name it in the mapping")
        elif deflection is not None:
            notes.append(f"{problem}: no value of it is a position of this servo")
    return notes


def _moves(values: Array) -> bool:
    finite = values[np.isfinite(values)]
    return finite.size > 1 and float(np.ptp(finite)) > 0.0


def _trim(name: str, servo: ServoMap, log: Log) -> tuple[float, str | None]:
    """Output at zero deflection, by the mapping or else by the log, and a note where the log is used or differs."""
    parameter = parameter_of(servo.column, "TRIM")
    logged = log.parameters.get(parameter) if parameter else None
    if servo.trim is not None:
        if logged is None or abs(logged - servo.trim) <= SAME_TRIM_US:
            return servo.trim, None
        return servo.trim, (
            f"servo {name}: the mapping says trim {servo.trim:g}, the log's own {parameter} is {logged:g}; the mapping's is used"
        )
    (low, _), (high, _) = servo.ends
    if logged is None:
        absent = f"the log has no {parameter}" if parameter else f"{servo.column} has no parameter that says it"
        raise ImportDataError(f"[servos.{name}] has no trim and {absent}; add trim = the output at zero deflection")
    if not low < logged < high:
        raise ImportDataError(
            f"[servos.{name}]: {parameter} of the log, {logged:g}, does not lie between the ends of the travel, "
            f"{low:g} and {high:g}; correct the travel or add trim = the output at zero deflection"
        )
    return logged, f"servo {name}: zero deflection at {logged:g}, by {parameter} of the log"
