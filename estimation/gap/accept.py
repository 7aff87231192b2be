"""When a fitted hypothesis becomes an effect: significant, better than nameless, repeated, and held on unseen flights."""

import numpy as np

from estimation.gap.baseline import Baseline, Round
from estimation.gap.bench import Bench
from estimation.gap.confirm import Candidate
from estimation.gap.fitting import prior_cost
from estimation.gap.measure import predictive_cost
from estimation.gap.omnibus import Omnibus
from estimation.gap.result import Rejected
from estimation.gap.select import Choice
from estimation.gap.trail import Finding, Setting

NAMED_SHARE = 0.75  # of what the best nameless term gains: an effect that gains less does not get to give its name
STRONG = 1.5  # times the threshold
HELD_SLACK = 9.0  # twice a log-likelihood: what chance may take from a strong effect on flights that hardly show it


def accept(setting: Setting, round_: Round, choice: Choice, omnibus: Omnibus) -> tuple[Finding | None, list[Rejected]]:
    """The best candidate that is significant, explains what a nameless term can, and holds on flights it was not fitted to."""
    said: list[Rejected] = []
    refused: set[tuple[str, str]] = set()
    nameless = max((s.gain for s in omnibus.leading if s.kind == "term"), default=0.0)
    for candidate in choice.candidates:
        label = candidate.hypothesis.label
        if candidate.score < round_.threshold:
            break
        if candidate.gain < NAMED_SHARE * nameless:
            refused.add(candidate.hypothesis.key)
            said.append(Rejected(label, f"explains only {candidate.gain / nameless:.0%} of what a nameless term does"))
            continue
        if not repeats(round_, candidate):
            refused.add(candidate.hypothesis.key)
            said.append(Rejected(label, "does not hold on the training flights it was not fitted to"))
            continue
        child = setting.child(round_.baseline, candidate)
        held = held_gain(round_.baseline, child, setting.bench)
        strong = candidate.score > STRONG * round_.threshold
        least = -HELD_SLACK if strong or by_timing(round_, candidate) else 0.0
        if held is not None and held <= least:
            refused.add(candidate.hypothesis.key)
            said.append(Rejected(label, "does not hold on the held-out flights"))
            continue
        return Finding(round_, choice.without(refused), candidate, round_.baseline, child), said
    return None, said


def repeats(round_: Round, candidate: Candidate) -> bool:
    """Whether an effect shows on more than one training flight.

    Effects linear in their unknowns: the gain on each flight with everything fitted to the others, summed. Delays, lags
    and plays: the gain of the joint fit without the flight that gains most. One flight alone cannot be asked.
    """
    screen, form = round_.screen, candidate.hypothesis.form
    if not form.nonlinear:
        cross = screen.cross_gain(screen.hypotheses.index(candidate.hypothesis))
        if cross is None or cross > 0.0:
            return True
        if candidate.score < STRONG * round_.threshold:
            return False  # a strong effect may be beyond linear theory: then the joint fit decides
    if by_timing(round_, candidate):
        return True
    whiteners, flights = round_.baseline.problem.whiteners, screen.flights
    gains: dict[int, float] = {}
    for w, flight, one, two in zip(
        whiteners, flights, round_.baseline.fit.residuals, candidate.fit.residuals, strict=True
    ):
        gains[flight] = gains.get(flight, 0.0) + float(np.sum(w.rows(one) ** 2) - np.sum(w.rows(two) ** 2))
    return len(gains) < 2 or sum(gains.values()) - max(gains.values()) > 0.0


def by_timing(round_: Round, candidate: Candidate) -> bool:
    """Whether the base had to move its surfaces in time by more than the sampling leaves open to follow the flights.

    Then the base fits as well as the effect does, flight by flight; what it cannot explain is that shift.
    """
    problem, names = round_.baseline.problem, round_.baseline.problem.free
    freed = prior_cost(problem, names, round_.baseline.fit.values) - prior_cost(problem, names, candidate.fit.values)
    return 2.0 * freed > 0.5 * candidate.gain


def held_gain(parent: Baseline, child: Baseline, bench: Bench) -> float | None:
    """Twice the log-likelihood the child gains on the held-out flights, both weighed with the child's noise, the fitted
    parameters uncertain as the training flights leave them."""
    before, after = predictive_cost(parent, bench, child.noise), predictive_cost(child, bench, child.noise)
    return None if before is None or after is None else 2.0 * (before - after)
