"""The trimmed flight from which a manoeuvre starts, and its limits: amplitude and rate of controls, and the motion."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, ValidationError, field_validator

from daq.utilities.constants import DEGREE, GRAVITY
from daq.utilities.input_files import read_toml
from estimation.aircraft import Aircraft
from estimation.errors import EstimationError
from estimation.models.base import Model

USUAL_ALPHA = 0.08
"""Angle of attack [rad] of a small aircraft at cruise, where lift and pitching moment are not known."""

TRIM_ROUNDS = 8
"""Of the fixed point of lift and thrust: thrust carries a few hundredths of the weight, so each round gains two digits."""


@dataclass(frozen=True)
class Condition:
    """Values by name of states, inputs and outputs in trimmed flight; SI and radians. notes: assumptions."""

    values: Mapping[str, float]
    notes: tuple[str, ...] = ()

    def trim_value(self, name: str) -> float:
        """Trim value of a signal; 0 for one that rests in trim."""
        return self.values.get(name, 0.0)


def trimmed(model: Model, aircraft: Aircraft, speed: float, density: float) -> Condition:
    """Level flight: CL q S + T sin(alpha) = m g, Cm = 0 for alpha and delta_e (linear), T cos(alpha) = drag.

    speed: true airspeed [m/s]; density [kg/m3]; thrust acts along x.
    """
    values = {**{n: p.value for n, p in aircraft.derivatives.items()}, **model.starts()}
    base = {"V": speed, "rho": density, "g": GRAVITY}
    derivatives = ("CL_alpha", "Cm_alpha", "Cm_de")
    if any(values.get(n, 0.0) == 0.0 for n in derivatives):
        note = (
            f"lift and pitching moment are not known: alpha and theta are taken as {math.degrees(USUAL_ALPHA):.1f} deg"
        )
        return Condition({**base, "alpha": USUAL_ALPHA, "theta": USUAL_ALPHA}, (note,))
    pressure = 0.5 * density * speed**2 * aircraft.area
    matrix = [[values["CL_alpha"], values.get("CL_de", 0.0)], [values["Cm_alpha"], values["Cm_de"]]]
    alpha = elevator = thrust = 0.0
    for _ in range(TRIM_ROUNDS):
        lift = (aircraft.mass * GRAVITY - thrust * math.sin(alpha)) / pressure
        right = [lift - values.get("CL_0", 0.0), -values.get("Cm_0", 0.0)]
        alpha, elevator = np.linalg.solve(matrix, right).tolist()
        thrust = pressure * (values.get("CD_0", 0.0) + values.get("CD_k", 0.0) * lift**2) / math.cos(alpha)
    trim_values = {"alpha": alpha, "theta": alpha, "delta_e": elevator, "thrust": thrust}
    acceleration_values = {"az": -GRAVITY * math.cos(alpha), "ax": GRAVITY * math.sin(alpha)}
    return Condition({**base, **trim_values, **acceleration_values})


# The limits of a manoeuvre: amplitude and rate of each control, and the motion that it may cause.
#
# A file for `--limits`, with angles in degrees because people write it:
#
#     [controls.delta_a]
#     amplitude_deg = 6.0      # either side of trim
#     rate_deg_s = 200.0
#
#     [response]               # either side of trim, or [least, most]
#     beta_deg = 12.0
#     phi_deg = 35.0
#     load_factor = [0.3, 2.2]
#     airspeed = [12.0, 22.0]  # m/s

Range = tuple[float, float]
USUAL_AMPLITUDE = {"delta_a": math.radians(6.0), "delta_r": math.radians(3.5), "delta_e": math.radians(3.0)}
"""Peaks of controls where no file gives others [rad]: those of the published flights and similar ones."""
OTHER_AMPLITUDE = math.radians(3.0)
USUAL_RATE = math.radians(200.0)
"""Rate of a control where no file gives another [rad/s]: a hobby servo's 60 deg in 0.2 s, on a surface of half its travel."""
USUAL_RESPONSE = {"beta_deg": 15.0, "phi_deg": 40.0, "alpha_deg": 8.0, "theta_deg": 25.0}


class ControlLimit(BaseModel):
    """One control: peak [deg] either side of trim, rate [deg/s]."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    amplitude_deg: float = Field(gt=0.0, le=60.0)
    rate_deg_s: PositiveFloat = math.degrees(USUAL_RATE)


class LimitsFile(BaseModel):
    """The file as a person writes it."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    controls: dict[str, ControlLimit] = {}
    response: dict[str, float | Range] = {}

    @field_validator("response")
    @classmethod
    def _ranges_in_order(cls, value: dict[str, float | Range]) -> dict[str, float | Range]:
        for name, range_allowed in value.items():
            lowest, highest = range_allowed if isinstance(range_allowed, tuple) else (-range_allowed, range_allowed)
            if not (math.isfinite(lowest) and math.isfinite(highest) and lowest < highest):
                raise ValueError(f"{name} = {range_allowed}: write a positive number, or [least, most]")
        return value


@dataclass(frozen=True)
class Limits:
    """SI and radians. amplitude, rate: by control. response: signal -> (least, most), about trim where `relative`."""

    amplitude: Mapping[str, float] = field(default_factory=dict)
    rate: Mapping[str, float] = field(default_factory=dict)
    response: Mapping[str, tuple[float, float, bool]] = field(default_factory=dict)

    def amplitude_of(self, control: str) -> float:
        """Peak either side of trim [rad]."""
        return self.amplitude.get(control, USUAL_AMPLITUDE.get(control, OTHER_AMPLITUDE))

    def rate_of(self, control: str) -> float:
        """Highest rate [rad/s]."""
        return self.rate.get(control, USUAL_RATE)


_SIGNALS = {"airspeed": "V", "load_factor": "load_factor"}


def usual_limits() -> Limits:
    """The limits where no file is given."""
    return _limits(LimitsFile(response=dict(USUAL_RESPONSE)))


def load_limits(path: Path) -> Limits:
    """Read a file of limits. Raises EstimationError naming file and key."""
    try:
        return _limits(LimitsFile.model_validate(read_toml(path, "file of limits", EstimationError)))
    except ValidationError as error:
        first = error.errors()[0]
        key_path = ".".join(str(part) for part in first["loc"])
        raise EstimationError(f"{path}: {key_path}: {first['msg']}; see docs/design.md") from error


def _limits(file: LimitsFile) -> Limits:
    return Limits(
        {name: math.radians(c.amplitude_deg) for name, c in file.controls.items()},
        {name: math.radians(c.rate_deg_s) for name, c in file.controls.items()},
        dict(_response(name, range_allowed) for name, range_allowed in file.response.items()),
    )


def _response(name: str, allowed: Any) -> tuple[str, tuple[float, float, bool]]:
    """`beta_deg = 12` is 12 deg either side of trim, a pair is absolute; `_deg` and `_deg_s` name degrees."""
    for ending in ("_deg_s", "_deg"):
        if name.endswith(ending):
            signal, factor = name.removesuffix(ending), DEGREE
            break
    else:
        signal, factor = _SIGNALS.get(name, name), 1.0
    if isinstance(allowed, tuple):
        return signal, (factor * allowed[0], factor * allowed[1], False)
    return signal, (-factor * allowed, factor * allowed, True)
