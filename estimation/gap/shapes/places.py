"""Where an unknown part of the model may sit: coefficient by variable, read from the model's own equations; and which of these
places would explain what is left, by linear theory, against simulated nulls."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.estimators.normal_equations import solved
from estimation.gap.criteria import Criteria
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.shapes.spline import Range, basis
from estimation.gap.significance.calibration import Round, significant_above
from estimation.gap.significance.screen import Projected, gram_of
from estimation.gap.significance.tangent import responses
from estimation.models.base import Model, ParameterRole, Signal
from estimation.models.expressions import names_in, products_in

INCREMENT = "increment_{}"
EXTRA_INPUTS = ("alpha",)  # an input that no term of the model has, yet coefficients depend on
EXTRA_STATES = ("alpha", "V")
# that drive what can move in the airframe, where a model has them
ACCELERATIONS = ("ax", "ay", "az", "p_dot", "q_dot", "r_dot")
FLOWN = 1e-9  # of anything: a smaller range is none
NOTHING = 1e-300  # keeps a gain of nothing on the nulls from dividing by zero


@dataclass(frozen=True)
class Place:
    """A coefficient and the variable of which a part of it is a function. by: a second variable that multiplies it.

    lacks_line, lacks_constant: the base has no parameter that carries a line in the variable (a constant), so that the increment
    has to.
    """

    line: str
    variable: str
    lacks_line: bool
    lacks_constant: bool
    by: str = ""

    @property
    def extra(self) -> int:
        """Columns beside those of the spline."""
        return int(self.lacks_line) + int(self.lacks_constant)

    @property
    def words(self) -> str:
        return f"{self.line} by {self.variable}" + (f" times {self.by}" if self.by else "")


def coefficient_lines(model: Model) -> tuple[str, ...]:
    """Lines that hold derivatives of the aircraft: its coefficients, or its rates where the model names none."""
    parameters = {p.name for p in model.parameters if p.role in (ParameterRole.DERIVATIVE, ParameterRole.CONSTANT)}
    return tuple(
        line
        for line, text in model.definitions.items()
        if names_in(text) & parameters and not line.endswith("_measured") and line not in model.output_names
    )


def variables_of(model: Model, lines: Sequence[str]) -> tuple[str, ...]:
    """What the coefficients' own terms multiply, angle of attack, and airspeed where it is a state."""
    fixed_names = {*model.parameter_names, *model.constants, *lines}
    signals = {*model.state_names, *model.input_names, *model.definitions}
    factors = [n for line in lines for product in products_in(model.definitions[line]) for n in sorted(product)]
    variables = [n for n in dict.fromkeys(factors) if n in signals and n not in fixed_names]
    extras = [n for n in EXTRA_STATES if n in model.state_names] + [n for n in EXTRA_INPUTS if n in model.input_names]
    return tuple(dict.fromkeys([*variables, *extras]))


def places_of(model: Model) -> tuple[Place, ...]:
    """Every coefficient by every variable."""
    lines = coefficient_lines(model)
    variables = variables_of(model, lines)
    return tuple(_place(model, line, v) for line in lines for v in variables)


def products_of(model: Model) -> tuple[Place, ...]:
    """Every coefficient by a function of one variable times another."""
    lines = coefficient_lines(model)
    variables = variables_of(model, lines)
    return tuple(
        _place(model, line, v, multiplier)
        for line in lines
        for v in variables
        for multiplier in variables
        if v != multiplier
    )


def _place(model: Model, line: str, variable: str, by: str = "") -> Place:
    """Constant and line of a one-variable increment are the base's own constant and derivative, where it has them free; of a
    product the constant is the derivative by the second variable."""
    free = set(model.free_names)
    terms = products_in(model.definitions[line])
    linear_terms = [product - free for product in terms if len(product & free) == 1]
    single = bool((names_in(model.definitions[line]) - frozenset().union(*terms)) & free)
    linear_names = {n for product in linear_terms if len(product) == 1 for n in product}
    if by:
        return Place(line, variable, True, by not in linear_names, by)
    return Place(line, variable, variable not in linear_names, not single)


