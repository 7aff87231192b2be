"""What a model is made of: signals, parameters, and changes of an input that no equation can express."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

TRANSFORM_KINDS: Mapping[str, int] = {"delay": 1, "lag": 1, "deadzone": 1, "backlash": 1, "scale": 1, "bias": 1}
"""Input transforms by name -> number of parameters. Seconds for delay and lag, the input's unit for the next three."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A state, input or output. `column` names the flight column it is read from (its own name by default).

    `start` (states): the column or number from which the initial value is guessed where the state itself is not
    measured. `servo` (inputs): True where a servo moves it, so that it runs on a curve between samples, not on a line.
    `control` (inputs): True for a control surface or other input that may step, False for a motion variable
    that is smooth; it decides how measurement noise is taken off. `optional`: where the flight has no such column, an
    input is taken as zero and an output is not compared, and the result says so.
    """

    name: str
    unit: str = ""
    description: str = ""
    column: str | None = None
    start: str | float | None = None
    control: bool = False
    servo: bool = False
    optional: bool = False

    @property
    def source(self) -> str:
        return self.column or self.name


@dataclass(frozen=True, slots=True)
class Parameter:
    """An unknown (or `fixed` known) number of the model.

    `prior_mean`, `prior_std`: a Gaussian prior that enters the fit when both are given. `reference`: what is believed
    before flying (wind tunnel, engineering estimate): printed beside the estimate and used as the scale of what a
    useful bound is, but never drawn towards. `local`: each flight has its own value in a joint fit.
    """

    name: str
    unit: str = "1"
    start: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    prior_mean: float | None = None
    prior_std: float | None = None
    fixed: bool = False
    local: bool = False
    reference: float | None = None
    reference_std: float | None = None
    reference_source: str = ""
    description: str = ""


@dataclass(frozen=True, slots=True)
class InputTransform:
    """A change of a measured input that no algebra on its samples can express: delay, backlash, dead zone, lag."""

    kind: str
    input: str
    parameters: tuple[str, ...]
