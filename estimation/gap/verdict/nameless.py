"""From a nameless shape to what a person reads: the curve with its band, what does as well, what would settle it."""

from collections.abc import Sequence

import numpy as np

from estimation.gap.answer.result import EffectStep, Gap, GapVerdict, Rejected, Where
from estimation.gap.answer.shape import Alike, EventReport, Happened, Late, ShapeCurve, Swinging
from estimation.gap.errors import GapError
from estimation.gap.form.analytic import Plain
from estimation.gap.form.fitted import FittedIncrement
from estimation.gap.form.search import CoefficientShape, SearchTask, ShapeSearch, Tried, find_shape
from estimation.gap.form.swing import Swing
from estimation.gap.likelihood.baseline import Baseline
from estimation.gap.search.search_state import AcceptedEffect, SearchState, Setting
from estimation.gap.tests_of_fit.calibration import Round
from estimation.gap.tests_of_fit.measure import Floors, floors
from estimation.gap.tests_of_fit.omnibus import examine
from estimation.gap.tests_of_fit.transients import DetectedEvent, find_transients
from estimation.gap.verdict.decide import Decision
from estimation.gap.verdict.effect_location import SPANS, channels_that_gain, regime, signals_of, spans_of
from estimation.gap.verdict.same_form import alike
from estimation.gap.verdict.steps import UNKNOWN
from estimation.models.base import Model

UNNAMED = "an effect that no name of the catalogue stands for"
ANGLES = ("alpha", "beta", "delta_a", "delta_e", "delta_r")
SLOW_SWEEP = "sweep {x} slowly and evenly through {low:.3g} to {high:.3g} {unit} with everything else held"


def standing_round(setting: Setting, search: SearchState, kept: Sequence[AcceptedEffect]) -> Round:
    """The round about the model with the names that stand."""
    standing = kept[-1].child if kept else search.rounds[0].baseline
    round_ = next((r for r in search.rounds if r.baseline is standing), None)
    return round_ or setting.screened(standing, len(search.rounds))


def floor_about(setting: Setting, round_: Round) -> Floors:
    """What the gap measures on the nulls of a round, training and held-out flights."""
    held = setting.errors[len(setting.prepared.of(setting.prepared.training)) :]
    return floors(round_, round_.baseline.held_out, held, setting.options.seed)


def searched(setting: Setting, search: SearchState, round_: Round, decision: Decision) -> ShapeSearch:
    """Look for a shape of what the standing names leave: at length where a rest is known to matter."""
    setting.tell("a shape for what has no name", 0.92)
    number = len(search.rounds)
    task = SearchTask(
        setting.prepared,
        setting.errors,
        setting.options.seed,
        lambda b: setting.screened(b, number + 1),
        lambda r: floor_about(setting, r),
    )
    try:
        return find_shape(round_, task, decision.verdict is GapVerdict.UNKNOWN)
    except GapError:  # a motion that cannot be linearised: the answer stands without a shape
        return ShapeSearch(None, ())


def shaped_step(
    shape: CoefficientShape, baseline: Baseline, setting: Setting, rejected: Sequence[Rejected]
) -> EffectStep:
    """The step of an unknown whose shape was found about `baseline`. rejected: names that were turned down."""
    child = shape.measured.child
    gain = [
        np.nan_to_num((p / baseline.scatter) ** 2 - (c / baseline.scatter) ** 2)
        for p, c in zip(baseline.fit.residuals, child.fit.residuals, strict=True)
    ]
    where = regime(signals_of(child), np.concatenate([g.sum(axis=1) for g in gain]), child.criteria)
    formulas = [formula for formula, _ in shape.plain]
    known = alike(formulas, shape.fitted.increment.place.line, baseline.clean, setting.effects, rejected)
    curve = curve_of(shape, setting, where, known)
    order = channels_that_gain(np.sum([g.sum(axis=0) for g in gain], axis=0), child.criteria)
    spans = [spans_of(child.problem.coarse[i].time, g.sum(axis=1), child.criteria) for i, g in enumerate(gain)]
    names = child.model.output_names
    return EffectStep(
        effect="unknown", title=UNNAMED if known else UNKNOWN, form="", confidence=0.0, members=(),
        separate_by=curve.separate_by, estimates={}, units={}, score=shape.score, threshold=shape.threshold,
        where=Where(
            curve.output, tuple(names[i] for i in order), tuple(spans[int(np.argmax([len(s) for s in spans]))][:SPANS]),
            curve.regime,
        ),
        gap=shape.measured.gap, holdout=shape.measured.holdout, migrated={}, shape=curve,
    )  # fmt: skip


