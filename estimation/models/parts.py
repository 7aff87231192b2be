"""What a model is made of: signals, parameters, and changes of an input that no equation can express."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field
from enum import StrEnum
from functools import cached_property

from estimation.errors import ModelError
from estimation.models.expressions import split_line

TRANSFORM_KINDS: Mapping[str, int] = dict.fromkeys(
    ("delay", "lag", "deadzone", "backlash", "rate_limit", "bend", "scale", "bias"), 1
)
"""Input transforms by name -> number of parameters. Seconds for delay and lag, the input's unit for dead zone, backlash and
bias, seconds per unit of the input for the rate limit (0: none); bend: share of each step by which the input is beyond the
straight line half-way between two samples."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A state, input or output. `column` names the flight column it is read from (its own name by default).

    `start` (states): the column or number from which the initial value is guessed where the state itself is not
    measured. `servo` (inputs): True where a servo moves it, so that it runs on a curve between samples, not on a line.
    `control` (inputs): True for a control surface or other input that may step, False for a motion variable
    that is smooth; it decides how measurement noise is taken off. `optional`: where the flight has no such column, an
    input is taken as zero and an output is not compared, and the result says so. `held` (states): the initial value is not
    estimated; it is `start` where that is a number, else what was measured. `computed` (inputs): the column is the result of a
    calculation, without noise of its own, and is taken as it stands.
    """

    name: str
    unit: str = ""
    description: str = ""
    column: str | None = None
    start: str | float | None = None
    control: bool = False
    servo: bool = False
    optional: bool = False
    held: bool = False
    computed: bool = False

    @property
    def source(self) -> str:
        return self.column or self.name


class ParameterRole(StrEnum):
    """What a parameter is for. Whatever treats parameters differently asks for this, never for their names."""

    DERIVATIVE = "derivative"  # of the aircraft: the same in every flight
    CONSTANT = (
        "constant"  # a coefficient's constant part: holds trim, centre of gravity and sensor offsets of the day too
    )
    INSTRUMENT = "instrument"  # bias, scale, delay or place of a sensor
    NUISANCE = "nuisance"  # fitted so that nothing else takes it up; never named as an answer
    DORMANT = "dormant"  # of a term that is written into the equations but held without effect


def usual_role(name: str) -> ParameterRole:
    """The role where a model file or class states none: by the convention of the field, `CY_0`, `Z_0` ... are constants.

    `CD_0`, the drag at no lift, is a property of the aircraft like any derivative.
    """
    return ParameterRole.CONSTANT if name.endswith("_0") and name != "CD_0" else ParameterRole.DERIVATIVE


@dataclass(frozen=True, slots=True)
class Parameter:
    """An unknown (or `fixed` known) number of the model.

    `prior_mean`, `prior_std`: a Gaussian prior that enters the fit when both are given. `reference`: what is believed
    before flying (wind tunnel, engineering estimate): printed beside the estimate and used as the scale of what a
    useful bound is, but never drawn towards. `local`: each flight has its own value in a joint fit. `role`: what it is for.
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
    role: ParameterRole = ParameterRole.DERIVATIVE


@dataclass(frozen=True, slots=True)
class InputTransform:
    """A change of a measured input that no algebra on its samples can express: delay, backlash, dead zone, lag."""

    kind: str
    input: str
    parameters: tuple[str, ...]


@dataclass(frozen=True)
class ModelStructure:
    """What decides the traced functions of a model: names and equations, not values. constants: sorted."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    constants: tuple[str, ...]
    equations: tuple[str, ...]

    @property
    def constants_kept(self) -> tuple[str, ...]:
        """Constants in the order in which they follow the parameters; one that a parameter has replaced is left out."""
        return tuple(sorted(set(self.constants) - set(self.parameters)))

    @property
    def definitions(self) -> dict[str, str]:
        """Symbol -> expression text, in the order of the text."""
        return dict(split_line(line) for line in self.equations)

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Number of states, inputs, parameters with constants, outputs."""
        return len(self.states), len(self.inputs), len(self.parameters) + len(self.constants_kept), len(self.outputs)

    @cached_property
    def digest(self) -> str:
        return hashlib.sha256(json.dumps(astuple(self)).encode()).hexdigest()[:24]


@dataclass(frozen=True, slots=True)
class EstimatedStretch:
    """A stretch of a recording that a model was estimated from: digest of the recording, first and last time [s]."""

    sha256: str
    begin: float
    end: float


@dataclass(frozen=True)
class ModelParts:
    """The parts of a model as they were written, not yet looked at: see `estimation.models.base.Model`."""

    name: str
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    parameters: tuple[Parameter, ...]
    equations: tuple[str, ...]
    constants: Mapping[str, float] = field(default_factory=dict)
    title: str = ""
    transforms: tuple[InputTransform, ...] = ()
    output_delays: Mapping[str, str] = field(default_factory=dict)
    description: str = ""
    flown: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Name -> least and greatest value in the flights that the model was estimated from; empty where nobody says."""
    estimated_from: tuple[EstimatedStretch, ...] = ()

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.states)

    @cached_property
    def input_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.inputs)

    @cached_property
    def output_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.outputs)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @cached_property
    def free_names(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated."""
        return tuple(p.name for p in self.parameters if not p.fixed)

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name; ModelError naming the nearest ones otherwise."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise ModelError(f"model {self.name}: no parameter {name!r}; it has {', '.join(self.parameter_names)}")

    def starts(self) -> dict[str, float]:
        """Start value of every parameter, fixed ones included."""
        return {p.name: p.start for p in self.parameters}

    @cached_property
    def definitions(self) -> Mapping[str, str]:
        """Symbol -> expression text, in the order of the text."""
        return dict(split_line(line) for line in self.equations)

    @cached_property
    def structure(self) -> ModelStructure:
        """Equal for models that differ in values only."""
        return ModelStructure(
            self.state_names,
            self.input_names,
            self.output_names,
            self.parameter_names,
            tuple(sorted(self.constants)),
            self.equations,
        )
