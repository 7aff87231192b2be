"""What a person reads of an effect without a name: a curve with its band, what does as well and what would settle it, effects of
the catalogue that have its form, an event in time, or an instrument that holds its values."""

from collections.abc import Sequence

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.answer.result import EffectStep, Gap, GapVerdict, Rejected, Where
from estimation.gap.answer.shape import Alike, EventReport, Happened, HeldInstrument, ShapeCurve
from estimation.gap.criteria import Criteria
from estimation.gap.decision.decide import Decision
from estimation.gap.decision.location import SPANS, locate
from estimation.gap.decision.steps import UNKNOWN
from estimation.gap.effects.base import Effect, Form
from estimation.gap.errors import GapError
from estimation.gap.fit.baseline import Baseline
from estimation.gap.records.flight_records import FlightRecords
from estimation.gap.search.state import AcceptedEffect, SearchState, Setting
from estimation.gap.shapes.formulas import Plain
from estimation.gap.shapes.increment import FittedIncrement
from estimation.gap.shapes.search import CoefficientShape, SearchTask, ShapeSearch, find_shape
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.measure import Floors, floors
from estimation.gap.significance.omnibus import examine
from estimation.gap.significance.screen import Hypothesis
from estimation.gap.significance.transients import DetectedEvent, find_transients
from estimation.models.base import Model
from estimation.models.expressions import evaluate, names_in
from estimation.models.numeric import FUNCTIONS

UNNAMED = "an effect that no name of the catalogue stands for"
ANGLES = ("alpha", "beta", "delta_a", "delta_e", "delta_r")
SLOW_SWEEP = "sweep {x} slowly and evenly through {low:.3g} to {high:.3g} {unit} with everything else held"
POINTS = 16  # at which two forms are compared: more than the zeros that products of a few powers can share
SAME = 1e-9  # of the ratio of two forms, by which rounding alone may move it


def standing_round(setting: Setting, search: SearchState, kept: Sequence[AcceptedEffect]) -> Round:
    """The round about the model with the names that stand."""
    standing = kept[-1].child if kept else search.rounds[0].baseline
    round_ = next((r for r in search.rounds if r.baseline is standing), None)
    return round_ or setting.screened(standing, len(search.rounds))


def floor_about(setting: Setting, round_: Round) -> Floors:
    """What the gap measures on the nulls of a round, training and held-out flights."""
    holdout_errors = setting.errors[len(setting.prepared.of(setting.prepared.training)) :]
    return floors(round_, round_.baseline.held_out, holdout_errors, setting.options.seed)


def search_shape(setting: Setting, search: SearchState, round_: Round, decision: Decision) -> ShapeSearch:
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
    location = locate(baseline, shape.measured.child, shape.fitted.increment.place.line)
    formulas = [formula for formula, _ in shape.plain]
    catalogued = effects_of_same_form(formulas, location.equation, baseline.clean, setting.effects, rejected)
    curve = curve_of(shape, setting, location.regime, catalogued)
    return EffectStep(
        effect="unknown", title=UNNAMED if catalogued else UNKNOWN, form="", confidence=0.0, members=(),
        separate_by=curve.separate_by, estimates={}, units={}, score=shape.score, threshold=shape.threshold, where=location,
        gap=shape.measured.gap, holdout=shape.measured.holdout, migrated={}, shape=curve,
    )  # fmt: skip


def curve_of(shape: CoefficientShape, setting: Setting, regime: str, known: tuple[Alike, ...]) -> ShapeCurve:
    increment = shape.fitted.increment
    place, limits = increment.place, increment.flown
    child = shape.measured.child
    final = FittedIncrement(increment, child.problem, child.fit, shape.fitted.gain)
    x, value, std = final.curve()
    unit = "rad" if place.variable in ANGLES else _unit(setting.base, place.variable)
    variables = (place.variable, place.by) if place.by else (place.variable,)
    formulas = [(p, c, True) for p, c in shape.plain] + [(p, c, False) for p, c in shape.refused]
    return ShapeCurve(
        output=place.line, variables=variables, grid=x, value=value / increment.reach, std=std / increment.reach, unit=unit,
        low=limits.low, high=limits.high, closed=shape.measured.closed,
        analytic=shape.plain[0][0].text if shape.plain else None,
        candidates=tuple(_candidate(p, c, accepted) for p, c, accepted in formulas),
        rivals=tuple(
            (f.increment.place.line, tuple(n for n in (f.increment.place.variable, f.increment.place.by) if n),
             f.gain / shape.fitted.gain)
            for f in shape.rivals
        ),
        left_out=tuple((setting.prepared.names[o.flight], o.inside, o.gain) for o in shape.others),
        regime=regime,
        separate_by=SLOW_SWEEP.format(x=place.variable, low=limits.low, high=limits.high, unit=unit), alike=known,
    )  # fmt: skip


def _candidate(plain: Plain, closed: float, good: bool) -> tuple[str, dict[str, tuple[float, float]], float, bool]:
    return plain.text, dict(plain.estimates), closed, good


def _unit(model: Model, variable: str) -> str:
    return next((s.unit for s in (*model.states, *model.inputs, *model.outputs) if s.name == variable), "1")


