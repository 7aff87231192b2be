"""What can be asked of a model: forms of effects that apply to it, and what a small step of each changes in the outputs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect, EffectParameter, Form
from estimation.gap.likelihood.fitting import LikelihoodProblem, ModelFit, carried
from estimation.gap.records.candidate_model import awakened
from estimation.models.base import Model

SMALL = 0.05  # usual sizes: secant steps to both sides, in which every smooth effect is linear
LARGE = 0.3  # usual sizes: where only one side is possible, far enough that a play or a delay acts at all


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
    found = []
    for i in range(len(problem.records)):
        outputs = []
        for step in steps:
            local = carried(fit.locals[i], fit.model, model)
            residual = trial.residual(i, {**model.starts(), **fit.values, column.name: none + step}, local)
            if residual is None:
                return None
            outputs.append(residual)
        before = outputs[1] if two_sided else base_residuals[i]
        found.append(np.nan_to_num((before - outputs[0]) / (2 * steps[0] if two_sided else steps[0])))
    return found


def one_sided(parameter: EffectParameter, none: float, criteria: Criteria) -> bool:
    """Whether an unknown can only lie to one side of `none`, its value without effect."""
    return parameter.lower >= none - criteria.one_sided * parameter.typical


def hypotheses_for(model: Model, effects: Sequence[Effect], available: frozenset[str]) -> tuple[Hypothesis, ...]:
    """Every form of every effect that applies to `model` and whose inputs are at hand."""
    return tuple(
        Hypothesis(effect, form)
        for effect in effects
        for form in effect.applicable(model)
        if all(s.name in available for s in form.inputs)
    )
