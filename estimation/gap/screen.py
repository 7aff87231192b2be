"""Score-test screen: what each hypothesis would leave in the residuals, with everything the base can absorb taken out.

All hypotheses are linearised at the fitted baseline. Per record the whitened sensitivities of shared parameters, of all
hypotheses and the residuals are reduced to one small Gram matrix with the record's own unknowns (initial states, biases)
eliminated. From then on scores, ties, detectable sizes, pairs, nulls and held-out predictions are small linear algebra.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, norm

from estimation.engine.kernel import Array
from estimation.gap.dormant import awakened
from estimation.gap.effects.base import Effect, EffectParameter, Form
from estimation.gap.fitting import Fit, Local, Problem, prior_terms
from estimation.models.base import Model


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
class Column:
    """One unknown of one hypothesis."""

    hypothesis: int
    parameter: EffectParameter


@dataclass(frozen=True)
class Reduced:
    """Gram matrix of one record's whitened columns [shared | hypotheses | residuals], local unknowns eliminated."""

    gram: Array
    rows: int


@dataclass(frozen=True)
class Screen:
    """The linearised problem. shared: (n,) names; columns: of the hypotheses; reduced: per record; prior: Gram matrix of
    the shared priors, of the same size."""

    shared: tuple[str, ...]
    hypotheses: tuple[Hypothesis, ...]
    columns: tuple[Column, ...]
    reduced: tuple[Reduced, ...]
    prior: Array
    flights: tuple[int, ...]  # of each record

    @property
    def n(self) -> int:
        return len(self.shared)

    @property
    def k(self) -> int:
        return len(self.columns)

    def total(self, flights: Sequence[int] | None = None) -> Array:
        """Sum of the Gram matrices of the records of `flights` (default all), with the priors."""
        grams = [r.gram for r, f in zip(self.reduced, self.flights, strict=True) if flights is None or f in flights]
        return np.sum(grams, axis=0) + self.prior

    def projected(self, flights: Sequence[int] | None = None) -> "Projected":
        """Hypotheses and residuals with the shared parameters projected out."""
        G = self.total(flights)
        n, k = self.n, self.k
        A = np.linalg.pinv(G[:n, :n], hermitian=True, rcond=1e-12)
        rest = G[n:, n:] - G[n:, :n] @ A @ G[:n, n:]
        raw = np.diag(G)[n : n + k]
        return Projected(rest[:k, :k], rest[:k, k:], np.diag(rest)[k:].copy(), raw.copy())

    def cross_gain(self, hypothesis: int, column: int = 0) -> float | None:
        """Twice the log-likelihood gained on each flight by a hypothesis fitted to all the others, summed; linear theory.

        None where there is only one flight.
        """
        names = sorted(set(self.flights))
        if len(names) < 2:
            return None
        n, r = self.n, self.n + self.k + column
        theta = list(range(n))
        both = theta + [n + c for c in self.span(hypothesis)]
        total = 0.0
        for held in names:
            others = self.total([f for f in names if f != held])
            own = self.total([held]) - self.prior
            costs = []
            for index in (theta, both):
                x = np.linalg.pinv(others[np.ix_(index, index)], hermitian=True, rcond=1e-12) @ others[index, r]
                costs.append(x @ own[np.ix_(index, index)] @ x - 2 * x @ own[index, r])
            total += float(costs[0] - costs[1])
        return total

    def span(self, hypothesis: int) -> list[int]:
        """Column indices of one hypothesis."""
        return [i for i, c in enumerate(self.columns) if c.hypothesis == hypothesis]


@dataclass(frozen=True)
class Projected:
    """B: (k, k) Gram matrix, b: (k, m) correlations with each of m residual columns, energy: (m,) what is left of each
    residual, raw: (k,) squared length of each hypothesis before projection."""

    B: Array
    b: Array
    energy: Array
    raw: Array

    def z(self, column: int = 0) -> Array:
        """(k,) signed scores of single columns: unit variance where the noise model is right and nothing is hidden."""
        return self.b[:, column] / np.sqrt(np.maximum(np.diag(self.B), 1e-300))

    def gain(self, subset: Sequence[int], column: int = 0) -> float:
        """Twice the log-likelihood that a set of columns gains."""
        return float(self.gains(subset, slice(column, column + 1))[0])

    def gains(self, subset: Sequence[int], columns: slice, ridge: float = 1e-9) -> Array:
        """(residual columns,) twice the log-likelihood that a set of columns gains on each of them."""
        index = list(subset)
        B = self.B[np.ix_(index, index)]
        scale = 1 / np.sqrt(np.maximum(np.diag(B), 1e-300))
        c = scale[:, None] * self.b[index, columns]
        M = B * scale[:, None] * scale[None, :] + ridge * np.eye(len(index))
        return np.asarray(np.sum(c * np.linalg.solve(M, c), axis=0))

    def cosines(self) -> Array:
        """(k, k) cosines between the signatures of the columns."""
        scale = 1 / np.sqrt(np.maximum(np.diag(self.B), 1e-300))
        return np.clip(self.B * scale[:, None] * scale[None, :], -1.0, 1.0)