def events_in_time(setting: Setting, round_: Round) -> Happened | None:
    """Events in time that leave nothing else to explain; None where there is none, or where something else is left."""
    setting.tell("what may have happened at one time", 0.94)
    try:
        transients = find_transients(round_)
        if not transients.found or transients.cleared is None:
            return None
        rest = examine(transients.cleared)
    except GapError:  # as above
        return None
    if rest.significant:
        return None
    records, names = round_.baseline.problem.records, setting.prepared.names
    flights = ["" if f.event.record < 0 else names[records[f.event.record].flight] for f in transients.found]
    return Happened(
        [event_report(f, setting.base, flight) for f, flight in zip(transients.found, flights, strict=True)]
    )


def event_report(found: DetectedEvent, base: Model, flight: str) -> EventReport:
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


def find_held_instrument(baseline: Baseline, prepared: FlightRecords) -> HeldInstrument | None:
    """The stale output that is farthest from the model where it repeats; None where none is too far."""
    problem, fit = baseline.problem, baseline.fit
    modelled = [problem.modelled(i, fit.values, local) for i, local in enumerate(fit.locals)]
    pairs = [
        (r, y) for r, y in zip(problem.records, modelled, strict=True) if y is not None and r.uncompared is not None
    ]
    step = max(float(np.median(np.diff(r.time))) for r in problem.records)
    instruments = []
    for c, signal in enumerate(problem.model.outputs):
        if signal.source in prepared.stale and pairs:
            repeated = np.concatenate([r.uncompared[:, c] - y[:, c] for r, y in pairs if r.uncompared is not None])
            fresh = np.concatenate([r.z[:, c] - y[:, c] for r, y in pairs])
            instrument = held_instrument(
                signal.source, repeated[np.isfinite(repeated)], fresh[np.isfinite(fresh)], step, baseline.criteria
            )
            instruments += [instrument] if instrument is not None else []
    return max(instruments, key=lambda h: h.ratio, default=None)


def held_instrument(channel: str, far: Array, near: Array, step: float, criteria: Criteria) -> HeldInstrument | None:
    """Residuals of a channel where it repeats a value, (n,), against those at new values, (m,), of records sampled every `step`
    [s]; None where the former are little farther."""
    reference = float(np.sqrt(np.mean(near**2))) if near.size else 0.0
    if not far.size or reference <= 0.0:
        return None
    ratio = float(np.sqrt(np.mean(far**2))) / reference
    if ratio <= criteria.held_ratio:
        return None
    share = far.size / (far.size + near.size)
    return HeldInstrument(channel, step / (1.0 - share), share, ratio, criteria.held_ratio)


def held_step(held: HeldInstrument, gap: Gap) -> EffectStep:
    """The step of an unknown that is an instrument's."""
    return EffectStep(
        effect="unknown", title="an instrument that holds its values", form="", confidence=0.0, members=(),
        separate_by=f"read {held.channel} at the rate of the other channels, and repeat the flight", estimates={}, units={},
        score=held.ratio, threshold=held.threshold,
        where=Where(held.channel, (held.channel,), (), "where it repeats a value"),
        gap=gap, holdout=None, migrated={}, shape=held,
    )  # fmt: skip


def effects_of_same_form(
    plain: Sequence[Plain], line: str, model: Model, effects: Sequence[Effect], rejected: Sequence[Rejected]
) -> tuple[Alike, ...]:
    """Effects that add to `line` what a formula beside a shape does, times a number, and that `model` lacks."""
    one_term = [
        Hypothesis(effect, form)
        for effect in effects
        for form in effect.forms
        if _only_adds_to(line, form) and form.obstacle(model) is None
    ]
    return tuple(
        _told(hypothesis, estimate, rejected)
        for formula in plain
        for hypothesis in one_term
        if (estimate := _as_parameter(formula, hypothesis.form.terms[line][0], hypothesis.form.parameters[0].name))
        is not None
    )


def _only_adds_to(line: str, form: Form) -> bool:
    """Whether all that a form does is to add one piece with one unknown to a line."""
    extras = form.states or form.transforms or form.outputs or form.output_delays or form.lines
    return not extras and [*form.terms] == [line] and len(form.terms[line]) == 1 and len(form.parameters) == 1


def _as_parameter(formula: Plain, piece: str, parameter: str) -> tuple[float, float] | None:
    """(estimate, bound) of the parameter with which a piece is the formula; None where it is another function."""
    names = sorted(names_in(formula.text) - {"a"})
    if set(formula.estimates) != {"a"} or names_in(piece) - {parameter} != set(names):
        return None
    points = dict(zip(names, np.random.default_rng(0).uniform(-1.0, 1.0, (len(names), POINTS)), strict=True))
    with np.errstate(all="ignore"):  # a piece from somebody's file may have logarithms or poles
        ours = evaluate(formula.text, {**points, "a": 1.0}, FUNCTIONS)
        ratio = ours / evaluate(piece, {**points, parameter: 1.0}, FUNCTIONS)
    if not np.ptp(ratio) < SAME * abs(ratio[0]):
        return None
    value, std = formula.estimates["a"]
    return float(value * ratio[0]), float(std * abs(ratio[0]))


def _told(hypothesis: Hypothesis, found: tuple[float, float], rejected: Sequence[Rejected]) -> Alike:
    effect, parameter = hypothesis.effect, hypothesis.form.parameters[0]
    reasons = [r.why for r in rejected if r.effect == hypothesis.label]
    if not parameter.lower <= found[0] <= parameter.upper:
        reason = f"that is outside what is physically possible ({parameter.lower:g} to {parameter.upper:g})"
    else:
        explains_little = bool(reasons) and reasons[-1].startswith("explains")
        reason = f"as a name it {reasons[-1] if explains_little else 'does not stand by itself'}"
    return Alike(effect.name, effect.title, parameter.name, found, parameter.unit, reason)
