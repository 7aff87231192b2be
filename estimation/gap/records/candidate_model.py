"""One model that holds every candidate effect dormant, so that one compiled right-hand side serves the whole workflow.

All terms and lines that need no state of their own are written into the equations once, their parameters held at the
value without effect. Awakening a form frees its parameters (and attaches its transforms and delays); forms with states,
and forms that clash with one already dormant, are added to the equations when awakened.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from estimation.gap.effects.base import Effect, Form
from estimation.models.base import Model, Parameter, ParameterRole, Signal

DISTURBANCE = "disturbance_{}"


def with_dormant(
    model: Model, effects: Sequence[Effect], available: frozenset[str], disturbed: Sequence[str] = ()
) -> Model:
    """`model` with every applicable form without states dormant.

    available: inputs all flights have. disturbed: states whose rates get an input `disturbance_<state>`, zero in every
    fit, through which simulated nulls are shaken.
    """
    made = model.plus(
        inputs=[Signal(DISTURBANCE.format(s)) for s in disturbed],
        terms={f"{s}_dot": DISTURBANCE.format(s) for s in disturbed},
    )
    for effect in effects:
        # the richest form first: where forms share unknowns, its lines hold those of the others
        for form in sorted(effect.forms, key=lambda f: -len(f.parameters)):
            if form.states or form.lines or form.frees or not all(s.name in available for s in form.inputs):
                continue
            if form.obstacle(model) is None and form.obstacle(made) is None:
                made = _dormant(made, form)
    return made


def _dormant(model: Model, form: Form) -> Model:
    quiet = replace(form, transforms=(), output_delays={})
    added = quiet.added_to(model, fixed=True)
    names = {p.name for p in form.parameters}
    marked = tuple(replace(p, role=ParameterRole.DORMANT) if p.name in names else p for p in added.parameters)
    return replace(added, parameters=marked)


def awakened(model: Model, form: Form, at: Mapping[str, float] | None = None) -> Model:
    """`model` with a form free to act, its parameters starting at `at` (by default without effect)."""
    dormant = {p.name: p for p in model.parameters if p.role is ParameterRole.DORMANT}
    if not all(p.name in dormant for p in form.parameters):
        return form.added_to(model, at)
    fresh: dict[str, Parameter] = {}
    for p in form.parameters:
        old = dormant[p.name]
        start = (at or {}).get(p.name, old.start)
        fresh[p.name] = replace(
            old,
            fixed=False,
            start=start,
            lower=min(old.lower, start),
            upper=max(old.upper, start),
            role=ParameterRole.DERIVATIVE,
        )
    return replace(
        model,
        parameters=tuple(fresh.get(p.name, p) for p in model.parameters),
        transforms=model.transforms + tuple(t for t in form.transforms if t.input in model.input_names),
        output_delays={**model.output_delays, **form.output_delays},
    )
