"""A candidate effect, as data that can be added to any model with the equations it changes.

An `Effect` has one or more `Form`s: ways in which it can enter a model, each with its own unknowns (a lever arm has an x and
a z form). The search works on forms and answers with the effect's name; no code knows a particular effect.
A form names model lines, inputs and outputs as `estimation.models` does. Where the model lacks them, or already contains the
effect, the form does not apply and `obstacle` says why.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

from estimation.errors import EffectError
from estimation.models.base import InputTransform, Model, Parameter, Signal
from estimation.models.dependence import names_reached
from estimation.models.expressions import names_in


class Group(StrEnum):
    """Where an effect acts; the kinematic check tells SENSOR from all others."""

    DERIVATIVE = "omitted derivative"
    NONLINEAR = "aerodynamic nonlinearity"
    UNSTEADY = "unsteady aerodynamics"
    INERTIAL = "kinematic, inertial"
    PROPULSION = "propulsion"
    ACTUATOR = "actuator"
    SENSOR = "sensor"
    ENVIRONMENT = "environment"


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """An unknown of a form.

    typical: usual magnitude (positive), the scale of the prior and of the secant step. lower, upper: physically
    possible range; an estimate outside is rejected. none: the value at which the effect vanishes (a number, or the
    name of the model constant the parameter replaces).
    """

    name: str
    unit: str
    typical: float
    lower: float
    upper: float
    none: float | str = 0.0
    meaning: str = ""

    def null_value(self, model: Model) -> float:
        """The value without effect in `model`."""
        return float(model.constants[self.none]) if isinstance(self.none, str) else self.none


@dataclass(frozen=True)
class Form:
    """One way an effect enters a model: the arguments of `Model.plus`, as data.

    terms: line -> pieces added to it; a piece with a symbol that the model lacks is left out, and a form without any
    piece does not apply. requires: symbols that the model must have. unless: (line, symbol) pairs; where the line
    (or a line it is made of) already contains the symbol, the model has the effect. inputs: flight columns that become
    inputs where the model lacks them. frees: parameters that the model holds fixed.
    optional: outputs that are changed or delayed only where the model has them: one instrument may measure more than the model
    compares. equation: of this form, where it differs from the effect's.
    """

    label: str
    parameters: tuple[EffectParameter, ...]
    terms: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    lines: tuple[str, ...] = ()
    outputs: Mapping[str, str] = field(default_factory=dict)
    states: tuple[Signal, ...] = ()
    inputs: tuple[Signal, ...] = ()
    transforms: tuple[InputTransform, ...] = ()
    output_delays: Mapping[str, str] = field(default_factory=dict)
    requires: tuple[str, ...] = ()
    unless: tuple[tuple[str, str], ...] = ()
    frees: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    equation: str = ""

    @property
    def nonlinear(self) -> bool:
        """Whether the outputs depend on the unknowns in a way that a small step does not show (delays, lags, plays)."""
        return bool(self.states or self.transforms or self.output_delays)

    @property
    def slows_control(self) -> bool:
        """Whether the form delays a control."""
        return any(t.kind in ("delay", "lag") for t in self.transforms)

    @property
    def lagging(self) -> bool:
        """Whether forces or moments lag the motion by a state of their own, with time constants as the only unknowns."""
        return bool(self.states and self.terms) and all(p.unit == "s" for p in self.parameters)

    def shown_by(self, model: Model) -> "Form":
        """Without the optional outputs that `model` does not have."""
        absent = {o for o in self.optional if o not in model.output_names}
        if not absent:
            return self
        outputs = {o: v for o, v in self.outputs.items() if o not in absent}
        delays = {o: v for o, v in self.output_delays.items() if o not in absent}
        return replace(self, outputs=outputs, output_delays=delays, optional=())

    def obstacle(self, model: Model) -> str | None:
        """Why the form cannot be added to `model`, or None where it can."""
        symbols = symbols_of(model)
        present = [p.name for p in self.parameters if p.name in model.parameter_names and p.name not in self.frees]
        present += [s.name for s in self.states if s.name in model.state_names]
        if present:
            return f"the model already has {', '.join(present)}"
        missing = [s for s in self.requires if s not in symbols]
        visible = self.shown_by(model)
        missing += [o for o in (*visible.outputs, *visible.output_delays) if o not in model.output_names]
        if not (self.terms or visible.outputs or visible.output_delays):  # all that it changes is optional, and absent
            missing += [*self.outputs, *self.output_delays]
        if self.transforms and not self._transforms(model):
            missing.append(self.transforms[0].input)
        if missing:
            return f"the model has no {', '.join(dict.fromkeys(missing))}"
        for line, symbol in self.unless:
            if symbol in names_reached(model, [line]):
                return f"the model's {line} already contains {symbol}"
        if any(o in model.output_delays for o in visible.output_delays):
            return "the model already delays these outputs"
        if self.terms and not self._pieces(model):
            return "the model has none of the terms it would change"
        return None

    def added_to(self, model: Model, at: Mapping[str, float] | None = None, fixed: bool = False) -> Model:
        """`model` with this form, its parameters starting at `at` (by default without effect).

        Raises EffectError where the form does not apply.
        """
        obstacle = self.obstacle(model)
        if obstacle:
            raise EffectError(f"effect {self.label}: cannot be added to model {model.name}: {obstacle}")
        starts = {p.name: p.null_value(model) for p in self.parameters} | dict(at or {})
        parameters = [
            Parameter(
                p.name,
                p.unit,
                start=start,
                lower=min(p.lower, start),
                upper=max(p.upper, start),
                fixed=fixed,
                description=p.meaning,
            )
            for p, start in ((p, starts[p.name]) for p in self.parameters)
        ]
        visible = self.shown_by(model)
        return model.plus(
            terms=self._pieces(model),
            lines=self.lines,
            outputs=visible.outputs,
            states=self.states,
            inputs=[s for s in self.inputs if s.name not in symbols_of(model)],
            parameters=parameters,
            transforms=self._transforms(model),
            output_delays=visible.output_delays,
        )

    def _transforms(self, model: Model) -> tuple[InputTransform, ...]:
        return tuple(t for t in self.transforms if t.input in model.input_names)

    def _pieces(self, model: Model) -> dict[str, str]:
        symbols = symbols_of(model) | {p.name for p in self.parameters} | {s.name for s in (*self.states, *self.inputs)}
        symbols |= {line.partition("=")[0].strip() for line in self.lines}
        additions = {
            line: " + ".join(f"({piece})" for piece in pieces if names_in(piece) <= symbols)
            for line, pieces in self.terms.items()
            if line in model.definitions
        }
        return {line: added for line, added in additions.items() if added}


@dataclass(frozen=True)
class Effect:
    """A candidate explanation of a gap, with what a person needs to judge it.

    physics: a paragraph. source: of form and size. signature: the trace it leaves in the residuals. confusions: other effects it
    can be mistaken for -> what separates them. separate_by: the manoeuvre or bench test that isolates it. family: members of one
    family count as one class. tied_to: base parameters that absorb the effect completely.
    """

    name: str
    title: str
    group: Group
    physics: str
    equation: str
    source: str
    signature: str
    confusions: Mapping[str, str]
    separate_by: str
    forms: tuple[Form, ...]
    family: str = ""
    tied_to: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        labels = [f.label for f in self.forms]
        if twice := [n for n in labels if labels.count(n) > 1]:
            raise EffectError(f"effect {self.name!r}: two forms are called {twice[0]!r}; give each a label of its own")

    def applicable(self, model: Model) -> tuple[Form, ...]:
        """The forms that can be added to `model`, as it shows them."""
        return tuple(f.shown_by(model) for f in self.forms if f.obstacle(model) is None)


def symbols_of(model: Model) -> set[str]:
    """All names that equations of `model` may use."""
    return {*model.state_names, *model.input_names, *model.parameter_names, *model.constants, *model.definitions}
