"""Full fits of the leading hypotheses and what they weigh against each other.

A screen is linear; a delay of 60 ms or a backlash is not. Each leading hypothesis is fitted together with all base
parameters on the training flights. Weights follow from the evidence (Laplace approximation): gain in log-likelihood,
divided by the inflation found on the nulls, the price of an estimate far from its usual size, and the width of the prior
against the bound.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimation.gap.effects.base import EffectParameter
from estimation.gap.fit.baseline import ROUGH, first_values
from estimation.gap.fit.fitting import fit
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit, carried_local, freed_by
from estimation.gap.fit.spectra import NoiseModel
from estimation.gap.records.candidate_model import awakened
from estimation.gap.significance.screen import Hypothesis, equivalent_z, one_sided
from estimation.models.base import Model
from estimation.models.expressions import names_in, products_in

FIRST_STEPS = 5  # from every start; the better end goes on
STEPS = 30  # in all, along a narrow valley (a slow servo against roll damping): twelve end where rounding had led them
ENOUGH = 0.02  # of the log-likelihood: rivals are weighed by whole units of it
NEAREST, FARTHEST = 0.3, 3.0  # usual sizes from no effect, between which a fit starts: at none a play has no slope
SHORTER = (0.3, 0.03)  # of the first start, where the motion runs away from it
WEIGHED = 4.0  # times less or more than stated: no mass and no moment of inertia is so wrong
AT_LIMIT = 1e-6  # of a parameter's range: an estimate so near its end was stopped there
AT_NOTHING = 1e-3  # usual sizes: so near to none it has shrunk to nothing, and the words say so
ABOVE = 1.0  # of the log-likelihood: a fit that ends so far above the base, which it holds, is lost
AFAR = 4.0  # usual sizes: where a lag begins that the base may have taken for slow motion of the aircraft
FOLLOWS = 1.5  # of the cost of the base: derivatives with a wrong lag of that size cost twice to forty times as much
LOOK_STEPS = (
    2  # after which a fit from there is given up unless it is near that cost: the right lag is after one or two
)
NEARLY = 2.0  # times that cost
STRAYED = 0.5  # of what the model states: a derivative farther from it, and by three bounds, may hold such a lag


@dataclass(frozen=True)
class FittedHypothesis:
    """One fitted hypothesis. gain: twice the log-likelihood gained over the base fit with the same whitening.
    evidence: log evidence relative to the base. why_not: reason for rejection, or empty. noise: of these flights with the
    hypothesis in the model, where it was estimated."""

    hypothesis: Hypothesis
    fit: ModelFit
    gain: float
    score: float
    evidence: float
    estimates: Mapping[str, tuple[float, float]]
    size: float  # largest distance from no effect, in usual sizes
    why_not: str = ""
    noise: NoiseModel | None = None


def fit_hypothesis(
    problem: LikelihoodProblem,
    base_fit: ModelFit,
    hypothesis: Hypothesis,
    guess: Mapping[str, float],
    beyond: float = np.inf,
    afar: ModelFit | None = None,
) -> tuple[LikelihoodProblem, ModelFit]:
    """Fit base and hypothesis together from `guess`; (problem, fit).

    Delays, lags and plays are also started at their usual size, and the better end is kept: far from no effect the base
    parameters sit elsewhere, and a small step does not find the way. An end at nothing is not believed while another start
    is still on its way to something. Where the motion runs away from every start, or the best end is worse than the base,
    the fit begins nearer to no effect: with the base where it was without it, a guess that is right can be unstable, or
    another valley lies between. beyond: a cost that must be in reach, or the fit ends early.
    afar: one more start (`begun_afar`).
    """
    starts = [_inside(hypothesis, problem, guess)]
    if hypothesis.form.nonlinear:
        typical = {p.name: p.null_value(problem.model) + p.typical for p in hypothesis.form.parameters}
        starts.append(_inside(hypothesis, problem, typical))
    trials = [_begun(problem, base_fit, hypothesis, start, beyond) for start in starts]
    if afar is not None:
        trial = replace(problem, model=afar.model)
        trials.append((trial, fit(trial, afar.values, afar.locals, FIRST_STEPS, enough=ENOUGH, beyond=beyond)))
    for share in SHORTER if all(trial_fit.diverged for _, trial_fit in trials) else ():
        trials.append(_begun(problem, base_fit, hypothesis, _nearer(hypothesis, problem, starts[0], share), beyond))
        if not trials[-1][1].diverged:
            break
    ordered = sorted(trials, key=_cost)
    ends: list[tuple[LikelihoodProblem, ModelFit]] = []
    for trial, first_fit in ordered:
        if ends and (first_fit.diverged or _nothing(hypothesis, problem, first_fit)):
            continue
        ends.append((trial, _carried_on(trial, first_fit, beyond)))
        if not _nothing(hypothesis, problem, ends[-1][1]):
            break
    lowest = min(ends, key=_cost)
    for share in SHORTER if _lost(hypothesis, problem, base_fit, lowest[1]) else ():
        trial, first_fit = _begun(problem, base_fit, hypothesis, _nearer(hypothesis, problem, starts[0], share), beyond)
        lowest = min(lowest, (trial, _carried_on(trial, first_fit, beyond)), key=_cost)
        if _cost(lowest) < base_fit.cost:
            break
    return lowest


def _cost(pair: tuple[LikelihoodProblem, ModelFit]) -> float:
    return pair[1].cost if not pair[1].diverged else np.inf


def _lost(hypothesis: Hypothesis, problem: LikelihoodProblem, base_fit: ModelFit, found: ModelFit) -> bool:
    """Whether a fit came to rest above the base that it holds, not at a limit: another valley lies between."""
    within_limits = all(p.lower < found.values[p.name] < p.upper for p in hypothesis.form.parameters)
    is_worse = found.cost > base_fit.cost + ABOVE
    return found.converged and is_worse and within_limits and not _nothing(hypothesis, problem, found)


def _carried_on(trial: LikelihoodProblem, begun: ModelFit, beyond: float) -> ModelFit:
    if begun.converged or begun.diverged or begun.abandoned:
        return begun
    return fit(trial, begun.values, begun.locals, iterations=STEPS - FIRST_STEPS, enough=ENOUGH, beyond=beyond)


def _nothing(hypothesis: Hypothesis, problem: LikelihoodProblem, found: ModelFit) -> bool:
    """Whether a fit ended where the hypothesis does nothing."""
    return all(
        abs(found.values[p.name] - p.null_value(problem.model)) < AT_NOTHING * p.typical
        for p in hypothesis.form.parameters
    )


def _begun(
    problem: LikelihoodProblem, base_fit: ModelFit, hypothesis: Hypothesis, start: Mapping[str, float], beyond: float
) -> tuple[LikelihoodProblem, ModelFit]:
    """The first steps of base and hypothesis together from a start."""
    model = awakened(problem.model, hypothesis.form, start)
    trial = replace(problem, model=model)
    locals_ = [carried_local(local, base_fit.model, model) for local in base_fit.locals]
    first = {**model.starts(), **base_fit.values, **start}
    return trial, fit(trial, first, locals_, iterations=FIRST_STEPS, enough=ENOUGH, beyond=beyond)


def begun_afar(problem: LikelihoodProblem, base_fit: ModelFit, hypothesis: Hypothesis) -> ModelFit | None:
    """The model's derivatives fitted afresh with a control that is late by some usual sizes; None where that is no way to follow
    these flights, or the base is where it was expected.

    A servo and a roll, one behind the other, look the same when they change places: about a base that took the slow one for the
    aircraft's no step leads to the other order.
    """
    slowed = {t.input for t in hypothesis.form.transforms if t.kind in ("delay", "lag")}
    if not (slowed and strayed(problem, base_fit, slowed)):
        return None
    none = {p.name: p.null_value(problem.model) for p in hypothesis.form.parameters}
    start = {p.name: min(none[p.name] + AFAR * p.typical, p.upper) for p in hypothesis.form.parameters}
    trial = replace(problem, model=awakened(problem.model, hypothesis.form, start))
    locals_ = [carried_local(local, base_fit.model, trial.model) for local in base_fit.locals]
    held, limit = [n for n in trial.free if n in start or trial.nuisance(n)], FOLLOWS * base_fit.cost
    values, found = {**first_values(trial), **start}, None
    for steps, most in ((LOOK_STEPS, NEARLY * limit), (FIRST_STEPS - LOOK_STEPS, limit)):
        found = fit(trial, values, locals_, iterations=steps, enough=ROUGH, held=held, beyond=limit)
        if found.diverged or found.cost > most:
            return None
        values, locals_ = dict(found.values), list(found.locals)
    return found


def strayed(problem: LikelihoodProblem, base_fit: ModelFit, controls: Collection[str]) -> bool:
    """Whether some derivative of the fitted base by what moves, in a coefficient that one of the controls changes, is far from
    what the model states: it may hold that the control is late. How far a control moves the aircraft says nothing of when."""
    starts, std, bounds = problem.model.starts(), base_fit.std(), problem.criteria.certain
    stated = {n for n in problem.parameters if not problem.nuisance(n) and starts[n] != 0.0}
    asked = {n: starts[n] for n in stated & beside_controls(problem.base, controls)}
    return not asked or any(
        abs(base_fit.values[n] - value) > STRAYED * abs(value) + bounds * std[n] for n, value in asked.items()
    )


def beside_controls(model: Model, controls: Collection[str]) -> set[str]:
    """Names in the lines of a model that hold one of some controls, but for what multiplies any control there."""
    every = {s.name for s in model.inputs if s.control}
    lines = [text for text in model.definitions.values() if names_in(text) & set(controls)]
    effectiveness = {name for text in lines for product in products_in(text) if product & every for name in product}
    return {name for text in lines for name in names_in(text)} - effectiveness


def _nearer(
    hypothesis: Hypothesis, problem: LikelihoodProblem, start: Mapping[str, float], share: float
) -> dict[str, float]:
    """A start moved to a share of its distance from no effect."""
    none = {p.name: p.null_value(problem.model) for p in hypothesis.form.parameters}
    return {n: none[n] + share * (value - none[n]) for n, value in start.items()}


def _inside(hypothesis: Hypothesis, problem: LikelihoodProblem, guess: Mapping[str, float]) -> dict[str, float]:
    """Start values inside the physical range and not exactly at no effect, where one-sided effects have no slope."""
    start = {}
    for p in hypothesis.form.parameters:
        none = p.null_value(problem.model)
        value = guess.get(p.name, none)
        minimum = none + NEAREST * p.typical if one_sided(p, none, problem.criteria) else -np.inf
        width = FARTHEST * p.typical
        start[p.name] = float(np.clip(max(value, minimum), max(p.lower, none - width), min(p.upper, none + width)))
    return start


def assess(
    problem: LikelihoodProblem,
    base_fit: ModelFit,
    hypothesis: Hypothesis,
    found: ModelFit,
    inflation: float,
    own: float | None = None,
) -> FittedHypothesis:
    """Gain, score, evidence and admissibility of a fitted hypothesis.

    inflation: by which rivals' gains are divided alike for the evidence; own: the hypothesis' own, for its score.
    """
    criteria = problem.criteria
    gain = 2.0 * (base_fit.cost - found.cost) if not found.diverged else 0.0
    relief = freed_by(problem, base_fit, found) if not found.diverged else 0.0
    std = found.std() if not found.diverged else {}
    evidence = 0.5 * deflated(gain, relief, inflation)
    evidence -= float(np.log(len(hypothesis.effect.forms)))  # forms share their effect's prior
    estimates: dict[str, tuple[float, float]] = {}
    why_not, size = "the fit diverges" if found.diverged else "", 0.0
    for p in hypothesis.form.parameters:
        none = p.null_value(problem.model)
        value, bound = float(found.values[p.name]), float(std.get(p.name, np.inf)) * np.sqrt(inflation)
        estimates[p.name] = (value, bound)
        size = max(size, abs(value - none) / p.typical)
        evidence -= price(value - none, bound, criteria.prior_width * p.typical, criteria.prior_tail)
        why_not = why_not or impossible(p, value, none)
    extra_starts = len(hypothesis.form.states) * begun_anew(problem)
    evidence -= 0.5 * extra_starts  # what as many unknowns gain of noise
    unknowns = len(hypothesis.form.parameters) + extra_starts
    score = equivalent_z(deflated(gain, relief, inflation if own is None else own), unknowns)
    return FittedHypothesis(hypothesis, found, gain, score, evidence, estimates, size, why_not)


def begun_anew(problem: LikelihoodProblem) -> int:
    """Stretches that a state begins in beyond one for each flight: where a link breaks twenty times, what a lag or a flow of its
    own begins with is free twenty times, and pays for much that is no such effect."""
    return len(problem.records) - len({r.flight for r in problem.records})


def deflated(gain: float, freed: float, inflation: float) -> float:
    """A gain over its inflation on the nulls. That is of residuals: the part that comes from priors is not scattered by them."""
    return (gain - freed) / inflation + freed


def price(distance: float, bound: float, width: float, tail: float) -> float:
    """What an estimate costs in log evidence (Laplace): its distance from no effect in widths of the prior, and the width of
    the prior against the bound.

    The prior is Student's t with `tail` degrees of freedom: the usual size of an effect is known from some aircraft, and another
    kind of aircraft may have ten times as much of it. A Gaussian one made that cost more than any flight could tell.
    """
    if not np.isfinite(bound):
        return 0.0
    distance_price = 0.5 * (tail + 1.0) * np.log1p((distance / width) ** 2 / tail)
    return float(distance_price + max(np.log(width / max(bound, 1e-12)), 0.0))


def impossible(p: EffectParameter, value: float, none: float) -> str:
    """Why an estimate is none, or nothing: it ended at a limit of what is physically possible. The least lag that can be flown is
    not one: a shorter one than that leaves nearly the same."""
    lower, upper = p.lower, p.upper
    if isinstance(p.none, str) and 0.0 < lower < none:  # a mass or inertia that the model states
        lower, upper = max(lower, none / WEIGHED), min(upper, none * WEIGHED)
    edge = AT_LIMIT * (upper - lower)
    if (lower + edge < value or none < lower) and value < upper - edge:
        return ""
    if abs(value - none) < AT_NOTHING * p.typical:
        return f"{p.name} shrinks to nothing"
    return f"{p.name} = {value:.3g} {p.unit} is outside what is physically possible ({lower:g} to {upper:g})"
