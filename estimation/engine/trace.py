"""CasADi functions of (x, u, p) from the text of a model: rates and outputs with their exact Jacobians.

p holds the model's parameters, then its constants (in the order of `ModelStructure.remaining_constants`), so that a changed mass
or a fixed parameter needs no new trace; only parameters have derivatives. Jacobians are sparse; `Traced` has their patterns.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca

from estimation.errors import ModelError
from estimation.models.expressions import evaluate, names_in
from estimation.models.parts import ModelStructure

Pattern = tuple[tuple[int, ...], tuple[int, ...]]  # rows, columns of the non-zeros


def _tan(angle: Any) -> Any:
    """By sine and cosine, which the equations of motion mostly contain anyway and which together cost as much as a tangent."""
    return ca.sin(angle) / ca.cos(angle)


CASADI_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "sin": ca.sin, "cos": ca.cos, "tan": _tan, "asin": ca.asin, "acos": ca.acos, "atan": ca.atan,
    "atan2": ca.atan2, "sinh": ca.sinh, "cosh": ca.cosh, "tanh": ca.tanh, "sqrt": ca.sqrt, "exp": ca.exp,
    "log": ca.log, "abs": ca.fabs, "sign": ca.sign, "min": ca.fmin, "max": ca.fmax, "where": ca.if_else,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Traced:
    """Functions of one model structure; see the module head for (x, u, p).

    rates: -> f. rates_jacobian: -> f, non-zeros of df/dx, df/dp. rates_by_input: -> non-zeros of df/du, which only input
    transforms need. rates_by_all: -> f, non-zeros of df/dx, df/dp, df/du, with common terms computed once. outputs,
    outputs_jacobian, outputs_by_input, outputs_by_all: the same of y. patterns: the six sparsity patterns, "f_x" "f_u" "f_p"
    "y_x" "y_u" "y_p".
    """

    rates: ca.Function
    rates_jacobian: ca.Function
    rates_by_input: ca.Function
    rates_by_all: ca.Function
    outputs: ca.Function
    outputs_jacobian: ca.Function
    outputs_by_input: ca.Function
    outputs_by_all: ca.Function
    patterns: Mapping[str, Pattern]
    sizes: tuple[int, int, int, int]  # states, inputs, parameters with constants, outputs


@lru_cache(maxsize=256)
def trace(structure: ModelStructure) -> Traced:
    """CasADi functions of a model; the same object for every model of equal structure."""
    kinds = (structure.states, structure.inputs, structure.parameters, structure.remaining_constants)
    x, u, t, c = (ca.SX.sym(k, len(v)) for k, v in zip("xutc", kinds, strict=True))
    p = ca.vertcat(t, c)
    symbols: dict[str, Any] = {}
    for vector, names in zip((x, u, t, c), kinds, strict=True):
        symbols |= {name: vector[i] for i, name in enumerate(names)}
    definitions = structure.definitions

    def resolve(name: str) -> Any:
        if name not in symbols:
            for dependency in names_in(definitions[name]):
                resolve(dependency)
            try:
                symbols[name] = evaluate(definitions[name], symbols, CASADI_FUNCTIONS)
            except ArithmeticError as error:
                raise ModelError(f"the line of {name!r} cannot be calculated: {error}") from error
        return symbols[name]

    f = ca.vertcat(*(resolve(f"{s}_dot") for s in structure.states))
    output_symbols = (f"{o}_measured" if f"{o}_measured" in definitions else o for o in structure.outputs)
    y = ca.vertcat(*(resolve(name) for name in output_symbols))
    patterns: dict[str, Pattern] = {}
    jacobians: dict[str, Any] = {}
    for key, value in (("f", f), ("y", y)):
        for letter, vector in (("x", x), ("u", u), ("p", t)):
            matrix = ca.jacobian(value, vector)
            rows, columns = matrix.sparsity().get_triplet()
            patterns[f"{key}_{letter}"] = (tuple(rows), tuple(columns))
            jacobians[f"{key}_{letter}"] = _nonzeros(matrix)

    def function(name: str, *results: Any) -> ca.Function:
        return ca.Function(name, [x, u, p], ca.cse(list(results)))

    return Traced(
        rates=function("rates", f),
        rates_jacobian=function("rates_jacobian", f, jacobians["f_x"], jacobians["f_p"]),
        rates_by_input=function("rates_by_input", jacobians["f_u"]),
        rates_by_all=function("rates_by_all", f, jacobians["f_x"], jacobians["f_p"], jacobians["f_u"]),
        outputs=function("outputs", y),
        outputs_jacobian=function("outputs_jacobian", y, jacobians["y_x"], jacobians["y_p"]),
        outputs_by_input=function("outputs_by_input", jacobians["y_u"]),
        outputs_by_all=function("outputs_by_all", y, jacobians["y_x"], jacobians["y_p"], jacobians["y_u"]),
        patterns=patterns,
        sizes=structure.sizes,
    )


def rk4(
    rates: Callable[..., tuple[Any, ...]], states: tuple[Any, ...], inputs: Sequence[Any], h: Any
) -> tuple[Any, ...]:
    """The states after one classical Runge-Kutta step `h`. rates: of (states, inputs); inputs: at its begin, middle and end."""

    def ahead(slopes: tuple[Any, ...], step: Any) -> tuple[Any, ...]:
        return tuple(x + step * k for x, k in zip(states, slopes, strict=True))

    k1 = rates(states, inputs[0])
    k2 = rates(ahead(k1, h / 2), inputs[1])
    k3 = rates(ahead(k2, h / 2), inputs[1])
    k4 = rates(ahead(k3, h), inputs[2])
    return tuple(x + h / 6 * (a + 2 * b + 2 * c + d) for x, a, b, c, d in zip(states, k1, k2, k3, k4, strict=True))


def _nonzeros(matrix: ca.SX) -> ca.SX:
    nonzeros = matrix.nonzeros()
    return ca.vertcat(*nonzeros) if nonzeros else ca.SX(0, 1)  # type: ignore[call-overload]


def hoist_inputs(function: ca.Function, sizes: tuple[int, int, int, int]) -> tuple[ca.Function, ca.Function]:
    """A function of (x, u, p) as one of (x, u, p, h), and h as a function of (u, p): terms that do not change with the state from
    stage to stage, such as sines of measured angles and dynamic pressure."""
    x, u, p = (ca.SX.sym(name, size) for name, size in zip("xup", sizes[:3], strict=True))
    parameters: Any = ca.vertcat(u, p)
    results, names, values = ca.extract_parametric(function.call([x, u, p]), parameters, {"extract_trivial": False})
    h, hoisted_values = (ca.vertcat(*v) if v else ca.SX(0, 1) for v in (names, values))
    return (
        ca.Function(function.name(), [x, u, p, h], ca.cse(results)),
        ca.Function(f"{function.name()}_before", [u, p], ca.cse([hoisted_values])),
    )
