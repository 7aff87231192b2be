"""What of a model depends on what: states that forces drive, names in force while some parameters are held at zero."""

import ast
from collections.abc import Collection, Iterable, Set

from estimation.errors import ModelError
from estimation.models.base import Model
from estimation.models.expressions import NUMBERS, names_in, parse


def force_states(model: Model, parameters: Collection[str] | None = None) -> tuple[str, ...]:
    """States whose rate depends on a parameter: forces and moments act there, not in mere kinematics.

    parameters: those that count; by default all of the model's.
    """
    counted = set(model.parameter_names if parameters is None else parameters)

    def reach(symbol: str, visited: set[str]) -> set[str]:
        for name in names_in(model.definitions[symbol]) if symbol in model.definitions else ():
            if name not in visited:
                visited.add(name)
                reach(name, visited)
        return visited

    return tuple(s for s in model.state_names if reach(f"{s}_dot", set()) & counted)


def driven_outputs(model: Model) -> frozenset[str]:
    """Outputs in which process noise shows: all but states that only kinematics moves, such as attitude.

    Gusts and missing terms are forces and moments. Residuals of an attitude are coloured in any air, by the slow errors of the
    filter that it comes from, which a filter error takes up as gladly.
    """
    kinematic = set(model.state_names) - set(force_states(model, model.free_names))
    return frozenset(o for o in model.output_names if o not in kinematic)


def require_states(model: Model, method: str) -> Model:
    """The model. ModelError where it has no states: what a filter corrects, or a frequency response belongs to, is not there."""
    if not model.states:
        raise ModelError(
            f"model {model.name} has no states, so method {method} has no motion to work on; use method ml or ls"
        )
    return model


def asked_for(model: Model, zero: Set[str]) -> frozenset[str]:
    """Names that rates and outputs of `model` reach with the parameters `zero` held at nothing."""
    definitions = model.definitions
    pending = [f"{s}_dot" for s in model.state_names]
    pending += [n for o in model.output_names for n in (f"{o}_measured", o) if n in definitions or n == o]
    visited: set[str] = set()
    while pending:
        name = pending.pop()
        if name not in visited:
            visited.add(name)
            if name in definitions:
                pending += names_in_force(definitions[name], zero)
    return frozenset(visited)


def names_in_force(expression: str, zero: Set[str]) -> frozenset[str]:
    """Names an expression asks for where those in `zero` are nothing. A term is left out only where it is zero times something
    or zero over something; a function of zero counts as if it were not."""
    names = _in_force(parse(expression), zero)
    return frozenset() if names is None else names


def _in_force(node: ast.AST, zero: Set[str]) -> frozenset[str] | None:
    """Names of a part, or None where it is zero."""
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
