"""A postulated model, written once as readable equations.

The same text simulates, gives exact sensitivities, estimates, reconstructs, and takes a named extra term at run time
(`Model.plus`). Lines are definitions: `CY = CY_0 + CY_beta*beta`, `<state>_dot = ...` for each state; an output that is
a state, an input or an intermediate of that name needs no line, and `<output>_measured = ...` says what the instrument
shows where that differs from the quantity itself. Lines may stand in any order.

Signals carry the names of flight columns; SI and radians; body axes x forward, y right, z down.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

from estimation.errors import ModelError
from estimation.models.expressions import check_name, names_in, split_line

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


@dataclass(frozen=True)
class Model:
    """States, inputs, outputs, parameters and equations; immutable, every change makes a new one.

    Raises ModelError on construction when a name is used twice, a symbol is not defined, definitions run in a circle,
    or a state has no `<state>_dot` line.
    """

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

    def __post_init__(self) -> None:
        _check_model(self)

    # ------------------------------------------------------------------------------------------------ names
    @property
    def state_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.outputs)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters)

    @property
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

    def output_expression(self, name: str) -> str:
        """What output `name` shows: `<name>_measured` where the text defines it, else the quantity itself."""
        measured = f"{name}_measured"
        return self.definitions.get(measured, name)

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

        terms: symbol -> expression added to its line (`{"Cn": "Cn_da*delta_a"}`). replaced: symbol -> expression that
        takes the place of its line. lines: new lines. outputs: output -> what its instrument shows; the word of the
        output itself stands for what it showed before (`{"ay": "ay + x_imu*r_dot"}`, applied over earlier changes).
        parameters: new ones (one that has the name of a constant or an existing parameter takes its place).
        states, inputs, observed: new states, inputs and outputs. transforms, output_delays: as the fields.
        """
        definitions = dict(self.definitions)
        for symbol, term in (terms or {}).items():
            if symbol not in definitions:
                raise ModelError(f"model {self.name}: no line {symbol!r} to add a term to; {_has(definitions)}")
            definitions[symbol] = f"{definitions[symbol]} + {_bracket(term)}"
        for symbol, expression in (replaced or {}).items():
            if symbol not in definitions:
                raise ModelError(f"model {self.name}: no line {symbol!r} to replace; {_has(definitions)}")
            definitions[symbol] = expression
        for output, expression in (outputs or {}).items():
            self._apply_output(definitions, output, expression)
        equations = [f"{symbol} = {expression}" for symbol, expression in definitions.items()] + list(lines)
        fresh = {p.name: p for p in parameters}
        kept = tuple(fresh.pop(p.name, p) for p in self.parameters)
        return replace(
            self,
            name=name or self.name,
            title=title or self.title,
            states=self.states + tuple(states),
            inputs=self.inputs + tuple(inputs),
            outputs=self.outputs + tuple(observed),
            parameters=kept + tuple(fresh.values()),
            equations=tuple(equations),
            transforms=self.transforms + tuple(transforms),
            output_delays={**self.output_delays, **(output_delays or {})},
        )

    def _apply_output(self, definitions: dict[str, str], output: str, expression: str) -> None:
        if output not in self.output_names:
            raise ModelError(f"model {self.name}: no output {output!r}; it has {', '.join(self.output_names)}")
        measured = f"{output}_measured"
        count = 0
        if measured in definitions and output in names_in(expression):
            # chain: what the instrument showed so far becomes an intermediate of its own
            while f"{output}_shown{count}" in definitions:
                count += 1
            definitions[f"{output}_shown{count}"] = definitions.pop(measured)
            expression = _rename(expression, output, f"{output}_shown{count}")
        definitions[measured] = expression

    def with_biases(self, *outputs: str, local: bool = True) -> "Model":
        """A new model with a constant instrument bias `bias_<output>` on each named output, one value per flight."""
        model = self
        for output in outputs:
            unit = next((s.unit for s in self.outputs if s.name == output), "")
            bias = Parameter(f"bias_{output}", unit, local=local, description=f"instrument bias of {output}")
            model = model.plus(outputs={output: f"{output} + bias_{output}"}, parameters=[bias])
        return model

    def without_outputs(self, *outputs: str) -> "Model":
        """A new model that is not compared in the named outputs."""
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
            data[kind] = [_without_defaults(item) for item in getattr(self, kind)]
        data["constants"] = dict(self.constants)
        data["output_delays"] = dict(self.output_delays)
        data["equations"] = list(self.equations)
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Model":
        """Inverse of `to_dict`; ModelError names the key that does not fit."""
        known = {
            "name", "title", "description", "states", "inputs", "outputs", "parameters", "transforms",
            "constants", "output_delays", "equations",
        }  # fmt: skip
        unknown = sorted(set(data) - known)
        if unknown:
            raise ModelError(f"unknown key {unknown[0]!r}; known are {', '.join(sorted(known))}")
        for key in ("name", "states", "outputs", "parameters", "equations"):
            if key not in data:
                raise ModelError(f"key {key!r} is missing")
        return cls(
            name=str(data["name"]),
            title=str(data.get("title", "")),
            description=str(data.get("description", "")),
            states=tuple(_item(Signal, "states", d) for d in data["states"]),
            inputs=tuple(_item(Signal, "inputs", d) for d in data.get("inputs", [])),
            outputs=tuple(_item(Signal, "outputs", d) for d in data["outputs"]),
            parameters=tuple(_parameter(d) for d in data["parameters"]),
            transforms=tuple(_transform(d) for d in data.get("transforms", [])),
            constants={str(k): _number(v, f"constants.{k}") for k, v in dict(data.get("constants", {})).items()},
            output_delays={str(k): str(v) for k, v in dict(data.get("output_delays", {})).items()},
            equations=_lines(data["equations"]),
        )

    @cached_property
    def structure(self) -> str:
        """Digest of what decides the traced functions: names and equations, not values."""
        parts = [
            self.state_names, self.input_names, self.output_names, self.parameter_names,
            tuple(sorted(self.constants)), self.equations,
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:24]

    @cached_property
    def digest(self) -> str:
        """Digest of the whole model, values included: names it in lineages and reports."""
        return hashlib.sha256(json.dumps(self.to_dict(), sort_keys=True).encode()).hexdigest()[:16]


