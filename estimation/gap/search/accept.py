"""When a fitted hypothesis is accepted as an effect.

It must be significant, explain nearly what a nameless term or shape does, show on more than one training flight, and hold on the
held-out flights.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from estimation.gap.answer.result import HELD_OUT, Rejected
from estimation.gap.criteria import Criteria
from estimation.gap.fit.baseline import Baseline
from estimation.gap.fit.problem import prior_cost
from estimation.gap.search.confirm import FittedHypothesis, values_without_effect
from estimation.gap.search.select import Choice, individual_inflation
from estimation.gap.search.state import AcceptedEffect, Setting
from estimation.gap.significance.calibration import Round, inflation_by_hypothesis
from estimation.gap.significance.measure import held_out_gaps, held_out_likelihood
from estimation.gap.significance.measured_again import NOT_ITS_OWN
from estimation.gap.significance.omnibus import Remainder


def accept(
    setting: Setting, round_: Round, choice: Choice, rest: Remainder, shapes: Callable[[], float] = lambda: 0.0
) -> tuple[AcceptedEffect | None, list[Rejected]]:
    """The first candidate that is significant and `confirmed`, or None; and the candidates refused before it, with reasons.

    A score counts less where the candidate gains also on flights without it with controls measured again (`Remainder.again`).
    Behind one that the held-out flights do not confirm only as good an explanation is asked, not what is left to a lesser one.
    rest: of the residuals of `round_`. shapes: gives the gain of the best nameless function of one variable; called only where a
    candidate is significant.
    """
    rejected: list[Rejected] = []
    refused_keys: set[tuple[str, str]] = set()
    unconfirmed: FittedHypothesis | None = None  # the first of which the held-out flights show nothing
    shape = shapes() if any(c.score >= round_.threshold for c in choice.candidates) else 0.0
    for candidate in choice.candidates:
        if candidate.score < round_.threshold:
            break
        score = candidate.score * math.sqrt(rest.again.share(candidate.gain, candidate.fit))
        child = None
        if score < round_.threshold:
            remainder = f"{score:.1f} of {round_.threshold:.1f} is left"
            reason = f"{NOT_ITS_OWN} ({remainder})"
        elif unconfirmed is not None and not explains(score**2, unconfirmed.score**2, round_.criteria):
            reason = f"explains only {(score / unconfirmed.score) ** 2:.0%} of what {unconfirmed.hypothesis.label} does"
        else:
            candidate = replace(candidate, score=score)
            most = max(rest.most, shape)  # known without the controls measured again
            nameless = most if explains(candidate.gain, most, round_.criteria) else max(rest.nameless, shape)
            child, reason = confirmed(setting, round_, candidate, nameless)
        if child is not None:
            is_doubtful = doubtful(candidate, shape, round_.threshold, round_.criteria)
            others = choice.without(refused_keys)
            return AcceptedEffect(round_, others, candidate, round_.baseline, child, is_doubtful), rejected
        refused_keys.add(candidate.hypothesis.key)
        rejected.append(Rejected(candidate.hypothesis.label, reason))
        if rejected[-1].unconfirmed and unconfirmed is None:
            unconfirmed = candidate
    return None, rejected


def confirmed(
    setting: Setting, round_: Round, candidate: FittedHypothesis, nameless: float, nulls_of: Round | None = None
) -> tuple[Baseline | None, str]:
    """(model with a significant candidate in it, ""), or (None, reason for refusal). nameless: gain of the best nameless term.
    nulls_of: the round whose nulls show how large a held-out gap is without any effect, by default `round_`."""
    criteria = round_.criteria
    if not explains(candidate.gain, nameless, criteria):
        return None, f"explains only {candidate.gain / nameless:.0%} of what a nameless term does"
    strong = is_strong(candidate.score, round_.threshold, criteria)
    timing = by_timing(round_, candidate)
    index = round_.screen.hypotheses.index(candidate.hypothesis)
    cross_gain = None if candidate.hypothesis.form.nonlinear else round_.screen.cross_gain(index)
    if not repeats_on_flights(cross_gain, strong, timing, flight_gains(round_, candidate)):
        return None, "does not hold on the training flights it was not fitted to"
    child = setting.child(round_.baseline, candidate)
    estimates = estimates_of(round_, candidate, child)
    null_values = values_without_effect(candidate.hypothesis.form, round_.baseline.problem.model)
    if not size_is_known(estimates, null_values, criteria):
        words = ", ".join(f"{n} = {value:.3g} +- {bound:.2g}" for n, (value, bound) in estimates.items())
        return None, f"{words} cannot be told from no effect"
    lower_score = min(candidate.score, float(round_.standardised()[index]))
    margin = criteria.certain**2
    if not (strong or timing):
        margin = min(gain_above_threshold(lower_score, round_.threshold), margin)
    likelihood, gaps = held_out_likelihood(round_.baseline, child), held_out_gaps(round_.baseline, child)
    chance = own_inflation(candidate)
    if likelihood is None or gaps is None:
        return child, ""
    if likelihood.gain <= -margin * chance:
        return None, f"does not hold {HELD_OUT}"
    held = HeldOut(likelihood.gain / chance, likelihood.confirmed(chance, criteria), *gaps)
    if not timing and not held.closes(lambda: setting.floors(nulls_of or round_).highest, strong, criteria):
        return None, f"closes nothing {HELD_OUT}"
    return child, ""


def estimates_of(round_: Round, candidate: FittedHypothesis, child: Baseline) -> dict[str, tuple[float, float]]:
    """Unknown of a candidate -> (value, bound) in the model that has it; bounds include the inflation found on the nulls.

    For a late control it is the inflation shared with rivals: its own is that of a small step, which a long delay is not.
    """
    inflation_of = individual_inflation if candidate.hypothesis.form.slows_control else inflation_by_hypothesis
    widening = float(np.sqrt(inflation_of(round_).get(candidate.hypothesis.key, 1.0)))
    values, std = child.fit.values, child.fit.std()
    names = (p.name for p in candidate.hypothesis.form.parameters)
    return {n: (float(values[n]), widening * float(std[n])) for n in names}


def size_is_known(
    estimates: Mapping[str, tuple[float, float]], null_values: Mapping[str, float], criteria: Criteria
) -> bool:
    """Whether some unknown differs from its value without effect by more than `certain` bounds.

    One of a significant effect does, unless the effect has states of its own, whose initial values gain too.
    """
    return any(abs(value - null_values[n]) > criteria.certain * bound for n, (value, bound) in estimates.items())


def explains(gain: float, nameless: float, criteria: Criteria) -> bool:
    """Whether a hypothesis gains nearly what the best nameless term does (both twice a log-likelihood)."""
    return gain >= criteria.named_share * nameless


def doubtful(candidate: FittedHypothesis, shape: float, threshold: float, criteria: Criteria) -> bool:
    """Whether a candidate probably has the wrong form, because the best nameless smooth function gains clearly more.

    shape: gain of that function, less what chance gives its unknowns. Its lead must be a clear share of it and would have to be
    significant by itself. A candidate of the right form gains as much as the function.
    """
    excess = shape - candidate.gain
    return candidate.gain < criteria.shape_share * shape and excess > own_inflation(candidate) * threshold**2


def own_inflation(candidate: FittedHypothesis) -> float:
    """Inflation contained in a candidate's score: gain over score squared, at least 1; used for held-out flights too."""
    return max(candidate.gain / candidate.score**2, 1.0) if candidate.score > 0.0 else 1.0