def curve_of(shape: CoefficientShape, setting: Setting, where: str, known: tuple[Alike, ...]) -> ShapeCurve:
    increment = shape.fitted.increment
    place, flown = increment.place, increment.flown
    child = shape.measured.child
    final = FittedIncrement(increment, child.problem, child.fit, shape.fitted.gain)
    x, value, std = final.curve()
    unit = "rad" if place.variable in ANGLES else _unit(setting.base, place.variable)
    variables = (place.variable, place.by) if place.by else (place.variable,)
    shown = [(p, c, True) for p, c in shape.plain] + [(p, c, False) for p, c in shape.refused]
    return ShapeCurve(
        output=place.line, variables=variables, grid=x, value=value / increment.reach, std=std / increment.reach, unit=unit,
        low=flown.low, high=flown.high, closed=shape.measured.closed,
        analytic=shape.plain[0][0].text if shape.plain else None,
        candidates=tuple(_candidate(p, c, good) for p, c, good in shown),
        rivals=tuple(
            (f.increment.place.line, tuple(n for n in (f.increment.place.variable, f.increment.place.by) if n),
             f.gain / shape.fitted.gain)
            for f in shape.rivals
        ),
        left_out=tuple((setting.prepared.names[o.flight], o.inside, o.gain) for o in shape.others),
        regime=where,
        separate_by=SLOW_SWEEP.format(x=place.variable, low=flown.low, high=flown.high, unit=unit), alike=known,
    )  # fmt: skip


def _candidate(plain: Plain, closed: float, good: bool) -> tuple[str, dict[str, tuple[float, float]], float, bool]:
    return plain.text, dict(plain.estimates), closed, good


def _unit(model: Model, variable: str) -> str:
    return next((s.unit for s in (*model.states, *model.inputs, *model.outputs) if s.name == variable), "1")


def follower_of(found: ShapeSearch) -> Late | Swinging | None:
    """A lag or a swing as the answer tells it."""
    f = found.follower
    if isinstance(f, Swing):
        return Swinging(f.line, f.by, f.frequency, f.damping, f.frequency_std, f.damping_std, f.score, f.threshold)
    return None if f is None else Late(f.place.line, f.place.variable, f.time, f.score, f.threshold)


def why_not(tried: Tried) -> str:
    """Why a shape was looked at and not taken."""
    return f"as a shape without a name: {tried.why}"


def happened(setting: Setting, round_: Round) -> Happened | None:
    """Events in time that leave nothing else to explain; None where there is none, or where something else is left."""
    setting.tell("what may have happened at one time", 0.94)
    try:
        found = find_transients(round_)
        if not found.found or found.cleared is None:
            return None
        rest = examine(found.cleared)
    except GapError:  # as above
        return None
    if rest.matters(round_.criteria):
        return None
    records, names = round_.baseline.problem.records, setting.prepared.names
    flights = ["" if f.event.record < 0 else names[records[f.event.record].flight] for f in found.found]
    return Happened([happening(f, setting.base, flight) for f, flight in zip(found.found, flights, strict=True)])


def happening(found: DetectedEvent, base: Model, flight: str) -> EventReport:
    """An event in the words of the answer. flight: its name, "" for all of them."""
    event, sizes = found.event, found.sizes
    unit = next((s.unit for s in base.outputs if s.name == event.channel), "1/s")
    if event.air:  # half a cosine of rate adds up to half a sine
        unit = next(s.unit for s in base.states if s.name == event.air)
        share = (event.end - event.start) / np.pi
        sizes = tuple((share * v, share * s) for v, s in sizes)
    return EventReport(
        event.kind.value,
        event.channel,
        flight,
        event.start,
        event.end,
        sizes,
        unit,
        found.score,
        found.threshold,
        event.air,
    )


def event_step(shape: Happened, gap: Gap) -> EffectStep:
    """The step of an unknown that goes with time."""
    first = shape.events[0]
    spans = tuple(dict.fromkeys((e.start, e.end) for e in shape.events[:SPANS]))
    channels = tuple(dict.fromkeys(e.channel or e.air for e in shape.events if e.channel or e.air))
    return EffectStep(
        effect="unknown", title="something that happened at one time", form="", confidence=0.0, members=(),
        separate_by="look at the instrument or the weather there, or repeat the flight", estimates={}, units={},
        score=first.score, threshold=first.threshold,
        where=Where(first.channel or "forces and moments", channels, spans, f"{first.what} {first.flight}".rstrip()),
        gap=gap, holdout=None, migrated={}, shape=shape,
    )  # fmt: skip
