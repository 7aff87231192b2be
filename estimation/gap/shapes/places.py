"""Places for an unknown part of the model: a coefficient and a variable, read from the model's own equations; and which of these
would explain the residuals, by linear theory against simulated nulls."""

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
from estimation.models.dependence import names_reached
from estimation.models.expressions import names_in, products_in

INCREMENT = "increment_{}"
EXTRA_INPUTS = ("alpha",)  # coefficients may depend on it although no term of the model has it
EXTRA_STATES = ("alpha", "V")
# they drive movable masses and bending of the airframe, where a model has them
ACCELERATIONS = ("ax", "ay", "az", "p_dot", "q_dot", "r_dot")
FLOWN = 1e-9  # of a variable's size: a smaller range counts as constant
NOTHING = 1e-300  # keeps a gain of zero on the nulls from dividing by zero


@dataclass(frozen=True)
class Place:
    """A coefficient and the variable on which a part of it depends. by: a second variable that multiplies that part.

    lacks_line, lacks_constant: the base has no free parameter for a line in the variable (a constant), so that the increment
    needs it.
    """

    line: str
    variable: str
    lacks_line: bool
    lacks_constant: bool
    by: str = ""

    def columns(self, u: Array) -> Array:
        """(N, columns) of the increment at u (N,) in -1..1: those of the spline, then line and constant where the base lacks
        them."""
        extra = [c for c, lacking in ((u, self.lacks_line), (np.ones_like(u), self.lacks_constant)) if lacking]
        return np.column_stack([basis().columns(u), *extra])

    @property
    def words(self) -> str:
        return f"{self.line} by {self.variable}" + (f" times {self.by}" if self.by else "")


def coefficient_lines(model: Model) -> tuple[str, ...]:
    """Lines that hold derivatives of the aircraft: its coefficients, or its rates where the model names none; not those that show
    a measurement, or repeat a coefficient in a solved equation."""
    parameters = {p.name for p in model.parameters if p.role in (ParameterRole.DERIVATIVE, ParameterRole.CONSTANT)}
    return tuple(
        line
        for line, text in model.definitions.items()
        if names_in(text) & parameters
        and not line.endswith(("_measured", "_solved"))
        and line not in model.output_names
    )


def variables_of(model: Model, lines: Sequence[str]) -> tuple[str, ...]:
    """Signals in the terms of the coefficients, angle of attack, and airspeed where it is a state; no columns and coefficients of
    a simulation, which a reader could not interpret and whose own errors would be fitted."""
    fixed_names = {*model.parameter_names, *model.constants, *lines, *(f"{line}_sim" for line in lines)}
    inputs = (s.name for s in model.inputs if not s.computed)
    signals = {*model.state_names, *inputs, *model.definitions}
    factors = [n for line in lines for product in _terms(model, line) for n in sorted(product)]
    variables = [n for n in dict.fromkeys(factors) if n in signals and n not in fixed_names]
    extras = [n for n in EXTRA_STATES if n in model.state_names] + [n for n in EXTRA_INPUTS if n in model.input_names]
    return tuple(dict.fromkeys([*variables, *extras]))


def places_of(model: Model) -> tuple[Place, ...]:
    """Every coefficient by every variable that it does not drive."""
    lines = coefficient_lines(model)
    variables = variables_of(model, lines)
    return tuple(_place(model, line, v) for line in lines for v in variables if not drives(model, line, v))


def products_of(model: Model) -> tuple[Place, ...]:
    """Every coefficient by a function of one variable times another, neither of which it drives."""
    lines = coefficient_lines(model)
    variables = variables_of(model, lines)
    return tuple(
        _place(model, line, v, multiplier)
        for line in lines
        for v in variables
        for multiplier in variables
        if v != multiplier and not drives(model, line, v, multiplier)
    )


def drives(model: Model, line: str, *variables: str) -> bool:
    """Whether some variables depend on a coefficient: lift as a function of the rate of the angle of attack, which lift itself
    drives, would define itself."""
    return line in names_reached(model, variables)


def _terms(model: Model, line: str) -> tuple[frozenset[str], ...]:
    """The names of every product in a line; a derivative may be a difference, as from that of a simulation."""
    return products_in(model.definitions[line], frozenset((*model.parameter_names, *model.constants)))


def _place(model: Model, line: str, variable: str, by: str = "") -> Place:
    """Constant and line of a one-variable increment are the base's constant and derivative, where these are free; of a product
    the constant is the derivative with respect to the second variable."""
    free = set(model.free_names)
    terms, numbers = _terms(model, line), {*model.parameter_names, *model.constants}
    linear_terms = [product - numbers for product in terms if len(product & free) == 1]
    has_constant = bool((names_in(model.definitions[line]) - frozenset().union(*terms)) & free)
    linear_names = {n for product in linear_terms if len(product) == 1 for n in product}
    if by:
        return Place(line, variable, True, by not in linear_names, by)
    return Place(line, variable, variable not in linear_names, not has_constant)