def is_strong(score: float, threshold: float, criteria: Criteria) -> bool:
    """Whether an effect is so large that linear theory may fail for it, and that chance cannot hide it on held-out flights."""
    return score > criteria.clearly_above * threshold


def repeats_on_flights(cross: float | None, strong: bool, timing: bool, gains: Sequence[float]) -> bool:
    """Whether an effect shows on more than one training flight; always true of a single flight, which has no other.

    cross: cross-validated gain of an effect that is linear in its unknowns: on each flight with everything fitted to the others,
    summed; None for a delay, lag or play, and for one flight. Where it is not positive, only a strong effect can pass. gains: of
    the joint fit on each flight; without the flight that gains most their sum must be positive. timing: the base followed the
    effect by moving its surfaces in time flight by flight (`by_timing`), so that its residuals cannot decide.
    """
    if cross is not None and cross > 0.0:
        return True
    if cross is not None and not strong:
        return False
    return timing or len(gains) < 2 or sum(gains) - max(gains) > 0.0


def gain_above_threshold(score: float, threshold: float) -> float:
    """How far an effect's gain exceeds what its threshold requires: chance may take away that much on held-out flights.

    score: the lower of linear theory and full fit. The threshold is one of linear theory; a full fit also fits noise by its
    nonlinearity. An effect a little above its threshold gains two or three units on a single flight, and one time in six chance
    takes away more than that.
    """
    return max(score**2 - threshold**2, 0.0)


