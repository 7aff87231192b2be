"""A base that holds its derivatives at numbers, several of which are off: it is refitted in all of them before anything is asked.

A simulation of one's own has its derivatives from a handbook or a wind tunnel. One that is wrong is an answer, and gets its
name; of many that are off by some per cent each none is what the flights miss, and together they hide what is: of a T-37 with 14
lateral derivatives off by up to 10 % nothing was found where a `Cn_beta3` was hidden.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Group
from estimation.gap.fit.baseline import Baseline, fit_from
from estimation.gap.fit.problem import ModelFit
from estimation.gap.search.state import Setting
from estimation.gap.significance.screen import Screen, build_screen, hypotheses_for
from estimation.gap.significance.tangent import Tangent
from estimation.models.base import Model, Parameter, ParameterRole
from estimation.models.expressions import names_in

FACTOR = "k_"  # of a coefficient of a simulation: its derivatives, all free, say the same
SIMULATED = "_sim"  # what the simulation itself has of a coefficient
OFF = 0.1  # of the simulation's own: prior width of a derivative that the model has no parameter for


def derivatives_off(setting: Setting, baseline: Baseline) -> tuple[str, ...]:
    """All derivatives that a fitted base holds at numbers, where several are off, one beside the other; none otherwise."""
    held = [e for e in setting.effects if e.group is Group.DERIVATIVE and any(f.frees for f in e.forms)]
    hypotheses = hypotheses_for(baseline.clean, held, setting.prepared.available)
    problem, found, off = baseline.problem, baseline.fit, list[str]()
    while not many([*off, *factors_off(found, baseline.criteria)] if off else (), baseline.criteria):
        rest = [h for h in hypotheses if h.form.frees[0] not in off]
        if found.diverged or not rest:
            return ()
        name = largest(build_screen(Tangent(problem, found), rest), baseline.criteria)
        if name is None:
            return ()
        off.append(name)
        if not many(off, baseline.criteria):
            problem = replace(problem, model=problem.model.freed(name))
            found = fit_from(problem, found)
    return tuple(h.form.frees[0] for h in hypotheses)


def many(off: Sequence[str], criteria: Criteria) -> bool:
    """Whether so many derivatives that are off are no answer any more."""
    return len(off) >= criteria.many_derivatives


def factors_off(found: ModelFit, criteria: Criteria) -> list[str]:
    """Factors on coefficients of a simulation that are off: each says that what it multiplies is, beside the derivatives that are
    free. All are where mass or air density is wrong, which is no derivative's."""
    factors = [n for n in found.values if n.startswith(FACTOR)]
    return far_off(factors, dict.fromkeys(factors, 1.0), found, criteria)


def far_off(names: Sequence[str], before: Mapping[str, float], found: ModelFit, criteria: Criteria) -> list[str]:
    """Those that a fit moved by more than their bounds allow. Freed one by one more look off: a wrong one bends what
    its neighbours have to be."""
    std = found.std()
    return [n for n in names if n in std and abs(found.values[n] - before[n]) > criteria.certain * std[n]]


def outstanding(setting: Setting, baseline: Baseline, names: Sequence[str]) -> str | None:
    """The one of several derivatives whose number alone explains most of what all of them free do; None where there is none.

    Where surfaces are known by commands that a log has at intervals, their times bend every derivative by some per cent: many
    look off beside the one that is.
    """
    problem, held = baseline.problem, baseline.fit
    hypotheses = [
        h
        for h in hypotheses_for(baseline.clean, setting.effects, setting.prepared.available)
        if h.effect.group is Group.DERIVATIVE and h.form.frees and h.form.frees[0] in names
    ]
    first = largest(build_screen(Tangent(problem, held), hypotheses), baseline.criteria) if hypotheses else None
    if first is None:
        return None
    alone = fit_from(replace(problem, model=problem.model.freed(first)), held)
    every = fit_from(replace(problem, model=with_free_derivatives(problem.model, names)), held)
    if alone.diverged or every.diverged:
        return None
    before, costs = problem.model.starts()[first], (held.cost, alone.cost, every.cost)
    return first if stands_out(before, alone.values[first], costs, baseline.criteria) else None


def stands_out(before: float, after: float, costs: tuple[float, float, float], criteria: Criteria) -> bool:
    """Whether the number of one derivative is wrong, and what freeing it gains is most of what freeing all does. costs: of the
    fits with all held, with it free, with all free."""
    held, alone, every = costs
    wrong = abs(after - before) > criteria.wrong_number * abs(before)
    return wrong and held - alone >= criteria.closed_share * (held - every) > 0.0


def largest(screen: Screen, criteria: Criteria) -> str | None:
    """The derivative that gains most, by linear theory; None where none gains clearly."""
    projected = screen.projected()
    gains = [projected.gain(screen.span(h)) for h in range(len(screen.hypotheses))]
    best = int(np.argmax(gains)) if gains else -1
    return screen.hypotheses[best].form.frees[0] if best >= 0 and gains[best] > criteria.certain**2 else None


def with_free_derivatives(model: Model, names: Sequence[str]) -> Model:
    """A base with derivatives free, and the factors on their coefficients held.

    What the simulation has by a control for which the model has no derivative (yawing moment by the aileron) is off as the others
    are: with it held, a product of inertia stood for 6 % of a `Cn_da`. So is all of a coefficient without derivatives: drag of a
    lift that is off was a nameless function of alpha.
    """
    coefficients = [n.removesuffix(SIMULATED) for n in model.definitions if n.endswith(SIMULATED)]
    with_derivatives = {c for c in coefficients if any(n.startswith(f"{c}_") for n in names)}
    controls = {s.name for s in model.inputs if s.control}
    signals = {s.name for s in (*model.states, *model.inputs)}
    free = model.freed(*names).fixed(*(FACTOR + c for c in with_derivatives if FACTOR + c in model.free_names))
    for c in coefficients:
        without = (controls if c in with_derivatives else signals) - names_in(model.definitions[c])
        for piece in model.definitions[c + SIMULATED].split(" + "):
            signal = piece.rpartition("*")[2]
            if signal in without:
                share = Parameter(
                    f"off_{c}_{signal}", "1", 0.0, prior_mean=0.0, prior_std=OFF, role=ParameterRole.NUISANCE
                )
                free = free.plus(terms={c: f"{share.name}*{piece}"}, parameters=[share])
    return free


def moved_in_words(names: Sequence[str], before: Mapping[str, float], baseline: Baseline, bent: bool = False) -> str:
    """A sentence on the derivatives that were set free and moved by more than their bounds allow. bent: the times of commands may
    be why."""
    std, values = baseline.fit.std(), baseline.fit.values
    moved = far_off(names, before, baseline.fit, baseline.criteria)
    words = ", ".join(f"{n} from {before[n]:.4g} to {values[n]:.4g} +- {std[n]:.2g}" for n in moved)
    off = "look off, as times of commands bend them" if bent else "are off"
    return f"Several derivatives of the base {off}, so that all {len(names)} were refitted first: {words or 'none moved far'}."


def others_freed_in_words(names: Sequence[str]) -> str:
    """A sentence on the derivatives that were free while the one that stands out was asked for."""
    return f"The {len(names)} other derivatives of the base were free beside it, as times of commands bend them."