def equivalent_z(gain: float, unknowns: int) -> float:
    """The |z| of one unknown that is as improbable as a gain in twice the log-likelihood with several."""
    if unknowns == 1:
        return float(np.sqrt(max(gain, 0.0)))
    tail = chi2.logsf(max(gain, 0.0), unknowns)
    return float(-norm.ppf(np.exp(max(tail, -700.0)) / 2)) if tail > -650 else float(np.sqrt(gain))


def sensitivity(problem: Problem, fit: Fit, base_residuals: Sequence[Array], hypothesis: Hypothesis, column: EffectParameter
                ) -> list[Array] | None:  # fmt: skip
    """Per record (N, ny) change of the outputs per unit of a hypothesis' parameter, by secants of a typical size.

    Two-sided where the parameter may have either sign; None where the hypothesis makes the motion diverge.
    """
    model = awakened(problem.model, hypothesis.form)
    none = column.null_value(problem.model)
    trial = replace(problem, model=model)
    two_sided = column.lower < none - 0.25 * column.typical
    steps = (0.05 * column.typical, -0.05 * column.typical) if two_sided else (0.3 * column.typical,)
    found = []
    for i in range(len(problem.records)):
        outputs = []
        for step in steps:
            local = extended(fit.locals[i], fit.model, model)
            residual = trial.residual(i, {**model.starts(), **fit.values, column.name: none + step}, local)
            if residual is None:
                return None
            outputs.append(residual)
        change = (
            (outputs[1] - outputs[0]) / (0.1 * column.typical)
            if two_sided
            else (base_residuals[i] - outputs[0]) / steps[0]
        )
        found.append(np.nan_to_num(change))
    return found


def extended(local: Local, old: Model, new: Model) -> Local:
    """A record's own unknowns carried over to a model with more states."""
    at = dict(zip(old.state_names, local.x0, strict=True))
    for signal in new.states:
        if signal.name not in at:
            at[signal.name] = (
                at.get(str(signal.start), 0.0) if isinstance(signal.start, str) else float(signal.start or 0.0)
            )
    return Local(np.array([at[n] for n in new.state_names]), local.parameters)


def hypotheses_for(model: Model, effects: Sequence[Effect], available: frozenset[str]) -> tuple[Hypothesis, ...]:
    """Every form of every effect that applies to `model` and whose inputs are at hand."""
    return tuple(
        Hypothesis(effect, form)
        for effect in effects
        for form in effect.applicable(model)
        if all(s.name in available for s in form.inputs)
    )


def build_screen(
    problem: Problem, fit: Fit, hypotheses: Sequence[Hypothesis], extra: Sequence[Sequence[Array]] = ()
) -> Screen:
    """Linearise all hypotheses at `fit`. extra: more residual columns per record, each (N, ny) (nulls)."""
    columns: list[Column] = []
    changes: list[list[Array]] = []
    kept: list[Hypothesis] = []
    for hypothesis in hypotheses:
        found = [(p, sensitivity(problem, fit, fit.residuals, hypothesis, p)) for p in hypothesis.form.parameters]
        if any(c is None or max(np.abs(x).max() for x in c) == 0.0 for _, c in found):
            continue  # diverges, or these flights do not excite it at all
        for parameter, change in found:
            columns.append(Column(len(kept), parameter))
            changes.append(change or [])
        kept.append(hypothesis)
    reduced = tuple(
        reduce_record(problem, fit, i, [c[i] for c in changes], extra[i] if extra else ())
        for i in range(len(problem.records))
    )
    n, size = len(problem.free), reduced[0].gram.shape[0]
    prior = np.zeros((size, size))
    weight, distance = prior_terms(problem, problem.free, fit.values)
    prior[:n, :n] = np.diag(weight)
    first = n + len(columns)
    prior[:n, first] = prior[first, :n] = distance
    return Screen(problem.free, tuple(kept), tuple(columns), reduced, prior, tuple(r.flight for r in problem.records))


def reduce_record(problem: Problem, fit: Fit, index: int, changes: Sequence[Array], extra: Sequence[Array]) -> Reduced:
    """Gram matrix of one record with its own unknowns eliminated; residual columns: the data's, then `extra`."""
    shared = len(problem.free)
    found = problem.linearised(index, fit.values, fit.locals[index])
    assert found is not None, "a converged fit can be linearised"
    residual, dy = found
    missing = ~np.isfinite(residual)
    block = np.concatenate(
        [dy, *(c[:, :, None] for c in changes), residual[:, :, None], *(e[:, :, None] for e in extra)], axis=2
    )
    block[missing] = 0.0
    rows = problem.whiteners[index].rows(block)
    own = rows[:, shared : dy.shape[2]]
    outer = np.concatenate([rows[:, :shared], rows[:, dy.shape[2] :]], axis=1)
    w, d = prior_terms(problem, problem.local_names, fit.locals[index].parameters)
    Hll = own.T @ own
    Hll[np.arange(w.size), np.arange(w.size)] += w
    cross = own.T @ outer
    cross[: d.size, shared + len(changes)] += d
    gram = outer.T @ outer - cross.T @ np.linalg.pinv(Hll, hermitian=True) @ cross
    return Reduced(gram, rows.shape[0])
