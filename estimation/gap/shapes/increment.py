"""An increment of a coefficient fitted by output error, tested on flights that were not in its fit, the gap it closes, and
plain formulas in place of its spline: the nearest ones, refitted.

The closed share is counted in energy of whitened residuals against simulated nulls. The plain gap also counts gusts and slow
errors of filters, beside which half a usual effect can disappear; whitened residuals weigh every frequency by its noise.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.estimators.normal_equations import pseudo_inverse
from estimation.gap.criteria import Criteria
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.fitting import fit
from estimation.gap.fit.noise import NoiseModel
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.shapes.places import ModelMotion, Place, spread_of
from estimation.gap.shapes.spline import KEPT, Range, curve_lines, lines, polynomial
from estimation.gap.significance.nulls import InputErrors, NullFlyer, Stream
from estimation.gap.significance.tangent import RecordTangent
from estimation.models.base import Model, Parameter

TAG = "form"
EDGES = ("low", "high", "middle", "half")
POINTS = 61  # of the curve in the answer
NULLS = 40  # for every record: enough for the upper end of their energy
REFITTED = 3  # formulas nearest to the spline
SHARES = (0.1, 0.2, 0.3, 0.45, 0.6)  # of the largest size flown: trial widths of a dead zone or a bend
SIZE, WIDTH = f"{TAG}_a", f"{TAG}_width"


@dataclass(frozen=True)
class Increment:
    """A part of a coefficient as a function of a variable over the range flown. reach: largest size of the second variable, the
    unit of that multiplier. spread: (columns,) prior standard deviations of the weights."""

    place: Place
    flown: Range
    reach: float
    spread: Array

    @classmethod
    def of(cls, place: Place, motion: ModelMotion) -> "Increment":
        reach = motion.reach(place.by) if place.by else 1.0
        return cls(place, motion.range_of(place.variable), reach, spread_of(place, motion.scale[place.line]))

    @property
    def weights(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return tuple(w for w in self.text_weights if w != "0")

    def edges(self, held: Range | None = None) -> dict[str, float]:
        """Values of the parameters that scale the variable and limit it to `held` (default: the range flown)."""
        ends = held or self.flown
        low, high = max(ends.low, self.flown.low), min(ends.high, self.flown.high)
        return dict(zip((f"{TAG}_{e}" for e in EDGES), (low, high, self.flown.middle, self.flown.half), strict=True))

    def added_to(self, model: Model) -> Model:
        """`model` with the increment, its unknowns at zero and with their priors."""
        text = list(lines(TAG, self.place.variable, self.text_weights))
        term = TAG
        edges = self.edges()
        if self.place.by:
            term, edges = f"{TAG}*{self.place.by}/{TAG}_reach", edges | {f"{TAG}_reach": self.reach}
        unknowns = [
            Parameter(n, "1", prior_mean=0.0, prior_std=float(s))
            for n, s in zip(self.weights, self.spread, strict=True)
        ]
        fixed = [Parameter(n, "1", start=v, fixed=True) for n, v in edges.items()]
        return model.plus(lines=text, terms={self.place.line: term}, parameters=[*unknowns, *fixed])

    @property
    def text_weights(self) -> tuple[str, ...]:
        """Factors of the columns in the text: of the spline, of u and of 1; "0" where there is no unknown."""
        line = f"{TAG}_line" if self.place.lacks_line else "0"
        constant = f"{TAG}_constant" if self.place.lacks_constant else "0"
        return (*(f"{TAG}_w{j}" for j in range(1, KEPT + 1)), line, constant)

    def columns(self, x: Array) -> Array:
        """(N, unknowns) at x (N,)."""
        return self.place.columns(np.clip(self.flown.scaled(x), -1.0, 1.0))

    def vector(self, values: Mapping[str, float]) -> Array:
        return np.array([values[n] for n in self.weights])

    def curve(self, model_fit: ModelFit) -> tuple[Array, Array, Array]:
        """(x, value, standard deviation), each (POINTS,), over the range flown, of a fit with this increment."""
        x = np.linspace(self.flown.low, self.flown.high, POINTS)
        columns = self.columns(x)
        indices = [model_fit.free.index(n) for n in self.weights]
        covariance = pseudo_inverse(model_fit.hessian)[0][np.ix_(indices, indices)]
        variance = np.einsum("ij,jk,ik->i", columns, covariance, columns)
        return x, columns @ self.vector(model_fit.values), np.sqrt(np.maximum(variance, 0.0))

    def written_into(self, model: Model, values: Mapping[str, float]) -> Model:
        """`model` with the curve in numbers, which a person can read and any simulation can adopt."""
        w = self.vector(values)
        rest = dict(zip(self.weights[KEPT:], w[KEPT:], strict=True))
        powers = polynomial(w[:KEPT], (rest.get(f"{TAG}_line", 0.0), rest.get(f"{TAG}_constant", 0.0)))
        name = f"{self.place.line}_nameless"
        text = curve_lines(name, self.place.variable, self.flown, powers)
        term = f"{name}*{self.place.by}/{self.reach:.17g}" if self.place.by else name
        return model.plus(lines=text, terms={self.place.line: term}, title=f"{model.title}, with a nameless part")


@dataclass(frozen=True)
class FittedIncrement:
    """An increment fitted with the base. gain: twice the log-likelihood over the base with the same noise."""

    increment: Increment
    problem: LikelihoodProblem
    fit: ModelFit
    gain: float


def fit_increment(baseline: Baseline, increment: Increment) -> FittedIncrement | None:
    """Base and increment fitted together on the training flights; None where that runs away."""
    problem = replace(baseline.problem, model=increment.added_to(baseline.model))
    model_fit = fit(problem, baseline.fit.values, baseline.fit.locals)
    if model_fit.diverged:
        return None
    return FittedIncrement(increment, problem, model_fit, 2.0 * (baseline.fit.cost - model_fit.cost))


# ---- flights left out
@dataclass(frozen=True)
class HoldoutPrediction:
    """A training flight predicted from the others. inside: share of it within their range. gain: twice the log-likelihood by
    which the increment, constant outside that range, predicts it better than the base."""

    flight: int
    inside: float
    gain: float


def holdout_predictions(baseline: Baseline, fitted: FittedIncrement, motion: ModelMotion) -> list[HoldoutPrediction]:
    """Every training flight predicted from the others, with and without the increment."""
    flights = [r.flight for r in baseline.problem.records]
    predictions = []
    for flight in dict.fromkeys(flights):
        training = [i for i, f in enumerate(flights) if f != flight]
        holdout = [i for i, f in enumerate(flights) if f == flight]
        if not training:
            continue
        variable = fitted.increment.place.variable
        limits = Range.of([motion.courses[i][variable] for i in training])
        share = float(np.mean([limits.inside(motion.courses[i][variable]) for i in holdout]))
        base_cost = holdout_cost(baseline.problem, baseline.fit, training, holdout, {})
        increment_cost = holdout_cost(fitted.problem, fitted.fit, training, holdout, fitted.increment.edges(limits))
        if increment_cost is None:
            gain = -np.inf
        else:
            gain = np.inf if base_cost is None else 2.0 * (base_cost - increment_cost)
        predictions.append(HoldoutPrediction(flight, share, float(gain)))
    return predictions


def holdout_cost(
    problem: LikelihoodProblem,
    model_fit: ModelFit,
    training: Sequence[int],
    holdout: Sequence[int],
    edges: Mapping[str, float],
) -> float | None:
    """Whitened cost of the records `holdout` with the parameters fitted to `training`; None where the motion runs away."""
    trained = fit(of_records(problem, training), model_fit.values, [model_fit.locals[i] for i in training])
    if trained.diverged:
        return None
    starts = [model_fit.locals[i] for i in holdout]
    tested = fit(of_records(problem, holdout), {**trained.values, **edges}, starts, frozen=True)
    return None if tested.diverged else tested.cost


def of_records(problem: LikelihoodProblem, records: Sequence[int]) -> LikelihoodProblem:
    """The problem with some of its records."""
    return replace(
        problem,
        records=tuple(problem.records[i] for i in records),
        whiteners=tuple(problem.whiteners[i] for i in records),
    )


def predicts_every_flight(predictions: Sequence[HoldoutPrediction], criteria: Criteria) -> bool:
    """Whether there are flights within the range of the others, and each of them is predicted better."""
    testable = [f for f in predictions if f.inside >= criteria.halfway]
    return bool(testable) and all(f.gain > 0.0 for f in testable)


# ---- the gap it closes
def closed(before: float, after: float, floor: float) -> float:
    """Closed share, 0 to 1, of the part above the floor; 0 where there was none."""
    if before <= floor:
        return 0.0
    return float(np.clip(1.0 - (after - floor) / (before - floor), 0.0, 1.0))


def holdout_energy(problem: LikelihoodProblem, model_fit: ModelFit, baseline: Baseline, noise: NoiseModel) -> float:
    """Whitened energy of a fitted model on the held-out flights with frozen shared parameters; on the training flights where
    there are none. problem, model_fit: on the training flights; noise: of the whitening."""
    held_out = replace(baseline, problem=problem, fit=model_fit, noise=noise).held_out
    return 2.0 * (model_fit.cost if held_out is None else held_out[1].cost)


def floor_energy(child: Baseline, errors: Sequence[InputErrors], seed: int) -> float:
    """The same energy with nothing hidden: upper end over simulated nulls of the model. errors: of every record, training first.

    The upper end, not the middle: the weather of one day and the surfaces of one flight are not average.
    """
    training = len(child.problem.records)
    problem, model_fit = child.held_out or (child.problem, child.fit)
    record_errors = errors[:training] if child.held_out is None else errors[len(errors) - len(problem.records) :]
    flyer = NullFlyer.build(problem, model_fit, child.noise, record_errors)
    total = np.zeros(NULLS)
    for i in range(len(problem.records)):
        tangent = RecordTangent.of(problem, model_fit, i, flyer.residuals(i, Stream.CLOSURE_NULLS, seed, NULLS))
        total += tangent.squares(tangent.fixed)[-NULLS:]
    return float(np.quantile(total, problem.criteria.null_level))


def refitted_with(
    problem: LikelihoodProblem, model_fit: ModelFit, child: Baseline
) -> tuple[LikelihoodProblem, ModelFit]:
    """A model refitted to the training flights with the noise of another."""
    reweighted = LikelihoodProblem(
        problem.model, problem.base, child.problem.records, child.problem.whiteners, problem.criteria
    )
    return reweighted, fit(reweighted, model_fit.values, model_fit.locals)


# ---- plain formulas in its place
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
    """The formulas nearest to a spline at the samples flown, refitted."""
    increment = fitted.increment
    x = np.concatenate([c[increment.place.variable] for c in motion.courses])
    sketches = regressed(x, increment.columns(x) @ increment.vector(fitted.fit.values), increment)
    formulas = [refitted(baseline, increment, s) for s in sketches[:REFITTED]]
    return [p for p in formulas if p is not None]
