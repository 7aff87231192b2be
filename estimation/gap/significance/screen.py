"""Score-test screen: the signature of each hypothesis in the residuals, with everything the base can absorb projected out.

A hypothesis is a form of an effect that applies to the model. All are linearised at the fitted baseline by small steps. Per
record the whitened sensitivities of shared parameters and of all hypotheses and the residuals give one small Gram matrix, with
the unknowns of the record alone (initial states, biases) eliminated. Scores, ties, detectable sizes, pairs, nulls and held-out
predictions are then small linear algebra.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtri  # scipy.stats takes half a second to import

from estimation.engine.kernel import Array
from estimation.estimators.normal_equations import eliminated, solved
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect, EffectParameter, Form
from estimation.gap.fit.problem import LARGEST, LikelihoodProblem, ModelFit, carried_local, prior_terms
from estimation.gap.records.candidate_model import awakened
from estimation.gap.significance.tangent import AT_ONCE, Tangent
from estimation.models.base import Model, ParameterRole

SMALL = 0.05  # usual sizes: secant steps to both sides, of effects with states or transforms
LARGE = 0.3  # usual sizes: step to one side, large enough for a play or a delay to act
SEEN = 1e-6  # of a column's squared length: less beside the base is rounding
ROUNDING = 1e-12  # of a column's squared length: what elimination leaves of one that the base absorbs
TINY = 1e-300  # keeps a column without length from dividing by zero
SMALLEST_TAIL = 1e-300  # a probability that still has a quantile


@dataclass(frozen=True)
class Hypothesis:
    """One form of one effect that can be added to the model at hand."""

    effect: Effect
    form: Form

    @property
    def key(self) -> tuple[str, str]:
        return self.effect.name, self.form.label

    @property
    def label(self) -> str:
        return self.effect.name if len(self.effect.forms) == 1 else f"{self.effect.name} ({self.form.label})"


@dataclass(frozen=True)
class HypothesisColumn:
    """One unknown of one hypothesis."""

    hypothesis: int
    parameter: EffectParameter


def derivatives(
    problem: LikelihoodProblem, fit: ModelFit, hypotheses: Sequence[Hypothesis]
) -> dict[str, list[Array] | None]:
    """Parameter -> per record (N, ny) change of the outputs per unit, of all parameters in which the equations are smooth: those
    that lie dormant in them and may have either sign. None where the motion runs away."""
    dormant = {p.name for p in problem.model.parameters if p.role is ParameterRole.DORMANT}
    smooth = dict.fromkeys(
        p.name
        for h in hypotheses
        for p in h.form.parameters
        if not h.form.nonlinear
        and p.name in dormant
        and not one_sided(p, p.null_value(problem.model), problem.criteria)
    )
    found: dict[str, list[Array] | None] = {}
    for first in range(0, len(smooth), AT_ONCE):
        names = list(smooth)[first : first + AT_ONCE]
        by_record = [problem.by_dormant(i, fit, names) for i in range(len(problem.records))]
        for k, name in enumerate(names):
            changes = [np.ascontiguousarray(by_names[:, :, k]) for by_names in by_record]
            finite = all(np.abs(c).max(initial=0.0) < LARGEST for c in changes)
            found[name] = changes if finite else None
    return found


def sensitivity(
    problem: LikelihoodProblem,
    fit: ModelFit,
    base_residuals: Sequence[Array],
    hypothesis: Hypothesis,
    column: EffectParameter,
) -> list[Array] | None:
    """Per record (N, ny) change of the outputs per unit of a hypothesis' parameter, by secants of a typical size.

    Two-sided where the parameter may have either sign; None where the hypothesis makes the motion diverge.
    """
    model = awakened(problem.model, hypothesis.form)
    none = column.null_value(problem.model)
    trial = replace(problem, model=model)
    two_sided = not one_sided(column, none, problem.criteria)
    steps = (SMALL * column.typical, -SMALL * column.typical) if two_sided else (LARGE * column.typical,)
    changes = []
    for i in range(len(problem.records)):
        outputs = []
        for step in steps:
            local = carried_local(fit.locals[i], fit.model, model)
            residual = trial.residual(i, {**model.starts(), **fit.values, column.name: none + step}, local)
            if residual is None:
                return None
            outputs.append(residual)
        reference = outputs[1] if two_sided else base_residuals[i]
        changes.append(np.nan_to_num((reference - outputs[0]) / (2 * steps[0] if two_sided else steps[0])))
    return changes


def one_sided(parameter: EffectParameter, none: float, criteria: Criteria) -> bool:
    """Whether an unknown can only lie to one side of `none`, its value without effect."""
    return parameter.lower >= none - criteria.negligible * parameter.typical


def hypotheses_for(model: Model, effects: Sequence[Effect], available: frozenset[str]) -> tuple[Hypothesis, ...]:
    """Every form of every effect that applies to `model`, with its inputs among `available`."""
    return tuple(
        Hypothesis(effect, form)
        for effect in effects
        for form in effect.applicable(model)
        if all(s.name in available for s in form.inputs)
    )


@dataclass(frozen=True)
class Screen:
    """The linearised problem. shared: (n,) names; columns: of the hypotheses; grams: per record, of whitened columns [shared |
    hypotheses | residuals] with the unknowns of the record alone eliminated; prior: Gram matrix of the shared priors, of the same
    size; flights: of each record; runaway: hypotheses that cannot be asked, since the motion runs away with little of them."""

    shared: tuple[str, ...]
    hypotheses: tuple[Hypothesis, ...]
    columns: tuple[HypothesisColumn, ...]
    grams: tuple[Array, ...]
    prior: Array
    flights: tuple[int, ...]
    runaway: tuple[Hypothesis, ...] = ()

    @property
    def n(self) -> int:
        return len(self.shared)

    @property
    def k(self) -> int:
        return len(self.columns)

    def total(self, flights: Sequence[int] | None = None) -> Array:
        """Sum of the Gram matrices of the records of `flights` (default all), with the priors."""
        grams = [gram for gram, f in zip(self.grams, self.flights, strict=True) if flights is None or f in flights]
        return np.sum(grams, axis=0) + self.prior

    @cached_property
    def _projected(self) -> "Projected":
        return Projected.of(self.total(), self.n, self.k)

    def projected(self) -> "Projected":
        """Hypotheses and residuals with the shared parameters projected out."""
        return self._projected

    def with_nulls(self, selected: NDArray[np.bool_]) -> "Screen":
        """The same with some of the nulls. selected: (nulls,)."""
        index = np.flatnonzero(np.concatenate([np.ones(self.n + self.k + 1, dtype=bool), selected]))
        pick = np.ix_(index, index)
        return replace(self, grams=tuple(gram[pick] for gram in self.grams), prior=self.prior[pick])

    def cross_gain(self, hypothesis: int) -> float | None:
        """Twice the log-likelihood gained on each flight by a hypothesis fitted to the others, summed, by linear theory.

        None with one flight only.
        """
        names = sorted(set(self.flights))
        if len(names) < 2:
            return None
        n, r = self.n, self.n + self.k
        theta = list(range(n))
        extended = theta + [n + c for c in self.span(hypothesis)]
        total = 0.0
        for flight in names:
            training = self.total([f for f in names if f != flight])
            holdout = self.total([flight]) - self.prior
            costs = []
            for index in (theta, extended):
                x = solved(training[np.ix_(index, index)], training[index, r])
                costs.append(x @ holdout[np.ix_(index, index)] @ x - 2 * x @ holdout[index, r])
            total += float(costs[0] - costs[1])
        return total

    def span(self, hypothesis: int) -> list[int]:
        """Column indices of one hypothesis."""
        return [i for i, c in enumerate(self.columns) if c.hypothesis == hypothesis]

    def tied(self, hypothesis: int, criteria: Criteria) -> list[bool]:
        """Of every hypothesis, whether its signature is nearly that of one of them."""
        cosines = np.abs(self.projected().cosines())[self.span(hypothesis)]
        return [bool(cosines[:, self.span(h)].max() > criteria.nearly_all) for h in range(len(self.hypotheses))]


@dataclass(frozen=True)
class Projected:
    """B: (k, k) Gram matrix, b: (k, m) products with each of m residual columns, energy: (m,) squared length of each residual,
    raw: (k,) squared length of each column before projection."""

    B: Array
    b: Array
    energy: Array
    raw: Array

    @classmethod
    def of(cls, gram: Array, n: int, k: int) -> "Projected":
        """From a Gram matrix of n columns to project out, k hypotheses and the residuals."""
        rest = eliminated(gram, n)
        return cls(rest[:k, :k], rest[:k, k:], np.diag(rest)[k:].copy(), np.diag(gram)[n : n + k].copy())

    def scores(self) -> Array:
        """(k, m) signed scores of single columns: unit variance where the noise model is right and nothing is hidden; zero where
        the base absorbs a column to rounding."""
        square = np.diag(self.B)
        visible = square > ROUNDING * self.raw
        return np.where(visible[:, None], self.b / np.sqrt(np.where(visible, square, 1.0))[:, None], 0.0)

    def gain(self, subset: Sequence[int]) -> float:
        """Twice the log-likelihood that a set of columns gains on the data."""
        return float(self.gains(subset, slice(0, 1))[0])

    def gains(self, subset: Sequence[int], columns: slice) -> Array:
        """(residual columns,) twice the log-likelihood that a set of columns gains on each of them."""
        index = list(subset)
        b = self.b[index, columns]
        return np.asarray(np.sum(b * solved(self.B[np.ix_(index, index)], b), axis=0))

    def cosines(self) -> Array:
        """(k, k) cosines between the signatures of the columns."""
        scale = 1 / np.sqrt(np.maximum(np.diag(self.B), TINY))
        return np.clip(self.B * scale[:, None] * scale[None, :], -1.0, 1.0)


def equivalent_z(gain: float, unknowns: int) -> float:
    """|z| of one unknown that is as improbable as a gain in twice the log-likelihood with several unknowns."""
    if unknowns == 1:
        return float(np.sqrt(max(gain, 0.0)))
    tail = chdtrc(unknowns, max(gain, 0.0))
    return float(-ndtri(tail / 2)) if tail > SMALLEST_TAIL else float(np.sqrt(gain))


@dataclass(frozen=True)
class Signatures:
    """Hypotheses linearised about a fit. columns: their unknowns, in order; changes: per column, per record (N, ny) change of the
    outputs; runaway: as of `Screen`."""

    hypotheses: tuple[Hypothesis, ...]
    columns: tuple[HypothesisColumn, ...]
    changes: tuple[list[Array], ...]
    runaway: tuple[Hypothesis, ...]

    @classmethod
    def of(cls, problem: LikelihoodProblem, fit: ModelFit, hypotheses: Sequence[Hypothesis]) -> "Signatures":
        """Without those that the flights do not excite at all."""
        columns: list[HypothesisColumn] = []
        changes: list[list[Array]] = []
        included: list[Hypothesis] = []
        runaway: list[Hypothesis] = []
        smooth = derivatives(problem, fit, hypotheses)
        for hypothesis in hypotheses:
            sensitivities = [
                (p, smooth[p.name] if p.name in smooth else sensitivity(problem, fit, fit.residuals, hypothesis, p))
                for p in hypothesis.form.parameters
            ]
            if any(c is None for _, c in sensitivities):
                runaway.append(hypothesis)
                continue
            if any(max(np.abs(x).max() for x in c or ()) == 0.0 for _, c in sensitivities):
                continue
            for parameter, change in sensitivities:
                columns.append(HypothesisColumn(len(included), parameter))
                changes.append(change or [])
            included.append(hypothesis)
        return cls(tuple(included), tuple(columns), tuple(changes), tuple(runaway))

    def screened(self, tangent: Tangent) -> Screen:
        """Beside the residuals of a tangent about the same fit."""
        problem = tangent.problem
        grams = tuple(tangent.record(i).gram_with([c[i] for c in self.changes]) for i in range(len(problem.records)))
        prior = shared_prior(problem, tangent.fit, grams[0].shape[0], len(self.columns))
        flights = tuple(r.flight for r in problem.records)
        return Screen(problem.free, self.hypotheses, self.columns, grams, prior, flights, self.runaway)


def build_screen(tangent: Tangent, hypotheses: Sequence[Hypothesis]) -> Screen:
    """Linearise all hypotheses at the fit of a tangent. Raises GapError where its motion cannot be linearised."""
    return Signatures.of(tangent.problem, tangent.fit, hypotheses).screened(tangent)


def shared_prior(problem: LikelihoodProblem, fit: ModelFit, size: int, k: int) -> Array:
    """(size, size) Gram matrix of the priors of the shared parameters, the data's residual behind k hypotheses."""
    prior, n = np.zeros((size, size)), len(problem.free)
    weight, distance = prior_terms(problem, problem.free, fit.values)
    prior[:n, :n] = np.diag(weight)
    prior[:n, n + k] = prior[n + k, :n] = distance
    return prior


