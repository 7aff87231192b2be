"""The parts of a model: signals, parameters, and changes of an input that no equation can express."""

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
"""Kind of input transform -> number of parameters. Units: seconds for delay and lag; the input's for dead zone, backlash and
bias; seconds per unit of the input for the rate limit (0: none). bend: share of the change between two samples by which the
input lies beyond their straight line half-way."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A state, input or output. `column` names the flight column it is read from (its own name by default).

    `start` (states): column or number for the first guess of the initial value where the state is not measured. `servo`
    (inputs): a servo moves it, so it follows a curve between samples, not a straight line. `control` (inputs): a control
    surface or another input that may step; False for a smooth motion variable. It decides how the input is de-noised.
    `optional`: where the flight has no such column, an input is zero and an output is not compared, and the result says so.
    `held` (states): the initial value is not estimated; it is `start` where that is a number, else the measured value.
    `computed` (inputs): the column was calculated, has no measurement noise, and is not de-noised.
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
        """Name of the flight column."""
        return self.column or self.name


class ParameterRole(StrEnum):
    """What a parameter is for. Code that treats parameters differently tests this, never their names."""

    DERIVATIVE = "derivative"  # of the aircraft: the same in every flight
    CONSTANT = "constant"  # of a coefficient: absorbs the day's trim, centre of gravity and sensor offsets too
    INSTRUMENT = "instrument"  # bias, scale, delay or place of a sensor
    NUISANCE = "nuisance"  # fitted so that no other parameter absorbs its effect; not part of the answer
    DORMANT = "dormant"  # of a term in the equations that is held without effect


def usual_role(name: str) -> ParameterRole:
    """The role of a parameter whose model states none: `CY_0`, `Z_0` ... are constants, by the convention of the field.

    `CD_0`, the drag at no lift, is a property of the aircraft like any derivative.
    """
    return ParameterRole.CONSTANT if name.endswith("_0") and name != "CD_0" else ParameterRole.DERIVATIVE


@dataclass(frozen=True, slots=True)
class Parameter:
    """An unknown (or `fixed` known) number of the model.

    `prior_mean`, `prior_std`: a Gaussian prior that enters the fit when both are given. `reference`: the value believed
    before flying (wind tunnel, engineering estimate), printed beside the estimate; it is the scale of a useful bound but does
    not enter the fit. `local`: each flight has its own value in a joint fit. `role`: what it is for.
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
    """A change of a measured input that the equations cannot express: delay, backlash, dead zone, lag."""

    kind: str
    input: str
    parameters: tuple[str, ...]


@dataclass(frozen=True)
class ModelStructure:
    """What the traced functions of a model depend on: names and equations, not values. constants: sorted."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    constants: tuple[str, ...]
    equations: tuple[str, ...]

    @property
    def remaining_constants(self) -> tuple[str, ...]:
        """Constants that no parameter has replaced, in the order in which they follow the parameters."""
        return tuple(sorted(set(self.constants) - set(self.parameters)))

    @property
    def definitions(self) -> dict[str, str]:
        """Symbol -> expression, in the order of the equations."""
        return dict(split_line(line) for line in self.equations)

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Numbers of states, inputs, parameters and constants together, outputs."""
        return (
            len(self.states),
            len(self.inputs),
            len(self.parameters) + len(self.remaining_constants),
            len(self.outputs),
        )

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
    """The parts of a model, not yet checked: see `estimation.models.base.Model`."""

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
    """Name -> least and greatest value in the flights that the model was estimated from; empty where unknown."""
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
        """The parameter of that name; ModelError naming those of the model otherwise."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise ModelError(f"model {self.name}: no parameter {name!r}; it has {', '.join(self.parameter_names)}")

    def starts(self) -> dict[str, float]:
        """Start value of every parameter, fixed ones included."""
        return {p.name: p.start for p in self.parameters}

    @cached_property
    def definitions(self) -> Mapping[str, str]:
        """Symbol -> expression, in the order of the equations."""
        return dict(split_line(line) for line in self.equations)

    @cached_property
    def structure(self) -> ModelStructure:
        """Names and equations: equal for models that differ in values only."""
        return ModelStructure(
            self.state_names,
            self.input_names,
            self.output_names,
            self.parameter_names,
            tuple(sorted(self.constants)),
            self.equations,
        )
