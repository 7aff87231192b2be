"""What has no name: a shape with its band, its rivals and effects of the catalogue of the same form; an event in time; an
instrument that holds its values; a held-out flight that the model does not predict. Each is looked for and becomes a step."""

from collections.abc import Sequence

import numpy as np

from estimation.engine.kernel import Array
from estimation.errors import GapError
from estimation.gap.answer.result import EffectStep, Gap, GapVerdict, Rejected, Where
from estimation.gap.answer.shape import Alike, EventReport, Happened, HeldInstrument, NotPredicted, ShapeCurve
from estimation.gap.criteria import Criteria
from estimation.gap.decision.decide import Decision
from estimation.gap.decision.location import SPANS, channels_that_gain, locate, spans_of
from estimation.gap.decision.steps import UNKNOWN, nameless_step
from estimation.gap.effects.base import Effect, Form
from estimation.gap.fit.baseline import Baseline
from estimation.gap.records.flight_records import FlightRecords
from estimation.gap.search.state import AcceptedEffect, SearchState, Setting
from estimation.gap.shapes.increment import Plain
from estimation.gap.shapes.places import Place
from estimation.gap.shapes.search import CoefficientShape, SearchTask, ShapeSearch, find_shape
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.measure import Floors, plain_residuals, rms_over_noise
from estimation.gap.significance.omnibus import examine
from estimation.gap.significance.screen import Hypothesis
from estimation.gap.significance.transients import DetectedEvent, find_transients
from estimation.models.base import Model
from estimation.models.expressions import evaluate, names_in
from estimation.models.numeric import FUNCTIONS

UNNAMED = "an effect that no name of the catalogue stands for"
ANGLES = ("alpha", "beta", "delta_a", "delta_e", "delta_r")
POINTS = 16  # at which two forms are compared: more than the zeros that products of a few powers can share
SAME = 1e-9  # relative change of the ratio of two forms by rounding alone


def standing_round(setting: Setting, search: SearchState, findings: Sequence[AcceptedEffect]) -> Round:
    """The round about the model with the names that stand."""
    standing = findings[-1].child if findings else search.rounds[0].baseline
    round_ = next((r for r in search.rounds if r.baseline is standing), None)
    return round_ or setting.screened(standing, len(search.rounds))


# ---- a shape
def search_shape(setting: Setting, search: SearchState, round_: Round, decision: Decision) -> ShapeSearch:
    """Look for a shape of the rest that the standing names leave; at length where that rest is an unknown effect."""
    setting.tell("a shape for what has no name", 0.92)
    number = len(search.rounds) + 1
    seed = setting.options.seed
    task = SearchTask(setting.prepared, setting.errors, seed, lambda b: setting.screened(b, number), setting.floors)
    try:
        return find_shape(round_, task, decision.verdict is GapVerdict.UNKNOWN)
    except GapError:  # a motion that cannot be linearised: the answer stands without a shape
        return ShapeSearch(None, ())


def shaped_step(
    shape: CoefficientShape, baseline: Baseline, setting: Setting, rejected: Sequence[Rejected]
) -> EffectStep:
    """The step of an unknown whose shape was found about `baseline`. rejected: names rejected by the search."""
    measured, line = shape.measured, shape.fitted.increment.place.line
    location = locate(baseline, measured.child, line)
    formulas = [formula for formula, _ in shape.plain]
    alike = effects_of_same_form(formulas, line, baseline.clean, setting.effects, rejected)
    curve = curve_of(shape, setting, location.regime, alike)
    title = UNNAMED if alike else UNKNOWN
    scores = shape.score, shape.threshold
    return nameless_step(title, location, *scores, measured.gap, curve.separate_by, measured.holdout, curve)


def curve_of(shape: CoefficientShape, setting: Setting, regime: str, alike: tuple[Alike, ...]) -> ShapeCurve:
    """The curve of a shape as the answer has it. alike: effects of the catalogue with its form."""
    increment = shape.fitted.increment
    place, low, high = increment.place, increment.flown.low, increment.flown.high
    x, value, std = increment.curve(shape.measured.child.fit)
    signals = (*setting.base.states, *setting.base.inputs, *setting.base.outputs)
    unit = "rad" if place.variable in ANGLES else next((s.unit for s in signals if s.name == place.variable), "1")
    sweep = f"sweep {place.variable} slowly and evenly through {low:.3g} to {high:.3g} {unit} with everything else held"
    formulas = [(p, c, True) for p, c in shape.plain] + [(p, c, False) for p, c in shape.refused]
    others = [(f.increment.place, f.gain / shape.fitted.gain) for f in shape.rivals]
    return ShapeCurve(
        output=place.line,
        variables=_variables(place),
        grid=x,
        value=value / increment.reach,
        std=std / increment.reach,
        unit=unit,
        low=low,
        high=high,
        closed=shape.measured.closed,
        analytic=shape.plain[0][0].text if shape.plain else None,
        candidates=tuple((p.text, dict(p.estimates), c, accepted) for p, c, accepted in formulas),
        rivals=tuple((rival.line, _variables(rival), share) for rival, share in others),
        left_out=tuple((setting.prepared.names[o.flight], o.inside, o.gain) for o in shape.predictions),
        regime=regime,
        separate_by=sweep,
        alike=alike,
    )