@dataclass(frozen=True)
class ModelMotion:
    """The motion of a fitted model: variables and coefficients along every record on its fine grid, and the response of the
    outputs to a change of a coefficient. courses: per record, name -> (2N - 1,). scale: coefficient -> rms about its mean."""

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
        simulator = Simulator.build(probe, (), substeps=problem.substeps, hold="linear")
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
        """Whether a variable varies on the flights."""
        limits = self.range_of(variable)
        return limits.half > FLOWN * max(abs(limits.middle), FLOWN)

    def columns(self, place: Place, index: int, flown: Range) -> Array:
        """(2N - 1, columns) of an increment along one record."""
        values = place.columns(np.clip(flown.scaled(self.courses[index][place.variable]), -1.0, 1.0))
        if place.by:
            values *= (self.courses[index][place.by] / self.reach(place.by))[:, None]
        return np.ascontiguousarray(values)

    def reach(self, variable: str) -> float:
        """Largest size of a variable: the unit of a multiplier."""
        return max(float(np.abs(c[variable]).max()) for c in self.courses)

    def shows(self, place: Place) -> bool:
        """Whether a place can be seen on the flights: its variable varies, its coefficient does, and a multiplier is more than
        nothing (thrust with the engine off)."""
        has_multiplier = not place.by or self.reach(place.by) > 0.0
        return self.moves(place.variable) and self.scale[place.line] > 0.0 and has_multiplier

    def changes(self, index: int, parts: Sequence[tuple[str, Array]]) -> Iterator[Array]:
        """(N, ny) changes of the outputs of a record by each of `parts`, a coefficient and the course (2N - 1,) added to it, by
        linear theory. Zero where they run away or nothing was measured."""
        segment, local, outputs = self.segments[index], self.fit.locals[index], len(self.problem.model.outputs)

        def respond(moved: Array) -> Array | None:
            motion = self.simulator.run_by_middles(
                segment, {**self.fit.values, **local.parameters}, local.x0, sensitivities=True, moved=moved
            )
            if motion.dy is None or not motion.finite:
                return None
            return motion.dy[:, :outputs, -moved.shape[2] :].copy()

        courses = [(INCREMENT.format(line), course) for line, course in parts]
        return responses(respond, self.simulator.model.input_names, courses, ~np.isfinite(self.fit.residuals[index]))


def spread_of(place: Place, scale: float) -> Array:
    """(columns,) prior standard deviations of the weights of an increment of a coefficient whose rms is `scale`."""
    return scale * np.concatenate([basis().spread, np.ones(place.lacks_line + place.lacks_constant)])


Candidate = TypeVar("Candidate")  # ranked: places of a spline or of a lag, or oscillators


@dataclass(frozen=True)
class Ranked(Generic[Candidate]):
    """Candidates with their gains. gains: (places,) twice the log-likelihood with the penalty counted; scores: (places,)
    root of the gain over its median on the nulls; usual: (places,) that median; threshold: family-wise, from the largest score
    of every null."""

    places: tuple[Candidate, ...]
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
        """Largest gain of a place that passes the threshold, less the usual gain on nulls; 0 where none passes."""
        return float((self.gains - self.usual)[self.order].max()) if self.order else 0.0


def rank(motion: ModelMotion, round_: Round, places: Sequence[Place]) -> Ranked[Place]:
    """Score every place on the residuals of a round's baseline and on its nulls."""
    problem, criteria = motion.problem, round_.criteria
    usable = [p for p in places if motion.shows(p)]
    spans: list[range] = []
    parts: list[list[tuple[str, Array]]] = [[] for _ in problem.records]
    weights: list[Array] = []
    for place in usable:
        limits = motion.range_of(place.variable)
        begin = len(parts[0])
        for i, record_parts in enumerate(parts):
            record_parts += [(place.line, course) for course in motion.columns(place, i, limits).T]
        spans.append(range(begin, len(parts[0])))
        weights.append(1.0 / spread_of(place, motion.scale[place.line]) ** 2)
    gram = gram_of(round_.tangent, lambda i: motion.changes(i, parts[i]))
    projected = Projected.of(gram, len(problem.free), len(parts[0]))
    gains = np.array([penalised(projected, span, w) for span, w in zip(spans, weights, strict=True)])
    return ranked(usable, gains, criteria)


def penalised(projected: Projected, span: Sequence[int], weight: Array) -> Array:
    """(residual columns,) twice the log-likelihood gained by columns with a Gaussian prior of precision `weight`."""
    index = list(span)
    b = projected.b[index]
    return np.asarray(np.sum(b * solved(projected.B[np.ix_(index, index)] + np.diag(weight), b), axis=0))


def ranked(places: Sequence[Candidate], gains: Array, criteria: Criteria) -> Ranked[Candidate]:
    """Candidates ranked by gains (places, 1 + nulls); the threshold has the margin of that of a name."""
    if not places:
        return Ranked((), np.zeros(0), np.zeros(0), np.zeros(0), 0.0)
    medians = np.maximum(np.median(gains[:, 1:], axis=1), NOTHING)  # nulls that run away would dominate a mean
    scores = np.sqrt(gains / medians[:, None])
    limit = significant_above(scores[:, 1:].max(axis=0), criteria)
    return Ranked(tuple(places), gains[:, 0], scores[:, 0], medians, limit)
