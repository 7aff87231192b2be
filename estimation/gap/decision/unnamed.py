"""Steps of effects without a name: a curve with its band, its rivals and effects of the catalogue of the same form; an event in
time; an instrument that holds its values."""

from collections.abc import Sequence

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.answer.result import EffectStep, Gap, GapVerdict, Rejected, Where
from estimation.gap.answer.shape import Alike, EventReport, Happened, HeldInstrument, ShapeCurve
from estimation.gap.criteria import Criteria
from estimation.gap.decision.decide import Decision
from estimation.gap.decision.location import SPANS, locate
from estimation.gap.decision.steps import UNKNOWN, nameless_step
from estimation.gap.effects.base import Effect, Form
from estimation.gap.errors import GapError
from estimation.gap.fit.baseline import Baseline
from estimation.gap.records.flight_records import FlightRecords
from estimation.gap.search.state import AcceptedEffect, SearchState, Setting
from estimation.gap.shapes.formulas import Plain
from estimation.gap.shapes.search import CoefficientShape, SearchTask, ShapeSearch, find_shape
from estimation.gap.significance.calibration import Round
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
SAME = 1e-9  # relative change of the ratio of two forms by rounding alone


def standing_round(setting: Setting, search: SearchState, findings: Sequence[AcceptedEffect]) -> Round:
    """The round about the model with the names that stand."""
    standing = findings[-1].child if findings else search.rounds[0].baseline
    round_ = next((r for r in search.rounds if r.baseline is standing), None)
    return round_ or setting.screened(standing, len(search.rounds))


def search_shape(setting: Setting, search: SearchState, round_: Round, decision: Decision) -> ShapeSearch:
    """Look for a shape of the rest that the standing names leave; at length where that rest is an unknown effect."""
    setting.tell("a shape for what has no name", 0.92)
    number = len(search.rounds)
    task = SearchTask(
        setting.prepared,
        setting.errors,
        setting.options.seed,
        lambda b: setting.screened(b, number + 1),
        setting.floors,
    )
    try:
        return find_shape(round_, task, decision.verdict is GapVerdict.UNKNOWN)
    except GapError:  # a motion that cannot be linearised: the answer stands without a shape
        return ShapeSearch(None, ())


def shaped_step(
    shape: CoefficientShape, baseline: Baseline, setting: Setting, rejected: Sequence[Rejected]
) -> EffectStep:
    """The step of an unknown whose shape was found about `baseline`. rejected: names rejected by the search."""
    location, measured = locate(baseline, shape.measured.child, shape.fitted.increment.place.line), shape.measured
    formulas = [formula for formula, _ in shape.plain]
    alike = effects_of_same_form(formulas, location.equation, baseline.clean, setting.effects, rejected)
    curve = curve_of(shape, setting, location.regime, alike)
    title, separate_by = UNNAMED if alike else UNKNOWN, curve.separate_by
    return nameless_step(
        title, location, shape.score, shape.threshold, measured.gap, separate_by, measured.holdout, curve
    )


def curve_of(shape: CoefficientShape, setting: Setting, regime: str, alike: tuple[Alike, ...]) -> ShapeCurve:
    """The curve of a shape as the answer has it. alike: effects of the catalogue with its form."""
    increment = shape.fitted.increment
    place, limits = increment.place, increment.flown
    x, value, std = increment.curve(shape.measured.child.fit)
    unit = "rad" if place.variable in ANGLES else _unit(setting.base, place.variable)
    variables = (place.variable, place.by) if place.by else (place.variable,)
    formulas = [(p, c, True) for p, c in shape.plain] + [(p, c, False) for p, c in shape.refused]
    return ShapeCurve(
        output=place.line, variables=variables, grid=x, value=value / increment.reach, std=std / increment.reach, unit=unit,
        low=limits.low, high=limits.high, closed=shape.measured.closed,
        analytic=shape.plain[0][0].text if shape.plain else None,
        candidates=tuple((p.text, dict(p.estimates), c, accepted) for p, c, accepted in formulas),
        rivals=tuple(
            (f.increment.place.line, tuple(n for n in (f.increment.place.variable, f.increment.place.by) if n),
             f.gain / shape.fitted.gain)
            for f in shape.rivals
        ),
        left_out=tuple((setting.prepared.names[o.flight], o.inside, o.gain) for o in shape.predictions),
        regime=regime,
        separate_by=SLOW_SWEEP.format(x=place.variable, low=limits.low, high=limits.high, unit=unit), alike=alike,
    )  # fmt: skip


def _unit(model: Model, variable: str) -> str:
    return next((s.unit for s in (*model.states, *model.inputs, *model.outputs) if s.name == variable), "1")