def _variables(place: Place) -> tuple[str, ...]:
    return (place.variable, place.by) if place.by else (place.variable,)


def effects_of_same_form(
    plain: Sequence[Plain], line: str, model: Model, effects: Sequence[Effect], rejected: Sequence[Rejected]
) -> tuple[Alike, ...]:
    """Effects missing in `model` that add a multiple of one of these formulas to `line`."""
    one_term = [
        Hypothesis(effect, form)
        for effect in effects
        for form in effect.forms
        if _only_adds_to(line, form) and form.obstacle(model) is None
    ]
    alike = []
    for formula in plain:
        for hypothesis in one_term:
            (piece,), (parameter,) = hypothesis.form.terms[line], hypothesis.form.parameters
            estimate = _as_parameter(formula, piece, parameter.name)
            if estimate is not None:
                reason = _why_not(hypothesis, estimate[0], rejected)
                effect = hypothesis.effect
                alike.append(Alike(effect.name, effect.title, parameter.name, estimate, parameter.unit, reason))
    return tuple(alike)


def _only_adds_to(line: str, form: Form) -> bool:
    """Whether a form only adds one piece with one unknown to a line."""
    extras = form.states or form.transforms or form.outputs or form.output_delays or form.lines
    return not extras and [*form.terms] == [line] and len(form.terms[line]) == 1 and len(form.parameters) == 1


def _as_parameter(formula: Plain, piece: str, parameter: str) -> tuple[float, float] | None:
    """(estimate, bound) of the parameter with which a piece equals the formula; None where it is another function."""
    names = sorted(names_in(formula.text) - {"a"})
    if set(formula.estimates) != {"a"} or names_in(piece) - {parameter} != set(names):
        return None
    points = dict(zip(names, np.random.default_rng(0).uniform(-1.0, 1.0, (len(names), POINTS)), strict=True))
    with np.errstate(all="ignore"):  # a piece from a person's file may have logarithms or poles
        ours = evaluate(formula.text, {**points, "a": 1.0}, FUNCTIONS)
        ratio = ours / evaluate(piece, {**points, parameter: 1.0}, FUNCTIONS)
    if not np.ptp(ratio) < SAME * abs(ratio[0]):
        return None
    value, std = formula.estimates["a"]
    return float(value * ratio[0]), float(std * abs(ratio[0]))


def _why_not(hypothesis: Hypothesis, value: float, rejected: Sequence[Rejected]) -> str:
    """Why a shape does not get the name of an effect with its form. value: of the effect's parameter."""
    (parameter,) = hypothesis.form.parameters
    if not parameter.lower <= value <= parameter.upper:
        return f"that is outside what is physically possible ({parameter.lower:g} to {parameter.upper:g})"
    reasons = [r.why for r in rejected if r.effect == hypothesis.label]
    explains_little = bool(reasons) and reasons[-1].startswith("explains")
    return f"as a name it {reasons[-1] if explains_little else 'does not stand by itself'}"


# ---- an event in time
def events_in_time(setting: Setting, round_: Round) -> Happened | None:
    """Events in time that leave nothing else to explain; None without events, and where something else is significant."""
    setting.tell("what may have happened at one time", 0.94)
    try:
        transients = find_transients(round_)
        if not transients.events or transients.cleared is None or examine(transients.cleared).significant:
            return None
    except GapError:  # a motion that cannot be linearised
        return None
    records, names = round_.baseline.problem.records, setting.prepared.names
    flights = ["" if e.event.record < 0 else names[records[e.event.record].flight] for e in transients.events]
    return Happened([event_report(e, setting.base, f) for e, f in zip(transients.events, flights, strict=True)])


def event_report(detected: DetectedEvent, base: Model, flight: str) -> EventReport:
    """An event as the answer has it. flight: its name, "" for all of them."""
    event, sizes = detected.event, detected.sizes
    unit = next((s.unit for s in base.outputs if s.name == event.channel), "1/s")
    if event.air:  # the integral of half a cosine of rate
        unit = next(s.unit for s in base.states if s.name == event.air)
        share = (event.end - event.start) / np.pi
        sizes = tuple((share * v, share * s) for v, s in sizes)
    where = event.kind.value, event.channel, flight, event.start, event.end
    return EventReport(*where, sizes, unit, detected.score, detected.threshold, event.air)


