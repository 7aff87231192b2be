"""From the state of the search to the answer: facts, decision, steps, models before and after, histories for pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.gap.answer.result import EffectStep, Gap, GapResult, GapVerdict, Histories, Rejected
from estimation.gap.answer.shape import Happened, HeldInstrument, LaggedTerm, SwingingTerm
from estimation.gap.answer.words import conclude, describe_not_predicted, describe_step, rest_of_inputs
from estimation.gap.decision.beside import ShapeContinuation, in_its_place, names_beside, without_doubted
from estimation.gap.decision.decide import (
    Decision,
    Named,
    VerdictFacts,
    as_unknown,
    decide,
    only_steered,
    with_names,
    with_shape,
)
from estimation.gap.decision.followers import beside_memory, late_rest, settled_follower
from estimation.gap.decision.held_out import held_out_step, not_predicted
from estimation.gap.decision.lineage import models
from estimation.gap.decision.location import views
from estimation.gap.decision.steps import (
    detectable_sizes,
    effect_scores,
    how_it_shows,
    misfit_of,
    nominal_threshold,
    step_of,
    ties_of,
    undetectable,
    unknown_step,
)
from estimation.gap.decision.unnamed import (
    event_step,
    events_in_time,
    find_held_instrument,
    floor_about,
    held_step,
    search_shape,
    shaped_step,
    standing_round,
)
from estimation.gap.effects.base import Effect
from estimation.gap.errors import GapError
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.channel_noise import sample_interval, time_bound
from estimation.gap.search.accept import estimates_of
from estimation.gap.search.state import AcceptedEffect, SearchState, Setting
from estimation.gap.shapes.search import ShapeSearch
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.kinematic_check import KinematicCheck
from estimation.gap.significance.measure import Floors, odd_flights, repeatability, rms_over_noise
from estimation.gap.significance.omnibus import Omnibus, examine

BAND = 20  # nulls from which the band of the floor in pictures is taken
NOT_SEARCHED = ShapeSearch(None, ())
EXPLAINED = (GapVerdict.NO_GAP, GapVerdict.GAP_CLOSED, GapVerdict.GAP_REDUCED)
LEFT = 5  # nameless signals in the JSON file


@dataclass
class _Standing:
    """What stands, step after step of the conclusion.

    named: steps of all accepted effects, of which the decision keeps some; kept: these effects; model: the one with them; rest:
    what stands out without a name; gap: plain, that is left; found: a shape, lag or swing for it; event: what happened instead.
    """

    setting: Setting
    search: SearchState
    floor: Floors
    cannot: list[Effect]
    named: list[EffectStep]
    decision: Decision
    kept: tuple[AcceptedEffect, ...]
    model: Baseline
    rest: Omnibus
    gap: float
    found: ShapeSearch = NOT_SEARCHED
    event: Happened | None = None


def concluded(setting: Setting, search: SearchState, check: KinematicCheck) -> GapResult:
    """Verdict, steps and words from what the rounds left."""
    state = _decided(setting, search)
    replaced = None
    if not setting.steered and not state.decision.doubted:
        replaced = without_doubted(setting, search, state.kept, state.named, state.decision)
    continuation = None
    if replaced is not None:
        state.decision, state.kept, state.model, state.found, continuation = replaced
    elif not setting.steered and not state.decision.doubted:
        _search_unnamed(state)
    if replaced is None and state.event is None and not state.decision.doubted:
        continuation = names_beside(setting, search, state.model, state.found, state.decision)
    if continuation is not None:
        renewed = in_its_place(setting, search, state.kept, continuation)
        if renewed is not None:
            return concluded(setting, renewed, check)
        _add_names(state, continuation)
    return _answer(state, check, rejected_hypotheses(search, continuation))


def _decided(setting: Setting, search: SearchState) -> _Standing:
    """The decision on what the rounds found, before anything without a name is looked for."""
    first, last = search.rounds[0], search.rounds[-1]
    floor = floor_about(setting, last)
    misfit = misfit_of(search.omnibus)
    steps = [step_of(setting, f, floor, misfit) for f in search.findings]
    gap = rms_over_noise(last.baseline.problem, last.baseline.fit, setting.scatter)
    cannot = [*undetectable(first), *setting.excluded_effects]
    facts = facts_of(search, steps, floor.covers(gap), cannot, len(setting.excluded_effects))
    facts = only_steered(facts) if setting.steered else facts
    decision = decide(facts, setting.options.criteria, bool(setting.commanded))
    standing = search.findings[: decision.kept]
    model = standing[-1].child if standing else first.baseline
    return _Standing(setting, search, floor, cannot, steps, decision, standing, model, search.omnibus, gap)


def _search_unnamed(state: _Standing) -> None:
    """Look for a shape, an event in time, or a lag or swing that the standing names leave."""
    setting, search = state.setting, state.search
    round_ = standing_round(setting, search, state.kept)
    if not state.kept or state.decision.verdict is GapVerdict.UNKNOWN:
        state.found = search_shape(setting, search, round_, state.decision)
    if state.found.shape is None:  # names say nothing of what happens at one time
        state.event = events_in_time(setting, round_)
    if state.found.shape is not None or state.event is not None:
        return
    late_term = late_rest(setting, search, state.kept)
    if late_term is None:
        follower = settled_follower(state.found.follower, state.model, setting.options.seed)
    else:
        follower = late_term.follower
        state.decision = beside_memory(state.decision, [n.effect for n in state.named], late_term)
        if state.decision.kept < len(state.kept):
            state.kept = state.kept[: state.decision.kept]
            round_ = standing_round(setting, search, state.kept)
            state.model, state.rest = round_.baseline, examine(round_)
            state.gap = rms_over_noise(state.model.problem, state.model.fit, setting.scatter)
    state.found = replace(state.found, follower=follower)
    if follower:
        state.decision = as_unknown(state.decision)


def _add_names(state: _Standing, beside: ShapeContinuation) -> None:
    """Add the names that stand beside a shape, with the shape about the model that has them."""
    floor = floor_about(state.setting, beside.round_)
    state.kept, state.model, state.found = (*state.kept, *beside.findings), beside.standing, beside.found
    new_steps = (step_of(state.setting, f, floor) for f in beside.findings)
    state.named = [*state.named[: state.decision.kept], *new_steps]
    state.decision = with_names(state.decision, [s.effect for s in state.named])


def _of_inputs(state: _Standing, rest: Omnibus) -> str:
    """A sentence on what the times of recorded commands may have made: the first name withdrawn, or the nameless rest."""
    if not state.decision.doubted:
        return ""
    if state.decision.withdrawn:
        first = state.named[state.decision.kept]
        return rest_of_inputs(state.setting.commanded, first.effect, first.score, first.threshold)
    place = rest.leading[0].place if rest.leading else "the motion"
    return rest_of_inputs(state.setting.commanded, f"what is left in {place}", rest.score, rest.threshold)


def _answer(state: _Standing, check: KinematicCheck, rejected: tuple[Rejected, ...]) -> GapResult:
    """The answer in which all that stands is told."""
    setting, search, shapes = state.setting, state.search, state.found
    prepared, first, last = setting.prepared, search.rounds[0], search.rounds[-1]
    decision, rest, final = state.decision, state.rest, state.model
    unchanged_gap, unnamed, remainder = Gap(state.gap, state.gap, state.floor.training_median), None, ""
    if shapes.shape is not None:
        decision, unnamed = with_shape(decision), shaped_step(shapes.shape, state.model, setting, rejected)
        last, final = shapes.shape.measured.round_, shapes.shape.measured.child
        rest, remainder = still_left(last, rest)
    elif state.event is not None:
        decision, unnamed = as_unknown(decision), event_step(state.event, unchanged_gap)
    elif (
        not state.decision.doubted
        and decision.verdict in EXPLAINED
        and (stale := find_held_instrument(state.model, prepared))
    ):
        decision, unnamed = as_unknown(decision), held_step(stale, unchanged_gap)
    unlike = not_predicted(final, prepared, state.floor)
    if unlike is not None and decision.verdict is GapVerdict.NO_GAP:
        decision, unnamed, unlike = as_unknown(decision), held_out_step(unlike, unchanged_gap, state.floor), None
    effect_steps = [with_final_estimates(s, f, final) for s, f in zip(state.named, state.kept, strict=False)]
    repeats, detectable = repeatability(last, prepared.names), detectable_sizes(last)
    odd = odd_flights(repeats)
    late = shapes.follower if len(odd) < max(len(repeats), 1) else None  # what each has otherwise swings for no flight
    steps = steps_in_words(decision, effect_steps, rest, check, state.gap, state.floor, unnamed, late)
    stages = views(first.baseline, final, prepared, final is not first.baseline)
    before_model, after_model = models(setting.base, first.baseline, state.kept, shapes.shape)
    hypotheses = {h.effect.name for h in first.screen.hypotheses}
    held_channels = [s.shape.channel for s in steps if isinstance(s.shape, HeldInstrument)]
    return GapResult(
        verdict=decision.verdict,
        text=conclude(
            decision.verdict,
            steps,
            detectable,
            state.cannot,
            tuple(e for e in setting.effects if e.tied_to and e.name in hypotheses),
            bool(prepared.holdout),
            odd,
            [n for n in prepared.stale if n not in held_channels],
            setting.following,
            remainder,
            len(repeats),
            _of_inputs(state, rest),
            describe_not_predicted(unlike) if unlike is not None else "",
        ),
        minimum_detectable=detectable,
        steps=steps,
        scores=effect_scores(first),
        threshold=first.threshold,
        nominal_threshold=nominal_threshold(len(first.screen.hypotheses), setting.options.criteria),
        rejected=(
            *rejected,
            *(Rejected(effect, reason) for effect, reason in decision.withdrawn),
            *(Rejected(t.place.words, f"as a shape without a name: {t.why}") for t in shapes.tried),
        ),
        ties=ties_of(first),
        model_before=before_model,
        model_after=after_model,
        notes=prepared.notes,
        outputs=setting.base.output_names,
        views=stages,
        histories=histories(setting, first.baseline, final, last),
        details={
            "kinematic_gate": check.to_json(),
            "cannot_tell": [{"effect": e.name, "separate_by": e.separate_by} for e in state.cannot],
            "left": [
                {"kind": s.kind, "place": s.place, "what": s.what, "score": round(s.score, 2)}
                for s in rest.leading[:LEFT]
            ],
            "left_threshold": round(float(rest.threshold), 2),
            "where": [v.to_json() for v in stages],
            "repeatability": [r.to_json() for r in repeats],
            "nulls": setting.options.nulls,
            "seed": setting.options.seed,
        },
    )


def with_final_estimates(step: EffectStep, finding: AcceptedEffect, after: Baseline) -> EffectStep:
    """A step with the size of its effect in the final model: what was missing beside it when it was found had bent it. The bound
    of a time has what sampling leaves open in it."""
    estimates = estimates_of(finding.round_, finding.candidate, after)
    interval, criteria = sample_interval(after.problem.records), after.criteria
    stated = {n: estimates[n] for n in estimates if step.units.get(n) == "s"}
    times = {n: (value, time_bound(std, interval, criteria)) for n, (value, std) in stated.items()}
    left_open = time_bound(0.0, interval, criteria) if times else 0.0
    return replace(step, estimates={**estimates, **times}, sampling_bound=left_open)


def still_left(round_: Round, before: Omnibus) -> tuple[Omnibus, str]:
    """What stands out without a name about a model, and how it shows where it matters; `before` where that cannot be examined."""
    try:
        rest = examine(round_)
    except GapError:  # a motion that cannot be linearised
        return before, ""
    return rest, how_it_shows(rest) if rest.significant else ""


def rejected_hypotheses(search: SearchState, beside: ShapeContinuation | None) -> tuple[Rejected, ...]:
    """Hypotheses that the rounds turned down, but for those that stand beside a shape in the end."""
    if beside is None:
        return search.rejected
    standing = {f.candidate.hypothesis.label for f in beside.findings}
    return tuple(r for r in (*search.rejected, *beside.rejected) if r.effect not in standing)


def facts_of(
    search: SearchState, named: Sequence[EffectStep], covered: bool, cannot: Sequence[Effect], untold: int = 0
) -> VerdictFacts:
    """What decides, from the state of the search and the steps of all accepted effects. untold: not asked at all."""
    forms = [f.candidate.hypothesis.form for f in search.findings]
    hypotheses = search.rounds[0].screen.hypotheses
    return VerdictFacts(
        named=tuple(
            Named(s.effect, s.score, s.gap, s.holdout, frozenset((*form.outputs, *form.output_delays)))
            for s, form in zip(named, forms, strict=True)
        ),
        rest=search.omnibus.score,
        rest_threshold=search.omnibus.threshold,
        rest_place=search.omnibus.leading[0].place if search.omnibus.leading else "",
        covered=covered,
        blind=len(cannot),
        asked=len({h.effect.name for h in hypotheses if not h.effect.tied_to}) + untold,
    )


def steps_in_words(
    decision: Decision,
    named: Sequence[EffectStep],
    rest: Omnibus,
    check: KinematicCheck,
    left: float,
    floor: Floors,
    unnamed: EffectStep | None = None,
    late: LaggedTerm | SwingingTerm | None = None,
) -> tuple[EffectStep, ...]:
    """The steps of the answer in words: those of the names that stand, and the nameless rest where that is the verdict.

    rest: what stands out without a name; unnamed: it with a shape or a time, where one was found; late: a lag or swing that gains
    where none was. The kinematic check saw the flights as they are: it speaks of the first.
    """
    steps = list(named[: decision.kept])
    if unnamed is not None:
        steps.append(unnamed)
    elif decision.verdict is GapVerdict.UNKNOWN:
        steps.append(replace(unknown_step(rest, Gap(left, left, floor.training_median)), shape=late))
    if steps:
        steps[0] = replace(steps[0], where=replace(steps[0].where, origin=check.origin))
    return tuple(replace(s, text=describe_step(s)) for s in steps)


def histories(setting: Setting, before: Baseline, after: Baseline, last: Round) -> tuple[Histories, ...]:
    """Measured, before and after over time for every flight, training and held out."""
    band = np.array(
        [
            np.nanstd(np.concatenate([n[i][:, c] for n in last.null_residuals[:BAND] for i in range(len(n))]))
            for c in range(len(setting.base.outputs))
        ]
    )
    prepared, courses = setting.prepared, []
    pairs = [(before.problem, before.fit, after.fit, False)]
    held_before, held_after = before.held_out, after.held_out
    if held_before is not None and held_after is not None:
        pairs.append((held_before[0], held_before[1], held_after[1], True))
    for problem, first, second, is_holdout in pairs:
        for i, record in enumerate(problem.records):
            z, name = problem.coarse[i].z, prepared.names[record.flight]
            courses.append(
                Histories(name, is_holdout, record.time, z, z - first.residuals[i], z - second.residuals[i], band)
            )
    return tuple(courses)
