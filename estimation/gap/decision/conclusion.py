"""From the state of the search to the answer: facts, decision, steps, models before and after, histories for pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.gap.answer.result import EffectStep, Gap, GapResult, GapVerdict, Histories, Rejected
from estimation.gap.answer.shape import Happened, HeldInstrument, LaggedTerm, SwingingTerm
from estimation.gap.answer.words import conclude, describe_not_predicted, describe_step, rest_of_inputs
from estimation.gap.decision.beside import ShapeContinuation, in_its_place, names_beside, without_doubted
from estimation.gap.decision.decide import Decision, Named, VerdictFacts, as_unknown, decide, only_steered, with_names
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

BAND = 20  # nulls for the band of the floor in pictures
NOT_SEARCHED = ShapeSearch(None, ())
EXPLAINED = (GapVerdict.NO_GAP, GapVerdict.GAP_CLOSED, GapVerdict.GAP_REDUCED)
LEADING = 5  # nameless signals in the JSON file


@dataclass
class _Conclusion:
    """The state of the conclusion.

    named: steps of all accepted effects; findings: the effects that stand; model: the fitted model with these; rest: the nameless
    signals about it; gap: its plain gap; shapes: a shape, lag or swing for the rest; event: events in time instead.
    """

    setting: Setting
    search: SearchState
    floor: Floors
    cannot: list[Effect]
    named: list[EffectStep]
    decision: Decision
    findings: tuple[AcceptedEffect, ...]
    model: Baseline
    rest: Omnibus
    gap: float
    shapes: ShapeSearch = NOT_SEARCHED
    event: Happened | None = None


def concluded(setting: Setting, search: SearchState, check: KinematicCheck) -> GapResult:
    """The answer: verdict, steps and words from the state after all rounds."""
    return _concluded(_decided(setting, search), check)


def _concluded(state: _Conclusion, check: KinematicCheck) -> GapResult:
    """The answer from the decision on the effects of the rounds."""
    setting, search = state.setting, state.search
    replaced = None
    if not setting.steered and not state.decision.doubted:
        replaced = without_doubted(setting, search, state.findings, state.named, state.decision)
    continuation = None
    if replaced is not None:
        state.decision, state.findings, state.model, state.shapes, continuation = replaced
    elif not setting.steered and not state.decision.doubted:
        _search_unnamed(state)
        if (state.shapes.found or state.event is not None) and (surer := search.with_enough_nulls) is not search:
            return concluded(setting, surer, check)
    if replaced is None and state.event is None and not state.decision.doubted:
        continuation = names_beside(setting, search, state.model, state.shapes, state.decision)
    if continuation is not None:
        further = _with_more_names(state, continuation)
        if further is not None:
            return _concluded(further, check)
        _add_names(state, continuation)
    return _answer(state, check, rejected_hypotheses(search, continuation))


def _with_more_names(state: _Conclusion, continuation: ShapeContinuation) -> _Conclusion | None:
    """The decision after the rounds that name what was behind a shape; None where no more names stand than before, for then the
    same search would follow, without end."""
    renewed = in_its_place(state.setting, state.search, state.findings, continuation)
    if renewed is None:
        return None
    further = _decided(state.setting, renewed)
    return further if further.decision.kept > state.decision.kept else None


def _decided(setting: Setting, search: SearchState) -> _Conclusion:
    """The decision on the effects of the rounds, before the search for shapes and events."""
    first, last = search.rounds[0], search.rounds[-1]
    floor = setting.floors(last)
    misfit = misfit_of(search.omnibus)
    steps = [step_of(setting, f, floor, misfit) for f in search.findings]
    gap = rms_over_noise(last.baseline.problem, last.baseline.fit, setting.scatter)
    cannot = [*undetectable(first), *setting.excluded_effects]
    facts = facts_of(search, steps, floor.covers(gap), cannot, len(setting.excluded_effects))
    facts = only_steered(facts) if setting.steered else facts
    decision = decide(facts, setting.options.criteria, bool(setting.commanded))
    standing = search.findings[: decision.kept]
    model = standing[-1].child if standing else first.baseline
    return _Conclusion(setting, search, floor, cannot, steps, decision, standing, model, search.omnibus, gap)


def _search_unnamed(state: _Conclusion) -> None:
    """Look for a shape, an event in time, or a lag or swing beside the standing names."""
    setting, search = state.setting, state.search
    round_ = standing_round(setting, search, state.findings)
    if not state.findings or state.decision.verdict is GapVerdict.UNKNOWN:
        state.shapes = search_shape(setting, search, round_, state.decision)
    if state.shapes.shape is None:  # also with names, which are no events in time
        state.event = events_in_time(setting, round_)
    if state.shapes.shape is not None or state.event is not None:
        return
    late_term = late_rest(setting, search, state.findings)
    if late_term is None:
        follower = settled_follower(state.shapes.follower, state.model, setting.options.seed)
    else:
        follower = late_term.follower
        state.decision = beside_memory(state.decision, [n.effect for n in state.named], late_term)
        if state.decision.kept < len(state.findings):
            state.findings = state.findings[: state.decision.kept]
            round_ = standing_round(setting, search, state.findings)
            state.model, state.rest = round_.baseline, examine(round_)
            state.gap = rms_over_noise(state.model.problem, state.model.fit, setting.scatter)
    state.shapes = replace(state.shapes, follower=follower)
    if follower:
        state.decision = as_unknown(state.decision)


def _add_names(state: _Conclusion, beside: ShapeContinuation) -> None:
    """Add the names that stand beside a shape, and the shape found about the model with them."""
    floor = state.setting.floors(beside.round_)
    state.findings, state.model, state.shapes = (*state.findings, *beside.findings), beside.baseline, beside.shapes
    new_steps = (step_of(state.setting, f, floor) for f in beside.findings)
    state.named = [*state.named[: state.decision.kept], *new_steps]
    state.decision = with_names(state.decision, [s.effect for s in state.named])


def _of_inputs(state: _Conclusion, rest: Omnibus) -> str:
    """A sentence on the first withdrawn name, or the nameless rest, that the times of recorded commands may have caused."""
    if not state.decision.doubted:
        return ""
    if state.decision.withdrawn:
        first = state.named[state.decision.kept]
        return rest_of_inputs(state.setting.commanded, first.effect, first.score, first.threshold)
    place = rest.leading[0].place if rest.leading else "the motion"
    return rest_of_inputs(state.setting.commanded, f"what is left in {place}", rest.score, rest.threshold)


def _answer(state: _Conclusion, check: KinematicCheck, rejected: tuple[Rejected, ...]) -> GapResult:
    """The answer from the final state."""
    setting, search, shapes = state.setting, state.search, state.shapes
    prepared, first, last = setting.prepared, search.rounds[0], search.rounds[-1]
    decision, rest, final = state.decision, state.rest, state.model
    unchanged_gap, unnamed, remainder = Gap(state.gap, state.gap, state.floor.training_median), None, ""
    if shapes.shape is not None:
        decision = replace(decision, verdict=GapVerdict.GAP_REDUCED)  # smaller, but unnamed
        unnamed = shaped_step(shapes.shape, state.model, setting, rejected)
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
    effect_steps = [with_final_estimates(s, f, final) for s, f in zip(state.named, state.findings, strict=False)]
    repeats, detectable = repeatability(last, prepared.names), detectable_sizes(last)
    odd = odd_flights(repeats)
    late = shapes.follower if len(odd) < max(len(repeats), 1) else None  # no swing explains flights that all differ
    steps = steps_in_words(decision, effect_steps, rest, check, unchanged_gap, unnamed, late)
    stages = views(first.baseline, final, prepared)
    before_model, after_model = models(setting.base, first.baseline, state.findings, shapes.shape)
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
            *shapes.rejected,
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
                for s in rest.leading[:LEADING]
            ],
            "left_threshold": round(float(rest.threshold), 2),
            "where": [v.to_json() for v in stages],
            "repeatability": [r.to_json() for r in repeats],
            "nulls": setting.options.nulls,
            "seed": setting.options.seed,
        },
    )


def with_final_estimates(step: EffectStep, finding: AcceptedEffect, after: Baseline) -> EffectStep:
    """A step with the size of its effect in the final model: effects that were still missing had biased the first one. The bound
    of a time includes the uncertainty from sampling."""
    estimates = estimates_of(finding.round_, finding.candidate, after)
    interval, criteria = sample_interval(after.problem.records), after.criteria
    times = {
        n: (value, time_bound(std, interval, criteria))
        for n, (value, std) in estimates.items()
        if step.units.get(n) == "s"
    }
    sampling_bound = time_bound(0.0, interval, criteria) if times else 0.0
    return replace(step, estimates={**estimates, **times}, sampling_bound=sampling_bound)


def still_left(round_: Round, before: Omnibus) -> tuple[Omnibus, str]:
    """The nameless signals about a model, and a description where they are significant; `before` where the model's motion cannot
    be linearised."""
    try:
        rest = examine(round_)
    except GapError:  # a motion that cannot be linearised
        return before, ""
    return rest, how_it_shows(rest) if rest.significant else ""


def rejected_hypotheses(search: SearchState, beside: ShapeContinuation | None) -> tuple[Rejected, ...]:
    """Hypotheses rejected by the rounds, except those that finally stand beside a shape."""
    if beside is None:
        return search.rejected
    standing = {f.candidate.hypothesis.label for f in beside.findings}
    return tuple(r for r in (*search.rejected, *beside.rejected) if r.effect not in standing)


def facts_of(
    search: SearchState, named: Sequence[EffectStep], covered: bool, cannot: Sequence[Effect], untold: int = 0
) -> VerdictFacts:
    """The facts from the state of the search and the steps of all accepted effects. untold: effects that were not searched."""
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
    gap: Gap,
    unnamed: EffectStep | None = None,
    late: LaggedTerm | SwingingTerm | None = None,
) -> tuple[EffectStep, ...]:
    """The steps of the answer with their words: the standing names, and the nameless rest where that is the verdict.

    rest: nameless signals; gap: unchanged; unnamed: the step of a shape or an event, if any; late: a lag or swing without one.
    The kinematic check looks at the flights before any step: its origin belongs to the first.
    """
    steps = list(named[: decision.kept])
    if unnamed is not None:
        steps.append(unnamed)
    elif decision.verdict is GapVerdict.UNKNOWN:
        steps.append(unknown_step(rest, gap, late))
    if steps:
        steps[0] = replace(steps[0], where=replace(steps[0].where, origin=check.origin))
    return tuple(replace(s, text=describe_step(s)) for s in steps)


def histories(setting: Setting, before: Baseline, after: Baseline, last: Round) -> tuple[Histories, ...]:
    """Measured, before and after over time for every flight, training and held out."""
    nulls = np.concatenate([residuals for null in last.null_residuals[:BAND] for residuals in null])
    compared = [column[np.isfinite(column)] for column in nulls.T]
    band = np.array([column.std() if column.size else np.nan for column in compared])
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
