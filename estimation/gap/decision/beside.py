"""Names beside what has no name: a shape, a lag or a swing.

A name has to gain most of what the best nameless term gains; otherwise an unknown effect would get a wrong name. Once the unknown
effect has a shape, the search runs again about the model with the shape. Where it names effects, the shape is sought again beside
these names. The search also runs about these names without the shape: beside them the unknown effect may turn out to be one of
the catalogue.

The catalogue has no lag and no swing, and names can imitate one so well that no nameless term, a function of the motion at that
instant, is significant any more. So the model with names is also screened for a lag or a swing. Where one is significant, it is
added to the first model instead, and every name has to be significant beside it. Several names may leave nothing at all of a lag
(yaw that follows roll rate 0.4 s late: `Cn_betadot` and `Ixz_error`); then they have to gain most of what it gains by itself, as
a name has to beside a nameless term.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.errors import GapError
from estimation.gap.answer.result import EffectStep, GapVerdict, Rejected
from estimation.gap.answer.shape import Follower, LaggedTerm, SwingingTerm
from estimation.gap.criteria import Criteria
from estimation.gap.decision.decide import Decision, as_unknown
from estimation.gap.decision.unnamed import search_shape, standing_round
from estimation.gap.effects.base import Effect, EffectParameter, Form, Group
from estimation.gap.fit.baseline import Baseline, fit_baseline
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit
from estimation.gap.search.accept import explains, own_inflation
from estimation.gap.search.confirm import fit_hypothesis
from estimation.gap.search.rounds import run_rounds
from estimation.gap.search.state import AcceptedEffect, SearchState, Setting, afresh_with
from estimation.gap.shapes.increment import fit_increment
from estimation.gap.shapes.lag_swing import find_memory, find_swing, rings
from estimation.gap.shapes.places import ModelMotion, places_of
from estimation.gap.shapes.search import CoefficientShape, ShapeSearch
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.measured_again import MeasuredAgain
from estimation.gap.significance.screen import Hypothesis
from estimation.models.base import Signal

SIZE, FOLLOWER, TIME = "nameless_late", "nameless_follower", "nameless_time"
SWING, FREQUENCY, DAMPING = "nameless_swing", "nameless_frequency", "nameless_damping"
LEAST_DAMPING, MOST_DAMPING = 0.005, 1.0
OCTAVE = 2.0  # range of a frequency to either side of its first value
SPAN = 3.0  # range of a time constant to either side of its first value, of a grid in steps of two to two and a half
NEAR_LIMIT = 1.01  # times a limit: the fit was stopped by it
SIZE_RANGE = 1e3  # usual sizes to either side: no limit in practice


# ---- names beside a shape
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
        shaped = _shaped(setting, search, baseline, shapes, decision)
        if shaped is None:
            return None
        shape, child = shaped
        setting.tell("names beside the shape", 0.93)
        extended = _rounds_about(setting, child, room)
        if extended is None:
            return None
        bare = replace(setting, working=baseline.model, clean=baseline.clean)
        shapeless = afresh_with(bare, extended.findings, extended.findings[-1].child)
        if shapeless is None:
            return None
        renewed = search_shape(setting, search, setting.screened(shapeless, len(search.rounds)), decision)
    except GapError:  # a motion that cannot be linearised: the answer stands without these names
        return None
    if renewed.shape is None or renewed.shape.fitted.increment.place != shape.fitted.increment.place:
        return None
    return ShapeContinuation(extended.findings, extended.rounds[-1], shapeless, renewed, extended.rejected)


def _shaped(
    setting: Setting, search: SearchState, baseline: Baseline, shapes: ShapeSearch, decision: Decision
) -> tuple[CoefficientShape, Baseline] | None:
    """A shape and the standing model with it.

    Where an unrelated rest outweighs names, neither closes the gap alone: the shape is sought about the model with the names, and
    added to the model without them.
    """
    if shapes.shape is not None:
        return shapes.shape, shapes.shape.measured.child
    if decision.kept == len(search.findings) or isinstance(shapes.follower, SwingingTerm):
        return None
    shape = search_shape(setting, search, search.rounds[-1], decision).shape
    fitted = None if shape is None else fit_increment(baseline, shape.fitted.increment)
    if shape is None or fitted is None:
        return None
    model, clean = fitted.problem.model, baseline.clean
    return shape, fit_baseline(model, clean, setting.prepared, setting.scatter, fitted.fit, baseline.noise)


def _rounds_about(setting: Setting, baseline: Baseline, room: int) -> SearchState | None:
    """The search about a model, for at most `room` effects and without progress, which the caller reports; None where it finds
    none."""
    options = replace(setting.options, most=room)
    model, clean = baseline.model, baseline.clean
    extended = run_rounds(
        replace(setting, working=model, clean=clean, options=options, tell=lambda what, share: None), baseline
    )
    return extended if extended.findings else None


def in_its_place(
    setting: Setting, search: SearchState, findings: Sequence[AcceptedEffect], beside: ShapeContinuation
) -> SearchState | None:
    """The search in which the rounds, with the names that stood beside a shape, name the effect behind the shape; None where they
    name nothing. Each of two missing effects can be too large a rest for the other to be named."""
    room = setting.options.most - len(findings) - len(beside.findings)
    if room <= 0:
        return None
    setting.tell("a name in place of the shape", 0.94)
    try:
        extended = _rounds_about(setting, beside.baseline, room)
    except GapError:  # a motion that cannot be linearised: the shape stands
        return None
    parent = findings[-1].child if findings else search.rounds[0].baseline
    replacements = None if extended is None else _without_shape(setting, parent, beside)
    if extended is None or replacements is None:
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
        replaced.append(replace(finding, parent=before, child=child, doubted=False))
        before = child
    return replaced


def without_doubted(
    setting: Setting,
    search: SearchState,
    findings: Sequence[AcceptedEffect],
    named: Sequence[EffectStep],
    decision: Decision,
) -> tuple[Decision, tuple[AcceptedEffect, ...], Baseline, ShapeSearch, ShapeContinuation | None] | None:
    """A shape in place of the first name that explains less than a shape: the decision, the names before it, the model with
    these, the shape and the names beside it. None where there is no such name, no shape closes as much, or later names do not
    stand beside the shape."""
    number = next((k for k, f in enumerate(findings) if f.doubted), None)
    if number is None:
        return None
    round_ = findings[number].round_
    shapes = search_shape(setting, search, round_, as_unknown(decision))
    if shapes.shape is None or not _closes_as_much(shapes.shape, named[number], setting.options.criteria):
        return None
    place = shapes.shape.fitted.increment.place.words
    reason = f"a smooth function without a name ({place}) explains clearly more than this form of it"
    withdrawn = (*decision.withdrawn, (findings[number].candidate.hypothesis.effect.name, reason))
    changed = replace(decision, kept=number, withdrawn=withdrawn)
    continuation = names_beside(setting, search, round_.baseline, shapes, changed)
    if not _names(findings[number + 1 :]) <= _names(() if continuation is None else continuation.findings):
        return None
    return changed, tuple(findings[:number]), round_.baseline, shapes, continuation


def _names(findings: Sequence[AcceptedEffect]) -> set[str]:
    return {f.candidate.hypothesis.effect.name for f in findings}


def _closes_as_much(shape: CoefficientShape, name: EffectStep, criteria: Criteria) -> bool:
    """Whether a shape closes as much of the gap as a name, within the margin by which two formulas count as equal."""
    return shape.measured.closed >= (name.holdout or name.gap).closed - (1.0 - criteria.shape_share)


# ---- names beside a lag or a swing
@dataclass(frozen=True)
class LateRest:
    """A lag or swing that is significant beside all names. needed: so many names, from the first on, are significant beside
    it."""

    follower: Follower
    needed: int


def late_rest(setting: Setting, search: SearchState, findings: Sequence[AcceptedEffect]) -> LateRest | None:
    """The lag or swing that the model with the names `findings` lacks; None where none is significant, or where the motion of
    that model cannot be linearised or flown: the answer stands without it."""
    if not findings:
        return None
    try:
        about = standing_round(setting, search, findings)
        motion = ModelMotion.of(about.baseline.problem, about.baseline.fit)
        candidates = (find_memory(motion, about, places_of(setting.base)), find_swing(motion, about))
        significant = [f for f in candidates if f is not None and stands_out(f, setting.options.criteria)]
        if not significant:
            return _instead_of_several(setting, search, findings) if len(findings) > 1 else None
        follower, first = max(significant, key=lambda f: f.gain), search.rounds[0].baseline
        return _needed_beside(setting, first, follower, _fitted(first, follower), findings)
    except GapError:
        return None


def _instead_of_several(setting: Setting, search: SearchState, findings: Sequence[AcceptedEffect]) -> LateRest | None:
    """The lag that gains clearly more about the first model than all names together; None where there is none, or where all names
    are needed beside it."""
    first = search.rounds[0]
    base = first.baseline
    memory = find_memory(ModelMotion.of(base.problem, base.fit), first, places_of(setting.base))
    if memory is None:
        return None
    fitted = _, with_memory = _fitted(base, memory)
    problem, with_names = base.problem, base.fit
    for finding in findings:
        candidate = finding.candidate
        problem, with_names = fit_hypothesis(problem, with_names, candidate.hypothesis, candidate.values)
    gain, memory_gain = (2.0 * (base.fit.cost - f.cost) for f in (with_names, with_memory))
    if with_memory.diverged or with_names.diverged or explains(gain, memory_gain, setting.options.criteria):
        return None
    late = _needed_beside(setting, base, memory, fitted, findings)
    return late if late is not None and late.needed < len(findings) else None


def _needed_beside(
    setting: Setting,
    first: Baseline,
    follower: Follower,
    with_follower: tuple[LikelihoodProblem, ModelFit],
    findings: Sequence[AcceptedEffect],
) -> LateRest | None:
    """A lag or swing as fitted with the first model (`with_follower`), and the names needed beside it (all where that runs away);
    None where it is not significant there."""
    problem, current = with_follower
    fitted = as_fitted(follower, current, setting.options.criteria)
    if fitted is None:
        return None
    if current.diverged:
        return LateRest(fitted, len(findings))
    if not _is_significant(follower, first, current, setting.options.seed):
        return None
    for count, finding in enumerate(findings):
        candidate = finding.candidate
        problem, extended = fit_hypothesis(problem, current, candidate.hypothesis, candidate.values)
        if extended.diverged or not significant_beside(2.0 * (current.cost - extended.cost), finding):
            return LateRest(fitted, count)
        current = extended
    return LateRest(fitted, len(findings))


def settled_follower(follower: Follower | None, baseline: Baseline, seed: int) -> Follower | None:
    """A lag or a swing as fitted with a model, and None where a swing does not ring. None also where it gains nearly as much with
    only the controls measured again. Unchanged where the fit runs away."""
    if follower is None:
        return None
    _, fitted = _fitted(baseline, follower)
    if not fitted.diverged and not _is_significant(follower, baseline, fitted, seed):
        return None
    return as_fitted(follower, fitted, baseline.criteria)


def _fitted(baseline: Baseline, follower: Follower) -> tuple[LikelihoodProblem, ModelFit]:
    """A model with a lag or a swing, fitted to the training flights."""
    hypothesis, start = hypothesis_of(follower, ModelMotion.of(baseline.problem, baseline.fit))
    return fit_hypothesis(baseline.problem, baseline.fit, hypothesis, start)


def _is_significant(follower: Follower, baseline: Baseline, model_fit: ModelFit, seed: int) -> bool:
    """Whether a fitted lag or swing is significant by its own share of its gain."""
    gain = 2.0 * (baseline.fit.cost - model_fit.cost)
    share = MeasuredAgain(baseline, seed).share(gain, model_fit)
    return follower.score * math.sqrt(share) > follower.threshold


def stands_out(follower: Follower, criteria: Criteria) -> bool:
    """Whether a lag or swing beside names is more than ordinary scatter."""
    return follower.score > criteria.far_above * follower.threshold


def significant_beside(gain: float, finding: AcceptedEffect) -> bool:
    """Whether a name that gains so much (twice a log-likelihood) beside a lag or swing would have been named."""
    return gain > own_inflation(finding.candidate) * finding.round_.threshold**2


def beside_memory(decision: Decision, named: Sequence[str], late: LateRest) -> Decision:
    """The decision in which a lag or swing replaces the names not needed beside it, and is unknown beside the others."""
    reason = f"not needed where {late.follower.words}, which explains more"
    withdrawn = (*decision.withdrawn, *((n, reason) for n in named[late.needed : decision.kept]))
    return replace(decision, verdict=GapVerdict.UNKNOWN, kept=late.needed, withdrawn=withdrawn)


def as_fitted(follower: Follower, model_fit: ModelFit, criteria: Criteria) -> Follower | None:
    """A lag or a swing with the fitted values; None of a swing that does not ring, or where a limit stopped its fit: an undamped
    tone needs no acceleration to drive it, and a frequency far from the first one belongs to another swing."""
    if model_fit.diverged:
        return follower
    if isinstance(follower, LaggedTerm):
        return replace(follower, time=float(model_fit.values[TIME]))
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


def hypothesis_of(follower: Follower, motion: ModelMotion) -> tuple[Hypothesis, dict[str, float]]:
    """A lag or a swing as a hypothesis, and the start values of its fit."""
    form, start = lag_of(follower, motion) if isinstance(follower, LaggedTerm) else swing_of(follower, motion)
    effect = Effect(form.label, follower.words, Group.UNSTEADY, "", "", "", "", {}, "", (form,))
    return Hypothesis(effect, form), start


def lag_of(memory: LaggedTerm, motion: ModelMotion) -> tuple[Form, dict[str, float]]:
    """A term proportional to a first-order lag of a variable minus that variable, size and time constant unknown, and their start
    values."""
    line, variable, time = memory.line, memory.variable, memory.time
    form = Form(
        SIZE,
        (
            _size(SIZE, motion.scale[line] / motion.reach(variable)),
            EffectParameter(TIME, "s", 0.3 * time, time / SPAN, SPAN * time, time),
        ),
        terms={line: (f"{SIZE}*({FOLLOWER} - {variable})",)},
        states=(Signal(FOLLOWER, start=variable),),
        lines=(f"{FOLLOWER}_dot = ({variable} - {FOLLOWER})/{TIME}",),
        requires=(line, variable),
    )
    return form, {SIZE: 0.0, TIME: time}


def swing_of(swing: SwingingTerm, motion: ModelMotion) -> tuple[Form, dict[str, float]]:
    """An oscillator driven by accelerations, with unknown frequency and damping, and its start values."""
    w, z = swing.frequency, swing.damping
    drive = " + ".join(f"{SWING}_{a}*{a}" for a in swing.by)
    form = Form(
        SWING,
        (
            *(_size(f"{SWING}_{a}", motion.scale[swing.line] / motion.reach(a)) for a in swing.by),
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
    return form, {**{f"{SWING}_{a}": size for a, size in swing.by.items()}, FREQUENCY: w, DAMPING: z}


def _size(name: str, typical: float) -> EffectParameter:
    """An unknown factor of a term."""
    return EffectParameter(name, "1", typical, -SIZE_RANGE * typical, SIZE_RANGE * typical)
