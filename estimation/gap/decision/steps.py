"""Steps of the answer: an effect, or the nameless rest, with its set, place, closed gap and size in simulator tolerances; and the
power of these flights: scores, detectable sizes, ties, effects that could not have been seen."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.special import ndtri

from estimation.gap.answer.result import EffectStep, Gap, Migration, Tie, Weighed, Where
from estimation.gap.answer.shape import Follower, Shape
from estimation.gap.criteria import Criteria
from estimation.gap.decision.location import SPANS, equation_of, locate
from estimation.gap.effects.base import Effect, EffectParameter
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.fitting import fit
from estimation.gap.records.candidate_model import timing_of
from estimation.gap.search.accept import by_timing, own_inflation
from estimation.gap.search.select import credible_set
from estimation.gap.search.state import AcceptedEffect, Setting
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.measure import Floors, gaps
from estimation.gap.significance.omnibus import Omnibus
from estimation.models.base import ParameterRole

UNKNOWN = "an effect the catalogue does not hold"

SHOWN = 3  # nameless signals in words; the JSON file has more
SMALLEST = 1e-300  # in place of zero in a divisor
RATE, ANGLE, FLOW = (2.0, "deg/s"), (2.0, "deg"), (1.0, "deg")
TOLERANCES = {"p": RATE, "r": RATE, "beta": FLOW, "phi": ANGLE, "q": RATE, "alpha": FLOW, "theta": ANGLE}
"""Tolerances of flight-simulator qualification as published (docs/gap.md): larger changes of an output matter."""


# ---- the nameless rest
def nameless_step(
    title: str,
    where: Where,
    score: float,
    threshold: float,
    gap: Gap,
    separate_by: str,
    holdout: Gap | None = None,
    shape: Shape | None = None,
) -> EffectStep:
    """The step of an effect without a name."""
    return EffectStep(
        effect="unknown", title=title, form="", confidence=0.0, members=(), separate_by=separate_by, estimates={}, units={},
        score=score, threshold=threshold, where=where, gap=gap, holdout=holdout, migrated={}, shape=shape,
    )  # fmt: skip


def unknown_step(omnibus: Omnibus, gap: Gap, shape: Follower | None = None) -> EffectStep:
    """The step of the nameless rest. shape: a lag or swing that gains there."""
    leading = [s for s in omnibus.leading if s.score > omnibus.threshold]
    channels = tuple(dict.fromkeys(s.place for s in leading))
    spans = tuple(s.span for s in leading if s.span is not None)
    where = Where(leading[0].place if leading else "", channels, spans[:SPANS], how_it_shows(omnibus))
    separate_by = "repeat the manoeuvre and vary one signal at a time around the regime named here"
    return nameless_step(UNKNOWN, where, omnibus.score, omnibus.threshold, gap, separate_by, shape=shape)


def how_it_shows(omnibus: Omnibus) -> str:
    """The strongest nameless signals in words."""
    significant = [s for s in omnibus.leading if s.score > omnibus.threshold][:SHOWN]
    return "; ".join(f"{s.place}: like {s.what}" if s.kind == "term" else f"{s.place}: {s.what}" for s in significant)


def misfit_of(rest: Omnibus) -> float:
    """The nameless rest over its threshold (in twice a log-likelihood); 1 where it does not matter."""
    return (rest.score / rest.threshold) ** 2 if rest.significant else 1.0


# ---- an accepted effect
def step_of(setting: Setting, finding: AcceptedEffect, floor: Floors, misfit: float = 1.0) -> EffectStep:
    """The step of an accepted effect, without estimates, which the final model gives. misfit: from `misfit_of` beside it."""
    effect, form = finding.candidate.hypothesis.effect, finding.candidate.hypothesis.form
    weights = finding.choice.beside_rest(misfit)
    members = dict(credible_set(weights, setting.options.criteria))
    members = {effect.name: weights.get(effect.name, 0.0), **members}  # the effect itself first
    shifts = followed_by_timing(finding)
    parent, child = as_sampled(finding.parent) if shifts else finding.parent, finding.child
    gap, held_out_gap = gaps(parent, child, floor, own_inflation(finding.candidate))
    effects = {e.name: e for e in setting.effects}
    separating = [effect.confusions[n] for n in members if n in effect.confusions]
    return EffectStep(
        effect=effect.name, title=effect.title, form=form.label, confidence=members[effect.name],
        members=tuple(Weighed(n, w, effects[n].title, effects[n].separate_by) for n, w in members.items()),
        separate_by=separating[0] if separating else effect.separate_by,
        estimates={}, units={p.name: p.unit for p in form.parameters},
        score=finding.candidate.score, threshold=finding.round_.threshold,
        where=locate(parent, child, equation_of(form)),
        gap=gap, holdout=held_out_gap, migrated=migrated(parent, child), absorbed=_absorbed(finding),
        equation=form.equation or effect.equation, practical=_practical(parent, child), followed=shifts,
    )  # fmt: skip


def followed_by_timing(finding: AcceptedEffect) -> dict[str, float]:
    """Control -> time [s] by which the base had shifted it, where it imitated the effect by that; else empty."""
    if not by_timing(finding.round_, finding.candidate):
        return {}
    values = finding.parent.fit.values
    shifts = {s.name: timing_of(s.name, values) for s in finding.parent.model.inputs if s.control}
    return followers(shifts, finding.round_.criteria)


def followers(shifts: Mapping[str, float], criteria: Criteria) -> dict[str, float]:
    """The surfaces with a shift in time [s] comparable to the largest."""
    limit = criteria.followed_share * max(map(abs, shifts.values()), default=0.0)
    return {n: v for n, v in shifts.items() if abs(v) > limit}


def as_sampled(parent: Baseline) -> Baseline:
    """The parent refitted with all times of its surfaces and attitudes as sampled."""
    problem = parent.problem
    delays = [p.name for p in problem.model.parameters if p.role is ParameterRole.NUISANCE and p.unit == "s"]
    values = {**parent.fit.values, **dict.fromkeys(delays, 0.0)}
    return replace(parent, fit=fit(problem, values, parent.fit.locals, held=delays))


def _absorbed(finding: AcceptedEffect) -> float | None:
    """Share of the effect's whitened signature that the base's own parameters can imitate; None without a score."""
    screen = finding.round_.screen
    if finding.candidate.hypothesis not in screen.hypotheses:
        return None
    span = screen.span(screen.hypotheses.index(finding.candidate.hypothesis))
    projected = screen.projected()
    return 1.0 - float(np.diag(projected.B)[span].sum()) / max(float(projected.raw[span].sum()), SMALLEST)


def _practical(parent: Baseline, child: Baseline) -> str:
    """The largest change of each output by the effect, against simulator tolerances, in words."""
    pairs = zip(parent.fit.residuals, child.fit.residuals, strict=True)
    largest = np.degrees(np.nanmax(np.abs(np.concatenate([p - q for p, q in pairs])), axis=0))
    return worth_in_words(dict(zip(parent.model.output_names, map(float, largest), strict=True)))


def worth_in_words(worth: Mapping[str, float]) -> str:
    """Largest changes of outputs [deg, deg/s] beside their tolerances, in words."""
    judged = [(n, worth[n], band, unit) for n, (band, unit) in TOLERANCES.items() if n in worth]
    words = [f"{n} {w:.2g} against {b:g} {unit}" + (" (beyond it)" if w > b else "") for n, w, b, unit in judged]
    significant = any(w > b for _, w, b, _ in judged)
    return ("matters: " if significant else "real but within simulator tolerances: ") + ", ".join(words)


def migrated(parent: Baseline, child: Baseline) -> dict[str, Migration]:
    """Base derivatives that had absorbed part of the effect, largest change first; weights of a shape do not count."""
    std, derivatives = child.fit.std(), parent.clean.parameter_names
    migrations = {}
    for name in parent.fit.free:
        if name in std and name in derivatives and not child.problem.nuisance(name):
            old, new = parent.fit.values[name], child.fit.values[name]
            bounds = abs(new - old) / max(std[name], SMALLEST)
            if bounds > child.criteria.certain:
                migrations[name] = Migration(old, new, bounds, parent.model.parameter(name).reference)
    return dict(sorted(migrations.items(), key=lambda item: -item[1].bounds))


# ---- the power of the flights
def undetectable(round_: Round) -> list[Effect]:
    """Effects of which twice the usual size (`far_above`) would not have passed the threshold on these flights, and those that
    could not be asked."""
    asked = {h.effect.name: h.effect for h in round_.screen.hypotheses}
    scores: dict[str, float] = {}
    for effect, parameter, score in _scores_per_unit(round_):
        scores[effect.name] = max(scores.get(effect.name, 0.0), score * parameter.typical)
    unseen = [asked[n] for n, score in scores.items() if round_.criteria.far_above * score < round_.threshold]
    unasked = {h.effect.name: h.effect for h in round_.screen.runaway if h.effect.name not in asked}
    return [e for e in (*unseen, *unasked.values()) if not e.tied_to]


def detectable_sizes(round_: Round) -> dict[str, float]:
    """Smallest size of each parameter that would have passed the threshold, by the effect's name for the first of its only
    form."""
    sizes: dict[str, float] = {}
    for effect, parameter, score in _scores_per_unit(round_):
        stands_for_effect = effect.name not in sizes and len(effect.forms) == 1
        sizes[effect.name if stands_for_effect else parameter.name] = round_.threshold / score
    return sizes


def _scores_per_unit(round_: Round) -> list[tuple[Effect, EffectParameter, float]]:
    """Every unknown of every hypothesis, with the score by linear theory of one unit of it."""
    screen, information = round_.screen, np.diag(round_.screen.projected().B)
    return [
        (
            screen.hypotheses[column.hypothesis].effect,
            column.parameter,
            float(np.sqrt(max(float(energy), SMALLEST) / round_.inflation[column.hypothesis])),
        )
        for column, energy in zip(screen.columns, information, strict=True)
    ]


def effect_scores(round_: Round) -> dict[str, float]:
    """Effect -> score of its best form, highest first."""
    scores: dict[str, float] = {}
    for hypothesis, value in zip(round_.screen.hypotheses, round_.standardised(), strict=True):
        scores[hypothesis.effect.name] = max(scores.get(hypothesis.effect.name, 0.0), float(value))
    return dict(sorted(scores.items(), key=lambda item: -item[1]))


def ties_of(round_: Round) -> tuple[Tie, ...]:
    """Pairs of hypotheses of different effects with nearly the same signature, closest first."""
    cosines = np.abs(round_.screen.projected().cosines())
    hypotheses = [round_.screen.hypotheses[column.hypothesis] for column in round_.screen.columns]
    ties = []
    for (i, a), (j, b) in combinations(enumerate(hypotheses), 2):
        if a.effect.name != b.effect.name and cosines[i, j] >= round_.criteria.nearly_all:
            ties.append(Tie(a.label, b.label, float(cosines[i, j])))
    return tuple(sorted(ties, key=lambda t: -t.cosine))


def nominal_threshold(hypotheses: int, criteria: Criteria) -> float:
    """Family-wise limit of |z| of so many hypotheses with an exact noise model (Bonferroni, two-sided)."""
    return float(-ndtri((1.0 - criteria.null_level) / 2 / max(hypotheses, 1)))
