"""Arithmetic over columns that a mapping writes, such as `CTUN.As * CTUN.E2T`: parsed here, never evaluated as code.

Numbers, + - * / **, brackets, and the functions below. A column stands by its name (`actuator_outputs[1].output[0]`); one whose
name has blanks or signs in it stands in backquotes: `Air Speed (kt)`.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.importers.errors import ImportDataError

Array = NDArray[np.float64]

LONGEST = 500
"""Characters of an expression: one that a person reads."""
DEEPEST = 30
"""Brackets within brackets."""

FUNCTIONS: Mapping[str, tuple[int, Callable[..., Array]]] = {
    "sqrt": (1, np.sqrt), "abs": (1, np.abs), "sin": (1, np.sin), "cos": (1, np.cos), "tan": (1, np.tan),
    "asin": (1, np.arcsin), "acos": (1, np.arccos), "atan": (1, np.arctan), "atan2": (2, np.arctan2), "hypot": (2, np.hypot),
    "min": (2, np.minimum), "max": (2, np.maximum),
}  # fmt: skip
"""Name -> number of arguments and what it does; angles in radians."""

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|`(?P<quoted>[^`]+)`"
    r"|(?P<name>[^\W\d]\w*(?:\[\d+\])?(?:\.[^\W\d]\w*(?:\[\d+\])?)*)|(?P<sign>\*\*|[-+*/(),]))"
)

Value = Callable[[Mapping[str, Array]], "Array | float"]


@dataclass(frozen=True)
class Expression:
    """text: as written; columns: that it reads, in the order of their first use."""

    text: str
    columns: tuple[str, ...]
    _value: Value

    def of(self, columns: Mapping[str, Array]) -> Array:
        """Its value (N,) from columns (N,) by name; NaN where it is not defined."""
        size = next(iter(columns.values())).size if columns else 1
        with np.errstate(all="ignore"):
            found = np.broadcast_to(np.asarray(self._value(columns), float), (size,)).copy()
        found[~np.isfinite(found)] = np.nan
        return found


def parse(text: str) -> Expression:
    """Raises ImportDataError that says where the text is no expression."""
    if len(text) > LONGEST:
        raise ImportDataError(f"expression of {len(text)} characters; at most {LONGEST}")
    reader = _Reader(text, _tokens(text))
    value = reader.sum()
    if reader.left:
        raise ImportDataError(f"expression {text!r}: {reader.peek()!r} is not expected there")
    if not reader.columns:
        raise ImportDataError(f"expression {text!r} names no column")
    return Expression(text, tuple(dict.fromkeys(reader.columns)), value)


def _tokens(text: str) -> list[tuple[str, str]]:
    out, at = [], 0
    while text[at:].strip():
        match = _TOKEN.match(text, at)
        if match is None or match.lastgroup is None:
            raise ImportDataError(
                f"expression {text!r}: cannot read {text[at:].strip()[:20]!r}; numbers, column names (in backquotes where they "
                f"hold blanks or signs), + - * / ** and {', '.join(FUNCTIONS)} are known"
            )
        out.append((match.lastgroup, match[match.lastgroup]))
        at = match.end()
    return out


class _Reader:
    """Recursive descent: sum of products of powers."""

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

    def _take(self, *signs: str) -> str:
        """The next token if it is one of these signs, else an empty string."""
        if self.left and self._tokens[self._at][0] == "sign" and self.peek() in signs:
            self._at += 1
            return self._tokens[self._at - 1][1]
        return ""

    def _expect(self, sign: str) -> None:
        if not self._take(sign):
            raise ImportDataError(f"expression {self._text!r}: {sign!r} is missing before {self.peek() or 'the end'!r}")

    def sum(self) -> Value:
        """Terms added and subtracted."""
        value = self._product()
        while sign := self._take("+", "-"):
            value = _both(np.add if sign == "+" else np.subtract, value, self._product())
        return value

    def _product(self) -> Value:
        value = self._signed()
        while sign := self._take("*", "/"):
            value = _both(np.multiply if sign == "*" else np.divide, value, self._signed())
        return value

    def _signed(self) -> Value:
        self._depth += 1
        if self._depth > DEEPEST:
            raise ImportDataError(f"expression {self._text!r}: brackets within brackets, more than {DEEPEST} deep")
        sign = self._take("-", "+")
        if sign:
            inner = self._signed()
            value: Value = (lambda c: np.negative(inner(c))) if sign == "-" else inner
        else:
            value = self._atom()
            if self._take("**"):
                value = _both(np.power, value, self._signed())
        self._depth -= 1
        return value

    def _atom(self) -> Value:
        if self._take("("):
            value = self.sum()
            self._expect(")")
            return value
        if not self.left:
            raise ImportDataError(f"expression {self._text!r} ends where a number or a column is expected")
        kind, word = self._tokens[self._at]
        self._at += 1
        if kind == "number":
            number = float(word)
            return lambda c: number
        if kind == "name" and word in FUNCTIONS and self.peek() == "(":
            return self._call(word)
        if kind == "sign":
            raise ImportDataError(f"expression {self._text!r}: {word!r} where a number or a column is expected")
        self.columns.append(word)
        return lambda c: c[word]

    def _call(self, name: str) -> Value:
        count, function = FUNCTIONS[name]
        self._expect("(")
        arguments = [self.sum()]
        while self._take(","):
            arguments.append(self.sum())
        self._expect(")")
        if len(arguments) != count:
            raise ImportDataError(f"expression {self._text!r}: {name} takes {count} arguments, not {len(arguments)}")
        return lambda c: function(*(a(c) for a in arguments))


def _both(function: Callable[..., Array], first: Value, second: Value) -> Value:
    return lambda c: function(first(c), second(c))
