"""Full fits of hypotheses, and their log evidence.

The screen is linear; a delay of 60 ms or a backlash is not. Each leading hypothesis is therefore fitted together with all base
parameters to the training flights. Its log evidence (Laplace approximation) is the gain in log-likelihood over inflation, less a
price for an estimate far from its usual size and for a prior that is wide against the bound of the estimate.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimation.gap.effects.base import EffectParameter, Form
from estimation.gap.fit.baseline import ROUGH, first_values
from estimation.gap.fit.fitting import cost_at, fit
from estimation.gap.fit.noise import NoiseModel
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit, carried_local, freed_by
from estimation.gap.records.candidate_model import awakened
from estimation.gap.significance.screen import Hypothesis, equivalent_z, one_sided
from estimation.models.base import Model
from estimation.models.expressions import names_in, products_in

FIRST_STEPS = 5  # from every start; then only the best goes on
STEPS, TIMES = 25, 4
"""Steps of the best, and how often it goes on from its end. Along a narrow valley (a slow servo against roll damping) short steps
look like the last ones: of a servo of 0.48 s, 0.1 s was found on three kinds of processor, whose rounding differs."""
SETTLED = 0.5  # of the log-likelihood: a fit that gains less from its end is there
ENOUGH = 0.02  # of the log-likelihood: rivals differ by whole units of it
NEAREST, FARTHEST = 0.3, 3.0  # usual sizes from no effect, between which a fit starts: a play of zero has no slope
SHORTER = (0.3, 0.03)  # shares of the first start, tried where the motion runs away from it
WEIGHED = 4.0  # factor from the stated value: no stated mass or moment of inertia is so wrong
AT_LIMIT = 1e-6  # of a parameter's range: an estimate so near to its end was stopped there
AT_NOTHING = 1e-3  # usual sizes: an estimate so near to no effect has shrunk to nothing
SMALLEST_BOUND = 1e-12  # in place of a bound of zero, so that one can divide by it
ABOVE = 1.0  # of the log-likelihood: a fit that ends so far above the base, which it contains, is in a wrong minimum
AFAR = (4.0, 8.0)  # usual sizes: starts of a lag that the base may have taken for slow motion of the aircraft
FOLLOWS = 1.5  # times the cost of the base: derivatives fitted with a wrong lag of that size cost twice to forty times as much
PROBE_STEPS = 2  # then a fit from that start is given up if not near that cost; the right lag needs one or two
NEARLY = 2.0  # times that cost
STRAYED = 0.5  # of the stated value: a derivative farther from it, and by three bounds, may stand for such a lag
HOLDS = 0.5  # of a stated derivative by a control: with less the base has lost what the control does


@dataclass(frozen=True)
class FittedHypothesis:
    """One fitted hypothesis.

    gain: twice the log-likelihood gained over the base fit with the same whiteners. score: the deflated gain as |z| of a single
    unknown. evidence: log evidence relative to the base. estimates: unknown -> (value, bound). size: largest distance from no
    effect, in usual sizes. why_not: reason for rejection, or empty. noise: of these flights with the hypothesis in the model,
    where it was estimated.
    """

    hypothesis: Hypothesis
    fit: ModelFit
    gain: float
    score: float
    evidence: float
    estimates: Mapping[str, tuple[float, float]]
    size: float
    why_not: str = ""
    noise: NoiseModel | None = None

    @property
    def values(self) -> dict[str, float]:
        """Unknown -> its estimate."""
        return {n: value for n, (value, _) in self.estimates.items()}


def fit_hypothesis(
    problem: LikelihoodProblem,
    base_fit: ModelFit,
    hypothesis: Hypothesis,
    guess: Mapping[str, float],
    beyond: float = np.inf,
    afar: ModelFit | None = None,
) -> tuple[LikelihoodProblem, ModelFit]:
    """Fit base and hypothesis together: (problem with the hypothesis in its model, best fit).

    guess: start values of the unknowns. beyond: the fit ends early where this cost is out of its reach. afar: one more start,
    from `fit_from_afar`.

    Delays, lags and plays start also at their usual size: far from no effect the base parameters have other values, which small
    steps from `guess` may not find. A fit that shrinks to no effect is not accepted while another start still goes elsewhere.
    Where the motion runs away from every start, or the best end is worse than the base, the fit starts again nearer to no
    effect: with the base parameters as they were without the hypothesis, the right size can be unstable, or in another valley.
    """
    starts = [_inside(hypothesis, problem, guess)]
    if hypothesis.form.nonlinear:
        typical = {p.name: p.null_value(problem.model) + p.typical for p in hypothesis.form.parameters}
        starts.append(_inside(hypothesis, problem, typical))
    trials = [_first_steps(problem, base_fit, hypothesis, start, beyond) for start in starts]
    if afar is not None:
        trial = replace(problem, model=afar.model)
        trials.append((trial, fit(trial, afar.values, afar.locals, FIRST_STEPS, enough=ENOUGH, beyond=beyond)))
    for share in SHORTER if all(trial_fit.diverged for _, trial_fit in trials) else ():
        nearer = _nearer(hypothesis, problem, starts[0], share)
        trials.append(_first_steps(problem, base_fit, hypothesis, nearer, beyond))
        if not trials[-1][1].diverged:
            break
    ordered = sorted(trials, key=_cost)
    ends: list[tuple[LikelihoodProblem, ModelFit]] = []
    for trial, first_fit in ordered:
        if ends and (first_fit.diverged or _shrank_to_nothing(hypothesis, problem, first_fit)):
            continue
        ends.append((trial, _finished(trial, first_fit, hypothesis, beyond)))
        if not _shrank_to_nothing(hypothesis, problem, ends[-1][1]):
            break
    lowest = min(ends, key=_cost)
    for share in SHORTER if _in_wrong_minimum(hypothesis, problem, base_fit, lowest[1]) else ():
        nearer = _nearer(hypothesis, problem, starts[0], share)
        trial, first_fit = _first_steps(problem, base_fit, hypothesis, nearer, beyond)
        lowest = min(lowest, (trial, _finished(trial, first_fit, hypothesis, beyond)), key=_cost)
        if _cost(lowest) < base_fit.cost:
            break
    return lowest


def _cost(pair: tuple[LikelihoodProblem, ModelFit]) -> float:
    return pair[1].cost if not pair[1].diverged else np.inf


def _in_wrong_minimum(
    hypothesis: Hypothesis, problem: LikelihoodProblem, base_fit: ModelFit, trial_fit: ModelFit
) -> bool:
    """Whether a fit converged to a higher cost than that of the base, which its model contains, and not at a limit."""
    within_limits = all(p.lower < trial_fit.values[p.name] < p.upper for p in hypothesis.form.parameters)
    is_worse = trial_fit.cost > base_fit.cost + ABOVE
    return trial_fit.converged and is_worse and within_limits and not _shrank_to_nothing(hypothesis, problem, trial_fit)


def _finished(trial: LikelihoodProblem, first_fit: ModelFit, hypothesis: Hypothesis, beyond: float) -> ModelFit:
    """The fit continued from its first steps, unless these have ended it; that of a lag, delay or play as long as it gains from
    its end."""
    best = first_fit
    for turn in range(TIMES if hypothesis.form.nonlinear or not first_fit.converged else 0):
        if best.diverged or best.abandoned:
            break
        further = fit(trial, best.values, best.locals, iterations=STEPS, enough=ENOUGH, beyond=beyond)
        gained = _cost((trial, best)) - _cost((trial, further))
        if turn == 0 or gained > 0.0:
            best = further
        if not gained > SETTLED:
            break
    return best


def _shrank_to_nothing(hypothesis: Hypothesis, problem: LikelihoodProblem, trial_fit: ModelFit) -> bool:
    """Whether a fit ended where the hypothesis has no effect."""
    return all(
        abs(trial_fit.values[p.name] - p.null_value(problem.model)) < AT_NOTHING * p.typical
        for p in hypothesis.form.parameters
    )


def _first_steps(
    problem: LikelihoodProblem, base_fit: ModelFit, hypothesis: Hypothesis, start: Mapping[str, float], beyond: float
) -> tuple[LikelihoodProblem, ModelFit]:
    """The first steps of a fit of base and hypothesis together from `start`."""
    model = awakened(problem.model, hypothesis.form, start)
    trial = replace(problem, model=model)
    locals_ = [carried_local(local, base_fit.model, model) for local in base_fit.locals]
    first = {**model.starts(), **base_fit.values, **start}
    return trial, fit(trial, first, locals_, iterations=FIRST_STEPS, enough=ENOUGH, beyond=beyond)


def fit_from_afar(problem: LikelihoodProblem, base_fit: ModelFit, hypothesis: Hypothesis) -> ModelFit | None:
    """A fit of the model's derivatives from their first values, with a control that is late by some usual sizes.

    A servo's lag and the roll mode, in series, give the same response when they exchange their time constants. From a base that
    took the servo's for the roll mode's, no step leads to the other order. None where the fit does not follow these flights, or
    where the derivatives of the base are near what the model states.
    """
    slowed = {t.input for t in hypothesis.form.transforms if t.kind in ("delay", "lag")}
    if not (slowed and strayed(problem, base_fit, slowed)):
        return None
    null_values, begun = values_without_effect(hypothesis.form, problem.model), []
    for size in AFAR:
        start = {p.name: min(null_values[p.name] + size * p.typical, p.upper) for p in hypothesis.form.parameters}
        trial = replace(problem, model=awakened(problem.model, hypothesis.form, start))
        begun.append((trial, {**first_values(trial), **start}))
    trial, values = min(begun, key=lambda b: cost_at(*b))
    locals_ = [carried_local(local, base_fit.model, trial.model) for local in base_fit.locals]
    late, limit = {p.name for p in hypothesis.form.parameters}, FOLLOWS * base_fit.cost
    held, trial_fit = [n for n in trial.free if n in late or trial.nuisance(n)], None
    for steps, cost_limit in ((PROBE_STEPS, NEARLY * limit), (FIRST_STEPS - PROBE_STEPS, limit)):
        trial_fit = fit(trial, values, locals_, iterations=steps, enough=ROUGH, held=held, beyond=limit)
        if trial_fit.diverged or trial_fit.cost > cost_limit:
            return None
        values, locals_ = dict(trial_fit.values), list(trial_fit.locals)
    return trial_fit


def strayed(problem: LikelihoodProblem, base_fit: ModelFit, controls: Collection[str]) -> bool:
    """Whether a derivative of the fitted base that may stand for a late control is far from what the model states.

    Such are the derivatives by the motion in the coefficients that one of `controls` changes. True also where the model states
    none of them, and where the base finds less than half of every stated derivative by `controls`: with what comes half a second
    late nothing correlates any more.
    """
    starts, std, bounds = problem.model.starts(), base_fit.std(), problem.criteria.certain
    non_zero = {n for n in problem.parameters if not problem.nuisance(n) and starts[n] != 0.0}
    stated = {n: starts[n] for n in non_zero & beside_controls(problem.base, controls)}
    if not stated or any(
        abs(base_fit.values[n] - value) > STRAYED * abs(value) + bounds * std[n] for n, value in stated.items()
    ):
        return True
    shares = [
        base_fit.values[n] / starts[n] for n in non_zero & by_controls(problem.base.definitions.values(), controls)
    ]
    return bool(shares) and max(shares) < HOLDS


def beside_controls(model: Model, controls: Collection[str]) -> set[str]:
    """Names in the lines of a model that contain one of `controls`, without the factors of any control.

    A control's effectiveness says nothing about when the control moves, as long as there is some.
    """
    all_controls = {s.name for s in model.inputs if s.control}
    lines = [text for text in model.definitions.values() if names_in(text) & set(controls)]
    return {name for text in lines for name in names_in(text)} - by_controls(lines, all_controls)


def by_controls(lines: Iterable[str], controls: Collection[str]) -> set[str]:
    """Names in those products of some lines that contain one of `controls`."""
    products = [product for text in lines for product in products_in(text)]
    return {name for product in products if product & set(controls) for name in product}


def _nearer(
    hypothesis: Hypothesis, problem: LikelihoodProblem, start: Mapping[str, float], share: float
) -> dict[str, float]:
    """Start values at a share of their distance from no effect."""
    null_values = values_without_effect(hypothesis.form, problem.model)
    return {n: null_values[n] + share * (value - null_values[n]) for n, value in start.items()}


def values_without_effect(form: Form, model: Model) -> dict[str, float]:
    """Unknown of a form -> its value in `model` where there is no effect."""
    return {p.name: p.null_value(model) for p in form.parameters}


def _inside(hypothesis: Hypothesis, problem: LikelihoodProblem, guess: Mapping[str, float]) -> dict[str, float]:
    """`guess` moved inside the physical range, and away from no effect, where one-sided effects have no slope."""
    start = {}
    for p in hypothesis.form.parameters:
        null = p.null_value(problem.model)
        value = guess.get(p.name, null)
        minimum = null + NEAREST * p.typical if one_sided(p, null, problem.criteria) else -np.inf
        width = FARTHEST * p.typical
        start[p.name] = float(np.clip(max(value, minimum), max(p.lower, null - width), min(p.upper, null + width)))
    return start


def assess(
    problem: LikelihoodProblem,
    base_fit: ModelFit,
    hypothesis: Hypothesis,
    trial_fit: ModelFit,
    inflation: float,
    score_inflation: float | None = None,
) -> FittedHypothesis:
    """Gain, score, evidence and admissibility of a fitted hypothesis.

    inflation: for the evidence and the bounds, shared by rivals; score_inflation: for the score (default: the same).
    """
    criteria = problem.criteria
    gain = 2.0 * (base_fit.cost - trial_fit.cost) if not trial_fit.diverged else 0.0
    prior_gain = freed_by(problem, base_fit, trial_fit) if not trial_fit.diverged else 0.0
    std = trial_fit.std() if not trial_fit.diverged else {}
    evidence = 0.5 * deflated(gain, prior_gain, inflation)
    evidence -= float(np.log(len(hypothesis.effect.forms)))  # the forms of an effect share its prior probability
    estimates: dict[str, tuple[float, float]] = {}
    why_not, size = "the fit diverges" if trial_fit.diverged else "", 0.0
    for p in hypothesis.form.parameters:
        null = p.null_value(problem.model)
        value, bound = float(trial_fit.values[p.name]), float(std.get(p.name, np.inf)) * np.sqrt(inflation)
        estimates[p.name] = (value, bound)
        size = max(size, abs(value - null) / p.typical)
        evidence -= price(value - null, bound, criteria.prior_width * p.typical, criteria.prior_tail)
        why_not = why_not or impossible(p, value, null)
    extra_initial_states = len(hypothesis.form.states) * extra_records(problem)
    evidence -= 0.5 * extra_initial_states  # what so many unknowns gain from noise alone, on average
    unknowns = len(hypothesis.form.parameters) + extra_initial_states
    deflated_gain = deflated(gain, prior_gain, inflation if score_inflation is None else score_inflation)
    score = equivalent_z(deflated_gain, unknowns)
    return FittedHypothesis(hypothesis, trial_fit, gain, score, evidence, estimates, size, why_not)


def extra_records(problem: LikelihoodProblem) -> int:
    """Number of records beyond one for each flight.

    Each record frees the initial value of a hypothesis' own state once more. A flight broken into twenty records by a bad link
    gives a lag twenty such unknowns, which explain much that is no lag.
    """
    return len(problem.records) - len({r.flight for r in problem.records})


def deflated(gain: float, prior_gain: float, inflation: float) -> float:
    """A gain over inflation. prior_gain: the part that comes from priors; inflation, found on residuals, leaves it as it is."""
    return (gain - prior_gain) / inflation + prior_gain


def price(distance: float, bound: float, width: float, tail: float) -> float:
    """What an estimate costs in log evidence (Laplace): for its distance from no effect, in widths of the prior, and for the
    ratio of this width to the bound; 0 where the bound is infinite.

    The prior is Student's t with `tail` degrees of freedom. The usual size of an effect is known from some aircraft, and another
    kind may have ten times as much; with a Gaussian prior that cost more than any flight can gain.
    """
    if not np.isfinite(bound):
        return 0.0
    distance_price = 0.5 * (tail + 1.0) * np.log1p((distance / width) ** 2 / tail)
    return float(distance_price + max(np.log(width / max(bound, SMALLEST_BOUND)), 0.0))


def impossible(p: EffectParameter, value: float, null: float) -> str:
    """Why an estimate is rejected that ended at a limit of what is physically possible; empty for any other.

    null: value without effect. Where the range begins above it (the shortest lag that can be simulated), the lower limit is no
    reason: a shorter lag would leave nearly the same residuals.
    """
    lower, upper = p.lower, p.upper
    if isinstance(p.none, str) and 0.0 < lower < null:  # a mass or inertia that the model states
        lower, upper = max(lower, null / WEIGHED), min(upper, null * WEIGHED)
    edge = AT_LIMIT * (upper - lower)
    if (lower + edge < value or null < lower) and value < upper - edge:
        return ""
    if abs(value - null) < AT_NOTHING * p.typical:
        return f"{p.name} shrinks to nothing"
    return f"{p.name} = {value:.3g} {p.unit} is outside what is physically possible ({lower:g} to {upper:g})"