# ---------------------------------------------------------------------------------------------------- checking


def _check_model(model: Model) -> None:
    where = f"model {model.name}"
    symbols: dict[str, str] = {}
    for kind, names in (
        ("state", model.state_names), ("input", model.input_names), ("parameter", model.parameter_names),
    ):  # fmt: skip
        for name in names:
            check_name(name, f"{where}: {kind}")
            if name in symbols:
                raise ModelError(f"{where}: {name!r} is both {symbols[name]} and {kind}")
            symbols[name] = kind
    lines = [split_line(line) for line in model.equations]
    defined: set[str] = set()
    for symbol, _ in lines:
        if symbol in defined or symbol in symbols:
            raise ModelError(f"{where}: {symbol!r} is defined twice ({symbols.get(symbol, 'equation')} and equation)")
        defined.add(symbol)
    for state in model.state_names:
        if f"{state}_dot" not in defined:
            raise ModelError(f"{where}: state {state!r} has no line '{state}_dot = ...'")
    known = defined | set(symbols) | set(model.constants)
    for output in model.output_names:
        if output not in known and f"{output}_measured" not in defined:
            raise ModelError(f"{where}: output {output!r} has no line '{output} = ...'")
    for symbol, expression in lines:
        for name in sorted(names_in(expression) - known):
            raise ModelError(f"{where}: {name!r} in the line of {symbol!r} is defined nowhere")
    if not model.states or not model.outputs:
        raise ModelError(f"{where}: at least one state and one output are needed")
    _check_circles(model, dict(lines))
    _check_parameters(model)
    _check_transforms(model)


def _check_circles(model: Model, definitions: Mapping[str, str]) -> None:
    done: set[str] = set()

    def visit(symbol: str, path: tuple[str, ...]) -> None:
        if symbol in path:
            raise ModelError(f"model {model.name}: definitions run in a circle: {' -> '.join((*path, symbol))}")
        if symbol in done or symbol not in definitions:
            return
        for name in sorted(names_in(definitions[symbol])):
            visit(name, (*path, symbol))
        done.add(symbol)

    for symbol in definitions:
        visit(symbol, ())