def event_step(shape: Happened, gap: Gap) -> EffectStep:
    """The step of events in time."""
    first = shape.events[0]
    spans = tuple(dict.fromkeys((e.start, e.end) for e in shape.events[:SPANS]))
    channels = tuple(dict.fromkeys(e.channel or e.air for e in shape.events if e.channel or e.air))
    where = Where(first.channel or "forces and moments", channels, spans, f"{first.what} {first.flight}".rstrip())
    separate_by = "look at the instrument or the weather there, or repeat the flight"
    title = "something that happened at one time"
    return nameless_step(title, where, first.score, first.threshold, gap, separate_by, shape=shape)


# ---- an instrument that holds its values
def find_held_instrument(baseline: Baseline, prepared: FlightRecords) -> HeldInstrument | None:
    """The stale output with the largest residual at repeats beside that at new values; None where none is too large."""
    problem, fit = baseline.problem, baseline.fit
    modelled = [problem.modelled(i, fit.values, local) for i, local in enumerate(fit.locals)]
    residuals = [
        (r.uncompared - y, r.z - y)
        for r, y in zip(problem.records, modelled, strict=True)
        if y is not None and r.uncompared is not None
    ]
    if not residuals:
        return None
    repeated, fresh = (np.concatenate(parts) for parts in zip(*residuals, strict=True))
    step = max(r.interval for r in problem.records)
    instruments = [
        held_instrument(signal.source, _finite(repeated[:, c]), _finite(fresh[:, c]), step, baseline.criteria)
        for c, signal in enumerate(problem.model.outputs)
        if signal.source in prepared.stale
    ]
    return max((h for h in instruments if h is not None), key=lambda h: h.ratio, default=None)


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]


def held_instrument(
    channel: str, repeated: Array, fresh: Array, step: float, criteria: Criteria
) -> HeldInstrument | None:
    """Compare the residuals of a channel at repeated values, (n,), with those at new ones, (m,), of records sampled every `step`
    [s]; None where the former are not much larger."""
    reference = float(np.sqrt(np.mean(fresh**2))) if fresh.size else 0.0
    if not repeated.size or reference <= 0.0:
        return None
    ratio = float(np.sqrt(np.mean(repeated**2))) / reference
    if ratio <= criteria.far_above:
        return None
    share = repeated.size / (repeated.size + fresh.size)
    return HeldInstrument(channel, step / (1.0 - share), share, ratio, criteria.far_above)


def held_step(held: HeldInstrument, gap: Gap) -> EffectStep:
    """The step of an instrument that holds its values."""
    where = Where(held.channel, (held.channel,), (), "where it repeats a value")
    separate_by = f"read {held.channel} at the rate of the other channels, and repeat the flight"
    title = "an instrument that holds its values"
    return nameless_step(title, where, held.ratio, held.threshold, gap, separate_by, shape=held)


# ---- a held-out flight
def not_predicted(baseline: Baseline, prepared: FlightRecords, floor: Floors) -> NotPredicted | None:
    """The held-out flight farthest from the model, where the gap of all is too large: one with a wrong instrument or control, or
    in another configuration. None otherwise, without held-out flights, and where the model runs away on them."""
    if baseline.held_out is None or baseline.held_out[1].diverged:
        return None
    problem, fit = baseline.held_out
    gap = rms_over_noise(problem, fit, baseline.scatter)
    if gap <= baseline.criteria.another_flight * floor.highest:
        return None
    squares = [
        (plain_residuals(problem, fit, i, baseline.scatter) / baseline.scatter) ** 2 for i in range(len(fit.residuals))
    ]
    means = [float(np.mean(_finite(s))) if np.isfinite(s).any() else 0.0 for s in squares]
    worst = int(np.argmax(means))
    record, parts = problem.records[worst], np.nan_to_num(squares[worst])
    order = channels_that_gain(parts.sum(axis=0), baseline.criteria)
    return NotPredicted(
        flight=prepared.names[record.flight],
        channels=tuple(baseline.model.output_names[i] for i in order),
        segments=tuple(spans_of(record.time, parts.sum(axis=1), baseline.criteria)[:SPANS]),
        gap=gap,
        highest=floor.highest,
    )


def held_out_step(unlike: NotPredicted, gap: Gap, floor: Floors) -> EffectStep:
    """The step of an unknown that only a held-out flight shows. gap: on the training flights."""
    title = "a held-out flight that the model does not predict"
    where = Where(" and ".join(unlike.channels), unlike.channels, unlike.segments, f"on {unlike.flight}")
    limit = floor.criteria.another_flight * unlike.highest
    separate_by = f"look at the instruments and the configuration of {unlike.flight}, or hold another flight out"
    held_out = Gap(unlike.gap, unlike.gap, floor.holdout_median or unlike.highest, unlike.highest)
    return nameless_step(title, where, unlike.gap, limit, gap, separate_by, held_out, unlike)
