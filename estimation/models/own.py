"""A user's model as a short class: names with units, and two methods of plain equations.

    class RollMode:
        states = {"p": "rad/s"}
        inputs = {"delta_a": "rad"}
        measured = {"p": "rad/s"}
        parameters = {"L_p": ("1/s", -5.0), "L_da": ("1/s2", -20.0)}

        def derivatives(self, x, u, p):
            return [p.L_p * x.p + p.L_da * u.delta_a]

        def outputs(self, x, u, p, xdot):
            return [x.p]

The methods are called once with symbols and give the equation text of an ordinary `Model`, so such a model simulates,
compiles, is written to TOML and takes extra terms like any other. Use `sin`, `where`, ... from this module, or numpy's.
A constructor with an argument gets the aircraft.
"""

import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Self

from estimation.aircraft import Aircraft
from estimation.errors import ModelError
from estimation.models.base import Model, Parameter, Signal
from estimation.models.parts import usual_role

# Binding strength of operators, of comparisons (weakest), and of names, numbers, calls and brackets (strongest).
_LEVEL = {"+": 1, "-": 1, "*": 2, "/": 2, "neg": 3, "**": 4}
_COMPARISON, _ATOM = 0, 9
_NUMPY = {
    "add": "+", "subtract": "-", "multiply": "*", "divide": "/", "power": "**", "negative": "neg",
    "sin": "sin", "cos": "cos", "tan": "tan", "tanh": "tanh", "arcsin": "asin", "arccos": "acos", "arctan": "atan",
    "arctan2": "atan2", "sqrt": "sqrt", "exp": "exp", "log": "log", "sign": "sign", "absolute": "abs", "minimum": "min",
    "maximum": "max", "less": "<", "less_equal": "<=", "greater": ">", "greater_equal": ">=",
}  # fmt: skip
SHORT = 12  # characters: a longer expression that is used twice gets a line of its own


def _infix(operator: str, swapped: bool = False) -> Callable[["Symbol", object], "Symbol"]:
    """An operator as a method of `Symbol`; swapped: of the operand on its right."""

    def apply(self: "Symbol", other: object) -> "Symbol":
        return Symbol(operator, symbol(other), self) if swapped else Symbol(operator, self, symbol(other))

    return apply


class Symbol:
    """A quantity in an equation: arithmetic on it gives equation text."""

    __slots__ = ("arguments", "operator")

    def __init__(self, operator: str, *arguments: "Symbol | str") -> None:
        self.operator = operator
        self.arguments = arguments

    def __bool__(self) -> bool:
        raise ModelError("an equation cannot branch with 'if' or 'and'; use where(a < b, value, otherwise)")

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: object, **_: object) -> "Symbol":
        """numpy's functions of quantities, and operators between a numpy number and a quantity."""
        if method != "__call__" or ufunc.__name__ not in _NUMPY:
            raise ModelError(f"numpy.{ufunc.__name__} has no place in an equation; known are {', '.join(_NUMPY)}")
        return Symbol(_NUMPY[ufunc.__name__], *(symbol(value) for value in inputs))

    def __radd__(self, other: object) -> "Symbol":
        if isinstance(other, int) and other == 0:  # sum() starts at 0
            return self
        return Symbol("+", symbol(other), self)

    def __neg__(self) -> "Symbol":
        return Symbol("neg", self)

    def __pos__(self) -> Self:
        return self

    def __abs__(self) -> "Symbol":
        return Symbol("abs", self)

    __add__, __sub__, __mul__, __truediv__, __pow__ = (_infix(o) for o in ("+", "-", "*", "/", "**"))
    __lt__, __le__, __gt__, __ge__ = (_infix(o) for o in ("<", "<=", ">", ">="))
    __rsub__, __rmul__, __rtruediv__, __rpow__ = (_infix(o, swapped=True) for o in ("-", "*", "/", "**"))


def symbol(value: object) -> Symbol:
    """A number or symbol as a symbol; ModelError for another value or a number that is not finite."""
    if isinstance(value, Symbol):
        return value
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise ModelError(
            f"an equation holds {type(value).__name__}, which is neither a number nor a quantity"
        ) from None
    if not math.isfinite(number):
        raise ModelError("an equation holds a number that is not finite; does the aircraft's file lack it?")
    return Symbol("leaf", repr(number))