def _check_parameters(model: Model) -> None:
    for p in model.parameters:
        where = f"model {model.name}: parameter {p.name}"
        if not p.lower <= p.start <= p.upper:
            raise ModelError(f"{where}: start {p.start} lies outside its limits {p.lower} .. {p.upper}")
        if not math.isfinite(p.start):
            raise ModelError(f"{where}: start {p.start} is not a finite number")
        if (p.prior_mean is None) != (p.prior_std is None) or (p.prior_std is not None and not p.prior_std > 0):
            raise ModelError(f"{where}: a prior needs a mean and a standard deviation greater than zero")


def _check_transforms(model: Model) -> None:
    for t in model.transforms:
        where = f"model {model.name}: transform {t.kind} of {t.input}"
        if t.kind not in TRANSFORM_KINDS:
            raise ModelError(f"{where}: no such kind; known are {', '.join(TRANSFORM_KINDS)}")
        if t.input not in model.input_names:
            raise ModelError(f"{where}: the model has no such input")
        if len(t.parameters) != TRANSFORM_KINDS[t.kind]:
            raise ModelError(f"{where}: {TRANSFORM_KINDS[t.kind]} parameter(s) needed, {len(t.parameters)} given")
        for name in t.parameters:
            model.parameter(name)
    for output, name in model.output_delays.items():
        if output not in model.output_names:
            raise ModelError(f"model {model.name}: delay on {output!r}, which is no output")
        model.parameter(name)


# ---------------------------------------------------------------------------------------------------- text and data


def _has(definitions: Mapping[str, str]) -> str:
    return f"it has {', '.join(definitions)}"


def _bracket(term: str) -> str:
    return f"({term})" if any(sign in term.strip()[1:] for sign in "+-") else term


def _rename(expression: str, old: str, new: str) -> str:
    import re

    return re.sub(rf"\b{re.escape(old)}\b", new, expression)


def _without_defaults(item: Any) -> dict[str, Any]:
    cls = type(item)
    default = cls("x", "x", ("x",)) if cls is InputTransform else cls("x")
    data = {k: v for k, v in asdict(item).items() if k in ("name", "kind", "input") or v != getattr(default, k)}
    return {k: list(v) if isinstance(v, tuple) else v for k, v in data.items()}


def _number(value: object, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ModelError(f"{key} = {value!r} is not a number")
    return float(value)


def _lines(value: object) -> tuple[str, ...]:
    rows = value.splitlines() if isinstance(value, str) else value
    if not isinstance(rows, list) or not all(isinstance(r, str) for r in rows):
        raise ModelError("equations must be lines of text: 'name = expression'")
    bare = (row.split("#", 1)[0].strip() for row in rows)
    return tuple(row for row in bare if row)


def _item(cls: type[Any], key: str, data: object) -> Any:
    if isinstance(data, str):
        data = {"name": data}
    if not isinstance(data, Mapping) or "name" not in data:
        raise ModelError(f"{key}: each entry is a table with at least a name, not {data!r}")
    allowed = set(cls.__dataclass_fields__)
    unknown = sorted(set(data) - allowed)
    if unknown:
        raise ModelError(f"{key} {data['name']!r}: unknown key {unknown[0]!r}; known are {', '.join(sorted(allowed))}")
    return cls(**data)


def _parameter(data: object) -> Parameter:
    if isinstance(data, Mapping):
        texts = {"name", "unit", "reference_source", "description"}
        flags = {"fixed", "local"}
        for key, value in data.items():
            if key in Parameter.__dataclass_fields__ and key not in texts | flags:
                _number(value, f"parameter {data.get('name')!r}: {key}")
            if key in flags and not isinstance(value, bool):
                raise ModelError(f"parameter {data.get('name')!r}: {key} = {value!r} must be true or false")
    return _item(Parameter, "parameters", data)  # type: ignore[no-any-return]


def _transform(data: object) -> InputTransform:
    if not isinstance(data, Mapping) or set(data) != {"kind", "input", "parameters"}:
        raise ModelError(f"transforms: each entry has kind, input and parameters, not {data!r}")
    return InputTransform(str(data["kind"]), str(data["input"]), tuple(str(p) for p in data["parameters"]))
