"""When a fitted hypothesis becomes an effect: significant, better than nameless, repeated, and held on unseen flights."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from estimation.gap.answer.result import Rejected
from estimation.gap.criteria import Criteria
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.problem import prior_cost
from estimation.gap.search.confirm import FittedHypothesis
from estimation.gap.search.select import Choice, individual_inflation
from estimation.gap.search.state import AcceptedEffect, Setting
from estimation.gap.significance.calibration import Round, inflation_by_hypothesis
from estimation.gap.significance.measure import held_out_gaps, predictive_cost
from estimation.gap.significance.measured_again import MeasuredAgain
from estimation.gap.significance.omnibus import Omnibus


def accept(
    setting: Setting, round_: Round, choice: Choice, omnibus: Omnibus, shapes: Callable[[], float] = lambda: 0.0
) -> tuple[AcceptedEffect | None, list[Rejected]]:
    """The best candidate that is significant, explains what a nameless term or shape can, and holds on flights it was not fitted
    to. shapes: what the best nameless function of the motion gains, asked only where a candidate is significant."""
    rejected: list[Rejected] = []
    refused_keys: set[tuple[str, str]] = set()
    nameless = max((s.gain for s in omnibus.leading if s.kind == "term"), default=0.0)
    shape = shapes() if any(c.score >= round_.threshold for c in choice.candidates) else 0.0
    nameless = max(nameless, shape)
    remeasured = MeasuredAgain(round_.baseline, setting.options.seed)
    for candidate in choice.candidates:
        if candidate.score < round_.threshold:
            break
        centred = candidate.score * math.sqrt(remeasured.share(candidate.gain, candidate.fit, candidate.score))
        if centred < round_.threshold:
            remainder = f"{centred:.1f} of {round_.threshold:.1f} is left"
            reason = f"gains nearly as much without it, where controls are measured again or answer gusts ({remainder})"
            refused_keys.add(candidate.hypothesis.key)
            rejected.append(Rejected(candidate.hypothesis.label, reason))
            continue
        candidate = replace(candidate, score=centred)
        child, reason = confirmed(setting, round_, candidate, nameless)
        if child is not None:
            is_doubtful = doubtful(candidate, shape, round_.threshold, round_.criteria)
            return AcceptedEffect(
                round_, choice.without(refused_keys), candidate, round_.baseline, child, is_doubtful
            ), rejected
        refused_keys.add(candidate.hypothesis.key)
        rejected.append(Rejected(candidate.hypothesis.label, reason))
    return None, rejected


def confirmed(
    setting: Setting, round_: Round, candidate: FittedHypothesis, nameless: float
) -> tuple[Baseline | None, str]:
    """The model with a significant candidate in it, or None and why not. nameless: gain of the best term without a name."""
    criteria = round_.criteria
    if not explains(candidate.gain, nameless, criteria):
        return None, f"explains only {candidate.gain / nameless:.0%} of what a nameless term does"
    strong = is_strong(candidate.score, round_.threshold, criteria)
    timing = by_timing(round_, candidate)
    cross, number = None, round_.screen.hypotheses.index(candidate.hypothesis)
    if not candidate.hypothesis.form.nonlinear:
        cross = round_.screen.cross_gain(number)
    if not repeats_on_flights(cross, strong, timing, flight_gains(round_, candidate)):
        return None, "does not hold on the training flights it was not fitted to"
    child = setting.child(round_.baseline, candidate)
    estimates = estimates_of(round_, candidate, child)
    if not size_is_known(estimates, none_of(candidate, round_.baseline), criteria):
        words = ", ".join(f"{n} = {value:.3g} +- {bound:.2g}" for n, (value, bound) in estimates.items())
        return None, f"{words} cannot be told from no effect"
    holdout_gain = held_gain(round_.baseline, child)
    held_support = None if holdout_gain is None else holdout_gain / own_inflation(candidate)
    sure = min(candidate.score, float(round_.standardised()[number]))
    spare = math.inf if strong or timing else to_spare(sure, round_.threshold)
    if not holds_on_holdout(held_support, spare, criteria):
        return None, "does not hold on the held-out flights"
    supported = held_support is not None and held_support > (0.0 if strong else ndtri(criteria.null_level) ** 2)
    held = None if timing else held_out_gaps(round_.baseline, child)
    if not closes_held_out(held, criteria.null_energy if supported else 1.0):
        return None, "closes nothing of the gap on the held-out flights"
    return child, ""


def estimates_of(round_: Round, candidate: FittedHypothesis, child: Baseline) -> dict[str, tuple[float, float]]:
    """Unknown of a candidate -> value and bound in the model that has it, as widely as the nulls scatter: of a control that is
    late as they scatter what it is weighed against, for a small step of it says nothing of one that is found afar."""
    known = individual_inflation if candidate.hypothesis.form.slows_control else inflation_by_hypothesis
    wider, std = float(np.sqrt(known(round_).get(candidate.hypothesis.key, 1.0))), child.fit.std()
    return {
        p.name: (float(child.fit.values[p.name]), wider * float(std[p.name]))
        for p in candidate.hypothesis.form.parameters
    }


def none_of(candidate: FittedHypothesis, baseline: Baseline) -> dict[str, float]:
    """Unknown of a candidate -> its value where there is no effect."""
    return {p.name: p.null_value(baseline.problem.model) for p in candidate.hypothesis.form.parameters}


def size_is_known(estimates: Mapping[str, tuple[float, float]], none: Mapping[str, float], criteria: Criteria) -> bool:
    """Whether some unknown is so many bounds from no effect. What is significant is, but for an effect with states: what these
    begin with gains too."""
    return any(abs(value - none[n]) > criteria.certain * bound for n, (value, bound) in estimates.items())


def explains(gain: float, nameless: float, criteria: Criteria) -> bool:
    """Whether a hypothesis gains nearly what the best nameless term does (both twice a log-likelihood)."""
    return gain >= criteria.named_share * nameless


def doubtful(candidate: FittedHypothesis, shape: float, threshold: float, criteria: Criteria) -> bool:
    """Whether a name has the wrong form: a smooth function without a name gains more (twice a log-likelihood, less what chance
    gives its unknowns) by a clear share and by what would itself be significant. One that is right gains as much."""
    excess = shape - candidate.gain
    return candidate.gain < criteria.shape_share * shape and excess > own_inflation(candidate) * threshold**2


def own_inflation(candidate: FittedHypothesis) -> float:
    """By how much the nulls scatter a candidate's gain, on held-out flights as on those it was fitted to."""
    return max(candidate.gain / candidate.score**2, 1.0) if candidate.score > 0.0 else 1.0