def _function(name: str) -> Any:
    def apply(*arguments: object) -> Symbol:
        return Symbol(name, *(symbol(a) for a in arguments))

    apply.__name__ = name
    apply.__doc__ = f"{name} of quantities in an equation."
    return apply


sin, cos, tan, tanh = (_function(n) for n in ("sin", "cos", "tan", "tanh"))
asin, acos, atan, atan2 = (_function(n) for n in ("asin", "acos", "atan", "atan2"))
sqrt, exp, log, sign = (_function(n) for n in ("sqrt", "exp", "log", "sign"))
minimum, maximum, where = _function("min"), _function("max"), _function("where")


class Names:
    """Quantities by attribute: `x.p`, `u.delta_a`; also by item, and iterable in order."""

    def __init__(self, kind: str, names: Iterable[str], suffix: str = "") -> None:
        self._kind = kind
        self._symbols = {name: Symbol("leaf", name + suffix) for name in names}

    def __getattr__(self, name: str) -> Symbol:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self._symbols[name]
        except KeyError:
            raise ModelError(f"no {self._kind} {name!r}; there are {', '.join(self._symbols)}") from None

    def __getitem__(self, name: str) -> Symbol:
        return getattr(self, name)  # type: ignore[no-any-return]

    def __iter__(self) -> Iterator[Symbol]:
        return iter(self._symbols.values())


def model_from_class(cls: type, aircraft: Aircraft | None = None) -> Model:
    """The `Model` of a class as in the module head; ModelError says what the class lacks."""
    for attribute in ("states", "measured", "parameters", "derivatives", "outputs"):
        if not hasattr(cls, attribute):
            raise ModelError(
                f"model class {cls.__name__}: no {attribute!r}; see 'A model of one's own' in docs/estimation.md"
            )
    instance = _instance(cls, aircraft)
    states = tuple(_signal(n, v, "state") for n, v in instance.states.items())
    inputs = tuple(_signal(n, v, "input") for n, v in getattr(instance, "inputs", {}).items())
    measured = tuple(_signal(n, v, "output") for n, v in instance.measured.items())
    parameters = tuple(_parameter(n, v) for n, v in instance.parameters.items())
    x, u = Names("state", [s.name for s in states]), Names("input", [s.name for s in inputs])
    p, xdot = Names("parameter", [q.name for q in parameters]), Names("state", [s.name for s in states], "_dot")
    rates = _in_order(instance.derivatives(x, u, p), [s.name for s in states], f"{cls.__name__}.derivatives")
    output_values = _in_order(instance.outputs(x, u, p, xdot), [s.name for s in measured], f"{cls.__name__}.outputs")
    targets = [(f"{s.name}_dot", r) for s, r in zip(states, rates, strict=True)]
    reserved = {*(s.name for s in (*states, *inputs)), *(q.name for q in parameters)} | {t for t, _ in targets}
    for output, value in zip(measured, output_values, strict=True):
        name = f"{output.name}_measured" if output.name in reserved else output.name
        if not (value.operator == "leaf" and value.arguments == (output.name,)):
            targets.append((name, value))
    return Model(
        name=str(getattr(instance, "name", cls.__name__)),
        title=(inspect.getdoc(cls) or "").split("\n", 1)[0],
        states=states,
        inputs=inputs,
        outputs=measured,
        parameters=parameters,
        constants={} if aircraft is None else aircraft.constants(),
        equations=tuple(_Writer(targets).lines()),
    )


def takes_aircraft(cls: type) -> bool:
    """Whether the constructor of a model class takes the aircraft: whether it has a positional argument without default."""
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return any(q.default is q.empty and q.kind in positional for q in inspect.signature(cls).parameters.values())


def _instance(cls: type, aircraft: Aircraft | None) -> Any:
    if not takes_aircraft(cls):
        return cls()
    if aircraft is None:
        raise ModelError(
            f"model class {cls.__name__} asks for an aircraft and was given none; name a built-in one or a file"
            " (--aircraft, or the argument aircraft of load_model)"
        )
    return cls(aircraft)


