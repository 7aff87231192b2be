"""Other bases: with all derivatives freed, with controls as given, and with noise that holds no effect.

A base may hold its derivatives at fixed numbers; all are freed before the search where several of these are off. A user's
simulation takes its derivatives from a handbook or a wind tunnel. A single wrong one is an answer of the search and gets its
name. Many that are off by some per cent each are no such answer, and together they hide the effect that is missing: with 14
lateral derivatives of a T-37 off by up to 10 %, a hidden `Cn_beta3` was not found.

The loop that controls close is left open where they answer what an effect does that the base lacks, and no gusts.

In each round the noise may contain an effect. The strengths of gusts and other process noise are estimated from the residuals
of the base. A large effect that the base lacks is in these residuals too, and passes for gusts. Then nulls scatter as widely
as the effect, and a large effect is missed where a smaller one is found: a `Cn_beta3` of 1 was named, one of 2 was not, for
the noise model had a hundred times the true process noise and the score was divided by 5.6. With the effect in the model the
estimated noise falls. The likelihood shows it, because the determinant of the noise covariance is a part of it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.errors import GapError
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Form, Group
from estimation.gap.fit.baseline import Baseline, fit_from
from estimation.gap.fit.closed_loop import ClosedLoop
from estimation.gap.fit.fitting import fit
from estimation.gap.fit.noise import NoiseModel
from estimation.gap.fit.problem import ModelFit
from estimation.gap.search.confirm import fit_hypothesis
from estimation.gap.search.select import NOISE_CANDIDATES, Choice, by_derivatives
from estimation.gap.search.state import Setting
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.screen import (
    Hypothesis,
    Screen,
    build_screen,
    hypotheses_for,
    linear_gains,
    linear_guess,
)
from estimation.gap.significance.tangent import Tangent
from estimation.models.base import Model, Parameter, ParameterRole
from estimation.models.expressions import names_in
from groundstation.flight import Flight

WORTH = 0.5  # of the gain that decides, with the noise of the base: chance reaches a third, an effect hidden in it more
LEADING = 3  # hypotheses of the largest gain by linear theory, of which one may be what a pilot answers or what bends derivatives
FACTOR = "k_"  # prefix of the factor on a simulation's coefficient; with all its derivatives free it is redundant
SIMULATED = "_sim"  # suffix of the value that the simulation itself gives a coefficient
OFF = 0.1  # prior width of a derivative for which the model has no parameter, as a share of the simulation's value


# ---- derivatives that are off
def derivatives_off(setting: Setting, baseline: Baseline) -> tuple[str, ...]:
    """All derivatives that a fitted base holds at fixed numbers, where several of them are off; otherwise none.

    They are freed one after the other, each time the one that gains most, until `many_derivatives` are found or none gains.
    """
    held = [e for e in setting.effects if e.group is Group.DERIVATIVE and any(f.frees for f in e.forms)]
    hypotheses = hypotheses_for(baseline.clean, held, setting.prepared.available)
    problem, model_fit, off = baseline.problem, baseline.fit, list[str]()
    while not many([*off, *factors_off(model_fit, baseline.criteria)] if off else (), baseline.criteria):
        untried = [h for h in hypotheses if h.form.frees[0] not in off]
        if model_fit.diverged or not untried:
            return ()
        name = largest(build_screen(Tangent(problem, model_fit), untried), baseline.criteria)
        if name is None:
            return ()
        off.append(name)
        if not many(off, baseline.criteria):
            problem = replace(problem, model=problem.model.freed(name))
            model_fit = fit_from(problem, model_fit)
    return tuple(h.form.frees[0] for h in hypotheses)


def many(off: Sequence[str], criteria: Criteria) -> bool:
    """Whether too many derivatives are off to be the answer of a search."""
    return len(off) >= criteria.many_derivatives


def factors_off(model_fit: ModelFit, criteria: Criteria) -> list[str]:
    """Factors on a simulation's coefficients that differ from 1 by more than their bounds allow.

    A wrong mass or air density, which is no error of a derivative, moves all factors.
    """
    factors = [n for n in model_fit.values if n.startswith(FACTOR)]
    return far_off(factors, dict.fromkeys(factors, 1.0), model_fit, criteria)


def far_off(names: Sequence[str], before: Mapping[str, float], model_fit: ModelFit, criteria: Criteria) -> list[str]:
    """The parameters that a fit with all of them free moved by more than their bounds allow. Freed one by one, more would look
    off: a wrong derivative biases its neighbours."""
    std = model_fit.std()
    return [n for n in names if n in std and abs(model_fit.values[n] - before[n]) > criteria.certain * std[n]]


def outstanding(setting: Setting, baseline: Baseline, names: Sequence[str]) -> str | None:
    """The one derivative that, freed alone, gains most of what freeing all of `names` gains; None where there is none.

    Surfaces that are known only by commands logged at intervals have errors in time, which bias every derivative by some per
    cent. Then many look off beside the one that is wrong.
    """
    problem, held_fit = baseline.problem, baseline.fit
    hypotheses = [
        h
        for h in hypotheses_for(baseline.clean, setting.effects, setting.prepared.available)
        if h.effect.group is Group.DERIVATIVE and h.form.frees and h.form.frees[0] in names
    ]
    name = largest(build_screen(Tangent(problem, held_fit), hypotheses), baseline.criteria) if hypotheses else None
    if name is None:
        return None
    single_fit = fit_from(replace(problem, model=problem.model.freed(name)), held_fit)
    joint_fit = fit_from(replace(problem, model=with_free_derivatives(problem.model, names)), held_fit)
    if single_fit.diverged or joint_fit.diverged:
        return None
    before, costs = problem.model.starts()[name], (held_fit.cost, single_fit.cost, joint_fit.cost)
    return name if stands_out(before, single_fit.values[name], costs, baseline.criteria) else None


def stands_out(before: float, after: float, costs: tuple[float, float, float], criteria: Criteria) -> bool:
    """Whether one derivative moved far, and freeing it gains most of what freeing all does. costs: of the fits with all held,
    with it free, with all free."""
    held_cost, single_cost, joint_cost = costs
    wrong = abs(after - before) > criteria.negligible * abs(before)
    return wrong and held_cost - single_cost >= criteria.closed_share * (held_cost - joint_cost) > 0.0


def largest(screen: Screen, criteria: Criteria) -> str | None:
    """The derivative whose freeing gains most, by linear theory; None where none gains clearly."""
    projected = screen.projected()
    gains = [projected.gain(screen.span(h)) for h in range(len(screen.hypotheses))]
    best = int(np.argmax(gains)) if gains else -1
    return screen.hypotheses[best].form.frees[0] if best >= 0 and gains[best] > criteria.certain**2 else None


def explained_by_one(setting: Setting, baseline: Baseline) -> bool:
    """Whether one of the leading hypotheses explains why derivatives are off: with it in the base they are not off any more.

    An airspeed that reads 5 % high makes every coefficient of a simulation look 9 % too large and every rate derivative 5 %.
    """
    for hypothesis, guess in _leading(setting, baseline, lambda form: not form.frees):
        child = None if by_derivatives(hypothesis) else _with(baseline, hypothesis, guess)
        if child is None:
            continue
        try:
            if not derivatives_off(setting, child):
                return True
        except GapError:  # about a fit that is barely stable nothing is known
            continue
    return False


def _leading(
    setting: Setting, baseline: Baseline, asked: Callable[[Form], bool]
) -> Iterator[tuple[Hypothesis, dict[str, float]]]:
    """The hypotheses of the largest gain about a fitted base, of the forms `asked`, with their sizes, by linear theory. Raises
    GapError where the motion cannot be linearised."""
    problem = baseline.problem
    hypotheses = hypotheses_for(baseline.clean, setting.effects, setting.prepared.available)
    screen = build_screen(Tangent(problem, baseline.fit), [h for h in hypotheses if asked(h.form)])
    for h in np.argsort(-linear_gains(screen, problem))[:LEADING]:
        yield screen.hypotheses[h], linear_guess(screen, problem, int(h))


def _with(baseline: Baseline, hypothesis: Hypothesis, guess: Mapping[str, float]) -> Baseline | None:
    """A fitted base with a hypothesis in it, its noise unchanged; None where the motion runs away."""
    trial, trial_fit = fit_hypothesis(baseline.problem, baseline.fit, hypothesis, guess)
    if trial_fit.diverged:
        return None
    values = {p.name: trial_fit.values[p.name] for p in hypothesis.form.parameters}
    clean = hypothesis.form.added_to(baseline.clean, values)
    return replace(baseline, problem=trial, fit=trial_fit, clean=clean)


def with_free_derivatives(model: Model, names: Sequence[str]) -> Model:
    """A base with the derivatives `names` free, and the factors on their coefficients held.

    What the simulation has beside these derivatives may be off too, and gets a nuisance parameter for each signal, `off_...`: in
    a coefficient with free derivatives the controls for which the model has none (yawing moment due to aileron: with it held, a
    product of inertia stood for 6 % of a `Cn_da`); in a coefficient without derivatives all signals (drag due to a lift that is
    off was taken for a nameless function of alpha).
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


