"""Fit the leading hypotheses of a round in full, and weigh them by their evidence.

A full fit goes to those whose predicted gain (promise) is near what a name needs, and near the best promise. For a hypothesis
that is linear in its unknowns, linear theory predicts the gain of the full fit. For a delay, a lag or a play it does not: the
effect of a small step says little about that of the usual size. Their changes of the outputs are computed at several sizes and
interpolated linearly; as in linear theory, the part that the base parameters can absorb is projected out.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.answer.result import Rejected
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Form
from estimation.gap.fit.fitting import fit
from estimation.gap.fit.problem import LikelihoodProblem, ModelFit, changes_by
from estimation.gap.records.candidate_model import awakened
from estimation.gap.records.flight_records import FlightRecord, sample_interval
from estimation.gap.search.confirm import ENOUGH, FittedHypothesis, assess, fit_from_afar, fit_hypothesis
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.screen import Hypothesis, Projected, Screen, gram_of, linear_guess

SIZES = (0.3, 1.0, 3.0)
"""Multiples of the usual size: from what the screen takes for a small step to the farthest from which a fit starts."""
BEYOND = 4.0  # times the last size, up to which its change is extrapolated linearly
HOPELESS = 0.5  # of the gain that a name needs: below this promise a hypothesis is not fitted, a fit given up
OUT_OF_REACH = 30.0  # of the log evidence: a rival so far behind the best cannot win after any later check
NOISE_CANDIDATES = 3  # hypotheses of the largest gain that may be hidden in the noise; more would be rivals of one form
AGAIN = 8  # steps from the end of the first fit, with other whiteners


@dataclass(frozen=True)
class Choice:
    """The outcome of one round: candidates, best first; effect -> weight; hypotheses that were rejected."""

    candidates: tuple[FittedHypothesis, ...]
    weights: Mapping[str, float]
    rejected: tuple[Rejected, ...]

    @classmethod
    def of(cls, candidates: Sequence[FittedHypothesis]) -> "Choice":
        """A choice between candidates, best first, weighed by their evidence."""
        return cls(tuple(candidates), _weights(candidates), ())

    @property
    def best(self) -> FittedHypothesis | None:
        return self.candidates[0] if self.candidates else None

    def without(self, refused: Collection[tuple[str, str]]) -> "Choice":
        """The same without candidates that a later check refused, with the weights of the others."""
        remaining = tuple(c for c in self.candidates if c.hypothesis.key not in refused)
        return replace(self, candidates=remaining, weights=_weights(remaining))

    def beside_rest(self, misfit: float) -> Mapping[str, float]:
        """Weights where a nameless remainder is left. misfit: its gain over what is significant; evidence is divided by it.

        What is still missing from the model biases the gains of the rivals, so that their evidence counts less.
        """
        return _weights(self.candidates, misfit) if misfit > 1.0 and self.candidates else self.weights


def choose(round_: Round) -> Choice:
    """Fit the leading hypotheses in full and weigh them."""
    if not round_.screen.hypotheses:
        return Choice((), {}, ())
    criteria, inflation = round_.criteria, shared_inflation(round_)
    judged, rejected = judged_hypotheses(round_, inflation)
    admissible = sorted((c for c in judged if not c.why_not), key=lambda c: -c.evidence)
    rejected += [Rejected(c.hypothesis.label, c.why_not) for c in judged if c.why_not]
    close = worth_comparing(admissible, round_.threshold, criteria)
    ranked = _compared_again(round_, close, inflation) if close else tuple(admissible)
    return Choice(held_first(ranked, criteria), _weights(ranked), tuple(rejected))


def judged_hypotheses(
    round_: Round, inflation: Mapping[tuple[str, str], float]
) -> tuple[list[FittedHypothesis], list[Rejected]]:
    """The leading hypotheses with their full fits, and those rejected without one."""
    problem, base_fit, screen = round_.baseline.problem, round_.baseline.fit, round_.screen
    criteria, individual = round_.criteria, individual_inflation(round_)
    interval, noise = sample_interval(problem.records), control_noise(problem.records)
    judged: list[FittedHypothesis] = []
    rejected: list[Rejected] = []
    cost_limit = within_reach(base_fit.cost, round_.threshold**2)
    afar = {h: fit_from_afar(problem, base_fit, hypothesis) for h, hypothesis in enumerate(screen.hypotheses)}
    further = [*(h for h in afar if afar[h] is not None), *noise_candidates(round_)]
    for h in leading(screen, promise(round_), round_.threshold, criteria, further):
        hypothesis, guess = screen.hypotheses[h], linear_guess(screen, problem, h)
        if reason := by_derivatives(hypothesis):
            rejected.append(Rejected(hypothesis.label, reason))
            continue
        _, model_fit = fit_hypothesis(problem, base_fit, hypothesis, guess, cost_limit, afar[h])
        key = hypothesis.key
        candidate = assess(problem, base_fit, hypothesis, model_fit, inflation[key], individual[key])
        judged.append(material(candidate, interval, noise, criteria))
        if not judged[-1].why_not:
            cost_limit = min(cost_limit, model_fit.cost + OUT_OF_REACH * max(inflation.values()))
    return judged, rejected


# ---- what a full fit promises
def leading(
    screen: Screen, promised: Array, threshold: float, criteria: Criteria, further: Collection[int] = ()
) -> list[int]:
    """Indices of the hypotheses worth a full fit, best first.

    promised: (hypotheses,) from `promise`. threshold: score that a name needs. further: indices to be included in any case.

    Worth a fit is what promises a good part of the gain that a name needs and of the best promise, and what has nearly the
    signature of the best (`Screen.tied`). Unsteady lags of the aerodynamics always are: where the base has taken one up as
    damping, adding it at any size makes the motion oscillate, and its promise says nothing.
    """
    order = [int(h) for h in np.argsort(-promised)]
    first = order[0]
    limit = max(HOPELESS * threshold**2, criteria.negligible * float(promised[first]))
    tied = screen.tied(first, criteria) if promised[first] >= limit else [False] * len(order)
    worth = [promised[h] >= limit or tied[h] or x.form.lagging or h in further for h, x in enumerate(screen.hypotheses)]
    return [h for h in order if worth[h]]


def promise(round_: Round) -> Array:
    """(hypotheses,) predicted gains of full fits, over inflation. For delays, lags and plays the inflation is at most the median
    of all: theirs is that of a small step, which says little about them."""
    nonlinear = np.array([h.form.nonlinear for h in round_.screen.hypotheses])
    usual = float(np.median(round_.inflation))
    inflation = np.where(nonlinear, np.minimum(round_.inflation, usual), round_.inflation)
    return np.asarray(np.maximum(round_.gains, gains_at_sizes(round_)) / inflation)


def gains_at_sizes(round_: Round) -> Array:
    """(hypotheses,) largest predicted gain over all sizes, of hypotheses that are strongly nonlinear; 0 of the others."""
    problem, model_fit = round_.baseline.problem, round_.baseline.fit
    owner: list[int] = []  # index of the hypothesis to which each change belongs
    changes: list[tuple[Array, ...]] = []
    for h, hypothesis in enumerate(round_.screen.hypotheses):
        at_sizes = changes_at_sizes(problem, model_fit, hypothesis) if strongly_nonlinear(hypothesis.form) else []
        owner += [h] * len(at_sizes)
        changes += at_sizes
    gram = gram_of(round_.tangent, lambda i: [change[i] for change in changes])
    projected, gains = Projected.of(gram, len(problem.free), len(owner)), np.zeros(len(round_.screen.hypotheses))
    for h in set(owner):
        span = [k for k, other in enumerate(owner) if other == h]
        gains[h] = gain_along(projected.B[np.ix_(span, span)], projected.b[span, 0])
    return gains


def strongly_nonlinear(form: Form) -> bool:
    """Whether a form's effect on the outputs departs from that of a small step already below the usual size: of a control that is
    late or has play, and of a form with states of its own. An output that is merely late does not."""
    return bool(form.transforms or form.states)


def changes_at_sizes(
    problem: LikelihoodProblem, model_fit: ModelFit, hypothesis: Hypothesis
) -> list[tuple[Array, ...]]:
    """Per size, per record: (N, ny) what a hypothesis of that size adds to the outputs of the fitted base. Sizes at which the
    motion runs away are left out."""
    trial = replace(problem, model=awakened(problem.model, hypothesis.form))
    changes = []
    for size in SIZES:
        unknowns = {
            p.name: float(np.clip(p.null_value(problem.model) + size * p.typical, p.lower, p.upper))
            for p in hypothesis.form.parameters
        }
        values = {**trial.model.starts(), **model_fit.values, **unknowns}
        if (change := changes_by(trial, model_fit, values)) is not None:
            changes.append(change)
    return changes


def gain_along(information: Array, gradient: Array) -> float:
    """The largest gain on straight lines from no change to that of the first size, to the next, and so on beyond the last.

    information: (sizes, sizes) products of the changes; gradient: (sizes,) their products with the residuals."""
    count, best = len(gradient), 0.0
    corners = np.vstack([np.zeros(count), np.eye(count), BEYOND * np.eye(count)[-1:]])
    for corner, next_corner in zip(corners[:-1], corners[1:], strict=True):
        direction = next_corner - corner
        slope, curvature = direction @ (gradient - information @ corner), direction @ information @ direction
        point = corner + direction * (np.clip(slope / curvature, 0.0, 1.0) if curvature > 0.0 else 0.0)
        best = max(best, float(2.0 * gradient @ point - point @ information @ point))
    return best


def noise_candidates(round_: Round) -> list[int]:
    """Indices of the hypotheses of the largest gains, whatever their inflation, if large enough that the noise of the base may
    contain the effect (`sharper_base`)."""
    largest = np.argsort(-round_.gains)[:NOISE_CANDIDATES]
    return [int(h) for h in largest if round_.gains[h] > HOPELESS * round_.criteria.noise_held]


def within_reach(cost: float, gain: float) -> float:
    """The cost that a fit must come near in order to matter. cost: of the base; gain: what a name needs over it."""
    return cost - 0.5 * HOPELESS * gain


# ---- what a fit is worth beside others
def held_first(ranked: Sequence[FittedHypothesis], criteria: Criteria) -> tuple[FittedHypothesis, ...]:
    """The candidates in their order, except that a derivative which the base holds at a fixed number goes before a leading term
    that the base lacks, unless that has most of the weight of the two. At one angle of attack a wrong `Cn_beta` and a missing
    `Cn_alpha_beta` leave the same residuals, and chance would decide."""

    def weight_beside(held: FittedHypothesis) -> float:
        return _weights((ranked[0], held))[ranked[0].hypothesis.effect.name]

    held = [c for c in ranked if c.hypothesis.form.frees and weight_beside(c) < criteria.named_share]
    if not held or ranked[0].hypothesis.form.frees:
        return tuple(ranked)
    return (held[0], *(c for c in ranked if c is not held[0]))


def worth_comparing(
    candidates: Sequence[FittedHypothesis], threshold: float, criteria: Criteria
) -> Sequence[FittedHypothesis]:
    """The first of the candidates (best evidence first), to be compared again with the leader's noise; none where no candidate is
    significant."""
    return candidates[: criteria.compared] if any(c.score >= threshold for c in candidates) else ()


def shared_inflation(round_: Round) -> dict[tuple[str, str], float]:
    """Hypothesis -> inflation by which its gain is divided when hypotheses are weighed against each other.

    Rivals with nearly the same signature must share one inflation, or chance differences of it would decide between them. The
    common one is that of the leading hypothesis. A hypothesis takes another where its inflation is more than `common_inflation`
    times as large and its signature differs from those that take the common one: that of the best of its signature. Delays, lags
    and plays always take the common one, for theirs is that of a small step and not of the full fit.
    """
    screen, criteria = round_.screen, round_.criteria
    order = [int(h) for h in np.argsort(-round_.gains / round_.inflation)]
    common = float(round_.inflation[order[0]])
    shared: dict[tuple[str, str], float] = {}
    with_common: list[int] = []  # linear hypotheses so far that take the common inflation
    groups: list[tuple[list[bool], float]] = []  # of every other signature: who has it, inflation of the best
    for h in order:
        inflation, hypothesis = float(round_.inflation[h]), screen.hypotheses[h]
        shared[hypothesis.key] = common
        if hypothesis.form.nonlinear and h != order[0]:
            continue
        if inflation > criteria.far_above * common and not any(tied[h] for tied, _ in groups):
            tied = screen.tied(h, criteria)
            if not any(tied[q] for q in with_common):
                groups.append((tied, inflation))
        of_group = next((group_inflation for tied, group_inflation in groups if tied[h]), None)
        if of_group is None:
            with_common.append(h)
        else:
            shared[hypothesis.key] = of_group
    return shared


def individual_inflation(round_: Round) -> dict[tuple[str, str], float]:
    """Hypothesis -> inflation by which its gain is divided when it is compared with the threshold.

    It is the hypothesis' own; for delays, lags and plays the one that rivals share, because on the nulls only that of a small
    step is known.
    """
    shared = shared_inflation(round_)
    return {
        h.key: max(1.0, shared[h.key]) if h.form.nonlinear else float(inflation)
        for h, inflation in zip(round_.screen.hypotheses, round_.inflation, strict=True)
    }


def control_noise(records: Sequence[FlightRecord]) -> dict[str, float]:
    """Input -> standard deviation of the noise found on it, median over the records."""
    return {n: float(np.median([r.input_noise.get(n, 0.0) for r in records])) for n in records[0].inputs}


def by_derivatives(hypothesis: Hypothesis) -> str:
    """Why a hypothesis that free derivatives of the base already represent is rejected; empty for any other.

    Only the nonlinearity of the equations tells it from those derivatives, and any nonlinear effect explains that as well.
    """
    tied = hypothesis.effect.tied_to
    return f"cannot be told from {', '.join(tied)}" if tied else ""


def material(
    candidate: FittedHypothesis, interval: float, noise: Mapping[str, float], criteria: Criteria
) -> FittedHypothesis:
    """The candidate, rejected (`why_not`) where its estimate does not matter.

    That is: free derivatives represent the effect, its size is far below the usual one, a surface is late by no more than
    samples at `interval` [s] can show, or a play is no wider than the noise of its control. noise: input -> standard deviation.
    """
    if candidate.why_not:
        return candidate
    if reason := by_derivatives(candidate.hypothesis):
        return replace(candidate, why_not=reason)
    if candidate.size < criteria.negligible:
        return replace(candidate, why_not=f"fits {candidate.size:.0%} of its usual size: too small to matter")
    delays = [t.parameters[0] for t in candidate.hypothesis.form.transforms if t.kind in ("delay", "lag")]
    # samples shift all controls alike: one is known beside the others
    slowed = {t.input for t in candidate.hypothesis.form.transforms if t.kind in ("delay", "lag")}
    beside_others = any(s.control and s.name not in slowed for s in candidate.fit.model.inputs)
    open_time = interval * (criteria.own_timing_share if beside_others else criteria.timing_share)
    if delays and not any(later_than_sampled(*candidate.estimates[n], open_time, criteria) for n in delays):
        return replace(candidate, why_not="is late by no more than the sample times are uncertain")
    for play in (t for t in candidate.hypothesis.form.transforms if t.kind == "backlash"):
        if abs(candidate.estimates[play.parameters[0]][0]) < criteria.play_in_noise * noise.get(play.input, 0.0):
            return replace(candidate, why_not=f"is no wider than the noise of {play.input}, which a play removes")
    return candidate


def later_than_sampled(time: float, std: float, open_time: float, criteria: Criteria) -> bool:
    """Whether a surface is late or early (`time` [s], with bound `std` [s]) by more than chance and than `open_time` [s], which
    samples leave open."""
    return abs(time) > criteria.certain * math.hypot(std, open_time)


def _compared_again(
    round_: Round, candidates: Sequence[FittedHypothesis], inflation: Mapping[tuple[str, str], float]
) -> tuple[FittedHypothesis, ...]:
    """The candidates (best first) refitted with the noise estimated from the best one's residuals: lower than that of the base,
    and the same for all. Scores and gains stay those of the first fits; admissible ones only, best evidence first."""
    leader, problem = candidates[0], round_.baseline.problem
    noise, whiteners = round_.baseline.noise_about(leader.fit)
    sharper = replace(problem, whiteners=whiteners)
    base_fit = fit(sharper, round_.baseline.fit.values, round_.baseline.fit.locals, iterations=AGAIN)
    compared, cost_limit = [], np.inf
    for candidate in candidates:
        first, trial = candidate.fit, replace(sharper, model=candidate.fit.model)
        model_fit = fit(trial, first.values, first.locals, iterations=AGAIN, enough=ENOUGH, beyond=cost_limit)
        cost_limit = min(cost_limit, model_fit.cost + OUT_OF_REACH * max(inflation.values()))
        refitted = assess(sharper, base_fit, candidate.hypothesis, model_fit, inflation[candidate.hypothesis.key])
        candidate_noise = noise if candidate is leader else None
        compared.append(replace(refitted, score=candidate.score, gain=candidate.gain, noise=candidate_noise))
    return tuple(sorted((c for c in compared if not c.why_not), key=lambda c: -c.evidence))


def _weights(candidates: Sequence[FittedHypothesis], misfit: float = 1.0) -> dict[str, float]:
    """Effect -> weight, largest first, summing to 1: the evidence of all its forms together, divided by `misfit`."""
    if not candidates:
        return {}
    top = max(c.evidence for c in candidates)
    weights: dict[str, float] = {}
    for c in candidates:
        name = c.hypothesis.effect.name
        weights[name] = weights.get(name, 0.0) + float(np.exp((c.evidence - top) / misfit))
    total = sum(weights.values())
    return dict(sorted(((n, w / total) for n, w in weights.items()), key=lambda item: -item[1]))


def credible_set(weights: Mapping[str, float], criteria: Criteria) -> list[tuple[str, float]]:
    """Smallest set of (effect, weight), best first, with at least `set_weight` of the total. weights: best first."""
    members, total = [], 0.0
    for name, weight in weights.items():
        members.append((name, weight))
        total += weight
        if total >= criteria.set_weight:
            break
    return members