def is_strong(score: float, threshold: float, criteria: Criteria) -> bool:
    """Whether an effect may be beyond linear theory, and beyond what chance takes from it on held-out flights."""
    return score > criteria.strong * threshold


def repeats_on_flights(cross: float | None, strong: bool, timing: bool, gains: Sequence[float]) -> bool:
    """Whether an effect shows on more than one training flight.

    cross: of effects linear in their unknowns, the gain on each flight with everything fitted to the others, summed, None for
    one flight; where it is no gain only the joint fit of a strong effect can speak for it. gains: of the joint fit on each
    flight; delays, lags and plays must gain without the flight that gains most. timing: the base followed the effect by its
    surfaces, flight by flight, so that its residuals say nothing. One flight alone cannot be asked.
    """
    if cross is not None and cross > 0.0:
        return True
    if cross is not None and not strong:
        return False
    return timing or len(gains) < 2 or sum(gains) - max(gains) > 0.0


def holds_on_holdout(held: float | None, spare: float, criteria: Criteria) -> bool:
    """Whether an effect holds on the held-out flights, where there are any: significant still with what they say. held: twice the
    log-likelihood gained there, over its inflation; spare: what of it chance may take, at most `certain` squared.

    An effect a little above its threshold changes a single flight by two or three units in all, of which chance takes more than
    that in one of six.
    """
    return held is None or held > -min(spare, criteria.certain**2)


def closes_held_out(gaps: tuple[float, float] | None, energy: float) -> bool:
    """Whether the plain gap on the held-out flights, before and after an effect, has less than `energy` times the energy with it.

    One that gains there by the likelihood (one that is not strong more than chance gives) need not make it smaller: a small one
    hardly moves it. None: not asked, of an effect that the base followed by its surfaces, or without held-out flights.
    """
    return gaps is None or gaps[1] ** 2 < energy * gaps[0] ** 2


def to_spare(score: float, threshold: float) -> float:
    """What an effect has gained above its threshold, in twice the log-likelihood. score: by linear theory or of the full fit,
    whichever says less: the threshold is one of linear theory, beyond which a full fit bends its model to the noise."""
    return max(score**2 - threshold**2, 0.0)


def flight_gains(round_: Round, candidate: FittedHypothesis) -> list[float]:
    """Twice the log-likelihood that a fitted candidate gains on each training flight."""
    gains: dict[int, float] = {}
    pairs = zip(round_.baseline.fit.residuals, candidate.fit.residuals, strict=True)
    for w, flight, (before_residual, after_residual) in zip(
        round_.baseline.problem.whiteners, round_.screen.flights, pairs, strict=True
    ):
        gains[flight] = gains.get(flight, 0.0) + w.energy(before_residual) - w.energy(after_residual)
    return list(gains.values())


def by_timing(round_: Round, candidate: FittedHypothesis) -> bool:
    """Whether the base had to move its surfaces in time by more than the sampling leaves open to follow the flights.

    Then the base fits as well as the effect does, flight by flight; what it cannot explain is that shift.
    """
    problem, names = round_.baseline.problem, round_.baseline.problem.free
    relief = prior_cost(problem, names, round_.baseline.fit.values) - prior_cost(problem, names, candidate.fit.values)
    return followed_by_surfaces(2.0 * relief, candidate.gain, round_.criteria)


def followed_by_surfaces(freed: float, gain: float, criteria: Criteria) -> bool:
    """Whether so much of an effect's gain (both twice a log-likelihood) is what surfaces moved in time are freed of."""
    return freed > criteria.followed_share * gain


def held_gain(parent: Baseline, child: Baseline) -> float | None:
    """Twice the log-likelihood the child gains on the held-out flights, both weighed with the child's noise, the fitted
    parameters uncertain as the training flights leave them."""
    parent_cost, child_cost = predictive_cost(parent, child.noise), predictive_cost(child, child.noise)
    if parent_cost is None or child_cost is None:
        return None
    return (
        0.0 if parent_cost == child_cost else 2.0 * (parent_cost - child_cost)
    )  # both infinite: neither can be asked there
