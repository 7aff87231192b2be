"""Dependences in a model: states that forces drive, and names that matter while some parameters are zero."""

import ast
from collections.abc import Collection, Iterable, Set

from estimation.errors import ModelError
from estimation.models.base import Model
from estimation.models.expressions import NUMBERS, parse


def force_states(model: Model, parameters: Collection[str] | None = None) -> tuple[str, ...]:
    """States whose rate depends on a parameter: forces and moments drive them, not kinematics alone.

    parameters: those that count, by default all of the model.
    """
    counted = set(model.parameter_names if parameters is None else parameters)

    return tuple(s for s in model.state_names if names_reached(model, [f"{s}_dot"]) & counted)


def driven_outputs(model: Model) -> frozenset[str]:
    """Outputs in which process noise shows: all but states that kinematics alone drives, such as attitude.

    Gusts and missing terms are forces and moments. Residuals of an attitude are coloured in calm air too, by the slow errors of
    the attitude filter, and a fit by filter error would take these for process noise.
    """
    kinematic = set(model.state_names) - set(force_states(model, model.free_names))
    return frozenset(o for o in model.output_names if o not in kinematic)


def require_states(model: Model, method: str) -> Model:
    """The model itself; ModelError where it has no states, which filters correct and frequency responses are of."""
    if not model.states:
        raise ModelError(
            f"model {model.name} has no states, so method {method} has no motion to work on; use method ml or ls"
        )
    return model


def names_used(model: Model, zero: Set[str]) -> frozenset[str]:
    """Names on which rates and outputs of `model` depend while the parameters `zero` are zero."""
    rates = [f"{s}_dot" for s in model.state_names]
    outputs = [n for o in model.output_names for n in (f"{o}_measured", o) if n in model.definitions or n == o]
    return names_reached(model, [*rates, *outputs], zero)


def names_reached(model: Model, symbols: Iterable[str], zero: Set[str] = frozenset()) -> frozenset[str]:
    """Names on which some symbols of a model depend, these included, while the parameters `zero` are zero."""
    pending, visited = list(symbols), set[str]()
    while pending:
        name = pending.pop()
        if name not in visited:
            visited.add(name)
            if name in model.definitions:
                pending += names_in_force(model.definitions[name], zero)
    return frozenset(visited)


def names_in_force(expression: str, zero: Set[str]) -> frozenset[str]:
    """Names on which an expression depends while those in `zero` are zero. Only products with and quotients of zero vanish; the
    names in a function's arguments always count."""
    names = _in_force(parse(expression), zero)
    return frozenset() if names is None else names


def _in_force(node: ast.AST, zero: Set[str]) -> frozenset[str] | None:
    """Names on which a part of an expression depends; None where the part is zero."""
    match node:
        case ast.Name(id=name):
            return None if name in zero else frozenset({name}) - set(NUMBERS)
        case ast.UnaryOp(operand=operand):
            return _in_force(operand, zero)
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            first, second = _in_force(left, zero), _in_force(right, zero)
            return None if first is None or second is None else first | second
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            first = _in_force(left, zero)
            return None if first is None else first | (_in_force(right, zero) or frozenset())
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            first, second = _in_force(left, zero), _in_force(right, zero)
            return None if first is None and second is None else (first or frozenset()) | (second or frozenset())
        case ast.Call(args=arguments):
            return _together(arguments, zero)
        case _:
            return _together(ast.iter_child_nodes(node), zero)


def _together(parts: Iterable[ast.AST], zero: Set[str]) -> frozenset[str]:
    return frozenset[str]().union(*(_in_force(part, zero) or frozenset() for part in parts))
