"""Check of a model: every name defined once, no circular definitions, finite numbers."""

import math
from collections.abc import Mapping

from daq.utilities import limits
from estimation.errors import ModelError
from estimation.models.expressions import check_name, names_in, split_line
from estimation.models.parts import TRANSFORM_KINDS, ModelParts


def check_model(model: ModelParts) -> None:
    """Raise ModelError naming the first thing that does not fit."""
    prefix = f"model {model.name}"
    symbols: dict[str, str] = {}
    for kind, names in (
        ("state", model.state_names),
        ("input", model.input_names),
        ("parameter", model.parameter_names),
    ):
        for name in names:
            check_name(name, f"{prefix}: {kind}")
            if name in symbols:
                raise ModelError(f"{prefix}: {name!r} is both {symbols[name]} and {kind}")
            symbols[name] = kind
    if len(set(model.output_names)) < len(model.output_names):
        repeated = next(n for n in model.output_names if model.output_names.count(n) > 1)
        raise ModelError(f"{prefix}: output {repeated!r} is listed twice")
    lines = [split_line(line) for line in model.equations]
    defined: set[str] = set()
    for symbol, _ in lines:
        if symbol in defined or symbol in symbols:
            raise ModelError(f"{prefix}: {symbol!r} is defined twice ({symbols.get(symbol, 'equation')} and equation)")
        defined.add(symbol)
    for state in model.state_names:
        if f"{state}_dot" not in defined:
            raise ModelError(f"{prefix}: state {state!r} has no line '{state}_dot = ...'")
    defined_names = defined | set(symbols) | set(model.constants)
    for output in model.output_names:
        if output not in defined_names and f"{output}_measured" not in defined:
            raise ModelError(f"{prefix}: output {output!r} has no line '{output} = ...'")
    for symbol, expression in lines:
        for name in sorted(names_in(expression) - defined_names):
            raise ModelError(f"{prefix}: {name!r} in the line of {symbol!r} is defined nowhere")
    if not model.outputs:
        raise ModelError(f"{prefix}: at least one output is needed")
    _check_circles(model, dict(lines))
    _check_parameters(model)
    _check_transforms(model)


def _check_circles(model: ModelParts, definitions: Mapping[str, str]) -> None:
    """ModelError where an equation uses itself, directly or through others, or through more than limits.MODEL_DEPTH others.

    Not recursive: a hostile file could otherwise exhaust the stack.
    """
    if len(definitions) > limits.MODEL_LINES:
        raise ModelError(f"model {model.name}: {len(definitions)} equations; at most {limits.MODEL_LINES} are taken")
    uses = {s: sorted(names_in(text) & definitions.keys()) for s, text in definitions.items()}
    depth: dict[str, int] = {}
    for first in definitions:
        path, unvisited = [first], [iter(uses[first])]  # from `first` down, and what each still uses
        while path:
            symbol = next(unvisited[-1], None) if path[-1] not in depth else None
            if symbol is None:
                finished = path.pop()
                unvisited.pop()
                depth.setdefault(finished, 1 + max((depth[u] for u in uses[finished]), default=0))
            elif symbol in path:
                raise ModelError(
                    f"model {model.name}: definitions run in a circle: {' -> '.join((*path[-10:], symbol))}"
                )
            elif symbol not in depth:
                path.append(symbol)
                unvisited.append(iter(uses[symbol]))
    deepest = max(depth, key=lambda s: depth[s], default="")
    if deepest and depth[deepest] > limits.MODEL_DEPTH:
        raise ModelError(
            f"model {model.name}: {deepest} uses others in a chain of {depth[deepest]}; at most {limits.MODEL_DEPTH} are followed"
        )


def _check_parameters(model: ModelParts) -> None:
    """ModelError for start values outside their limits or not finite, and for incomplete priors."""
    for p in model.parameters:
        prefix = f"model {model.name}: parameter {p.name}"
        if not p.lower <= p.start <= p.upper:
            raise ModelError(f"{prefix}: start {p.start} lies outside its limits {p.lower} .. {p.upper}")
        if not math.isfinite(p.start):
            raise ModelError(f"{prefix}: start {p.start} is not a finite number")
        if (p.prior_mean is None) != (p.prior_std is None) or (p.prior_std is not None and not p.prior_std > 0):
            raise ModelError(f"{prefix}: a prior needs a mean and a standard deviation greater than zero")


def _check_transforms(model: ModelParts) -> None:
    """ModelError for an unknown kind, input, output or parameter of transforms and delays."""
    for t in model.transforms:
        prefix = f"model {model.name}: transform {t.kind} of {t.input}"
        if t.kind not in TRANSFORM_KINDS:
            raise ModelError(f"{prefix}: no such kind; known are {', '.join(TRANSFORM_KINDS)}")
        if t.input not in model.input_names:
            raise ModelError(f"{prefix}: the model has no such input")
        if len(t.parameters) != TRANSFORM_KINDS[t.kind]:
            raise ModelError(f"{prefix}: {TRANSFORM_KINDS[t.kind]} parameter(s) needed, {len(t.parameters)} given")
        for name in t.parameters:
            model.parameter(name)
    for output, name in model.output_delays.items():
        if output not in model.output_names:
            raise ModelError(f"model {model.name}: delay on {output!r}, which is no output")
        model.parameter(name)