def moved_in_words(names: Sequence[str], before: Mapping[str, float], baseline: Baseline, biased: bool = False) -> str:
    """A sentence on the freed derivatives that moved by more than their bounds allow. biased: whether errors in the times of
    commands may be the reason."""
    std, values = baseline.fit.std(), baseline.fit.values
    moved = far_off(names, before, baseline.fit, baseline.criteria)
    words = ", ".join(f"{n} from {before[n]:.4g} to {values[n]:.4g} +- {std[n]:.2g}" for n in moved)
    off = "look off, as errors in the times of commands bias them" if biased else "are off"
    return f"Several derivatives of the base {off}, so that all {len(names)} were refitted first: {words or 'none moved far'}."


def others_freed_in_words(names: Sequence[str]) -> str:
    """A sentence on the derivatives that were free while the search tested the one that stands out."""
    return f"The {len(names)} other derivatives of the base were free beside it, as errors in the times of commands bias them."


# ---- controls that answer an effect
def answers_an_effect(setting: Setting, baseline: Baseline, loop: ClosedLoop, flights: Sequence[Flight]) -> bool:
    """Whether the controls of `loop` answer what an effect does that the base lacks, and no gusts: with one of the leading
    hypotheses in the base no control moves with the residuals any more. flights: of the fit, training ones first.

    Late or loose controls are not asked: what one that answers gusts does beside its record looks like a dead zone of it.
    """
    try:
        leading = list(_leading(setting, baseline, lambda form: not form.transforms))
    except GapError:  # about a fit that is barely stable nothing is known
        return False
    children = (_with(baseline, hypothesis, guess) for hypothesis, guess in leading)
    return any(c is not None and not ClosedLoop.of(c, flights, loop.gains).felt(c) for c in children)


