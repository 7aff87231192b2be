"""From the state of the search to the answer: facts, decision, steps, models before and after, histories for pictures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.errors import GapError
from estimation.gap.answer.result import EffectStep, Gap, GapResult, GapVerdict, Histories, Rejected
from estimation.gap.answer.shape import Follower, Happened, HeldInstrument, LaggedTerm, NotPredicted
from estimation.gap.answer.words import conclude, describe_not_predicted, describe_step, rest_of_inputs
from estimation.gap.decision import unnamed
from estimation.gap.decision.beside import (
    ShapeContinuation,
    beside_memory,
    in_its_place,
    late_rest,
    names_beside,
    settled_follower,
    stands_out,
    without_doubted,
)
from estimation.gap.decision.decide import Decision, Named, VerdictFacts, as_unknown, decide, only_steered, with_names
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
from estimation.gap.effects.base import Effect
from estimation.gap.fit.baseline import Baseline
from estimation.gap.records.flight_records import sample_interval
from estimation.gap.search.accept import estimates_of
from estimation.gap.search.state import AcceptedEffect, SearchState, Setting
from estimation.gap.shapes.search import ShapeSearch
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.instruments import KinematicCheck
from estimation.gap.significance.measure import Floors, odd_flights, repeatability, rms_over_noise
from estimation.gap.significance.omnibus import Omnibus, examine

BAND = 20  # nulls for the band of the floor in pictures
LEADING = 5  # nameless signals in the JSON file
NOT_SEARCHED = ShapeSearch(None, ())


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
    """The answer: verdict, steps and words from the state after all rounds.

    Something without a name that stands out of the first nulls has to stand out of all. Rounds about the names that stand
    beside a shape may name what was behind it. The answer is then that of these rounds, as long as more names stand than
    before: otherwise the same search would follow, without end.
    """
    state = _decided(setting, search)
    while True:
        beside = _names_beside_unnamed(state)
        if _is_hasty(state):
            state = _decided(setting, state.search.with_enough_nulls)
            continue
        renewed = None if beside is None else in_its_place(setting, state.search, state.findings, beside)
        further = None if renewed is None else _decided(setting, renewed)
        if further is None or further.decision.kept <= state.decision.kept:
            break
        state = further
    if beside is not None:
        _add_names(state, beside)
    return _answer(state, check, rejected_hypotheses(state.search, beside))


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


def _names_beside_unnamed(state: _Conclusion) -> ShapeContinuation | None:
    """Look for a shape in place of a doubted name, or for what has no name beside all; the names that stand beside a shape.

    Nothing without a name is believed where every control only follows the motion, or where the inputs may be its cause.
    """
    setting, search = state.setting, state.search
    if setting.steered or state.decision.doubted:
        return None
    replaced = without_doubted(setting, search, state.findings, state.named, state.decision)
    if replaced is not None:
        state.decision, state.findings, state.model, state.shapes, continuation = replaced
        return continuation
    _search_unnamed(state)
    if state.event is not None or _is_hasty(state):
        return None
    return names_beside(setting, search, state.model, state.shapes, state.decision)


def _is_hasty(state: _Conclusion) -> bool:
    """Whether something without a name stands out of the first nulls alone."""
    return (state.shapes.found or state.event is not None) and not state.search.rounds[-1].has_enough_nulls


def _search_unnamed(state: _Conclusion) -> None:
    """Look for a shape, an event in time, or a lag or swing beside the standing names."""
    setting, search = state.setting, state.search
    round_ = unnamed.standing_round(setting, search, state.findings)
    if not state.findings or state.decision.verdict is GapVerdict.UNKNOWN:
        state.shapes = unnamed.search_shape(setting, search, round_, state.decision)
    if state.shapes.shape is not None:
        return
    event = unnamed.events_in_time(setting, round_)  # also with names, which are no events in time
    if event is not None and not _outweighs(state.shapes.follower, event):
        state.event = event
        return
    late = late_rest(setting, search, state.findings)
    if late is None:
        follower = settled_follower(state.shapes.follower, state.model, setting.options.seed)
    else:
        follower = late.follower
        state.decision = beside_memory(state.decision, [n.effect for n in state.named], late)
        if state.decision.kept < len(state.findings):
            state.findings = state.findings[: state.decision.kept]
            round_ = unnamed.standing_round(setting, search, state.findings)
            state.model, state.rest = round_.baseline, examine(round_)
            state.gap = rms_over_noise(state.model.problem, state.model.fit, setting.scatter)
    state.shapes = replace(state.shapes, follower=follower)
    if follower:
        state.decision = as_unknown(state.decision)
    else:
        state.event = event


def _outweighs(follower: Follower | None, event: Happened) -> bool:
    """Whether a lag or swing stands clearer out of the nulls than an event in time: what a strong one leaves at some instant of
    the first model looks like an event."""
    strongest = max(e.score / e.threshold for e in event.events)
    return follower is not None and follower.score / follower.threshold > strongest


def _add_names(state: _Conclusion, beside: ShapeContinuation) -> None:
    """Add the names that stand beside a shape, and the shape found about the model with them."""
    floor = state.setting.floors(beside.round_)
    state.findings, state.model, state.shapes = (*state.findings, *beside.findings), beside.baseline, beside.shapes
    new_steps = (step_of(state.setting, f, floor) for f in beside.findings)
    state.named = [*state.named[: state.decision.kept], *new_steps]
    state.decision = with_names(state.decision, [s.effect for s in state.named])


def _nameless_step(
    state: _Conclusion, rejected: Sequence[Rejected], unlike: NotPredicted | None, gap: Gap
) -> tuple[Decision, EffectStep | None]:
    """The step of a shape, an event, an instrument that holds its values or a held-out flight that is not predicted, if any, and
    the decision with it. gap: unchanged."""
    decision, shape = state.decision, state.shapes.shape
    if shape is not None:
        reduced = replace(decision, verdict=GapVerdict.GAP_REDUCED)  # smaller, but unnamed
        return reduced, unnamed.shaped_step(shape, state.model, state.setting, rejected)
    step = None
    is_explained = not decision.doubted and decision.verdict not in (GapVerdict.UNKNOWN, GapVerdict.CANNOT_TELL)
    if state.event is not None:
        step = unnamed.event_step(state.event, gap)
    elif is_explained and (held := unnamed.find_held_instrument(state.model, state.setting.prepared)):
        step = unnamed.held_step(held, gap)
    elif unlike is not None and decision.verdict is GapVerdict.NO_GAP:
        step = unnamed.held_out_step(unlike, gap, state.floor)
    return (decision, None) if step is None else (as_unknown(decision), step)


def _answer(state: _Conclusion, check: KinematicCheck, rejected: tuple[Rejected, ...]) -> GapResult:
    """The answer from the final state."""
    setting, search, prepared, shape = state.setting, state.search, state.setting.prepared, state.shapes.shape
    first, last, final, rest, remainder = search.rounds[0], search.rounds[-1], state.model, state.rest, ""
    if shape is not None:
        last, final = shape.measured.round_, shape.measured.child
        rest, remainder = still_left(last, rest)
    unchanged_gap = Gap(state.gap, state.gap, state.floor.training_median)
    unlike = unnamed.not_predicted(final, prepared, state.floor)
    decision, nameless = _nameless_step(state, rejected, unlike, unchanged_gap)
    if nameless is not None and nameless.shape is unlike:
        unlike = None  # its step has the words
    effect_steps = [with_final_estimates(s, f, final) for s, f in zip(state.named, state.findings, strict=False)]
    repeats, detectable = repeatability(last, prepared.names), detectable_sizes(last)
    odd = odd_flights(repeats)
    late = state.shapes.follower
    # flights that all differ look like one that swings, or lags a little; a clear lag that the model lacks makes them differ
    if late is not None and len(odd) >= max(len(repeats), 1):
        late = late if isinstance(late, LaggedTerm) and stands_out(late, setting.options.criteria) else None
    steps = steps_in_words(decision, effect_steps, rest, check, unchanged_gap, nameless, late)
    stages = views(first.baseline, final, prepared)
    before_model, after_model = models(setting.base, first.baseline, state.findings, shape)
    hypotheses = {h.effect.name for h in first.screen.hypotheses}
    held_channels = [s.shape.channel for s in steps if isinstance(s.shape, HeldInstrument)]
    return GapResult(
        verdict=decision.verdict,
        text=conclude(
            decision.verdict,
            steps,
            detectable,
            state.cannot,
            [e for e in setting.effects if e.tied_to and e.name in hypotheses],
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
        rejected=(*rejected, *(Rejected(*withdrawn) for withdrawn in decision.withdrawn), *state.shapes.rejected),
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


def _of_inputs(state: _Conclusion, rest: Omnibus) -> str:
    """A sentence on the first withdrawn name, or the nameless rest, that the times of recorded commands may have caused."""
    if not state.decision.doubted:
        return ""
    if state.decision.withdrawn:
        first = state.named[state.decision.kept]
        return rest_of_inputs(state.setting.commanded, first.effect, first.score, first.threshold)
    place = rest.leading[0].place if rest.leading else "the motion"
    return rest_of_inputs(state.setting.commanded, f"what is left in {place}", rest.score, rest.threshold)


def with_final_estimates(step: EffectStep, finding: AcceptedEffect, after: Baseline) -> EffectStep:
    """A step with the size of its effect in the final model: effects that were still missing had biased the first one. The bound
    of a time includes the uncertainty from sampling."""
    estimates = estimates_of(finding.round_, finding.candidate, after)
    sampling_bound = after.criteria.timing_share * sample_interval(after.problem.records)
    times = {n: (v, math.hypot(std, sampling_bound)) for n, (v, std) in estimates.items() if step.units.get(n) == "s"}
    return replace(step, estimates={**estimates, **times}, sampling_bound=sampling_bound if times else 0.0)


def still_left(round_: Round, before: Omnibus) -> tuple[Omnibus, str]:
    """The nameless signals about a model, and a description where they are significant; `before` where the model's motion cannot
    be linearised."""
    try:
        rest = examine(round_)
    except GapError:
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
    hypotheses, rest = search.rounds[0].screen.hypotheses, search.omnibus
    return VerdictFacts(
        named=tuple(
            Named(s.effect, s.score, s.gap, s.holdout, frozenset((*form.outputs, *form.output_delays)))
            for s, form in zip(named, forms, strict=True)
        ),
        rest=rest.score,
        rest_threshold=rest.threshold,
        rest_place=rest.leading[0].place if rest.leading else "",
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
    nameless: EffectStep | None = None,
    late: Follower | None = None,
) -> tuple[EffectStep, ...]:
    """The steps of the answer with their words: the standing names, and the nameless rest where that is the verdict.

    rest: nameless signals; gap: unchanged; nameless: the step of a shape or an event, if any; late: a lag or swing without one.
    The kinematic check looks at the flights before any step: its origin belongs to the first.
    """
    steps = list(named[: decision.kept])
    if nameless is not None:
        steps.append(nameless)
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
    fitted = [(before.problem, before.fit, after.fit)]
    if before.held_out is not None and after.held_out is not None:
        fitted.append((*before.held_out, after.held_out[1]))
    courses = []
    for is_holdout, (problem, first, second) in zip((False, True), fitted, strict=False):
        for record, segment, r, s in zip(
            problem.records, problem.coarse, first.residuals, second.residuals, strict=True
        ):
            z, name = segment.z, setting.prepared.names[record.flight]
            courses.append(Histories(name, is_holdout, record.time, z, z - r, z - s, band))
    return tuple(courses)


def more_beside_what_records_show_wrong(result: GapResult) -> bool:
    """Whether effects were found by which a control or the aircraft moves otherwise than recorded, and something else was named
    or is unknown.

    Then the user's simulation has to be evaluated again at the true deflections and motion. It was, with its slopes, at the
    recorded ones: with a drag by |elevator| the slope has the wrong sign until a late elevator crosses zero, which looks like a
    drag that the simulation lacks. An effect that stands alone explains everything.
    """
    before, controls = set(result.model_before.transforms), {s.name for s in result.model_before.inputs if s.control}
    moved = any(t not in before and t.input in controls for t in result.model_after.transforms)
    shown_otherwise = result.model_after.instruments != result.model_before.instruments
    return (moved or shown_otherwise) and (len(result.steps) > 1 or result.verdict is GapVerdict.UNKNOWN)
