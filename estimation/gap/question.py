"""Earlier effects asked again with the later ones in the model: dropped where idle, exchanged where a rival does better."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.gap.baseline import Baseline, fit_baseline
from estimation.gap.confirm import Candidate, assess, fit_hypothesis, linear_gains, linear_guess
from estimation.gap.dormant import awakened
from estimation.gap.result import Rejected
from estimation.gap.screen import build_screen, hypotheses_for
from estimation.gap.select import Choice
from estimation.gap.trail import Finding, Setting

RIVALS = 6
EXCHANGE = 8.0  # in twice the log-likelihood, by which a rival must beat an accepted effect


def questioned_again(setting: Setting, findings: Sequence[Finding]) -> tuple[list[Finding], list[Rejected]] | None:
    """Every earlier effect asked again with the later ones in the model: dropped where it has become insignificant,
    exchanged where a rival now explains the same flights better. None where all stand."""
    last = findings[-1]
    said: list[Rejected] = []
    for i in range(len(findings) - 1):
        others = [f for j, f in enumerate(findings) if j != i]
        model, clean = setting.working, setting.clean
        for f in others:
            at = {n: v for n, (v, _) in f.candidate.estimates.items()}
            model, clean = (
                awakened(model, f.candidate.hypothesis.form, at),
                f.candidate.hypothesis.form.added_to(clean, at),
            )
        without = fit_baseline(model, clean, setting.bench, setting.scatter, None, None, last.child.noise, passes=0)
        old = findings[i].candidate
        gain = 2.0 * (without.fit.cost - last.child.fit.cost)
        if np.sqrt(max(gain, 0.0)) < findings[i].round_.threshold:
            said.append(
                Rejected(
                    old.hypothesis.label, f"no longer needed once {last.candidate.hypothesis.label} is in the model"
                )
            )
            fresh = fit_baseline(
                model, clean, setting.bench, setting.scatter, without.fit.values, without.fit.locals, without.noise
            )
            return [replace(f, child=fresh) if f is others[-1] else f for f in others], said
        rival = _rival(setting, without, old, gain)
        if rival is not None:
            said.append(
                Rejected(
                    old.hypothesis.label,
                    f"{rival.hypothesis.label} explains the same better with the other effects in the model",
                )
            )
            child = setting.child(without, rival)
            choice = Choice((rival,), {rival.hypothesis.effect.name: 1.0}, ())
            return [*others, Finding(last.round_, choice, rival, without, child)], said
    return None


def _rival(setting: Setting, without: Baseline, old: Candidate, gain: float) -> Candidate | None:
    """A hypothesis that beats `old` by a clear margin where it was taken out, or None."""
    problem = without.problem
    hypotheses = hypotheses_for(without.clean, setting.effects, setting.bench.available)
    screen = build_screen(problem, without.fit, hypotheses)
    gains = linear_gains(screen, problem)
    best: Candidate | None = None
    for h in np.argsort(-gains)[:RIVALS]:
        hypothesis = screen.hypotheses[int(h)]
        if hypothesis.key == old.hypothesis.key:
            continue
        _, found = fit_hypothesis(problem, without.fit, hypothesis, linear_guess(screen, problem, int(h)))
        candidate = assess(problem, without.fit, hypothesis, found, 1.0)
        if not candidate.why_not and candidate.gain > gain + EXCHANGE and (best is None or candidate.gain > best.gain):
            best = candidate
    return best
