"""Effects of the catalogue that a shape without a name has the form of: told beside it, with why they are not its name."""

from collections.abc import Sequence

import numpy as np

from estimation.gap.answer.result import Rejected
from estimation.gap.answer.shape import Alike
from estimation.gap.effects.base import Effect, EffectParameter, Form
from estimation.gap.form.analytic import Plain
from estimation.models.base import Model
from estimation.models.expressions import evaluate, names_in

POINTS = 16  # at which two forms are compared: more than the zeros that products of a few powers can share
SAME = 1e-9  # of the ratio of two forms, by which rounding alone may move it
FUNCTIONS = {"abs": np.abs, "sign": np.sign}


def alike(
    plain: Sequence[Plain], line: str, model: Model, effects: Sequence[Effect], rejected: Sequence[Rejected]
) -> tuple[Alike, ...]:
    """Effects that add to `line` what a formula beside a shape does, times a number, and that `model` lacks."""
    return tuple(
        _told(effect, form, parameter, found, rejected)
        for formula in plain
        for effect in effects
        for form in effect.forms
        if form.obstacle(model) is None
        for parameter in form.parameters
        if (found := _as_parameter(formula, line, form, parameter)) is not None
    )


def _as_parameter(formula: Plain, line: str, form: Form, parameter: EffectParameter) -> tuple[float, float] | None:
    """(estimate, bound) of the effect's parameter where the formula is the same function; None where it is another."""
    pieces = form.terms.get(line, ())
    elsewhere = form.states or form.transforms or form.outputs or form.output_delays or form.lines
    if (
        len(form.terms) != 1
        or len(pieces) != 1
        or len(form.parameters) != 1
        or elsewhere
        or set(formula.estimates) != {"a"}
    ):
        return None
    names = sorted(names_in(formula.text) - {"a"})
    if names_in(pieces[0]) - {parameter.name} != set(names):
        return None
    points = dict(zip(names, np.random.default_rng(0).uniform(-1.0, 1.0, (len(names), POINTS)), strict=True))
    try:
        ours = evaluate(formula.text, {**points, "a": 1.0}, FUNCTIONS)
        theirs = evaluate(pieces[0], {**points, parameter.name: 1.0}, FUNCTIONS)
    except KeyError:  # of a function that no formula has
        return None
    ratio = ours / theirs
    if not np.ptp(ratio) < SAME * abs(ratio[0]):
        return None
    value, std = formula.estimates["a"]
    return float(value * ratio[0]), float(std * abs(ratio[0]))


def _told(
    effect: Effect, form: Form, parameter: EffectParameter, found: tuple[float, float], rejected: Sequence[Rejected]
) -> Alike:
    value = found[0]
    if not parameter.lower <= value <= parameter.upper:
        why = f"that is outside what is physically possible ({parameter.lower:g} to {parameter.upper:g})"
    else:
        known = [r.why for r in rejected if r.effect in (effect.name, f"{effect.name} ({form.label})")]
        why = (
            f"as a name it {known[-1]}"
            if known and known[-1].startswith("explains")
            else "as a name it does not stand by itself"
        )
    return Alike(effect.name, effect.title, parameter.name, found, parameter.unit, why)