def _signal(name: str, value: object, kind: str) -> Signal:
    if isinstance(value, Signal):
        return value
    return Signal(name, str(value), control=kind == "input" and name.startswith(("delta_", "cmd_")))


def _parameter(name: str, value: object) -> Parameter:
    if isinstance(value, Parameter):
        return value
    if isinstance(value, str):
        return Parameter(name, value, role=usual_role(name))
    if isinstance(value, tuple) and 1 <= len(value) <= 4:
        numbers = [float(v) for v in value[1:]]
        start, lower, upper = (*numbers, *(0.0, -math.inf, math.inf)[len(numbers) :])
        return Parameter(name, str(value[0]), start, lower, upper, role=usual_role(name))
    raise ModelError(f"parameter {name!r}: give a unit, (unit, start), (unit, start, lower, upper) or a Parameter")


def _in_order(value: object, names: list[str], method: str) -> list[Symbol]:
    """What a method returned, a mapping, a sequence or one value, in the order of the names; ModelError for others."""
    if isinstance(value, Mapping):
        if set(value) != set(names):
            raise ModelError(f"{method}: gives {', '.join(map(str, value))}; needed are {', '.join(names)}")
        value = [value[n] for n in names]
    values = [symbol(v) for v in (value if isinstance(value, Iterable) else [value])]
    if len(values) != len(names):
        raise ModelError(f"{method}: gives {len(values)} values for {len(names)} names ({', '.join(names)})")
    return values


class _Writer:
    """Equation text of several targets; an expression that is used more than once becomes a line of its own."""

    def __init__(self, targets: list[tuple[str, Symbol]]) -> None:
        self.targets = targets
        self.uses: dict[int, int] = {}
        self.names: dict[int, str] = {}
        self.written: list[str] = []
        for _, value in targets:
            self._count(value)

    def lines(self) -> list[str]:
        for name, value in self.targets:
            text = self._text(value, top=True)[0]
            self.written.append(f"{name} = {text}")
        return self.written

    def _count(self, node: Symbol) -> None:
        self.uses[id(node)] = self.uses.get(id(node), 0) + 1
        if self.uses[id(node)] == 1:
            for argument in node.arguments:
                if isinstance(argument, Symbol):
                    self._count(argument)

    def _text(self, node: Symbol, top: bool = False) -> tuple[str, int]:
        """(text, binding strength) of a node."""
        if id(node) in self.names:
            return self.names[id(node)], _ATOM
        if node.operator == "leaf":
            text = str(node.arguments[0])
            return f"({text})" if text.startswith("-") else text, _ATOM
        expression, level = self._operation(node)
        if (
            not top
            and self.uses[id(node)] > 1
            and len(expression) > SHORT
            and node.operator not in ("<", "<=", ">", ">=")
        ):
            name = f"common_{len(self.names) + 1}"
            self.names[id(node)] = name
            self.written.append(f"{name} = {expression}")
            return name, _ATOM
        return expression, level

    def _operation(self, node: Symbol) -> tuple[str, int]:
        """(text, binding strength) of an operator or function with its arguments."""
        parts = [self._text(a) for a in node.arguments if isinstance(a, Symbol)]
        operator = node.operator
        if operator == "neg":
            return f"-{_wrapped(parts[0], _LEVEL['neg'])}", _LEVEL["neg"]
        if operator in _LEVEL:
            level = _LEVEL[operator]
            left = level + 1 if operator == "**" else level
            right = level + 1 if operator in "-/*" else level
            return f"{_wrapped(parts[0], left)} {operator} {_wrapped(parts[1], right)}", level
        if operator in ("<", "<=", ">", ">="):
            return f"{parts[0][0]} {operator} {parts[1][0]}", _COMPARISON
        return f"{operator}({', '.join(t for t, _ in parts)})", _ATOM


def _wrapped(part: tuple[str, int], weakest: int) -> str:
    """The text of a part, in brackets where it binds more weakly than `weakest`."""
    text, level = part
    return text if level >= weakest else f"({text})"