# ---- noise that contains an effect
def sharper_base(round_: Round, choice: Choice) -> Baseline | None:
    """The round's base refitted with the noise of the leading hypothesis that makes the flights likeliest; None where none of
    them makes the flights clearly likelier."""
    base = round_.baseline
    worth = [c for c in choice.candidates if c.gain > WORTH * base.criteria.noise_held]
    if not worth:
        return None
    base_deviance, _ = _deviance(base, base.fit)
    leading = sorted(worth, key=lambda c: -c.gain)[:NOISE_CANDIDATES]
    deviances = [_deviance(base, candidate.fit) for candidate in leading]
    deviance, noise = min(deviances, key=lambda pair: pair[0])
    return with_noise(base, noise) if holds_an_effect(base_deviance - deviance, base.criteria) else None


def holds_an_effect(likelier: float, criteria: Criteria) -> bool:
    """Whether the noise of the base contains an effect. likelier: increase of twice the log-likelihood with a hypothesis in the
    model and the noise estimated with it."""
    return likelier > criteria.noise_held


def _deviance(base: Baseline, model_fit: ModelFit) -> tuple[float, NoiseModel]:
    """Minus twice the log-likelihood (Whittle, up to a constant) of the training flights about a fitted model, with the noise
    estimated from its own residuals; and that noise."""
    noise, whiteners = base.noise_about(model_fit)
    pairs = list(zip(whiteners, model_fit.residuals, strict=True))
    return sum(w.log_determinant + w.energy(r) for w, r in pairs), noise


def with_noise(base: Baseline, noise: NoiseModel) -> Baseline | None:
    """A base fitted again with another noise; None where its motion runs away."""
    _, whiteners = base.noise_about(base.fit, noise)
    problem = replace(base.problem, whiteners=whiteners)
    fitted = fit(problem, base.fit.values, base.fit.locals)
    return None if fitted.diverged else replace(base, problem=problem, fit=fitted, noise=noise)
