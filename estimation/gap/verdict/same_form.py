"""Effects of the catalogue that a shape without a name has the form of: told beside it, with why they are not its name."""

from collections.abc import Sequence

import numpy as np

from estimation.gap.answer.result import Rejected
from estimation.gap.answer.shape import Alike
from estimation.gap.effects.base import Effect, Form
from estimation.gap.form.analytic import Plain
from estimation.gap.tests_of_fit.hypotheses import Hypothesis
from estimation.models.base import Model
from estimation.models.expressions import evaluate, names_in
from estimation.models.numeric import FUNCTIONS

POINTS = 16  # at which two forms are compared: more than the zeros that products of a few powers can share
SAME = 1e-9  # of the ratio of two forms, by which rounding alone may move it


def alike(
    plain: Sequence[Plain], line: str, model: Model, effects: Sequence[Effect], rejected: Sequence[Rejected]
) -> tuple[Alike, ...]:
    """Effects that add to `line` what a formula beside a shape does, times a number, and that `model` lacks."""
    one_term = [
        Hypothesis(effect, form)
        for effect in effects
        for form in effect.forms
        if _only_adds_to(line, form) and form.obstacle(model) is None
    ]
    return tuple(
        _told(hypothesis, found, rejected)
        for formula in plain
        for hypothesis in one_term
        if (found := _as_parameter(formula, hypothesis.form.terms[line][0], hypothesis.form.parameters[0].name))
        is not None
    )


def _only_adds_to(line: str, form: Form) -> bool:
    """Whether all that a form does is to add one piece with one unknown to a line."""
    more = form.states or form.transforms or form.outputs or form.output_delays or form.lines
    return not more and [*form.terms] == [line] and len(form.terms[line]) == 1 and len(form.parameters) == 1


def _as_parameter(formula: Plain, piece: str, parameter: str) -> tuple[float, float] | None:
    """(estimate, bound) of the parameter with which a piece is the formula; None where it is another function."""
    names = sorted(names_in(formula.text) - {"a"})
    if set(formula.estimates) != {"a"} or names_in(piece) - {parameter} != set(names):
        return None
    points = dict(zip(names, np.random.default_rng(0).uniform(-1.0, 1.0, (len(names), POINTS)), strict=True))
    with np.errstate(all="ignore"):  # a piece from somebody's file may have logarithms or poles
        ours = evaluate(formula.text, {**points, "a": 1.0}, FUNCTIONS)
        ratio = ours / evaluate(piece, {**points, parameter: 1.0}, FUNCTIONS)
    if not np.ptp(ratio) < SAME * abs(ratio[0]):
        return None
    value, std = formula.estimates["a"]
    return float(value * ratio[0]), float(std * abs(ratio[0]))


def _told(hypothesis: Hypothesis, found: tuple[float, float], rejected: Sequence[Rejected]) -> Alike:
    effect, parameter = hypothesis.effect, hypothesis.form.parameters[0]
    said = [r.why for r in rejected if r.effect == hypothesis.label]
    if not parameter.lower <= found[0] <= parameter.upper:
        why = f"that is outside what is physically possible ({parameter.lower:g} to {parameter.upper:g})"
    else:
        little = bool(said) and said[-1].startswith("explains")
        why = f"as a name it {said[-1] if little else 'does not stand by itself'}"
    return Alike(effect.name, effect.title, parameter.name, found, parameter.unit, why)
