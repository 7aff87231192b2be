"""A postulated model, written once as readable equations.

The same text simulates, gives exact sensitivities, estimates, reconstructs, and takes a named extra term at run time
(`Model.plus`). Lines are definitions: `CY = CY_0 + CY_beta*beta`, `<state>_dot = ...` for each state; an output that is
a state, an input or an intermediate of that name needs no line, and `<output>_measured = ...` says what the instrument
shows where that differs from the quantity itself. Lines may stand in any order.

Signals carry the names of flight columns; SI and radians; body axes x forward, y right, z down.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

from daq.utilities.plain_words import file_name, one_line
from estimation.errors import ModelError
from estimation.models import plain
from estimation.models.consistency import check_model
from estimation.models.expressions import names_in
from estimation.models.parts import TRANSFORM_KINDS, InputTransform, ModelParts, Parameter, ParameterRole, Signal

__all__ = ["TRANSFORM_KINDS", "InputTransform", "Model", "Parameter", "ParameterRole", "Signal", "joint_model"]


@dataclass(frozen=True)
class Model(ModelParts):
    """States, inputs, outputs, parameters and equations; immutable, every change makes a new one.

    Raises ModelError on construction when a name is used twice, a symbol is not defined, definitions run in a circle,
    or a state has no `<state>_dot` line.
    """

    def __post_init__(self) -> None:
        check_model(self)

    def __repr__(self) -> str:
        outputs = ", ".join(s.name for s in self.outputs)
        return (
            f"<Model {self.name}: {len(self.free_names)} free parameters, outputs {outputs}; .equations has its text>"
        )

    @property
    def instruments(self) -> dict[str, str]:
        """State -> the line, or the parameter of the delay, by which its instrument shows it otherwise than it is."""
        shown = {n: self.definitions[f"{n}_measured"] for n in self.state_names if f"{n}_measured" in self.definitions}
        return {**shown, **{n: delay for n, delay in self.output_delays.items() if n in self.state_names}}

    # ------------------------------------------------------------------------------------------------ new models
    def plus(
        self,
        *,
        name: str | None = None,
        title: str | None = None,
        terms: Mapping[str, str] | None = None,
        replaced: Mapping[str, str] | None = None,
        lines: Iterable[str] = (),
        outputs: Mapping[str, str] | None = None,
        parameters: Iterable[Parameter] = (),
        states: Iterable[Signal] = (),
        inputs: Iterable[Signal] = (),
        observed: Iterable[Signal] = (),
        transforms: Iterable[InputTransform] = (),
        output_delays: Mapping[str, str] | None = None,
    ) -> "Model":
        """A new model with an effect added.

        terms: symbol -> expression added to its line (`{"Cn": "Cn_da*delta_a"}`). replaced: symbol -> expression in place
        of its line. lines: new lines. outputs: output -> what its instrument shows; the output's
        name stands for what it showed before (`{"ay": "ay + x_imu*r_dot"}`, applied over earlier changes).
        parameters: new ones (one named like a constant or an existing parameter replaces it). states, inputs, observed: new
        states, inputs and outputs. transforms, output_delays: as the fields.
        """
        definitions = dict(self.definitions)
        for symbol, term in (terms or {}).items():
            if symbol not in definitions:
                raise ModelError(
                    f"model {self.name}: no line {symbol!r} to add a term to; it has {', '.join(definitions)}"
                )
            definitions[symbol] = f"{definitions[symbol]} + {_bracket(term)}"
        for symbol, expression in (replaced or {}).items():
            if symbol not in definitions:
                raise ModelError(f"model {self.name}: no line {symbol!r} to replace; it has {', '.join(definitions)}")
            definitions[symbol] = expression
        for output, expression in (outputs or {}).items():
            self._apply_output(definitions, output, expression)
        equations = [f"{symbol} = {expression}" for symbol, expression in definitions.items()] + list(lines)
        new_parameters = {p.name: p for p in parameters}
        parameters_before = tuple(new_parameters.pop(p.name, p) for p in self.parameters)
        return replace(
            self,
            name=name or self.name,
            title=title or self.title,
            states=self.states + tuple(states),
            inputs=self.inputs + tuple(inputs),
            outputs=self.outputs + tuple(observed),
            parameters=parameters_before + tuple(new_parameters.values()),
            equations=tuple(equations),
            transforms=self.transforms + tuple(transforms),
            output_delays={**self.output_delays, **(output_delays or {})},
        )

    def _apply_output(self, definitions: dict[str, str], output: str, expression: str) -> None:
        """Let the instrument of an output show `expression`, in place; the output's name stands for what it showed before."""
        if output not in self.output_names:
            raise ModelError(f"model {self.name}: no output {output!r}; it has {', '.join(self.output_names)}")
        measured = f"{output}_measured"
        count = 0
        if measured in definitions and output in names_in(expression):
            # what the instrument showed before becomes an intermediate that the new line refers to
            while f"{output}_shown{count}" in definitions:
                count += 1
            definitions[f"{output}_shown{count}"] = definitions.pop(measured)
            expression = renamed(expression, output, f"{output}_shown{count}")
        definitions[measured] = expression

    def with_biases(self, *outputs: str, local: bool = True) -> "Model":
        """A new model with a constant instrument bias `bias_<output>` on each named output, one value per flight.

        Raises ModelError where the model has a parameter of that name.
        """
        model = self
        for output in outputs:
            if f"bias_{output}" in model.parameter_names:
                raise ModelError(f"model {self.name}: it already has a parameter bias_{output}; rename that one")
            unit = next((s.unit for s in self.outputs if s.name == output), "")
            bias = Parameter(
                f"bias_{output}",
                unit,
                local=local,
                description=f"instrument bias of {output}",
                role=ParameterRole.INSTRUMENT,
            )
            model = model.plus(outputs={output: f"{output} + bias_{output}"}, parameters=[bias])
        return model

    def without_outputs(self, *outputs: str) -> "Model":
        """A new model without the named outputs and their delays."""
        keep = tuple(s for s in self.outputs if s.name not in outputs)
        delays = {k: v for k, v in self.output_delays.items() if k not in outputs}
        return replace(self, outputs=keep, output_delays=delays)

    def fixed(self, *names: str, **values: float) -> "Model":
        """A new model with parameters held: `names` at their start, `values` at the given number."""
        changes: dict[str, dict[str, Any]] = {n: {"fixed": True} for n in names}
        changes |= {n: {"fixed": True, "start": float(v)} for n, v in values.items()}
        return self._changed(changes)

    def freed(self, *names: str) -> "Model":
        """A new model in which the named parameters are estimated."""
        return self._changed({n: {"fixed": False} for n in names})

    def with_starts(self, values: Mapping[str, float] | None = None, **more: float) -> "Model":
        """A new model with other start values (of fixed parameters: their value)."""
        return self._changed({n: {"start": float(v)} for n, v in {**(values or {}), **more}.items()})

    def with_prior(self, **priors: tuple[float, float]) -> "Model":
        """A new model with Gaussian priors name=(mean, standard deviation) that enter the fit."""
        return self._changed({n: {"prior_mean": float(m), "prior_std": float(s)} for n, (m, s) in priors.items()})

    def with_limits(self, **limits: tuple[float, float]) -> "Model":
        """A new model with bounds name=(lower, upper)."""
        return self._changed({n: {"lower": float(a), "upper": float(b)} for n, (a, b) in limits.items()})

    def with_initial(self, *names: str, held: bool, values: Mapping[str, float] | None = None) -> "Model":
        """A new model in which the initial values of the named states are held or estimated; of all states where none is named.

        values: state -> number at which its initial value is held. Raises ModelError for a name that is no state's.
        """
        held_values = dict(values or {})
        changed_states = (*(names or (() if held_values else self.state_names)), *held_values)
        for name in changed_states:
            if name not in self.state_names:
                raise ModelError(f"model {self.name}: no state {name!r}; it has {', '.join(self.state_names)}")
        states = tuple(
            replace(s, held=held, start=held_values.get(s.name, s.start)) if s.name in changed_states else s
            for s in self.states
        )
        return replace(self, states=states)

    def free_of(self, *roles: ParameterRole) -> tuple[str, ...]:
        """Names of the estimated parameters that have one of the roles."""
        return tuple(p.name for p in self.parameters if p.role in roles and not p.fixed)

    def with_local(self, *names: str) -> "Model":
        """A new model in which each flight has its own value of the named parameters."""
        return self._changed({n: {"local": True} for n in names})

    def _changed(self, changes: Mapping[str, Mapping[str, Any]]) -> "Model":
        for name in changes:
            self.parameter(name)
        return replace(
            self, parameters=tuple(replace(p, **changes[p.name]) if p.name in changes else p for p in self.parameters)
        )

    # ------------------------------------------------------------------------------------------------ identity
    def to_dict(self) -> dict[str, Any]:
        """Plain data that `from_dict` turns back into an equal model."""
        data: dict[str, Any] = {"name": self.name, "title": self.title, "description": self.description}
        for kind in ("states", "inputs", "outputs", "parameters", "transforms"):
            data[kind] = [plain.without_defaults(item) for item in getattr(self, kind)]
        data["constants"] = dict(self.constants)
        data["output_delays"] = dict(self.output_delays)
        data["equations"] = list(self.equations)
        if self.flown:
            data["flown"] = {name: list(ends) for name, ends in self.flown.items()}
        if self.estimated_from:
            data["estimated_from"] = [asdict(stretch) for stretch in self.estimated_from]
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Model":
        """Inverse of `to_dict`; ModelError names the key that does not fit."""
        known_keys = {
            "name", "title", "description", "states", "inputs", "outputs", "parameters", "transforms",
            "constants", "output_delays", "equations", "flown", "estimated_from",
        }  # fmt: skip
        unknown = sorted(set(data) - known_keys)
        if unknown:
            raise ModelError(f"unknown key {unknown[0]!r}; known are {', '.join(sorted(known_keys))}")
        for key in ("name", "outputs", "parameters", "equations"):
            if key not in data:
                raise ModelError(f"key {key!r} is missing")
        return cls(
            name=file_name(str(data["name"])),
            title=one_line(str(data.get("title", ""))),
            description=str(data.get("description", "")),
            states=tuple(plain.read_signal("states", d) for d in plain.read_list(data, "states")),
            inputs=tuple(plain.read_signal("inputs", d) for d in plain.read_list(data, "inputs")),
            outputs=tuple(plain.read_signal("outputs", d) for d in plain.read_list(data, "outputs")),
            parameters=tuple(plain.read_parameter(d) for d in plain.read_list(data, "parameters")),
            transforms=tuple(plain.read_transform(d) for d in plain.read_list(data, "transforms")),
            constants={
                str(k): plain.read_number(v, f"constants.{k}") for k, v in plain.read_table(data, "constants").items()
            },
            output_delays={str(k): str(v) for k, v in plain.read_table(data, "output_delays").items()},
            equations=plain.read_lines(data["equations"]),
            flown={str(k): plain.read_ends(v, f"flown.{k}") for k, v in plain.read_table(data, "flown").items()},
            estimated_from=tuple(plain.read_stretch(d) for d in plain.read_list(data, "estimated_from")),
        )

    @cached_property
    def digest(self) -> str:
        """Digest of the model, values included; it identifies the model in lineages and reports."""
        return hashlib.sha256(json.dumps(self.to_dict(), sort_keys=True).encode()).hexdigest()[:16]


def joint_model(model: Model) -> Model:
    """The model for a joint fit: each flight has its own constant coefficients (CY_0 Cl_0 Cn_0 ...).

    They absorb the day's trim, centre of gravity and sensor offsets.
    """
    return model.with_local(*model.free_of(ParameterRole.CONSTANT))


def _bracket(term: str) -> str:
    """The term in brackets where it is a sum."""
    return f"({term})" if any(sign in term.strip()[1:] for sign in "+-") else term


def renamed(expression: str, old: str, new: str) -> str:
    """An expression with one name in place of another."""
    return re.sub(rf"\b{re.escape(old)}\b", new, expression)
