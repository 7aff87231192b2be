"""From the state of the search to the answer: facts, decision, steps, models before and after, histories for pictures."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.gap.answer.result import EffectStep, Gap, GapResult, GapVerdict, Histories, Rejected
from estimation.gap.answer.shape import HeldInstrument, LaggedTerm, SwingingTerm
from estimation.gap.answer.words import conclude, describe_step
from estimation.gap.criteria import Criteria
from estimation.gap.decision.beside import ShapeContinuation, in_its_place, names_beside
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
from estimation.gap.decision.followers import beside_memory, late_rest, settled
from estimation.gap.decision.lineage import fitted
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
    floor_about,
    happened,
    held_back,
    held_step,
    searched,
    shaped_step,
    standing_round,
    why_not,
)
from estimation.gap.effects.base import Effect
from estimation.gap.errors import GapError
from estimation.gap.fit.baseline import Baseline
from estimation.gap.search.accept import estimates_of
from estimation.gap.search.state import AcceptedEffect, SearchState, Setting
from estimation.gap.shapes.search import CoefficientShape, ShapeSearch
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.kinematic_check import KinematicCheck
from estimation.gap.significance.measure import Floors, repeatability, rms_over_noise
from estimation.gap.significance.omnibus import Omnibus, examine
from estimation.models.base import Model

BAND = 20  # nulls from which the band of the floor in pictures is taken
NOT_SEARCHED = ShapeSearch(None, ())
EXPLAINED = (GapVerdict.NO_GAP, GapVerdict.GAP_CLOSED, GapVerdict.GAP_REDUCED)
LEFT = 5  # nameless signals in the JSON file


def concluded(setting: Setting, search: SearchState, check: KinematicCheck) -> GapResult:
    """Verdict, steps and words from what the rounds left."""
    prepared, first, last = setting.prepared, search.rounds[0], search.rounds[-1]
    floor = floor_about(setting, last)
    misfit = misfit_of(search.omnibus, setting.options.criteria)
    named = [step_of(setting, f, floor, misfit) for f in search.findings]
    left = rms_over_noise(last.baseline.problem, last.baseline.fit, setting.scatter)
    cannot = [*undetectable(first), *setting.untold]
    facts = facts_of(search, named, floor.covers(left), cannot, len(setting.untold))
    decision = decide(only_steered(facts) if setting.steered else facts, setting.options.criteria)
    kept = search.findings[: decision.kept]
    standing = kept[-1].child if kept else first.baseline
    found, event, unnamed, beside = NOT_SEARCHED, None, None, None
    instead = None if setting.steered else without_doubted(setting, search, kept, named, decision)
    if instead is not None:
        decision, kept, standing, found, beside = instead
    rest = search.omnibus
    unsearched = found.shape is None and not setting.steered
    if unsearched and (not kept or decision.verdict is GapVerdict.UNKNOWN):
        about = standing_round(setting, search, kept)
        found = searched(setting, search, about, decision)
        event = happened(setting, about) if found.shape is None else None
    elif unsearched:  # names say nothing of what happens at one time
        event = happened(setting, standing_round(setting, search, kept))
    if unsearched and found.shape is None and event is None:
        late = late_rest(setting, search, kept)
        if late is not None:
            decision = beside_memory(decision, [n.effect for n in named], late)
            if decision.kept < len(kept):
                kept = kept[: decision.kept]
                about = standing_round(setting, search, kept)
                standing, rest = about.baseline, examine(about)
                left = rms_over_noise(standing.problem, standing.fit, setting.scatter)
        follower = settled(found.follower, standing, setting.options.seed) if late is None else late.follower
        found, decision = replace(found, follower=follower), as_unknown(decision) if follower else decision
    if instead is None and event is None:
        beside = names_beside(setting, search, standing, found, decision)
    if beside is not None and (more := in_its_place(setting, search, kept, beside)) is not None:
        return concluded(setting, more, check)
    if beside is not None:
        kept, standing, found = (*kept, *beside.findings), beside.standing, beside.found
        own = floor_about(setting, beside.round_)
        named = [*named[: decision.kept], *(step_of(setting, f, own) for f in beside.findings)]
        decision = with_names(decision, [s.effect for s in named])
    still, rejected = "", turned_down(search, beside)
    if found.shape is not None:
        decision, unnamed = with_shape(decision), shaped_step(found.shape, standing, setting, rejected)
        last = found.shape.measured.round_
        rest, still = still_left(last, rest)
    elif event is not None:
        decision, unnamed = as_unknown(decision), event_step(event, Gap(left, left, floor.training_median))
    elif decision.verdict in EXPLAINED and (held := held_back(standing, prepared)):
        decision, unnamed = as_unknown(decision), held_step(held, Gap(left, left, floor.training_median))
    after = standing if found.shape is None else found.shape.measured.child
    named = [sized(s, f, after) for s, f in zip(named, kept, strict=False)]
    steps = told(decision, named, rest, check, left, floor, unnamed, found.follower)
    seen = views(first.baseline, after, prepared, after is not first.baseline)
    detectable = detectable_sizes(last)
    repeats = repeatability(last, prepared.names)
    asked = {h.effect.name for h in first.screen.hypotheses}
    tied = tuple(e for e in setting.effects if e.tied_to and e.name in asked)
    odd = [r.flight for r in repeats if r.odd]
    told_of = [s.shape.channel for s in steps if isinstance(s.shape, HeldInstrument)]
    stale = [n for n in prepared.stale if n not in told_of]
    before_model, after_model = models(setting.base, first.baseline, kept, found.shape)
    return GapResult(
        verdict=decision.verdict,
        text=conclude(
            decision.verdict,
            steps,
            detectable,
            cannot,
            tied,
            bool(prepared.holdout),
            odd,
            stale,
            setting.following,
            still,
        ),
        minimum_detectable=detectable,
        steps=steps,
        scores=effect_scores(first),
        threshold=first.threshold,
        nominal_threshold=nominal_threshold(len(first.screen.hypotheses), setting.options.criteria),
        rejected=(
            *rejected,
            *(Rejected(effect, why) for effect, why in decision.withdrawn),
            *(Rejected(t.place.words, why_not(t)) for t in found.tried),
        ),
        ties=ties_of(first),
        model_before=before_model,
        model_after=after_model,
        notes=prepared.notes,
        outputs=setting.base.output_names,
        views=seen,
        histories=histories(setting, first.baseline, after, last),
        details={
            "kinematic_gate": check.to_json(),
            "cannot_tell": [{"effect": e.name, "separate_by": e.separate_by} for e in cannot],
            "left": [
                {"kind": s.kind, "place": s.place, "what": s.what, "score": round(s.score, 2)}
                for s in rest.leading[:LEFT]
            ],
            "left_threshold": round(float(rest.threshold), 2),
            "where": [v.to_json() for v in seen],
            "repeatability": [r.to_json() for r in repeats],
            "nulls": setting.options.nulls,
            "seed": setting.options.seed,
        },
    )


def sized(step: EffectStep, finding: AcceptedEffect, after: Baseline) -> EffectStep:
    """A step with the size of its effect in the final model: what was missing beside it when it was found had bent it."""
    return replace(step, estimates=estimates_of(finding.round_, finding.candidate, after))


def still_left(round_: Round, before: Omnibus) -> tuple[Omnibus, str]:
    """What stands out without a name about a model, and how it shows where it matters; `before` where that cannot be examined."""
    try:
        rest = examine(round_)
    except GapError:  # a motion that cannot be linearised
        return before, ""
    return rest, how_it_shows(rest) if rest.matters(round_.criteria) else ""


def turned_down(search: SearchState, beside: ShapeContinuation | None) -> tuple[Rejected, ...]:
    """Hypotheses that the rounds turned down, but for those that stand beside a shape in the end."""
    if beside is None:
        return search.rejected
    standing = {f.candidate.hypothesis.label for f in beside.findings}
    return tuple(r for r in (*search.rejected, *beside.rejected) if r.effect not in standing)


def as_good(shape: CoefficientShape, name: EffectStep, criteria: Criteria) -> bool:
    """Whether a shape closes no less of the gap than a name does, but for what two formulas are equal by."""
    closed = name.gap.closed if name.holdout is None else name.holdout.closed
    return shape.measured.closed >= closed - criteria.form_equal


def without_doubted(
    setting: Setting,
    search: SearchState,
    kept: Sequence[AcceptedEffect],
    named: Sequence[EffectStep],
    decision: Decision,
) -> tuple[Decision, tuple[AcceptedEffect, ...], Baseline, ShapeSearch, ShapeContinuation | None] | None:
    """A shape in place of the first name that it explains more than: the decision, the names before it, the model with these, the
    shape and what stands beside it. None where there is no such name, or names found after it do not stand beside it."""
    number = next((k for k, f in enumerate(kept) if f.doubted), None)
    if number is None:
        return None
    about = kept[number].round_
    again = searched(setting, search, about, as_unknown(decision))
    if again.shape is None or not as_good(again.shape, named[number], setting.options.criteria):
        return None
    without = without_name(decision, kept[number], number, again.shape)
    beside = names_beside(setting, search, about.baseline, again, without)
    found = {f.candidate.hypothesis.effect.name for f in beside.findings} if beside is not None else set()
    if not {f.candidate.hypothesis.effect.name for f in kept[number + 1 :]} <= found:
        return None
    return without, tuple(kept[:number]), about.baseline, again, beside


def without_name(decision: Decision, finding: AcceptedEffect, number: int, shape: CoefficientShape) -> Decision:
    """The decision where a shape without a name takes the place of a name that it explains more than, after `number` others."""
    place = shape.fitted.increment.place.words
    why = f"a smooth function without a name ({place}) explains clearly more than this form of it"
    effect = finding.candidate.hypothesis.effect.name
    return replace(decision, kept=number, withdrawn=(*decision.withdrawn, (effect, why)))


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


def told(
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


def models(
    base: Model, first: Baseline, kept: Sequence[AcceptedEffect], shape: CoefficientShape | None = None
) -> tuple[Model, Model]:
    """The base as fitted, and the child with the effects that stand and a nameless shape (the same where there is neither)."""
    before = fitted(base, first.fit.values)
    if not kept and shape is None:
        return before, before
    child = base
    for f in kept:
        child = f.candidate.hypothesis.form.added_to(child)
    names = [base.name, *(f.candidate.hypothesis.effect.name for f in kept)]
    values = kept[-1].child.fit.values if kept else first.fit.values
    if shape is not None:
        values = shape.measured.child.fit.values
        child = shape.fitted.increment.written_into(child, values)
        names.append("nameless")
    return before, replace(fitted(child, values), name="+".join(names))


def histories(setting: Setting, before: Baseline, after: Baseline, last: Round) -> tuple[Histories, ...]:
    """Measured, before and after over time for every flight, training and held out."""
    band = np.array(
        [
            np.nanstd(np.concatenate([n[i][:, c] for n in last.null_residuals[:BAND] for i in range(len(n))]))
            for c in range(len(setting.base.outputs))
        ]
    )
    prepared, made = setting.prepared, []
    pairs = [(before.problem, before.fit, after.fit, False)]
    held_before, held_after = before.held_out, after.held_out
    if held_before is not None and held_after is not None:
        pairs.append((held_before[0], held_before[1], held_after[1], True))
    for problem, one, two, held in pairs:
        for i, record in enumerate(problem.records):
            z = problem.coarse[i].z
            made.append(
                Histories(
                    prepared.names[record.flight],
                    held,
                    record.time,
                    z,
                    z - one.residuals[i],
                    z - two.residuals[i],
                    band,
                )
            )
    return tuple(made)
