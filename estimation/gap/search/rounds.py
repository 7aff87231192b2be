"""Rounds of nulls, screen, full fits and acceptance, until nothing is significant.

After each, earlier effects are asked again with the later ones in the model: dropped where idle, exchanged where a rival does
better.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.answer.result import Rejected
from estimation.gap.criteria import Criteria
from estimation.gap.errors import GapError
from estimation.gap.fit.baseline import Baseline, deeper_fit, fit_baseline
from estimation.gap.fit.channel_noise import sample_interval
from estimation.gap.search.accept import accept, confirmed, own_inflation
from estimation.gap.search.confirm import FittedHypothesis, assess, fit_hypothesis
from estimation.gap.search.select import (
    Choice,
    by_derivatives,
    choose,
    control_noise,
    individual_inflation,
    material,
    within_reach,
)
from estimation.gap.search.sharper import sharper_base
from estimation.gap.search.state import AcceptedEffect, SearchState, Setting, afresh_with
from estimation.gap.shapes.places import ModelMotion, places_of, rank
from estimation.gap.significance.calibration import Round, inflation_by_hypothesis
from estimation.gap.significance.omnibus import examine
from estimation.gap.significance.screen import Screen, build_screen, hypotheses_for, linear_gains, linear_guess
from estimation.gap.significance.tangent import Tangent

DEEPER = 2  # better valleys of the base that one round is asked again for


def backward_check(
    setting: Setting, findings: Sequence[AcceptedEffect]
) -> tuple[list[AcceptedEffect], list[Rejected]] | None:
    """Every earlier effect asked again with the later ones in the model: dropped where it has become insignificant,
    exchanged where a rival now explains the same flights better. None where all stand."""
    last = findings[-1]
    for finding in findings[:-1]:
        rest = [f for f in findings if f is not finding]
        old = finding.candidate
        reduced = afresh_with(setting, rest, last.child)
        if reduced is None:
            continue
        gain = 2.0 * (reduced.fit.cost - last.child.fit.cost)
        if idle(gain, finding.round_.threshold):
            reason = f"no longer needed once {last.candidate.hypothesis.label} is in the model"
            fresh = fit_baseline(
                reduced.model, reduced.clean, setting.prepared, setting.scatter, reduced.fit, reduced.noise
            )
            updated = [replace(f, child=fresh) if f is last else f for f in rest]
            return updated, [Rejected(old.hypothesis.label, reason)]
        rival = _rival(setting, reduced, finding, last.round_, gain)
        if rival is not None:
            reason = f"{rival[0].hypothesis.label} explains the same better with the other effects in the model"
            candidate, child = rival
            lead = 0.5 * (candidate.gain / own_inflation(candidate) - gain / own_inflation(old))
            choice = Choice.of((candidate, replace(old, evidence=candidate.evidence - lead)))
            exchanged = AcceptedEffect(last.round_, choice, candidate, reduced, child)
            return [*rest, exchanged], [Rejected(old.hypothesis.label, reason)]
    return None


def idle(gain: float, threshold: float) -> bool:
    """Whether an effect that gains so much (twice a log-likelihood) beside the others would not be significant any more."""
    return float(np.sqrt(max(gain, 0.0))) < threshold


def _rival(
    setting: Setting, without: Baseline, old: AcceptedEffect, last: Round, gain: float
) -> tuple[FittedHypothesis, Baseline] | None:
    """The best hypothesis that beats an earlier effect, which gains `gain`, by a clear margin where that was taken out, and is
    confirmed there as any is that gets a name, with the model that has it; or None.

    By how much nulls scatter gains is known of the last round, and of what is in its model of the round before it was. Of a rival
    with nearly the signature of the old effect the last round knows what is left of it beside that: it shares the old one's.
    """
    problem, criteria = without.problem, without.criteria
    hypotheses = hypotheses_for(without.clean, setting.effects, setting.prepared.available)
    screen = build_screen(Tangent(problem, without.fit), hypotheses)
    rounds = (old.round_, last)
    scatter = _of_each(screen, *(individual_inflation(round_) for round_ in rounds))
    keys = [h.key for h in hypotheses]
    if old.candidate.hypothesis.key in keys:
        tied = screen.tied(keys.index(old.candidate.hypothesis.key), criteria)
        scatter = np.where(tied, np.maximum(scatter, own_inflation(old.candidate)), scatter)
    gains = linear_gains(screen, problem)
    interval, noise = sample_interval(problem.records), control_noise(problem.records)
    candidates, needed = [], gain / own_inflation(old.candidate) + criteria.certain**2
    for h in questioners(gains / scatter, criteria):
        hypothesis = screen.hypotheses[h]
        if hypothesis.key != old.candidate.hypothesis.key and not by_derivatives(hypothesis):
            guess = linear_guess(screen, problem, h)
            _, fitted = fit_hypothesis(problem, without.fit, hypothesis, guess, within_reach(without.fit.cost, needed))
            rival = assess(problem, without.fit, hypothesis, fitted, float(scatter[h]))
            candidates.append(material(rival, interval, noise, criteria))
    inflation = _of_each(screen, *(inflation_by_hypothesis(round_) for round_ in rounds))
    asked = replace(last, baseline=without, screen=screen, gains=gains, inflation=inflation)
    for rival in better_rivals(candidates, gain / own_inflation(old.candidate), last.threshold, criteria):
        if deeper_fit(without, rival.fit) is not None:  # its gain is that of another valley
            continue
        child, _ = confirmed(setting, asked, rival, nameless=0.0)
        if child is not None:
            return rival, child
    return None


def _of_each(screen: Screen, *known: Mapping[tuple[str, str], float]) -> Array:
    """(hypotheses,) what is known of each, of the last that knows it; 1 of what nobody knows."""
    return np.array([next((k[h.key] for k in reversed(known) if h.key in k), 1.0) for h in screen.hypotheses])


def questioners(gains: Array, criteria: Criteria) -> list[int]:
    """Indices of the hypotheses that question an earlier effect: the best by linear theory, gains over what nulls scatter."""
    return [int(h) for h in np.argsort(-gains)[: criteria.rivals]]


def better_rivals(
    found: Sequence[FittedHypothesis], gain: float, threshold: float, criteria: Criteria
) -> list[FittedHypothesis]:
    """The significant candidates that gain more than an accepted effect's `gain` by a clear margin, the most first; gains over
    what the nulls scatter of them: what they scatter a hundred times too far gains by chance more than anything else."""
    significant = [(c.gain / own_inflation(c), c) for c in found if not c.why_not and c.score >= threshold]
    ahead = [(gained, c) for gained, c in significant if gained > gain + criteria.certain**2]
    return [c for _, c in sorted(ahead, key=lambda pair: -pair[0])]


def shape_gain(setting: Setting, round_: Round) -> float:
    """What the best function of one variable without a name gains about a fitted model (twice the log-likelihood); nothing where
    none stands out of the nulls."""
    motion = ModelMotion.of(round_.baseline.problem, round_.baseline.fit)
    return rank(motion, round_, places_of(setting.base)).best_gain


def _better_base(setting: Setting, round_: Round, choice: Choice) -> Baseline | None:
    """The round's base in the better valley to which the best significant candidate leads, or None: what is gained there without
    the candidate is not its own, and the round has to be asked again."""
    candidate = choice.best
    if candidate is None or candidate.score < round_.threshold:
        return None
    model_fit, base = deeper_fit(round_.baseline, candidate.fit), round_.baseline
    if model_fit is None:
        return None
    try:
        return fit_baseline(base.model, base.clean, setting.prepared, setting.scatter, model_fit, base.noise)
    except GapError:  # better with the noise it has only
        return None


def run_rounds(setting: Setting, baseline: Baseline) -> SearchState:
    """Add one effect after the other to `baseline` as long as one is accepted; what is left is examined at the end."""
    findings: list[AcceptedEffect] = []
    rounds: list[Round] = []
    rejected: list[Rejected] = []
    restarts, sharpened = 0, False
    while True:
        try:
            round_ = setting.screened(baseline, len(rounds))
        except GapError as error:  # what was found before it stands
            if not findings:
                raise
            rejected.append(
                Rejected(findings.pop().candidate.hypothesis.label, f"the model with it cannot be examined: {error}")
            )
            break
        rounds.append(round_)
        omnibus = examine(round_)
        if len(findings) == setting.options.most:
            break
        setting.tell(f"round {len(rounds)}: full fits", 0.1 + 0.8 * len(rounds) / (setting.options.most + 1))
        choice = choose(round_, setting.prepared)
        deeper_base = _better_base(setting, round_, choice) if restarts < DEEPER else None
        if deeper_base is not None:
            baseline, restarts = deeper_base, restarts + 1
            rounds.pop()
            continue
        restarts = 0
        finding, words = accept(setting, round_, choice, omnibus, partial(shape_gain, setting, round_))
        sharper = sharper_base(round_, choice) if finding is None and not sharpened else None
        sharpened = sharper is not None
        if sharper is not None:
            baseline = sharper
            rounds.pop()
            continue
        rejected += [*choice.rejected, *words]
        if finding is None:
            break
        findings.append(finding)
        if len(findings) > 1:
            questioned = backward_check(setting, findings)
            if questioned is not None:
                findings, notes = questioned
                rejected += notes
        baseline = findings[-1].child
    return SearchState(tuple(findings), tuple(rounds), omnibus, tuple(rejected))
