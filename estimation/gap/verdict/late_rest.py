"""Names beside a coefficient that follows late, or swings: which of them are still needed?

Neither is an entry of the catalogue, and names can imitate one well enough that the nameless terms, which are functions of the
moment, say nothing any more. So where names stand they are asked too. Where one still stands out of the nulls about the model
with them, it is put into the first model instead, and every name has to show that it is significant beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.gap.answer.result import GapVerdict
from estimation.gap.criteria import Criteria
from estimation.gap.errors import GapError
from estimation.gap.form.memory import find_memory
from estimation.gap.form.places import ModelMotion, places_of
from estimation.gap.form.swing import find_swing
from estimation.gap.likelihood.fitting import LikelihoodProblem, ModelFit
from estimation.gap.search.accept import own_inflation
from estimation.gap.search.confirm import fit_hypothesis
from estimation.gap.search.search_state import AcceptedEffect, SearchState, Setting
from estimation.gap.tests_of_fit.calibration import Round
from estimation.gap.verdict.decide import Decision
from estimation.gap.verdict.followers import Follower, as_fitted, hypothesis_of, stands
from estimation.gap.verdict.nameless import standing_round


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
    flown = ModelMotion.of(about.baseline.problem, about.baseline.fit)
    asked = (find_memory(flown, about, places_of(setting.base)), find_swing(flown, about))
    found = [f for f in asked if f is not None and stands_out(f, setting.options.criteria)]
    if not found:
        return None
    follower = max(found, key=lambda f: f.gain)
    first = search.rounds[0].baseline
    hypothesis, start = hypothesis_of(follower, ModelMotion.of(first.problem, first.fit))
    problem, beside = fit_hypothesis(first.problem, first.fit, hypothesis, start)
    fitted = as_fitted(follower, beside, setting.options.criteria)
    if fitted is None or beside.diverged:
        return None if fitted is None else LateRest(fitted, len(kept))
    if not stands(follower, first, beside, setting.options.seed):
        return None
    needed = 0
    for finding in kept:
        problem, after = _with_name(problem, beside, finding)
        if after.diverged or not significant(2.0 * (beside.cost - after.cost), finding):
            break
        beside, needed = after, needed + 1
    return LateRest(fitted, needed)


def stands_out(follower: Follower, criteria: Criteria) -> bool:
    """Whether a lag or swing beside names is more than restless scatter."""
    return follower.score > criteria.restless_margin * follower.threshold


def significant(gain: float, finding: AcceptedEffect) -> bool:
    """Whether a name that gains so much (twice a log-likelihood) beside a lag or swing would have been named."""
    return gain > own_inflation(finding.candidate) * finding.round_.threshold**2


def _with_name(
    problem: LikelihoodProblem, beside: ModelFit, finding: AcceptedEffect
) -> tuple[LikelihoodProblem, ModelFit]:
    at = {n: v for n, (v, _) in finding.candidate.estimates.items()}
    return fit_hypothesis(problem, beside, finding.candidate.hypothesis, at)


def beside_memory(decision: Decision, named: Sequence[str], late: LateRest) -> Decision:
    """The decision where a lag or swing takes the place of names not needed beside it, and is unknown beside the others."""
    why = f"not needed where {late.follower.words}, which explains more"
    return replace(
        decision,
        verdict=GapVerdict.UNKNOWN,
        kept=late.needed,
        withdrawn=(*decision.withdrawn, *((n, why) for n in named[late.needed : decision.kept])),
    )