def events_in_time(setting: Setting, round_: Round) -> Happened | None:
    """Events in time that leave nothing else to explain; None without events, and where something else is significant."""
    setting.tell("what may have happened at one time", 0.94)
    try:
        transients = find_transients(round_)
        if not transients.events or transients.cleared is None:
            return None
        rest = examine(transients.cleared)
    except GapError:  # a motion that cannot be linearised
        return None
    if rest.significant:
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
    return EventReport(
        event.kind.value,
        event.channel,
        flight,
        event.start,
        event.end,
        sizes,
        unit,
        detected.score,
        detected.threshold,
        event.air,
    )


def event_step(shape: Happened, gap: Gap) -> EffectStep:
    """The step of events in time."""
    first = shape.events[0]
    spans = tuple(dict.fromkeys((e.start, e.end) for e in shape.events[:SPANS]))
    channels = tuple(dict.fromkeys(e.channel or e.air for e in shape.events if e.channel or e.air))
    where = Where(first.channel or "forces and moments", channels, spans, f"{first.what} {first.flight}".rstrip())
    separate_by = "look at the instrument or the weather there, or repeat the flight"
    title = "something that happened at one time"
    return nameless_step(title, where, first.score, first.threshold, gap, separate_by, shape=shape)


def find_held_instrument(baseline: Baseline, prepared: FlightRecords) -> HeldInstrument | None:
    """The stale output with the largest residual at repeats beside that at new values; None where none is too large."""
    problem, fit = baseline.problem, baseline.fit
    modelled = [problem.modelled(i, fit.values, local) for i, local in enumerate(fit.locals)]
    pairs = [
        (r, y) for r, y in zip(problem.records, modelled, strict=True) if y is not None and r.uncompared is not None
    ]
    step = max(r.interval for r in problem.records)
    instruments = []
    for c, signal in enumerate(problem.model.outputs):
        if signal.source in prepared.stale and pairs:
            repeated = np.concatenate([r.uncompared[:, c] - y[:, c] for r, y in pairs if r.uncompared is not None])
            fresh = np.concatenate([r.z[:, c] - y[:, c] for r, y in pairs])
            repeated, fresh = repeated[np.isfinite(repeated)], fresh[np.isfinite(fresh)]
            instruments.append(held_instrument(signal.source, repeated, fresh, step, baseline.criteria))
    return max((h for h in instruments if h is not None), key=lambda h: h.ratio, default=None)


def held_instrument(
    channel: str, repeated: Array, fresh: Array, step: float, criteria: Criteria
) -> HeldInstrument | None:
    """Compare the residuals of a channel at repeated values, (n,), with those at new ones, (m,), of records sampled every `step`
    [s]; None where the former are not much larger."""
    reference = float(np.sqrt(np.mean(fresh**2))) if fresh.size else 0.0
    if not repeated.size or reference <= 0.0:
        return None
    ratio = float(np.sqrt(np.mean(repeated**2))) / reference
    if ratio <= criteria.held_ratio:
        return None
    share = repeated.size / (repeated.size + fresh.size)
    return HeldInstrument(channel, step / (1.0 - share), share, ratio, criteria.held_ratio)


def held_step(held: HeldInstrument, gap: Gap) -> EffectStep:
    """The step of an instrument that holds its values."""
    where = Where(held.channel, (held.channel,), (), "where it repeats a value")
    separate_by = f"read {held.channel} at the rate of the other channels, and repeat the flight"
    title = "an instrument that holds its values"
    return nameless_step(title, where, held.ratio, held.threshold, gap, separate_by, shape=held)


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
    return tuple(
        _alike(hypothesis, estimate, rejected)
        for formula in plain
        for hypothesis in one_term
        if (estimate := _as_parameter(formula, hypothesis.form.terms[line][0], hypothesis.form.parameters[0].name))
        is not None
    )


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


def _alike(hypothesis: Hypothesis, estimate: tuple[float, float], rejected: Sequence[Rejected]) -> Alike:
    """An effect with the form of a shape, and why the shape does not get its name."""
    effect, parameter = hypothesis.effect, hypothesis.form.parameters[0]
    reasons = [r.why for r in rejected if r.effect == hypothesis.label]
    if not parameter.lower <= estimate[0] <= parameter.upper:
        reason = f"that is outside what is physically possible ({parameter.lower:g} to {parameter.upper:g})"
    else:
        explains_little = bool(reasons) and reasons[-1].startswith("explains")
        reason = f"as a name it {reasons[-1] if explains_little else 'does not stand by itself'}"
    return Alike(effect.name, effect.title, parameter.name, estimate, parameter.unit, reason)
