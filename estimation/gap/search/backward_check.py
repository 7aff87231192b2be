"""Earlier effects asked again with the later ones in the model: dropped where idle, exchanged where a rival does better."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.answer.result import Rejected
from estimation.gap.criteria import Criteria
from estimation.gap.likelihood.baseline import Baseline, fit_baseline
from estimation.gap.search.confirm import Candidate, assess, fit_hypothesis
from estimation.gap.search.search_state import Finding, Setting, afresh_with
from estimation.gap.search.select import Choice
from estimation.gap.tests_of_fit.hypotheses import hypotheses_for
from estimation.gap.tests_of_fit.screen import build_screen, linear_gains, linear_guess
from estimation.gap.tests_of_fit.tangent import Tangent


def backward_check(setting: Setting, findings: Sequence[Finding]) -> tuple[list[Finding], list[Rejected]] | None:
    """Every earlier effect asked again with the later ones in the model: dropped where it has become insignificant,
    exchanged where a rival now explains the same flights better. None where all stand."""
    last = findings[-1]
    for finding in findings[:-1]:
        others = [f for f in findings if f is not finding]
        old = finding.candidate
        without = afresh_with(setting, others, last.child)
        if without is None:
            continue
        gain = 2.0 * (without.fit.cost - last.child.fit.cost)
        if idle(gain, finding.round_.threshold):
            why = f"no longer needed once {last.candidate.hypothesis.label} is in the model"
            fresh = fit_baseline(
                without.model, without.clean, setting.prepared, setting.scatter, without.fit, without.noise
            )
            kept = [replace(f, child=fresh) if f is last else f for f in others]
            return kept, [Rejected(old.hypothesis.label, why)]
        rival = _rival(setting, without, old, gain)
        if rival is not None:
            why = f"{rival.hypothesis.label} explains the same better with the other effects in the model"
            choice = Choice((rival,), {rival.hypothesis.effect.name: 1.0}, ())
            exchanged = Finding(last.round_, choice, rival, without, setting.child(without, rival))
            return [*others, exchanged], [Rejected(old.hypothesis.label, why)]
    return None


def idle(gain: float, threshold: float) -> bool:
    """Whether an effect that gains so much (twice a log-likelihood) beside the others would not be significant any more."""
    return float(np.sqrt(max(gain, 0.0))) < threshold


def _rival(setting: Setting, without: Baseline, old: Candidate, gain: float) -> Candidate | None:
    """The best hypothesis that beats `old` by a clear margin where it was taken out, or None."""
    problem, criteria = without.problem, without.criteria
    hypotheses = hypotheses_for(without.clean, setting.effects, setting.prepared.available)
    screen = build_screen(Tangent(problem, without.fit), hypotheses)
    found = []
    for h in questioners(linear_gains(screen, problem), criteria):
        hypothesis = screen.hypotheses[h]
        if hypothesis.key != old.hypothesis.key:
            _, fitted = fit_hypothesis(problem, without.fit, hypothesis, linear_guess(screen, problem, h))
            found.append(assess(problem, without.fit, hypothesis, fitted, 1.0))
    return best_rival(found, gain, criteria)


def questioners(gains: Array, criteria: Criteria) -> list[int]:
    """Indices of the hypotheses that question an earlier effect: the best by linear theory."""
    return [int(h) for h in np.argsort(-gains)[: criteria.rivals]]


def best_rival(found: Sequence[Candidate], gain: float, criteria: Criteria) -> Candidate | None:
    """The candidate that gains most, and more than an accepted effect's `gain` by a clear margin."""
    better = [c for c in found if not c.why_not and c.gain > gain + criteria.exchange]
    return max(better, key=lambda c: c.gain, default=None)