@dataclass(frozen=True)
class HeldOut:
    """An effect on the held-out flights. gain: of their likelihood (twice its logarithm) over the inflation; confirmed: the share
    that the likelihood confirms; before, after: gap (rms over noise) without and with it."""

    gain: float
    confirmed: float | None
    before: float
    after: float

    def closes(self, highest: Callable[[], float], strong: bool, criteria: Criteria) -> bool:
        """Whether the effect closes something there, by the figure that will be printed.

        highest: gives the upper end of the gap with nothing hidden; strong: `is_strong`. A gap that shrinks decides where it was
        larger than those of nulls; otherwise it may be chance's, and the likelihood must not speak against the effect, unless it
        can tell nothing. A gap that grows must be no larger than those of nulls, in which a small effect hardly shows, or belong
        to a flight that the model still predicts and whose likelihood confirms the effect; and that likelihood must gain more
        than chance gives it, anything where it can tell nothing of a strong effect.
        """
        if self.after < self.before:
            return self.gain > 0.0 or self.before > highest() or self.confirmed is None
        is_confirmed = self.confirmed is not None and self.confirmed >= criteria.closed_share
        if max(self.before, self.after) > highest() * (criteria.another_flight if is_confirmed else 1.0):
            return False
        tells_nothing = strong and self.confirmed is None
        return bool(self.gain > (0.0 if tells_nothing else ndtri(criteria.null_level) ** 2))


def flight_gains(round_: Round, candidate: FittedHypothesis) -> list[float]:
    """Gain of a fitted candidate on each training flight."""
    gains: dict[int, float] = {}
    pairs = zip(round_.baseline.fit.residuals, candidate.fit.residuals, strict=True)
    for w, flight, (before, after) in zip(round_.baseline.problem.whiteners, round_.screen.flights, pairs, strict=True):
        gains[flight] = gains.get(flight, 0.0) + w.energy(before) - w.energy(after)
    return list(gains.values())


def by_timing(round_: Round, candidate: FittedHypothesis) -> bool:
    """Whether the candidate gains mainly because the base no longer has to shift its surfaces in time against their priors.

    Such a base fits each flight as well as the candidate does, by shifts larger than sampling explains. So the gain is in the
    priors and not in the residuals.
    """
    problem, names = round_.baseline.problem, round_.baseline.problem.free
    relief = prior_cost(problem, names, round_.baseline.fit.values) - prior_cost(problem, names, candidate.fit.values)
    return followed_by_surfaces(2.0 * relief, candidate.gain, round_.criteria)


def followed_by_surfaces(freed: float, gain: float, criteria: Criteria) -> bool:
    """Whether `freed`, the part of an effect's gain that comes from the priors, is a large share of `gain`."""
    return freed > criteria.followed_share * gain