@dataclass(frozen=True)
class ModelMotion:
    """A fitted model's own motion: variables and coefficients along every record on its fine grid, and what a part of a
    coefficient changes in the outputs. courses: per record, name -> (2N - 1,). scale: line -> rms about its mean."""

    problem: LikelihoodProblem
    fit: ModelFit
    simulator: Simulator
    segments: tuple[Segment, ...]
    courses: tuple[dict[str, Array], ...]
    scale: dict[str, float]

    @classmethod
    def of(cls, problem: LikelihoodProblem, fit: ModelFit) -> "ModelMotion":
        model = problem.model
        lines = coefficient_lines(problem.base)
        variables = variables_of(problem.base, lines)
        accelerations = [n for n in ACCELERATIONS if n in model.definitions]
        names = tuple(dict.fromkeys((*variables, *lines, *accelerations)))
        probe = model.plus(
            inputs=[Signal(INCREMENT.format(n)) for n in lines],
            terms={n: INCREMENT.format(n) for n in lines},
            observed=[Signal(n) for n in names if n not in model.output_names],
        )
        simulator = Simulator.build(probe, (), substeps=1, hold="linear")
        segments, courses = [], []
        for i, local in enumerate(fit.locals):
            inputs = problem.driven(problem.grids[i], fit.values)
            zeros = np.zeros((inputs.u.shape[0], len(lines)))
            segment = replace(inputs, u=np.ascontiguousarray(np.concatenate([inputs.u, zeros], axis=1)))
            y = simulator.run(segment, {**fit.values, **local.parameters}, local.x0).y
            segments.append(segment)
            courses.append({n: y[:, probe.output_names.index(n)] for n in names})
        scale = {n: float(np.std(np.concatenate([c[n] for c in courses]))) for n in lines}
        return cls(problem, fit, simulator, tuple(segments), tuple(courses), scale)

    def range_of(self, variable: str) -> Range:
        return Range.of([c[variable] for c in self.courses])

    def moves(self, variable: str) -> bool:
        """Whether a variable was flown over any range at all."""
        limits = self.range_of(variable)
        return limits.half > FLOWN * max(abs(limits.middle), FLOWN)

    def columns(self, place: Place, index: int, flown: Range) -> Array:
        """(2N - 1, columns) of an increment along one record."""
        u = np.clip(flown.scaled(self.courses[index][place.variable]), -1.0, 1.0)
        values = basis().columns(u)
        extra = [c for c, is_needed in ((u, place.lacks_line), (np.ones_like(u), place.lacks_constant)) if is_needed]
        values = np.column_stack([values, *extra])
        if place.by:
            values *= (self.courses[index][place.by] / self.reach(place.by))[:, None]
        return np.ascontiguousarray(values)

    def reach(self, variable: str) -> float:
        """Largest size of a variable: what a multiplier is counted in."""
        return max(float(np.abs(c[variable]).max()) for c in self.courses)

    def changes(self, index: int, asks: Sequence[tuple[str, Array]]) -> Iterator[Array]:
        """(N, ny) changes of the outputs of a record by unit of each of `asks`, by linear theory: a coefficient and the course
        (2N - 1,) of a part of it. Nothing where they run away or nothing was measured."""
        segment, local, outputs = self.segments[index], self.fit.locals[index], len(self.problem.model.outputs)

        def respond(moved: Array) -> Array | None:
            motion = self.simulator.run_by_middles(
                segment, {**self.fit.values, **local.parameters}, local.x0, sensitivities=True, moved=moved
            )
            if motion.dy is None or not motion.finite:
                return None
            return motion.dy[:, :outputs, -moved.shape[2] :].copy()

        courses = [(INCREMENT.format(line), course) for line, course in asks]
        return responses(respond, self.simulator.model.input_names, courses, ~np.isfinite(self.fit.residuals[index]))


def spread_of(place: Place, scale: float) -> Array:
    """(columns,) prior standard deviations of the weights of an increment of a coefficient whose rms is `scale`."""
    return scale * np.concatenate([basis().spread, np.ones(place.extra)])


Asked = TypeVar("Asked")  # what is ranked: places of a spline, of a lag, oscillators


@dataclass(frozen=True)
class Ranked(Generic[Asked]):
    """Places by what is gained there. gains: (places,) twice the log-likelihood with the penalty counted; scores: (places,)
    root of the gain over its median on the nulls; usual: (places,) that median; threshold: family-wise, from the largest score
    of every null."""

    places: tuple[Asked, ...]
    gains: Array
    scores: Array
    usual: Array
    threshold: float

    @property
    def order(self) -> list[int]:
        """Indices of the places whose score passes the threshold, largest gain first."""
        return [int(i) for i in np.argsort(-self.gains) if self.scores[i] > self.threshold]

    @property
    def best_gain(self) -> float:
        """Largest gain of a place that passes the threshold, less what so many unknowns gain there with nothing hidden; 0 where
        none passes."""
        return float((self.gains - self.usual)[self.order].max()) if self.order else 0.0


def rank(flown: ModelMotion, round_: Round, places: Sequence[Place]) -> Ranked[Place]:
    """Score every place on the residuals of a round's baseline and on its nulls."""
    problem, criteria = flown.problem, round_.criteria
    usable = [p for p in places if flown.moves(p.variable) and flown.scale[p.line] > 0.0]
    spans: list[range] = []
    asks: list[list[tuple[str, Array]]] = [[] for _ in problem.records]
    weights: list[Array] = []
    for place in usable:
        spread = spread_of(place, flown.scale[place.line])
        limits = flown.range_of(place.variable)
        begin = len(asks[0])
        for i, record_asks in enumerate(asks):
            record_asks += [(place.line, course) for course in flown.columns(place, i, limits).T]
        spans.append(range(begin, len(asks[0])))
        weights.append(1.0 / spread**2)
    gram = gram_of(round_.tangent, lambda i: flown.changes(i, asks[i]))
    projected = Projected.of(gram, len(problem.free), len(asks[0]))
    gains = np.array([penalised(projected, span, w) for span, w in zip(spans, weights, strict=True)])
    return ranked(usable, gains, criteria)


def penalised(projected: Projected, span: Sequence[int], weight: Array) -> Array:
    """(residual columns,) twice the log-likelihood that columns gain under a Gaussian prior of precision `weight`."""
    index = list(span)
    b = projected.b[index]
    return np.asarray(np.sum(b * solved(projected.B[np.ix_(index, index)] + np.diag(weight), b), axis=0))


def ranked(places: Sequence[Asked], gains: Array, criteria: Criteria) -> Ranked[Asked]:
    """gains: (places, 1 + nulls). The threshold is raised like that of a name."""
    if not places:
        return Ranked((), np.zeros(0), np.zeros(0), np.zeros(0), 0.0)
    medians = np.maximum(np.median(gains[:, 1:], axis=1), NOTHING)  # a mean is made by the few nulls that run away
    scores = np.sqrt(gains / medians[:, None])
    limit = significant_above(scores[:, 1:].max(axis=0), criteria)
    return Ranked(tuple(places), gains[:, 0], scores[:, 0], medians, limit)
