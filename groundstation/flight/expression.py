"""Arithmetic over columns that a mapping writes, such as `CTUN.As * CTUN.E2T`, and conditions that name stretches of a flight,
such as `V > 12 and abs(phi) < 0.5` or `mode:MANUAL`: parsed here, never evaluated as code.

Numbers, + - * / **, brackets, and the functions below. A column stands by its name (`actuator_outputs[1].output[0]`); one whose
name has blanks or signs in it stands in backquotes: `Air Speed (kt)`.
Conditions: < <= > >= == !=, and, or, not, brackets, mode:NAME;
a comma between conditions means or.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.flight.errors import FlightError

Array = NDArray[np.float64]

LONGEST = 500
"""Characters of an expression: one that a person reads."""
DEEPEST = 40
"""Brackets within brackets."""

FUNCTIONS: Mapping[str, tuple[int, Callable[..., Array]]] = {
    "sqrt": (1, np.sqrt), "abs": (1, np.abs), "sin": (1, np.sin), "cos": (1, np.cos), "tan": (1, np.tan),
    "asin": (1, np.arcsin), "acos": (1, np.arccos), "atan": (1, np.arctan), "atan2": (2, np.arctan2), "hypot": (2, np.hypot),
    "min": (2, np.minimum), "max": (2, np.maximum),
}  # fmt: skip
"""Name -> number of arguments and what it does; angles in radians."""

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|`(?P<quoted>[^`]+)`"
    r"|mode:\s*(?P<mode>\w+(?: \d+)?)"
    r"|(?P<name>[^\W\d]\w*(?:\[\d+\])?(?:\.[^\W\d]\w*(?:\[\d+\])?)*)|(?P<sign>\*\*|[<>=!]=|[-+*/(),<>]))"
)
_COMPARED: Mapping[str, Callable[..., Array]] = {
    "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal, "!=": np.not_equal,
}  # fmt: skip
MODE = "mode:"
"""What the pseudo-column of a flight mode begins with: 1 in it, 0 else."""


class ExpressionError(FlightError):
    """A text that is no expression."""


@dataclass(frozen=True)
class _Value:
    """What a part of an expression is worth; condition: whether that is true or false."""

    of: Callable[[Mapping[str, Array]], Array | float]
    condition: bool = False


@dataclass(frozen=True)
class Expression:
    """text: as written; columns: that it reads, in the order of their first use."""

    text: str
    columns: tuple[str, ...]
    _value: _Value

    def of(self, columns: Mapping[str, Array]) -> Array:
        """Its value (N,) from columns (N,) by name; NaN where it is not defined."""
        size = next(iter(columns.values())).size if columns else 1
        with np.errstate(all="ignore"):
            found = np.broadcast_to(np.asarray(self._value.of(columns), float), (size,)).copy()
        found[~np.isfinite(found)] = np.nan
        return found


def parse(text: str) -> Expression:
    """Arithmetic. Raises ExpressionError that says where the text is none."""
    return _parsed(text, condition=False)


def parse_condition(text: str) -> Expression:
    """What is true or false of each sample; its value is 1 or 0. Raises ExpressionError that says where the text is none."""
    return _parsed(text, condition=True)


def _parsed(text: str, *, condition: bool) -> Expression:
    if len(text) > LONGEST:
        raise ExpressionError(f"expression of {len(text)} characters; at most {LONGEST}")
    reader = _ExpressionParser(text, _tokens(text))
    value = reader.either()
    while condition and reader.takes(","):
        value = reader.logical(np.logical_or, value, reader.either())
    if reader.left:
        raise ExpressionError(f"expression {text!r}: {reader.peek()!r} is not expected there")
    if not reader.columns:
        raise ExpressionError(f"expression {text!r} names no column")
    if value.condition != condition:
        wanted = "a condition, like V > 12 or mode:MANUAL" if condition else "a number, and no condition"
        raise ExpressionError(f"expression {text!r}: {wanted} is expected")
    return Expression(text, tuple(dict.fromkeys(reader.columns)), value)


def _tokens(text: str) -> list[tuple[str, str]]:
    out, at = [], 0
    while text[at:].strip():
        match = _TOKEN.match(text, at)
        if match is None or match.lastgroup is None:
            raise ExpressionError(
                f"expression {text!r}: cannot read {text[at:].strip()[:20]!r}; numbers, column names (in backquotes where they "
                f"hold blanks or signs), + - * / ** and {', '.join(FUNCTIONS)} are known"
            )
        out.append((match.lastgroup, match[match.lastgroup]))
        at = match.end()
    return out


class _ExpressionParser:
    """Recursive descent: conditions of comparisons of sums of products of powers."""

    def __init__(self, text: str, tokens: list[tuple[str, str]]) -> None:
        self._text, self._tokens, self._at, self._depth = text, tokens, 0, 0
        self.columns: list[str] = []

    @property
    def left(self) -> bool:
        """Whether something is not read yet."""
        return self._at < len(self._tokens)

    def peek(self) -> str:
        """The next sign or word; empty at the end."""
        return self._tokens[self._at][1] if self.left else ""

    def takes(self, *signs: str) -> str:
        """The next token if it is one of these signs or words, else an empty string."""
        if self.left and self._tokens[self._at][0] in ("sign", "name") and self.peek() in signs:
            self._at += 1
            return self._tokens[self._at - 1][1]
        return ""

    def _expect(self, sign: str) -> None:
        if not self.takes(sign):
            raise ExpressionError(f"expression {self._text!r}: {sign!r} is missing before {self.peek() or 'the end'!r}")

    def either(self) -> _Value:
        """Conditions of which one is to be true, or a number."""
        self._depth += 1
        if self._depth > DEEPEST:
            raise ExpressionError(f"expression {self._text!r}: brackets within brackets, more than {DEEPEST} deep")
        value = self._all()
        while self.takes("or"):
            value = self.logical(np.logical_or, value, self._all())
        self._depth -= 1
        return value

    def _all(self) -> _Value:
        value = self._negated()
        while self.takes("and"):
            value = self.logical(np.logical_and, value, self._negated())
        return value

    def _negated(self) -> _Value:
        turned = False
        while self.takes("not"):
            turned = not turned
        value = self._compared()
        return self.logical(np.logical_xor, value, _Value(lambda c: 1.0, True)) if turned else value

    def _compared(self) -> _Value:
        first = self._sum()
        found: _Value | None = None
        while sign := self.takes(*_COMPARED):
            second = self._sum()
            here = _Value(self._both(_COMPARED[sign], first, second).of, True)
            found = here if found is None else self.logical(np.logical_and, found, here)
            first = second
        return first if found is None else found

    def logical(self, function: Callable[..., Array], first: _Value, second: _Value) -> _Value:
        """Two conditions as one."""
        if not (first.condition and second.condition):
            raise ExpressionError(
                f"expression {self._text!r}: and, or, not and commas stand between conditions, like V > 12"
            )
        return _Value(lambda c: function(first.of(c), second.of(c)), True)

    def _both(self, function: Callable[..., Array], first: _Value, second: _Value) -> _Value:
        if first.condition or second.condition:
            raise ExpressionError(f"expression {self._text!r}: a condition stands where a number is expected")
        return _Value(lambda c: function(first.of(c), second.of(c)))

    def _sum(self) -> _Value:
        value = self._product()
        while sign := self.takes("+", "-"):
            value = self._both(np.add if sign == "+" else np.subtract, value, self._product())
        return value

    def _product(self) -> _Value:
        value = self._signed()
        while sign := self.takes("*", "/"):
            value = self._both(np.multiply if sign == "*" else np.divide, value, self._signed())
        return value

    def _signed(self) -> _Value:
        self._depth += 1
        if self._depth > DEEPEST:
            raise ExpressionError(f"expression {self._text!r}: brackets within brackets, more than {DEEPEST} deep")
        sign = self.takes("-", "+")
        if sign:
            inner = self._signed()
            value = self._both(np.multiply, inner, _Value(lambda c: -1.0 if sign == "-" else 1.0))
        else:
            value = self._atom()
            if self.takes("**"):
                value = self._both(np.power, value, self._signed())
        self._depth -= 1
        return value

    def _atom(self) -> _Value:
        if self.takes("("):
            value = self.either()
            self._expect(")")
            return value
        if not self.left:
            raise ExpressionError(f"expression {self._text!r} ends where a number or a column is expected")
        kind, word = self._tokens[self._at]
        self._at += 1
        if kind == "number":
            number = float(word)
            return _Value(lambda c: number)
        if kind == "name" and word in FUNCTIONS and self.peek() == "(":
            return self._call(word)
        if kind == "sign":
            raise ExpressionError(f"expression {self._text!r}: {word!r} where a number or a column is expected")
        name = f"{MODE}{word.upper()}" if kind == "mode" else word
        self.columns.append(name)
        return _Value(lambda c: c[name], kind == "mode")

    def _call(self, name: str) -> _Value:
        count, function = FUNCTIONS[name]
        self._expect("(")
        arguments = [self._sum()]
        while self.takes(","):
            arguments.append(self._sum())
        self._expect(")")
        if len(arguments) != count:
            raise ExpressionError(f"expression {self._text!r}: {name} takes {count} arguments, not {len(arguments)}")
        if any(a.condition for a in arguments):
            raise ExpressionError(f"expression {self._text!r}: a condition stands where a number is expected")
        return _Value(lambda c: function(*(a.of(c) for a in arguments)))
