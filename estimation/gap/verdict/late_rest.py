"""Names beside a coefficient that follows late: which of them are still needed?

A memory is no entry of the catalogue, and two names together can imitate one well enough that the nameless terms, which are
functions of the moment, say nothing any more. So where names stand the memory is asked too. Where it still stands out of the
nulls about the model with them, a first-order lag of that coefficient is put into the first model instead, and every name has to
show that it is significant beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.gap.answer.result import Verdict
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.errors import GapError
from estimation.gap.form.memory import Memory, find_memory
from estimation.gap.form.places import Flown, places_of
from estimation.gap.likelihood.fitting import Fit, Problem
from estimation.gap.search.accept import own_inflation
from estimation.gap.search.confirm import fit_hypothesis
from estimation.gap.search.search_state import Finding, SearchState, Setting
from estimation.gap.tests_of_fit.calibration import Round
from estimation.gap.tests_of_fit.hypotheses import Hypothesis
from estimation.gap.verdict.decide import Decision
from estimation.gap.verdict.nameless import standing_round
from estimation.models.base import Signal

SIZE, FOLLOWER = "nameless_late", "nameless_follower"


@dataclass(frozen=True)
class LateRest:
    """A memory that stands out beside all names. needed: so many of them, from the first on, are significant beside it."""

    memory: Memory
    needed: int


def late_rest(setting: Setting, search: SearchState, kept: Sequence[Finding]) -> LateRest | None:
    """The memory that the model with the names `kept` lacks; None where none stands out of the nulls about it, or where its
    motion cannot be linearised or flown: the answer stands without that question."""
    try:
        return _late_rest(setting, search, kept, standing_round(setting, search, kept)) if kept else None
    except GapError:
        return None


def _late_rest(setting: Setting, search: SearchState, kept: Sequence[Finding], about: Round) -> LateRest | None:
    memory = find_memory(Flown.of(about.baseline.problem, about.baseline.fit), about, places_of(setting.base))
    if memory is None or not stands_out(memory, setting.options.criteria):
        return None
    first = search.rounds[0].baseline
    lag = lag_of(memory, Flown.of(first.problem, first.fit))
    problem, beside = fit_hypothesis(first.problem, first.fit, lag, {SIZE: 0.0})
    if beside.diverged:
        return LateRest(memory, len(kept))
    needed = 0
    for finding in kept:
        problem, after = _with_name(problem, beside, finding)
        if after.diverged or not significant(2.0 * (beside.cost - after.cost), finding):
            break
        beside, needed = after, needed + 1
    return LateRest(memory, needed)


def stands_out(memory: Memory, criteria: Criteria) -> bool:
    """Whether a memory beside names is more than restless scatter."""
    return memory.score > criteria.restless_margin * memory.threshold


def significant(gain: float, finding: Finding) -> bool:
    """Whether a name that gains so much (twice a log-likelihood) beside a memory would have been named."""
    return gain > own_inflation(finding.candidate) * finding.round_.threshold**2


def lag_of(memory: Memory, flown: Flown) -> Hypothesis:
    """What a memory adds to its coefficient: how far a first-order lag of its variable is behind it."""
    line, variable = memory.place.line, memory.place.variable
    usual = flown.scale[line] / flown.reach(variable)
    form = Form(
        SIZE,
        (EffectParameter(SIZE, "1", usual, -1e3 * usual, 1e3 * usual),),
        terms={line: (f"{SIZE}*({FOLLOWER} - {variable})",)},
        states=(Signal(FOLLOWER, start=variable),),
        lines=(f"{FOLLOWER}_dot = ({variable} - {FOLLOWER})/{memory.time!r}",),
        requires=(line, variable),
    )
    effect = Effect(SIZE, f"{line} late after {variable}", Group.UNSTEADY, "", "", "", "", {}, "", (form,))
    return Hypothesis(effect, form)


def _with_name(problem: Problem, beside: Fit, finding: Finding) -> tuple[Problem, Fit]:
    at = {n: v for n, (v, _) in finding.candidate.estimates.items()}
    return fit_hypothesis(problem, beside, finding.candidate.hypothesis, at)


def beside_memory(decision: Decision, named: Sequence[str], late: LateRest) -> Decision:
    """The decision where a memory takes the place of names that are not needed beside it, and is unknown beside the others."""
    place = late.memory.place
    why = (
        f"not needed where {place.line} follows {place.variable} some {late.memory.time:g} s late, which explains more"
    )
    return replace(
        decision,
        verdict=Verdict.UNKNOWN,
        kept=late.needed,
        withdrawn=(*decision.withdrawn, *((n, why) for n in named[late.needed : decision.kept])),
    )
