"""Choose what explains the flights: full fits, evidence, set, held-out test, exchange and backward checks."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.gap.answer.result import Rejected
from estimation.gap.criteria import Criteria
from estimation.gap.fit.baseline import whiteners_for
from estimation.gap.fit.channel_noise import sample_interval, time_bound
from estimation.gap.fit.fitting import fit
from estimation.gap.records.flight_records import FlightRecord, FlightRecords
from estimation.gap.search.confirm import ENOUGH, FittedHypothesis, assess, begun_afar, fit_hypothesis
from estimation.gap.search.promise import HOPELESS, leading, promise
from estimation.gap.significance.calibration import Round
from estimation.gap.significance.screen import Hypothesis, linear_guess

OUT_OF_REACH = 30.0  # of the log evidence: a rival so far behind the best so far that no check of it brings back
ASKED = 3  # hypotheses, of the largest gain, whether the noise has swallowed them: rivals of one form are alike
AGAIN = 8  # steps from where the first fit ended, with another whitening


@dataclass(frozen=True)
class Choice:
    """The outcome of one round: ranked candidates with weights over effects, and what was rejected."""

    candidates: tuple[FittedHypothesis, ...]
    weights: Mapping[str, float]
    rejected: tuple[Rejected, ...]

    @classmethod
    def of(cls, candidates: Sequence[FittedHypothesis]) -> "Choice":
        """Between candidates, best first, weighed by their evidence."""
        return cls(tuple(candidates), _weights(candidates), ())

    @property
    def best(self) -> FittedHypothesis | None:
        return self.candidates[0] if self.candidates else None

    def without(self, refused: Collection[tuple[str, str]]) -> "Choice":
        """The same without candidates that a later check refused; the weights count the others only."""
        remaining = tuple(c for c in self.candidates if c.hypothesis.key not in refused)
        return replace(self, candidates=remaining, weights=_weights(remaining))

    def beside_rest(self, misfit: float) -> Mapping[str, float]:
        """Weights where so many times what noise does (twice a log-likelihood) is left without a name: what is missing bends the
        gains of rivals as it bends the fit, and evidence counts that much less."""
        return _weights(self.candidates, misfit) if misfit > 1.0 and self.candidates else self.weights


def choose(round_: Round, prepared: FlightRecords) -> Choice:
    """Fit the leading hypotheses in full and weigh them."""
    if not round_.screen.hypotheses:
        return Choice((), {}, ())
    criteria, inflation = round_.criteria, shared_inflation(round_)
    judged, rejected = judged_hypotheses(round_, inflation)
    admissible = sorted((c for c in judged if not c.why_not), key=lambda c: -c.evidence)
    rejected += [Rejected(c.hypothesis.label, c.why_not) for c in judged if c.why_not]
    close = worth_comparing(admissible, round_.threshold, criteria)
    ranked = _compared_again(round_, prepared, close, inflation) if close else tuple(admissible)
    return Choice(held_first(ranked, criteria), _weights(ranked), tuple(rejected))


def judged_hypotheses(
    round_: Round, inflation: Mapping[tuple[str, str], float]
) -> tuple[list[FittedHypothesis], list[Rejected]]:
    """The leading hypotheses with their full fits, and those that need none to be rejected."""
    problem, base_fit, screen = round_.baseline.problem, round_.baseline.fit, round_.screen
    criteria, individual = round_.criteria, individual_inflation(round_)
    interval, noise = sample_interval(problem.records), control_noise(problem.records)
    judged: list[FittedHypothesis] = []
    rejected: list[Rejected] = []
    cost_limit = within_reach(base_fit.cost, round_.threshold**2)
    afar = {h: begun_afar(problem, base_fit, hypothesis) for h, hypothesis in enumerate(screen.hypotheses)}
    further = [*(h for h in afar if afar[h] is not None), *asked_for_noise(round_)]
    for h in leading(screen, promise(round_), round_.threshold, criteria, further):
        hypothesis, guess = screen.hypotheses[h], linear_guess(screen, problem, h)
        if carried := by_derivatives(hypothesis):
            rejected.append(Rejected(hypothesis.label, carried))
            continue
        _, model_fit = fit_hypothesis(problem, base_fit, hypothesis, guess, cost_limit, afar[h])
        key = hypothesis.key
        candidate = assess(problem, base_fit, hypothesis, model_fit, inflation[key], individual[key])
        judged.append(material(candidate, interval, noise, criteria))
        if not judged[-1].why_not:
            cost_limit = min(cost_limit, model_fit.cost + OUT_OF_REACH * max(inflation.values()))
    return judged, rejected


def asked_for_noise(round_: Round) -> list[int]:
    """Indices of the hypotheses of the largest gain, whatever the nulls scatter, where it may be that the noise of the base has
    swallowed an effect (`sharper_base`)."""
    largest = np.argsort(-round_.gains)[:ASKED]
    return [int(h) for h in largest if round_.gains[h] > HOPELESS * round_.criteria.noise_held]


def held_first(ranked: Sequence[FittedHypothesis], criteria: Criteria) -> tuple[FittedHypothesis, ...]:
    """The candidates in their order, but a derivative that the base holds at a number before a term that it lacks, where it gains
    as much: at one angle of attack a `Cn_beta` that is off and a `Cn_alpha_beta` leave the same, and chance would decide."""
    held = [c for c in ranked if c.hypothesis.form.frees and c.gain >= ranked[0].gain - criteria.certain**2]
    if not held or ranked[0].hypothesis.form.frees:
        return tuple(ranked)
    return (held[0], *(c for c in ranked if c is not held[0]))


def within_reach(cost: float, gain: float) -> float:
    """The cost that a fit must be able to reach to matter where a name needs such a gain (twice a log-likelihood) over `cost`."""
    return cost - 0.5 * HOPELESS * gain


def worth_comparing(
    sound: Sequence[FittedHypothesis], threshold: float, criteria: Criteria
) -> Sequence[FittedHypothesis]:
    """The candidates, best evidence first, that are compared again with sharper noise; none where none is significant."""
    return sound[: criteria.compared] if any(c.score >= threshold for c in sound) else ()


def shared_inflation(round_: Round) -> dict[tuple[str, str], float]:
    """Inflation by which the gains of the hypotheses are divided when they are weighed against each other.

    Rivals with nearly the same signature must be divided by the same number, or its chance differences decide between
    them: that of the leading hypothesis, unless a hypothesis' own is more than twice as large and its signature another; then
    that of the best of those which have its signature. Delays, lags and plays always take the common one: their scatter on the
    nulls is that of a small step, not of the full fit they are judged by.
    """
    screen, criteria = round_.screen, round_.criteria
    order = [int(h) for h in np.argsort(-round_.gains / round_.inflation)]
    common = float(round_.inflation[order[0]])
    shared: dict[tuple[str, str], float] = {}
    quiet: list[int] = []  # linear ones so far that take the common one
    groups: list[tuple[list[bool], float]] = []  # of the others: who has the signature of the best, its own inflation
    for h in order:
        own, hypothesis = float(round_.inflation[h]), screen.hypotheses[h]
        shared[hypothesis.key] = common
        if hypothesis.form.nonlinear and h != order[0]:
            continue
        if own > criteria.common_inflation * common and not any(tied[h] for tied, _ in groups):
            tied = screen.tied(h, criteria)
            if not any(tied[q] for q in quiet):
                groups.append((tied, own))
        group = next((inflation for tied, inflation in groups if tied[h]), None)
        if group is None:
            quiet.append(h)
        else:
            shared[hypothesis.key] = group
    return shared


def individual_inflation(round_: Round) -> dict[tuple[str, str], float]:
    """Inflation by which a hypothesis' gain is divided when it is held against the null threshold: its own. Delays, lags and
    plays, for which the nulls know only the small step, take the one that rivals share where that is larger."""
    shared = shared_inflation(round_)
    return {
        h.key: max(1.0, shared[h.key]) if h.form.nonlinear else float(inflation)
        for h, inflation in zip(round_.screen.hypotheses, round_.inflation, strict=True)
    }


def control_noise(records: Sequence[FlightRecord]) -> dict[str, float]:
    """Input -> standard deviation of the noise found on it, median over the records."""
    return {n: float(np.median([r.input_noise.get(n, 0.0) for r in records])) for n in records[0].inputs}


def by_derivatives(hypothesis: Hypothesis) -> str:
    """Why a hypothesis that derivatives of the base carry already is none, or nothing: what is left of its signature is the
    curvature of the equations, which anything bent explains as well."""
    tied = hypothesis.effect.tied_to
    return f"cannot be told from {', '.join(tied)}" if tied else ""


def material(
    candidate: FittedHypothesis, interval: float, noise: Mapping[str, float], criteria: Criteria
) -> FittedHypothesis:
    """The candidate, rejected where its estimate is far below the size at which the effect matters, where a surface would be late
    by no more than what samples at `interval` [s] leave open, or where a play is no wider than the noise of its control. noise:
    input -> standard deviation."""
    if candidate.why_not:
        return candidate
    if carried := by_derivatives(candidate.hypothesis):
        return replace(candidate, why_not=carried)
    if candidate.size < criteria.immaterial:
        return replace(candidate, why_not=f"fits {candidate.size:.0%} of its usual size: too small to matter")
    delays = [t.parameters[0] for t in candidate.hypothesis.form.transforms if t.kind in ("delay", "lag")]
    if delays and not any(later_than_sampled(*candidate.estimates[n], interval, criteria) for n in delays):
        return replace(candidate, why_not="is within what sampling leaves open of any time")
    for play in (t for t in candidate.hypothesis.form.transforms if t.kind == "backlash"):
        if abs(candidate.estimates[play.parameters[0]][0]) < criteria.play_in_noise * noise.get(play.input, 0.0):
            return replace(candidate, why_not=f"is no wider than the noise of {play.input}, which it takes off")
    return candidate


def later_than_sampled(time: float, std: float, interval: float, criteria: Criteria) -> bool:
    """Whether a surface is late (or early) by more than may be chance: by its bound [s] and what samples at `interval` [s] leave
    open of when a surface moves."""
    return abs(time) > criteria.certain * time_bound(std, interval, criteria)


def _compared_again(
    round_: Round,
    prepared: FlightRecords,
    sound: Sequence[FittedHypothesis],
    inflation: Mapping[tuple[str, str], float],
) -> tuple[FittedHypothesis, ...]:
    """The candidates with the noise re-estimated from the best one's residuals: sharper, and the same for all."""
    leader, problem = sound[0], round_.baseline.problem
    noise, whiteners = whiteners_for(
        leader.fit.model,
        prepared,
        problem.records,
        {**leader.fit.model.starts(), **leader.fit.values},
        None,
        leader.fit.residuals,
        round_.baseline.scatter,
        round_.baseline.noise,
    )
    sharper = replace(problem, whiteners=whiteners)
    base_fit = fit(sharper, round_.baseline.fit.values, round_.baseline.fit.locals, iterations=AGAIN)
    result, limit = [], np.inf
    for candidate in sound:
        first, trial = candidate.fit, replace(sharper, model=candidate.fit.model)
        model_fit = fit(trial, first.values, first.locals, iterations=AGAIN, enough=ENOUGH, beyond=limit)
        limit = min(limit, model_fit.cost + OUT_OF_REACH * max(inflation.values()))
        fresh = assess(sharper, base_fit, candidate.hypothesis, model_fit, inflation[candidate.hypothesis.key])
        candidate_noise = noise if candidate is leader else None
        result.append(replace(fresh, score=candidate.score, gain=candidate.gain, noise=candidate_noise))
    return tuple(sorted((c for c in result if not c.why_not), key=lambda c: -c.evidence))


def _weights(candidates: Sequence[FittedHypothesis], misfit: float = 1.0) -> dict[str, float]:
    """Weight of each effect: the evidence of its forms together, over a misfit that they share."""
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
    """Smallest set of effects that holds nearly all of the weight, best first."""
    members, total = [], 0.0
    for name, weight in weights.items():
        members.append((name, weight))
        total += weight
        if total >= criteria.set_weight:
            break
    return members
