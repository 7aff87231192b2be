"""Lags and swings fitted with a model, and the names that are still needed beside them.

The catalogue has neither, and names can imitate one so well that no nameless term, a function of the motion at that instant,
is significant any more. So the model with names is also screened for a lag or a swing. Where one is significant, it is added to
the first model instead, and every name has to be significant beside it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.gap.answer.result import GapVerdict
from estimation.gap.answer.shape import LaggedTerm, SwingingTerm
from estimation.gap.criteria import Criteria
from estimation.gap.decision.decide import Decision
from estimation.gap.decision.unnamed import standing_round
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.errors import GapError
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.problem import ModelFit
from estimation.gap.search.accept import own_inflation
from estimation.gap.search.confirm import fit_hypothesis
from estimation.gap.search.state import AcceptedEffect, SearchState, Setting
from estimation.gap.shapes.lag_swing import find_memory, find_swing, rings
from estimation.gap.shapes.places import ModelMotion, places_of
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.measured_again import MeasuredAgain
from estimation.gap.significance.screen import Hypothesis
from estimation.models.base import Signal

Follower = LaggedTerm | SwingingTerm
SIZE, FOLLOWER = "nameless_late", "nameless_follower"
SWING, FREQUENCY, DAMPING = "nameless_swing", "nameless_frequency", "nameless_damping"
LEAST_DAMPING, MOST_DAMPING = 0.005, 1.0
OCTAVE = 2.0  # range of the frequency to either side of its first value
NEAR_LIMIT = 1.01  # times a limit: the fit was stopped by it
SIZE_RANGE = 1e3  # usual sizes to either side: no limit in practice


def hypothesis_of(follower: Follower, motion: ModelMotion) -> tuple[Hypothesis, dict[str, float]]:
    """A lag or a swing as a hypothesis, and the start values of its fit."""
    return lag_of(follower, motion) if isinstance(follower, LaggedTerm) else swing_of(follower, motion)


def lag_of(memory: LaggedTerm, motion: ModelMotion) -> tuple[Hypothesis, dict[str, float]]:
    """A term proportional to a first-order lag of a variable minus that variable, and its start value."""
    line, variable = memory.line, memory.variable
    scale = motion.scale[line] / motion.reach(variable)
    form = Form(
        SIZE,
        (EffectParameter(SIZE, "1", scale, -SIZE_RANGE * scale, SIZE_RANGE * scale),),
        terms={line: (f"{SIZE}*({FOLLOWER} - {variable})",)},
        states=(Signal(FOLLOWER, start=variable),),
        lines=(f"{FOLLOWER}_dot = ({variable} - {FOLLOWER})/{memory.time!r}",),
        requires=(line, variable),
    )
    return _unnamed(f"{line} late after {variable}", form), {SIZE: 0.0}


def swing_of(swing: SwingingTerm, motion: ModelMotion) -> tuple[Hypothesis, dict[str, float]]:
    """An oscillator driven by accelerations, with unknown frequency and damping, and its start values."""
    sizes = {f"{SWING}_{a}": size for a, size in swing.by.items()}
    scales = {f"{SWING}_{a}": motion.scale[swing.line] / motion.reach(a) for a in swing.by}
    w, z = swing.frequency, swing.damping
    drive = " + ".join(f"{SWING}_{a}*{a}" for a in swing.by)
    form = Form(
        SWING,
        (
            *(EffectParameter(n, "1", u, -SIZE_RANGE * u, SIZE_RANGE * u) for n, u in scales.items()),
            EffectParameter(FREQUENCY, "rad/s", 0.1 * w, w / OCTAVE, OCTAVE * w, w),
            EffectParameter(DAMPING, "1", 0.5 * z, LEAST_DAMPING, MOST_DAMPING, z),
        ),
        terms={swing.line: (SWING,)},
        states=(Signal(SWING, start=0.0), Signal(f"{SWING}_rate", start=0.0)),
        lines=(
            f"{SWING}_dot = {SWING}_rate",
            f"{SWING}_rate_dot = {FREQUENCY}^2*({drive} - {SWING}) - 2*{DAMPING}*{FREQUENCY}*{SWING}_rate",
        ),
        requires=(swing.line, *swing.by),
    )
    return _unnamed(swing.words, form), {**sizes, FREQUENCY: w, DAMPING: z}


def _unnamed(title: str, form: Form) -> Hypothesis:
    return Hypothesis(Effect(form.label, title, Group.UNSTEADY, "", "", "", "", {}, "", (form,)), form)


def settled_follower(follower: Follower | None, baseline: Baseline, seed: int) -> Follower | None:
    """A lag unchanged; a swing with frequency and damping as fitted with a model, and None where the fit does not ring. None also
    where it gains nearly as much with only the controls measured again. Unchanged where the fit runs away."""
    if follower is None:
        return None
    hypothesis, start = hypothesis_of(follower, ModelMotion.of(baseline.problem, baseline.fit))
    _, fitted = fit_hypothesis(baseline.problem, baseline.fit, hypothesis, start)
    if not fitted.diverged and not stands(follower, baseline, fitted, seed):
        return None
    return as_fitted(follower, fitted, baseline.criteria)


def stands(follower: Follower, baseline: Baseline, model_fit: ModelFit, seed: int) -> bool:
    """Whether a fitted lag or swing is significant by its own share of its gain."""
    gain = 2.0 * (baseline.fit.cost - model_fit.cost)
    share = MeasuredAgain(baseline, seed).share(gain, model_fit)
    return follower.score * math.sqrt(share) > follower.threshold


def as_fitted(follower: Follower, model_fit: ModelFit, criteria: Criteria) -> Follower | None:
    """A lag unchanged, a swing with the fitted values; None where that does not ring, or where a limit stopped the fit: an
    undamped tone needs no acceleration to drive it, and a frequency far from the first one belongs to another swing."""
    if not isinstance(follower, SwingingTerm) or model_fit.diverged:
        return follower
    values, std = model_fit.values, model_fit.std()
    fitted = replace(
        follower,
        by={a: float(values[f"{SWING}_{a}"]) for a in follower.by},
        frequency=float(values[FREQUENCY]),
        damping=float(values[DAMPING]),
        frequency_std=float(std[FREQUENCY]),
        damping_std=float(std[DAMPING]),
    )
    shift = max(fitted.frequency / follower.frequency, follower.frequency / fitted.frequency)
    plausible = fitted.damping > LEAST_DAMPING * NEAR_LIMIT and shift < OCTAVE / NEAR_LIMIT
    return fitted if plausible and rings(fitted.damping, criteria) else None


@dataclass(frozen=True)
class LateRest:
    """A lag or swing that is significant beside all names. needed: so many names, from the first on, are significant beside
    it."""

    follower: Follower
    needed: int


def late_rest(setting: Setting, search: SearchState, findings: Sequence[AcceptedEffect]) -> LateRest | None:
    """The lag or swing that the model with the names `findings` lacks; None where none is significant, or where the motion of
    that model cannot be linearised or flown: the answer stands without it."""
    try:
        return _late_rest(setting, search, findings, standing_round(setting, search, findings)) if findings else None
    except GapError:
        return None


def _late_rest(
    setting: Setting, search: SearchState, findings: Sequence[AcceptedEffect], about: Round
) -> LateRest | None:
    motion = ModelMotion.of(about.baseline.problem, about.baseline.fit)
    candidates = (find_memory(motion, about, places_of(setting.base)), find_swing(motion, about))
    significant_terms = [f for f in candidates if f is not None and stands_out(f, setting.options.criteria)]
    if not significant_terms:
        return None
    follower = max(significant_terms, key=lambda f: f.gain)
    first = search.rounds[0].baseline
    hypothesis, start = hypothesis_of(follower, ModelMotion.of(first.problem, first.fit))
    problem, current = fit_hypothesis(first.problem, first.fit, hypothesis, start)
    fitted = as_fitted(follower, current, setting.options.criteria)
    if fitted is None or current.diverged:
        return None if fitted is None else LateRest(fitted, len(findings))
    if not stands(follower, first, current, setting.options.seed):
        return None
    count = 0
    for finding in findings:
        estimates = {n: v for n, (v, _) in finding.candidate.estimates.items()}
        problem, extended = fit_hypothesis(problem, current, finding.candidate.hypothesis, estimates)
        if extended.diverged or not significant_beside(2.0 * (current.cost - extended.cost), finding):
            break
        current, count = extended, count + 1
    return LateRest(fitted, count)


def stands_out(follower: Follower, criteria: Criteria) -> bool:
    """Whether a lag or swing beside names is more than ordinary scatter."""
    return follower.score > criteria.restless_margin * follower.threshold


def significant_beside(gain: float, finding: AcceptedEffect) -> bool:
    """Whether a name that gains so much (twice a log-likelihood) beside a lag or swing would have been named."""
    return gain > own_inflation(finding.candidate) * finding.round_.threshold**2


def beside_memory(decision: Decision, named: Sequence[str], late: LateRest) -> Decision:
    """The decision in which a lag or swing replaces the names not needed beside it, and is unknown beside the others."""
    reason = f"not needed where {late.follower.words}, which explains more"
    return replace(
        decision,
        verdict=GapVerdict.UNKNOWN,
        kept=late.needed,
        withdrawn=(*decision.withdrawn, *((n, reason) for n in named[late.needed : decision.kept])),
    )
