"""Names beside a shape: effects of the catalogue that were hidden by a larger effect without a name.

A name has to gain most of what the best nameless term gains; otherwise an unknown effect would get a wrong name. Once the unknown
effect has a shape, the search runs again about the model with the shape. Where it names effects, the shape is sought again beside
these names. The search also runs about these names without the shape: beside them the unknown effect may turn out to be one of
the catalogue.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.gap.answer.result import EffectStep, Rejected
from estimation.gap.answer.shape import SwingingTerm
from estimation.gap.criteria import Criteria
from estimation.gap.decision.decide import Decision, as_unknown
from estimation.gap.decision.unnamed import search_shape
from estimation.gap.errors import GapError
from estimation.gap.fit.baseline import Baseline, fit_baseline
from estimation.gap.search.rounds import run_rounds
from estimation.gap.search.state import AcceptedEffect, SearchState, Setting, afresh_with
from estimation.gap.shapes.increment import fit_increment
from estimation.gap.shapes.search import CoefficientShape, ShapeSearch
from estimation.gap.significance.calibration import Round


@dataclass(frozen=True)
class ShapeContinuation:
    """findings: effects of the rounds about the model with the shape; round_: the last round. baseline: the model with these
    names and without the shape; shapes: the search for a shape about that model."""

    findings: tuple[AcceptedEffect, ...]
    round_: Round
    baseline: Baseline
    shapes: ShapeSearch
    rejected: tuple[Rejected, ...]


def names_beside(
    setting: Setting, search: SearchState, baseline: Baseline, shapes: ShapeSearch, decision: Decision
) -> ShapeContinuation | None:
    """Effects that stand beside a shape found about `baseline`, or about the model with the names that the rest outweighs.

    None where there is no such effect, or the shape does not stand beside them.
    """
    room = setting.options.most - decision.kept
    if room <= 0:
        return None
    try:
        shape, child = _shaped(setting, search, baseline, shapes, decision)
        if shape is None or child is None:
            return None
        setting.tell("names beside the shape", 0.93)
        options = replace(setting.options, most=room)
        extended = run_rounds(
            replace(setting, working=child.model, clean=child.clean, options=options, tell=_silent), child
        )
        if not extended.findings:
            return None
        bare = replace(setting, working=baseline.model, clean=baseline.clean)
        nameless_base = afresh_with(bare, extended.findings, extended.findings[-1].child)
        if nameless_base is None:
            return None
        renewed = search_shape(setting, search, setting.screened(nameless_base, len(search.rounds)), decision)
    except GapError:  # a motion that cannot be linearised: the answer stands without these names
        return None
    if renewed.shape is None or renewed.shape.fitted.increment.place != shape.fitted.increment.place:
        return None
    return ShapeContinuation(extended.findings, extended.rounds[-1], nameless_base, renewed, extended.rejected)


def _shaped(
    setting: Setting, search: SearchState, baseline: Baseline, shapes: ShapeSearch, decision: Decision
) -> tuple[CoefficientShape | None, Baseline | None]:
    """A shape and the standing model with it.

    Where an unrelated rest outweighs names, neither closes the gap alone: the shape is sought about the model with the names, and
    added to the model without them.
    """
    if shapes.shape is not None:
        return shapes.shape, shapes.shape.measured.child
    if decision.kept == len(search.findings) or isinstance(shapes.follower, SwingingTerm):
        return None, None
    shape = search_shape(setting, search, search.rounds[-1], decision).shape
    fitted = None if shape is None else fit_increment(baseline, shape.fitted.increment)
    if fitted is None:
        return None, None
    model, clean = fitted.problem.model, baseline.clean
    return shape, fit_baseline(model, clean, setting.prepared, setting.scatter, fitted.fit, baseline.noise)


def in_its_place(
    setting: Setting, search: SearchState, findings: Sequence[AcceptedEffect], beside: ShapeContinuation
) -> SearchState | None:
    """The search in which the rounds, with the names that stood beside a shape, name the effect behind the shape; None where they
    name nothing. Each of two missing effects can be too large a rest for the other to be named."""
    baseline, parent = beside.baseline, findings[-1].child if findings else search.rounds[0].baseline
    room = setting.options.most - len(findings) - len(beside.findings)
    if room <= 0:
        return None
    setting.tell("a name in place of the shape", 0.94)
    options = replace(setting.options, most=room)
    renewed = replace(setting, working=baseline.model, clean=baseline.clean, options=options, tell=_silent)
    try:
        extended = run_rounds(renewed, baseline)
    except GapError:  # a motion that cannot be linearised: the shape stands
        return None
    if not extended.findings:
        return None
    replacements = _without_shape(setting, parent, beside)
    if replacements is None:
        return None
    return SearchState(
        (*findings, *replacements, *extended.findings),
        (*search.rounds, *extended.rounds),
        extended.omnibus,
        (*search.rejected, *beside.rejected, *extended.rejected),
    )


def _without_shape(setting: Setting, before: Baseline, beside: ShapeContinuation) -> list[AcceptedEffect] | None:
    """The findings beside a shape with models that lack the shape, from the model `before`; None where the motion runs away."""
    bare = replace(setting, working=before.model, clean=before.clean)
    replaced: list[AcceptedEffect] = []
    for count, finding in enumerate(beside.findings, 1):
        complete = count == len(beside.findings)
        child = beside.baseline if complete else afresh_with(bare, beside.findings[:count], finding.child)
        if child is None:
            return None
        # `doubted` compares the effect with a shape about another model
        replaced.append(replace(finding, parent=replaced[-1].child if replaced else before, child=child, doubted=False))
    return replaced


def _silent(what: str, share: float) -> None:
    """No progress: the caller has reported these rounds."""


def closes_as_much(shape: CoefficientShape, name: EffectStep, criteria: Criteria) -> bool:
    """Whether a shape closes as much of the gap as a name, within the margin by which two formulas count as equal."""
    closed = name.gap.closed if name.holdout is None else name.holdout.closed
    return shape.measured.closed >= closed - (1.0 - criteria.shape_share)


def without_doubted(
    setting: Setting,
    search: SearchState,
    findings: Sequence[AcceptedEffect],
    named: Sequence[EffectStep],
    decision: Decision,
) -> tuple[Decision, tuple[AcceptedEffect, ...], Baseline, ShapeSearch, ShapeContinuation | None] | None:
    """A shape in place of the first name that explains less than a shape: the decision, the names before it, the model with
    these, the shape and the names beside it. None where there is no such name, or later names do not stand beside the shape."""
    number = next((k for k, f in enumerate(findings) if f.doubted), None)
    if number is None:
        return None
    doubted, round_ = findings[number], findings[number].round_
    shapes = search_shape(setting, search, round_, as_unknown(decision))
    if shapes.shape is None or not closes_as_much(shapes.shape, named[number], setting.options.criteria):
        return None
    place = shapes.shape.fitted.increment.place.words
    reason = f"a smooth function without a name ({place}) explains clearly more than this form of it"
    withdrawn = (*decision.withdrawn, (doubted.candidate.hypothesis.effect.name, reason))
    changed = replace(decision, kept=number, withdrawn=withdrawn)
    continuation = names_beside(setting, search, round_.baseline, shapes, changed)
    if not _names(findings[number + 1 :]) <= _names(continuation.findings if continuation is not None else ()):
        return None
    return changed, tuple(findings[:number]), round_.baseline, shapes, continuation


def _names(findings: Sequence[AcceptedEffect]) -> set[str]:
    return {f.candidate.hypothesis.effect.name for f in findings}
