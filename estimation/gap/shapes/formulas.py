"""Plain formulas in place of a spline: the nearest ones, refitted by output error."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.fitting import fit
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.shapes.increment import TAG, FittedIncrement, Increment
from estimation.gap.shapes.places import ModelMotion
from estimation.models.base import Parameter

REFITTED = 3  # formulas nearest to the spline
SHARES = (0.1, 0.2, 0.3, 0.45, 0.6)  # of the largest size flown: trial widths of a dead zone or a bend
SIZE, WIDTH = f"{TAG}_a", f"{TAG}_width"


@dataclass(frozen=True)
class Formula:
    """A function of one variable. text: with {x} and, where it has a width, {w}; value: of x and the width."""

    text: str
    value: Callable[[Array, float], Array]
    wide: bool = False

    def written(self, variable: str, width: str = "w") -> str:
        return self.text.format(x=variable, w=width)


FORMULAS = (
    Formula("{x}", lambda x, w: x),
    Formula("{x}^2", lambda x, w: x**2),
    Formula("abs({x})", lambda x, w: np.abs(x)),
    Formula("{x}*abs({x})", lambda x, w: x * np.abs(x)),
    Formula("{x}^3", lambda x, w: x**3),
    Formula("{x}^4", lambda x, w: x**4),
    Formula("sign({x})*max(abs({x}) - {w}, 0)", lambda x, w: np.sign(x) * np.maximum(np.abs(x) - w, 0.0), wide=True),
    Formula("tanh({x}/{w})", lambda x, w: np.tanh(x / w), wide=True),
)


@dataclass(frozen=True)
class Sketch:
    """A formula regressed on a spline. missed: share of the spline's variance at the samples flown that it does not explain."""

    formula: Formula
    width: float
    size: float
    missed: float


def sketched(fitted: FittedIncrement, motion: ModelMotion) -> list[Sketch]:
    """Every formula regressed on the spline at the samples flown, best first."""
    increment = fitted.increment
    x = np.concatenate([c[increment.place.variable] for c in motion.courses])
    target = increment.columns(x) @ increment.vector(fitted.fit.values)
    return regressed(x, target, increment)


def regressed(x: Array, target: Array, increment: Increment) -> list[Sketch]:
    """Formulas regressed on a curve `target` (N,) at the samples x (N,), best first; without constant and line where the base has
    them."""
    place = increment.place
    free = [c for c, lacking in ((x, place.lacks_line), (np.ones_like(x), place.lacks_constant)) if not lacking]
    base = np.column_stack(free) if free else np.zeros((x.size, 0))
    remainder = _without(target, base)
    total = max(float(remainder @ remainder), np.finfo(float).tiny)
    sketches = []
    for formula in FORMULAS:
        closest: Sketch | None = None
        for width in (s * float(np.abs(x).max()) for s in (SHARES if formula.wide else (1.0,))):
            column = _without(formula.value(x, width), base)
            length = float(column @ column)
            if length <= np.finfo(float).eps * float(np.sum(formula.value(x, width) ** 2)):
                continue  # the base has it
            size = float(column @ remainder) / length
            sketch = Sketch(formula, width, size, float(np.sum((remainder - size * column) ** 2)) / total)
            closest = sketch if closest is None or sketch.missed < closest.missed else closest
        if closest is not None:
            sketches.append(closest)
    return sorted(sketches, key=lambda s: s.missed)


def _without(values: Array, base: Array) -> Array:
    """(N,) residual of `values` after regression on the columns of `base`."""
    return values - base @ np.linalg.lstsq(base, values, rcond=None)[0] if base.shape[1] else values


@dataclass(frozen=True)
class Plain:
    """A formula refitted by output error. estimates: its unknowns with bounds; gain: twice the log-likelihood over the base with
    the same noise."""

    text: str
    estimates: Mapping[str, tuple[float, float]]
    problem: LikelihoodProblem
    fit: ModelFit
    gain: float


def refitted(baseline: Baseline, increment: Increment, sketch: Sketch) -> Plain | None:
    """Base and formula fitted together; None where that runs away. The size has no prior, the width stays in the range flown."""
    place = increment.place
    widest = max(abs(increment.flown.low), abs(increment.flown.high))
    unknowns = [Parameter(SIZE, "1", start=sketch.size)]
    if sketch.formula.wide:
        unknowns.append(Parameter(WIDTH, "1", start=sketch.width, lower=SHARES[0] ** 2 * widest, upper=widest))
    term = f"{SIZE}*({sketch.formula.written(place.variable, WIDTH)})"
    term += f"*{place.by}/{increment.reach:.17g}" if place.by else ""
    model = baseline.model.plus(terms={place.line: term}, parameters=unknowns)
    problem = replace(baseline.problem, model=model)
    model_fit = fit(problem, {**baseline.fit.values, SIZE: sketch.size, WIDTH: sketch.width}, baseline.fit.locals)
    if model_fit.diverged:
        return None
    std = model_fit.std()
    names = {"a": SIZE} | ({"w": WIDTH} if sketch.formula.wide else {})
    scale = {"a": 1.0 / increment.reach, "w": 1.0}
    estimates = {
        n: (float(model_fit.values[p]) * scale[n], float(std.get(p, np.inf)) * scale[n]) for n, p in names.items()
    }
    text = f"a*{sketch.formula.written(place.variable)}" + (f"*{place.by}" if place.by else "")
    return Plain(text, estimates, problem, model_fit, 2.0 * (baseline.fit.cost - model_fit.cost))


def plain_formulas(baseline: Baseline, fitted: FittedIncrement, motion: ModelMotion) -> list[Plain]:
    """The formulas nearest to a spline, refitted."""
    formulas = [refitted(baseline, fitted.increment, s) for s in sketched(fitted, motion)[:REFITTED]]
    return [p for p in formulas if p is not None]
