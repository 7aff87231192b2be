"""Lags and swings fitted with a model, and the names beside them: which of these are still needed?

Neither is an entry of the catalogue, and names can imitate one well enough that the nameless terms, which are functions of the
moment, say nothing any more. So where names stand they are asked too. Where one still stands out of the nulls about the model
with them, it is put into the first model instead, and every name has to show that it is significant beside it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from estimation.gap.answer.result import GapVerdict
from estimation.gap.answer.shape import LaggedTerm, SwingingTerm
from estimation.gap.criteria import Criteria
from estimation.gap.decision.decide import Decision
from estimation.gap.decision.unnamed import standing_round
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.errors import GapError
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
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
OCTAVE = 2.0  # to either side of the frequency it was found at
NEAR_LIMIT = 1.01  # times a limit: stopped there by it


def hypothesis_of(follower: Follower, flown: ModelMotion) -> tuple[Hypothesis, dict[str, float]]:
    """What a lag or a swing adds to its coefficient, and where its fit begins."""
    return lag_of(follower, flown) if isinstance(follower, LaggedTerm) else swing_of(follower, flown)


def lag_of(memory: LaggedTerm, flown: ModelMotion) -> tuple[Hypothesis, dict[str, float]]:
    """How far a first-order lag of a variable is behind it."""
    line, variable = memory.line, memory.variable
    scale = flown.scale[line] / flown.reach(variable)
    form = Form(
        SIZE,
        (EffectParameter(SIZE, "1", scale, -1e3 * scale, 1e3 * scale),),
        terms={line: (f"{SIZE}*({FOLLOWER} - {variable})",)},
        states=(Signal(FOLLOWER, start=variable),),
        lines=(f"{FOLLOWER}_dot = ({variable} - {FOLLOWER})/{memory.time!r}",),
        requires=(line, variable),
    )
    return _unnamed(f"{line} late after {variable}", form), {SIZE: 0.0}


def swing_of(swing: SwingingTerm, flown: ModelMotion) -> tuple[Hypothesis, dict[str, float]]:
    """What an oscillator makes of accelerations; its frequency and damping are unknowns too."""
    sizes = {f"{SWING}_{a}": size for a, size in swing.by.items()}
    scales = {f"{SWING}_{a}": flown.scale[swing.line] / flown.reach(a) for a in swing.by}
    w, z = swing.frequency, swing.damping
    drive = " + ".join(f"{SWING}_{a}*{a}" for a in swing.by)
    form = Form(
        SWING,
        (
            *(EffectParameter(n, "1", u, -1e3 * u, 1e3 * u) for n, u in scales.items()),
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
    """A lag as it is; a swing with frequency and damping as fitted beside a model, and none where the fit ends in something that
    does not ring. None too where it gains nearly as much with only the controls measured again. As linear theory has it where
    the fit runs away."""
    if follower is None:
        return None
    hypothesis, start = hypothesis_of(follower, ModelMotion.of(baseline.problem, baseline.fit))
    _, fitted = fit_hypothesis(baseline.problem, baseline.fit, hypothesis, start)
    if not fitted.diverged and not stands(follower, baseline, fitted, seed):
        return None
    return as_fitted(follower, fitted, baseline.criteria)


def stands(follower: Follower, baseline: Baseline, found: ModelFit, seed: int) -> bool:
    """Whether a fitted lag or swing is significant by what of its gain is its own."""
    share = MeasuredAgain(baseline, seed).share(2.0 * (baseline.fit.cost - found.cost), found)
    return follower.score * math.sqrt(share) > follower.threshold


def as_fitted(follower: Follower, found: ModelFit, criteria: Criteria) -> Follower | None:
    """A lag as it is, a swing with what was fitted; none where that does not ring, or where a limit stopped it: a tone that never
    dies is driven by nothing, and one that is elsewhere than it was found is another."""
    if not isinstance(follower, SwingingTerm) or found.diverged:
        return follower
    fitted = _with_bounds(follower, found.values, found.std())
    shift = max(fitted.frequency / follower.frequency, follower.frequency / fitted.frequency)
    plausible = fitted.damping > LEAST_DAMPING * NEAR_LIMIT and shift < OCTAVE / NEAR_LIMIT
    return fitted if plausible and rings(fitted.damping, criteria) else None


def _with_bounds(swing: SwingingTerm, values: Mapping[str, float], std: Mapping[str, float]) -> SwingingTerm:
    return replace(
        swing,
        by={a: float(values[f"{SWING}_{a}"]) for a in swing.by},
        frequency=float(values[FREQUENCY]),
        damping=float(values[DAMPING]),
        frequency_std=float(std[FREQUENCY]),
        damping_std=float(std[DAMPING]),
    )


@dataclass(frozen=True)
class LateRest:
    """What stands out beside all names. needed: so many of them, from the first on, are significant beside it."""

    follower: Follower
    needed: int


def late_rest(setting: Setting, search: SearchState, kept: Sequence[AcceptedEffect]) -> LateRest | None:
    """The lag or swing that the model with the names `kept` lacks; None where none stands out of the nulls about it, or where its
    motion cannot be linearised or flown: the answer stands without that question."""
    try:
        return _late_rest(setting, search, kept, standing_round(setting, search, kept)) if kept else None
    except GapError:
        return None


def _late_rest(setting: Setting, search: SearchState, kept: Sequence[AcceptedEffect], about: Round) -> LateRest | None:
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
        return None if fitted is None else LateRest(fitted, len(kept))
    if not stands(follower, first, current, setting.options.seed):
        return None
    count = 0
    for finding in kept:
        problem, extended = _with_name(problem, current, finding)
        if extended.diverged or not significant_beside(2.0 * (current.cost - extended.cost), finding):
            break
        current, count = extended, count + 1
    return LateRest(fitted, count)


def stands_out(follower: Follower, criteria: Criteria) -> bool:
    """Whether a lag or swing beside names is more than restless scatter."""
    return follower.score > criteria.restless_margin * follower.threshold


def significant_beside(gain: float, finding: AcceptedEffect) -> bool:
    """Whether a name that gains so much (twice a log-likelihood) beside a lag or swing would have been named."""
    return gain > own_inflation(finding.candidate) * finding.round_.threshold**2


def _with_name(
    problem: LikelihoodProblem, beside: ModelFit, finding: AcceptedEffect
) -> tuple[LikelihoodProblem, ModelFit]:
    values = {n: v for n, (v, _) in finding.candidate.estimates.items()}
    return fit_hypothesis(problem, beside, finding.candidate.hypothesis, values)


def beside_memory(decision: Decision, named: Sequence[str], late: LateRest) -> Decision:
    """The decision where a lag or swing takes the place of names not needed beside it, and is unknown beside the others."""
    reason = f"not needed where {late.follower.words}, which explains more"
    return replace(
        decision,
        verdict=GapVerdict.UNKNOWN,
        kept=late.needed,
        withdrawn=(*decision.withdrawn, *((n, reason) for n in named[late.needed : decision.kept])),
    )
