"""Equation text as data: parsed by a whitelist, never evaluated as code.

A line is `name = expression`. An expression may hold + - * / ** (or ^), unary minus, numbers, names, and the functions of
`FUNCTIONS`; a comparison may be the first argument of `where`. Everything else is refused with a sentence, so a stranger's
model file can do nothing but arithmetic.
"""

import ast
import re
import warnings
from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import pairwise
from typing import Any

from estimation.errors import ModelError

FUNCTIONS: Mapping[str, int] = {
    "sin": 1, "cos": 1, "tan": 1, "asin": 1, "acos": 1, "atan": 1, "atan2": 2,
    "sinh": 1, "cosh": 1, "tanh": 1, "sqrt": 1, "exp": 1, "log": 1, "abs": 1, "sign": 1,
    "min": 2, "max": 2, "where": 3,
}  # fmt: skip
"""Function name -> number of arguments."""

NUMBERS: Mapping[str, float] = {"pi": 3.141592653589793}
LARGEST = 1e100  # number in an equation
LONGEST = 4000  # characters in one expression; longer text is no equation of motion
DEEPEST = 200  # nested operations; reading the tree takes some of Python's thousand stack frames for each

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
_BINARY = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
_COMPARE = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}


def check_name(name: str, kind: str) -> str:
    """`name` if an equation may use it; ModelError otherwise."""
    if not _NAME.match(name) or name in FUNCTIONS or name in NUMBERS:
        raise ModelError(
            f"{kind} {name!r}: use letters, digits and _, not beginning with a digit, and no function's name"
        )
    return name


def split_line(line: str) -> tuple[str, str]:
    """(`name`, `expression`) of an equation line."""
    name, sign, right = line.partition("=")
    if not sign or not right.strip() or right.lstrip().startswith("="):
        raise ModelError(f"equation {line.strip()!r}: write it as 'name = expression'")
    return check_name(name.strip(), f"left side of {line.strip()!r}:"), right.strip()


@lru_cache(maxsize=4096)
def parse(expression: str) -> ast.expr:
    """Syntax tree of an expression, every node checked against the whitelist.

    Raises ModelError naming the first thing that is not allowed.
    """
    if len(expression) > LONGEST:
        raise ModelError(f"expression of {len(expression)} characters: the limit is {LONGEST}; use intermediate lines")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's parser warns of syntax that is refused below anyway
            tree = ast.parse(expression.replace("^", "**").strip(), mode="eval").body
        _check(tree, expression)
        _check_depth(tree, expression)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ModelError(f"expression {_short(expression)}: cannot be read ({error})") from error
    return tree


@lru_cache(maxsize=4096)
def names_in(expression: str) -> frozenset[str]:
    """Names an expression refers to, without functions and pi."""
    functions = {
        n.func.id for n in ast.walk(parse(expression)) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)
    }
    names = {n.id for n in ast.walk(parse(expression)) if isinstance(n, ast.Name)}
    return frozenset(names - functions - set(NUMBERS))


@lru_cache(maxsize=4096)
def products_in(expression: str, constants: frozenset[str] = frozenset()) -> tuple[frozenset[str], ...]:
    """The names of every product of an expression that has no sum inside, but for sums of `constants` alone."""
    products = []
    for node in ast.walk(parse(expression)):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
            sums = (n for n in ast.walk(node) if isinstance(n, ast.BinOp) and isinstance(n.op, ast.Add | ast.Sub))
            if all(_names(n) <= constants for n in sums):
                products.append(_names(node))
    return tuple(products)


def _names(node: ast.AST) -> frozenset[str]:
    return frozenset(n.id for n in ast.walk(node) if isinstance(n, ast.Name))


def addends_in(expression: str) -> tuple[str, ...]:
    """The addends of a sum, each with its sign: `a - b*c + d` gives `a`, ` - b*c`, ` + d`."""
    spaced = " ".join(expression.replace("^", "**").split())
    node, text = parse(spaced), spaced.encode()  # the tree counts in bytes
    end, cuts = len(text), [len(text)]
    while isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
        if b")" in text[node.end_col_offset : end]:  # a sum in brackets is one addend
            break
        begin = node.left.end_col_offset or 0
        end = begin + next(i for i, sign in enumerate(text[begin:]) if sign in b"+-")
        cuts.append(len(text[:end].rstrip()))
        node = node.left
    return tuple(text[start:stop].decode() for start, stop in pairwise([0, *reversed(cuts)]))


