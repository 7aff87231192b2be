"""Arithmetic over columns in mappings, such as `CTUN.As * CTUN.E2T`, and conditions that select stretches of a flight, such as
`V > 12 and abs(phi) < 0.5` or `mode:MANUAL`. Expressions are parsed, never evaluated as code.

Arithmetic: numbers, + - * / **, brackets, FUNCTIONS, and columns by name (`actuator_outputs[1].output[0]`), in backquotes where
the name holds blanks or signs (`Air Speed (kt)`). Conditions: < <= > >= == !=, and, or, not, brackets, mode:NAME; a comma between
conditions means or.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from groundstation.flight.arrays import Array
from groundstation.flight.errors import FlightError

LONGEST = 500  # characters of an expression: more than a person writes
DEEPEST = 40  # brackets within brackets

FUNCTIONS: Mapping[str, tuple[int, Callable[..., Array]]] = {
    "sqrt": (1, np.sqrt), "abs": (1, np.abs), "sin": (1, np.sin), "cos": (1, np.cos), "tan": (1, np.tan),
    "asin": (1, np.arcsin), "acos": (1, np.arccos), "atan": (1, np.arctan), "atan2": (2, np.arctan2), "hypot": (2, np.hypot),
    "min": (2, np.minimum), "max": (2, np.maximum),
}  # fmt: skip
"""Name -> number of arguments and function; angles in radians."""

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|`(?P<quoted>[^`]+)`"
    r"|mode:\s*(?P<mode>\w+(?: \d+)?)"
    r"|(?P<name>[^\W\d]\w*(?:\[\d+\])?(?:\.[^\W\d]\w*(?:\[\d+\])?)*)|(?P<sign>\*\*|[<>=!]=|[-+*/(),<>]))"
)
Function = Callable[..., Array]
_OR: Mapping[str, Function] = {"or": np.logical_or}
_AND: Mapping[str, Function] = {"and": np.logical_and}
_SUM: Mapping[str, Function] = {"+": np.add, "-": np.subtract}
_PRODUCT: Mapping[str, Function] = {"*": np.multiply, "/": np.divide}
_COMPARISON: Mapping[str, Function] = {
    **{"<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal},
    **{"==": np.equal, "!=": np.not_equal},
}
MODE = "mode:"  # beginning of the name of a flight mode's pseudo-column, which is 1 in the mode and 0 elsewhere


class ExpressionError(FlightError):
    """A text that cannot be read as an expression."""


@dataclass(frozen=True)
class _Term:
    """A part of an expression; condition: whether it is true or false."""

    values: Callable[[Mapping[str, Array]], Array | float]
    condition: bool = False


@dataclass(frozen=True)
class Expression:
    """text: as written. columns: those used, in the order of their first use."""

    text: str
    columns: tuple[str, ...]
    _term: _Term

    def values(self, columns: Mapping[str, Array]) -> Array:
        """Value (N,) of the expression from columns (N,) by name; NaN where it is not defined."""
        size = next(iter(columns.values())).size if columns else 1
        with np.errstate(all="ignore"):
            values = np.broadcast_to(np.asarray(self._term.values(columns), float), (size,)).copy()
        values[~np.isfinite(values)] = np.nan
        return values


def parse(text: str) -> Expression:
    """Parse arithmetic. Raises ExpressionError that names the place of a mistake."""
    return _parsed(text, condition=False)


def parse_condition(text: str) -> Expression:
    """Parse a condition, whose value is 1 or 0. Raises ExpressionError that names the place of a mistake."""
    return _parsed(text, condition=True)


def _parsed(text: str, *, condition: bool) -> Expression:
    if len(text) > LONGEST:
        raise ExpressionError(f"expression of {len(text)} characters; at most {LONGEST}")
    parser = _ExpressionParser(text, _tokens(text))
    term = parser.disjunction()
    while condition and parser.accept(","):
        term = parser.combined(np.logical_or, term, parser.disjunction(), conditions=True)
    if parser.unread:
        raise ExpressionError(f"expression {text!r}: {parser.peek()!r} is not expected there")
    if not parser.columns:
        raise ExpressionError(f"expression {text!r} names no column")
    if term.condition != condition:
        expectation = "a condition, like V > 12 or mode:MANUAL" if condition else "a number, and no condition"
        raise ExpressionError(f"expression {text!r}: {expectation} is expected")
    return Expression(text, tuple(dict.fromkeys(parser.columns)), term)


def _tokens(text: str) -> list[tuple[str, str]]:
    tokens, position = [], 0
    while text[position:].strip():
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            raise ExpressionError(
                f"expression {text!r}: cannot read {text[position:].strip()[:20]!r}; numbers, column names (in backquotes "
                f"where they hold blanks or signs), + - * / ** and {', '.join(FUNCTIONS)} are known"
            )
        tokens.append((match.lastgroup, match[match.lastgroup]))
        position = match.end()
    return tokens


class _ExpressionParser:
    """Recursive descent: conditions of comparisons of sums of products of powers."""

    def __init__(self, text: str, tokens: list[tuple[str, str]]) -> None:
        self._text, self._tokens, self._position, self._depth = text, tokens, 0, 0
        self.columns: list[str] = []

    def _error(self, problem: str) -> ExpressionError:
        return ExpressionError(f"expression {self._text!r}{problem}")

    @property
    def unread(self) -> bool:
        """Whether tokens remain."""
        return self._position < len(self._tokens)

    def peek(self) -> str:
        """The next sign or word; empty at the end."""
        return self._tokens[self._position][1] if self.unread else ""

    def accept(self, *signs: str) -> str:
        """The next token if it is one of these signs or words, else an empty string."""
        if self.unread and self._tokens[self._position][0] in ("sign", "name") and self.peek() in signs:
            self._position += 1
            return self._tokens[self._position - 1][1]
        return ""

    def _expect(self, sign: str) -> None:
        if not self.accept(sign):
            raise self._error(f": {sign!r} is missing before {self.peek() or 'the end'!r}")

    def _nested(self, parse_inner: Callable[[], _Term]) -> _Term:
        self._depth += 1
        if self._depth > DEEPEST:
            raise self._error(f": brackets within brackets, more than {DEEPEST} deep")
        term = parse_inner()
        self._depth -= 1
        return term

    def combined(self, function: Function, first: _Term, second: _Term, *, conditions: bool) -> _Term:
        """The term function(first, second) of two conditions or two numbers."""
        if conditions and not (first.condition and second.condition):
            raise self._error(": and, or, not and commas stand between conditions, like V > 12")
        if not conditions and (first.condition or second.condition):
            raise self._error(": a condition stands where a number is expected")
        return _Term(lambda c: function(first.values(c), second.values(c)), conditions)

    def _chain(self, operators: Mapping[str, Function], operand: Callable[[], _Term], *, conditions: bool) -> _Term:
        """Operands and operators of one precedence, from left to right."""
        term = operand()
        while sign := self.accept(*operators):
            term = self.combined(operators[sign], term, operand(), conditions=conditions)
        return term

    def disjunction(self) -> _Term:
        """Conditions joined by `or`, or a number."""
        return self._nested(lambda: self._chain(_OR, self._conjunction, conditions=True))

    def _conjunction(self) -> _Term:
        return self._chain(_AND, self._negation, conditions=True)

    def _negation(self) -> _Term:
        negated = False
        while self.accept("not"):
            negated = not negated
        term = self._comparison()
        return self.combined(np.logical_xor, term, _Term(lambda c: 1.0, True), conditions=True) if negated else term

    def _comparison(self) -> _Term:
        first = self._sum()
        comparison: _Term | None = None
        while sign := self.accept(*_COMPARISON):
            second = self._sum()
            term = _Term(self.combined(_COMPARISON[sign], first, second, conditions=False).values, True)
            comparison = self.combined(np.logical_and, comparison, term, conditions=True) if comparison else term
            first = second
        return comparison or first

    def _sum(self) -> _Term:
        return self._chain(_SUM, self._product, conditions=False)

    def _product(self) -> _Term:
        return self._chain(_PRODUCT, self._signed, conditions=False)

    def _signed(self) -> _Term:
        return self._nested(self._signed_or_power)

    def _signed_or_power(self) -> _Term:
        sign = self.accept("-", "+")
        if sign:
            factor = _Term(lambda c: -1.0 if sign == "-" else 1.0)
            return self.combined(np.multiply, self._signed(), factor, conditions=False)
        term = self._atom()
        return self.combined(np.power, term, self._signed(), conditions=False) if self.accept("**") else term

    def _atom(self) -> _Term:
        if self.accept("("):
            term = self.disjunction()
            self._expect(")")
            return term
        if not self.unread:
            raise self._error(" ends where a number or a column is expected")
        kind, word = self._tokens[self._position]
        self._position += 1
        if kind == "number":
            number = float(word)
            return _Term(lambda c: number)
        if kind == "name" and word in FUNCTIONS and self.peek() == "(":
            return self._call(word)
        if kind == "sign":
            raise self._error(f": {word!r} where a number or a column is expected")
        name = f"{MODE}{word.upper()}" if kind == "mode" else word
        self.columns.append(name)
        return _Term(lambda c: c[name], kind == "mode")

    def _call(self, name: str) -> _Term:
        count, function = FUNCTIONS[name]
        self._expect("(")
        arguments = [self._sum()]
        while self.accept(","):
            arguments.append(self._sum())
        self._expect(")")
        if len(arguments) != count:
            raise self._error(f": {name} takes {count} arguments, not {len(arguments)}")
        if any(a.condition for a in arguments):
            raise self._error(": a condition stands where a number is expected")
        return _Term(lambda c: function(*(a.values(c) for a in arguments)))