def gram_of(tangent: Tangent, changes: Callable[[int], Iterable[Array]]) -> Array:
    """Gram matrix of shared unknowns, columns, residuals of the data and of nulls over all records, with the unknowns of each
    record alone eliminated and the priors of the shared ones. changes: record -> (N, ny) changes of the outputs by each column.

    Raises GapError where the fitted motion cannot be linearised.
    """
    problem = tangent.problem
    gram = np.sum([tangent.record(i).gram_with(changes(i)) for i in range(len(problem.records))], axis=0)
    columns = len(gram) - len(problem.free) - 1 - len(tangent.nulls)
    return np.asarray(gram + shared_prior(problem, tangent.fit, len(gram), columns))


def linear_gains(screen: Screen, problem: LikelihoodProblem, column: int | slice = 0) -> Array:
    """Gains in twice the log-likelihood by linear theory, (hypotheses,) for one residual column, (columns, hypotheses)
    for a slice of them; zero where the sign is physically impossible."""
    projected = screen.projected()
    residual_columns = column if isinstance(column, slice) else slice(column, column + 1)
    gains = np.zeros((projected.b[:, residual_columns].shape[1], len(screen.hypotheses)))
    for h in range(len(screen.hypotheses)):
        span = screen.span(h)
        gains[:, h] = projected.gains(span, residual_columns)
        if len(span) == 1:
            p = screen.columns[span[0]].parameter
            none = p.null_value(problem.model)
            if one_sided(p, none, problem.criteria):
                gains[projected.b[span[0], residual_columns] < 0, h] = 0.0
    return gains if isinstance(column, slice) else gains[0]


def linear_guess(screen: Screen, problem: LikelihoodProblem, hypothesis: int) -> dict[str, float]:
    """Parameter values of a hypothesis by linear theory."""
    projected = screen.projected()
    span = screen.span(hypothesis)
    eta = solved(projected.B[np.ix_(span, span)], projected.b[span, 0])
    return {
        screen.columns[c].parameter.name: screen.columns[c].parameter.null_value(problem.model) + float(e)
        for c, e in zip(span, eta, strict=True)
    }