def without_addends_of(expression: str, name: str) -> str:
    """The sum without the addends that contain a name; 0 where all of them do."""
    remainder = "".join(addend for addend in addends_in(expression) if name not in names_in(addend))
    return remainder.strip().removeprefix("+").lstrip() or "0"


def evaluate(expression: str, symbols: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]) -> Any:
    """Value of an expression, a number, an array or a CasADi expression as `symbols` and `functions` are."""
    return _value(parse(expression), symbols, functions)


def _check(node: ast.AST, text: str) -> None:
    """ModelError for a node that is not on the whitelist."""
    match node:
        case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
            if not abs(value) <= LARGEST:
                raise ModelError(f"expression {_short(text)}: {value} is no number to calculate with")
            return
        case ast.Name(id=name) if name in FUNCTIONS:
            raise ModelError(f"expression {_short(text)}: {name} is a function; write it with its arguments")
        case ast.Name():
            return
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            _check(operand, text)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            _check(left, text)
            _check(right, text)
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
            _check_call(name, arguments, text)
        case ast.Call(func=ast.Name(id=name)):
            raise ModelError(f"expression {_short(text)}: no function {name!r}; known are {', '.join(FUNCTIONS)}")
        case _:
            raise ModelError(f"expression {_short(text)}: only arithmetic is allowed, not {type(node).__name__}")


def _check_depth(tree: ast.AST, text: str) -> None:
    level: list[ast.AST] = [tree]
    for _ in range(DEEPEST):
        level = [inner for node in level for inner in ast.iter_child_nodes(node)]
        if not level:
            return
    raise ModelError(
        f"expression {_short(text)}: more than {DEEPEST} operations within one another; use intermediate lines"
    )


def _check_call(name: str, arguments: list[ast.expr], text: str) -> None:
    """ModelError for a call with the wrong arguments; only `where` takes a comparison."""
    if len(arguments) != FUNCTIONS[name]:
        raise ModelError(f"expression {_short(text)}: {name} takes {FUNCTIONS[name]} arguments, not {len(arguments)}")
    values = arguments
    if name == "where":
        condition, *values = arguments
        match condition:
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _COMPARE:
                _check(left, text)
                _check(right, text)
            case _:
                raise ModelError(f"expression {_short(text)}: where(a < b, value, other) needs one comparison first")
    for argument in values:
        _check(argument, text)


def _value(node: ast.AST, symbols: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]) -> Any:
    """Value of a checked node."""
    match node:
        case ast.Constant(value=value):
            return float(value)  # type: ignore[arg-type]
        case ast.Name(id=name):
            return NUMBERS[name] if name in NUMBERS else symbols[name]
        case ast.UnaryOp(op=op, operand=operand):
            inner = _value(operand, symbols, functions)
            return -inner if isinstance(op, ast.USub) else inner
        case ast.BinOp(left=left, op=op, right=right):
            return _arithmetic(_BINARY[type(op)], _value(left, symbols, functions), _value(right, symbols, functions))
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            a, b = _value(left, symbols, functions), _value(right, symbols, functions)
            return _comparison(_COMPARE[type(op)], a, b)
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return functions[name](*(_value(argument, symbols, functions) for argument in arguments))
    raise ModelError(f"expression holds {type(node).__name__}, which is not arithmetic")


def _arithmetic(operator: str, a: Any, b: Any) -> Any:
    if isinstance(a, float) and isinstance(b, float):
        return _of_numbers(operator, a, b)
    return _of_symbols(operator, a, b)


def _of_numbers(operator: str, a: float, b: float) -> float:
    """`_of_symbols` of two floats; ModelError where the value is no finite real number that Python can compute."""
    try:
        value = _of_symbols(operator, a, b)
    except (OverflowError, ZeroDivisionError):
        value = None
    if not isinstance(value, float):  # a complex root of a negative number
        raise ModelError(f"{a:g} {operator} {b:g} in an equation: that is no number to calculate with")
    return value


def _of_symbols(operator: str, a: Any, b: Any) -> Any:
    match operator:
        case "+":
            return a + b
        case "-":
            return a - b
        case "*":
            return a * b
        case "/":
            return a / b
    # squares and cubes as products: their derivatives are exact at zero, and they are faster than pow()
    if isinstance(b, float) and b in (2.0, 3.0):
        return a * a if b == 2.0 else a * a * a
    return a**b


def _comparison(operator: str, a: Any, b: Any) -> Any:
    return {"<": lambda: a < b, "<=": lambda: a <= b, ">": lambda: a > b, ">=": lambda: a >= b}[operator]()


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")
