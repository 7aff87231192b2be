"""Rounds of nulls, screen, full fits and acceptance, until nothing is significant.

Whenever an effect is added, the earlier ones are tested again beside it: an effect that is no longer significant is dropped, one
that a rival beats is exchanged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from estimation.engine.kernel import Array
from estimation.errors import GapError
from estimation.gap.answer.result import Rejected
from estimation.gap.criteria import Criteria
from estimation.gap.fit.baseline import Baseline, deeper_fit, fit_baseline
from estimation.gap.records.flight_records import sample_interval
from estimation.gap.search.accept import accept, confirmed, explains, own_inflation
from estimation.gap.search.bases import sharper_base
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
from estimation.gap.search.state import AcceptedEffect, SearchState, Setting, afresh_with
from estimation.gap.shapes.places import ModelMotion, places_of, rank
from estimation.gap.significance.calibration import Round, beyond_doubt, inflation_by_hypothesis
from estimation.gap.significance.omnibus import Remainder
from estimation.gap.significance.screen import Screen, build_screen, hypotheses_for, linear_gains, linear_guess
from estimation.gap.significance.tangent import Tangent

DEEPER = 2  # times a round is repeated because a better minimum of its base was found


def backward_check(
    setting: Setting, findings: Sequence[AcceptedEffect]
) -> tuple[list[AcceptedEffect], list[Rejected]] | None:
    """The findings without, or with another in place of, the first earlier effect that fails beside the last one; and why.

    An effect that has become insignificant is dropped; one that a rival now beats is exchanged. None where all stand.
    """
    last = findings[-1]
    for finding in findings[:-1]:
        others = [f for f in findings if f is not finding]
        old = finding.candidate
        reduced = afresh_with(setting, others, last.child)
        if reduced is None:
            continue
        gain = 2.0 * (reduced.fit.cost - last.child.fit.cost)
        if idle(gain, finding.round_.threshold):
            reason = f"no longer needed once {last.candidate.hypothesis.label} is in the model"
            refitted = fit_baseline(
                reduced.model, reduced.clean, setting.prepared, setting.scatter, reduced.fit, reduced.noise
            )
            updated = [replace(f, child=refitted) if f is last else f for f in others]
            return updated, [Rejected(old.hypothesis.label, reason)]
        rival = _rival(setting, reduced, finding, last.round_, gain)
        if rival is not None:
            reason = f"{rival[0].hypothesis.label} explains the same better with the other effects in the model"
            candidate, child = rival
            lead = 0.5 * (candidate.gain / own_inflation(candidate) - gain / own_inflation(old))
            choice = Choice.of((candidate, replace(old, evidence=candidate.evidence - lead)))
            exchanged = AcceptedEffect(last.round_, choice, candidate, reduced, child)
            return [*others, exchanged], [Rejected(old.hypothesis.label, reason)]
    return None


def idle(gain: float, threshold: float) -> bool:
    """Whether an effect with this gain beside the other effects is no longer significant."""
    return float(np.sqrt(max(gain, 0.0))) < threshold


def _rival(
    setting: Setting, without: Baseline, old: AcceptedEffect, last: Round, gain: float
) -> tuple[FittedHypothesis, Baseline] | None:
    """The best confirmed hypothesis that beats an earlier effect by a clear margin, and the model with it; or None.

    without: the model without the earlier effect `old`; gain: what `old` gains over it. last: the last round.

    Inflation is taken from the last round; of hypotheses that its model already has, from the round that accepted `old`. A rival
    with nearly the signature of `old` takes at least the inflation of `old`: the last round, whose model has `old`, knows only
    what is left of the rival beside it.
    """
    problem, criteria = without.problem, without.criteria
    hypotheses = hypotheses_for(without.clean, setting.effects, setting.prepared.available)
    screen = build_screen(Tangent(problem, without.fit), hypotheses)
    rounds = (old.round_, last)
    inflation = _latest_known(screen, *(individual_inflation(round_) for round_ in rounds))
    keys = [h.key for h in screen.hypotheses]  # without those that cannot be asked
    old_key, old_inflation = old.candidate.hypothesis.key, own_inflation(old.candidate)
    if old_key in keys:
        tied = screen.tied(keys.index(old_key), criteria)
        inflation = np.where(tied, np.maximum(inflation, old_inflation), inflation)
    gains = linear_gains(screen, problem)
    interval, noise = sample_interval(problem.records), control_noise(problem.records)
    needed = max(gain / old_inflation + criteria.certain**2, criteria.named_share * gain)
    candidates, cost_limit = [], within_reach(without.fit.cost, needed)
    for h in questioners(gains / inflation, criteria):
        hypothesis = screen.hypotheses[h]
        if hypothesis.key != old_key and not by_derivatives(hypothesis):
            guess = linear_guess(screen, problem, h)
            _, fitted = fit_hypothesis(problem, without.fit, hypothesis, guess, cost_limit)
            rival = assess(problem, without.fit, hypothesis, fitted, float(inflation[h]))
            candidates.append(material(rival, interval, noise, criteria))
    small_step = _latest_known(screen, *(inflation_by_hypothesis(round_) for round_ in rounds))
    round_without = replace(last, baseline=without, screen=screen, gains=gains, inflation=small_step)
    for rival in better_rivals(candidates, gain, old_inflation, last.threshold, criteria):
        if deeper_fit(without, rival.fit) is not None:  # the gain comes from a better minimum of the base
            continue
        child, _ = confirmed(setting, round_without, rival, nameless=0.0, nulls_of=last)
        if child is not None:
            return rival, child
    return None


def _latest_known(screen: Screen, *tables: Mapping[tuple[str, str], float]) -> Array:
    """(hypotheses,) the value of each from the last table that has it; 1 where none has."""
    return np.array([next((t[h.key] for t in reversed(tables) if h.key in t), 1.0) for h in screen.hypotheses])


def questioners(gains: Array, criteria: Criteria) -> list[int]:
    """Indices of the hypotheses that compete with an earlier effect: those of the largest gains (linear theory, deflated)."""
    return [int(h) for h in np.argsort(-gains)[: criteria.compared]]


def better_rivals(
    candidates: Sequence[FittedHypothesis], gain: float, inflation: float, threshold: float, criteria: Criteria
) -> list[FittedHypothesis]:
    """The significant candidates that gain clearly more than an accepted effect's `gain`, the best first.

    Gains are compared over inflation: a hypothesis of inflation 100 would by chance gain more than any other. But a rival that
    leaves much of the plain gain would leave that to be named next, by the very effect that it replaces.
    """
    significant = [(c.gain / own_inflation(c), c) for c in candidates if not c.why_not and c.score >= threshold]
    ahead = [
        (gained, c)
        for gained, c in significant
        if gained > gain / inflation + criteria.certain**2 and explains(c.gain, gain, criteria)
    ]
    return [c for _, c in sorted(ahead, key=lambda pair: -pair[0])]


def shape_gain(setting: Setting, round_: Round) -> float:
    """Gain of the best nameless function of one variable about a fitted model; 0 where none stands out of the nulls."""
    motion = ModelMotion.of(round_.baseline.problem, round_.baseline.fit)
    return rank(motion, round_, places_of(setting.base)).best_gain


def _better_base(setting: Setting, round_: Round, choice: Choice) -> Baseline | None:
    """The round's base in the better minimum to which the best significant candidate leads, or None where there is none.

    What the base gains there without the candidate is not the candidate's, so the round has to be repeated.
    """
    candidate = choice.best
    if candidate is None or candidate.score < round_.threshold:
        return None
    model_fit, base = deeper_fit(round_.baseline, candidate.fit), round_.baseline
    if model_fit is None:
        return None
    try:
        return fit_baseline(base.model, base.clean, setting.prepared, setting.scatter, model_fit, base.noise)
    except GapError:  # the better minimum does not last once its noise is estimated anew
        return None


def _standing(setting: Setting, findings: list[AcceptedEffect]) -> tuple[list[AcceptedEffect], list[Rejected]]:
    """The findings after a `backward_check`, repeated where one fell: those that stood beside it are asked again; and why."""
    fallen: list[Rejected] = []
    for _ in range(setting.options.most):
        revised = backward_check(setting, findings) if len(findings) > 1 else None
        if revised is None:
            break
        findings, reasons = revised
        fallen += reasons
    return findings, fallen


def weighed(round_: Round) -> tuple[Round, Remainder, Choice]:
    """A round with as many nulls as decide it, what its baseline leaves without a name, and its hypotheses weighed."""
    rest = Remainder(round_)
    if not round_.has_enough_nulls and not beyond_doubt(rest.omnibus.score, rest.omnibus.threshold):
        round_ = round_.with_enough_nulls
        rest = Remainder(round_)
    choice = choose(round_)
    best = max((c.score for c in choice.candidates), default=0.0)
    surer = round_ if beyond_doubt(best, round_.threshold) else round_.with_enough_nulls
    return (round_, rest, choice) if surer is round_ else (surer, Remainder(surer), choose(surer))


def run_rounds(setting: Setting, baseline: Baseline) -> SearchState:
    """Add one effect after the other to `baseline` as long as one is accepted; then test the residuals for anything nameless.

    Effects that were in the model before and come back end the search too: it would go on in circles. Raises GapError where
    already the first baseline cannot be screened.
    """
    findings: list[AcceptedEffect] = []
    rounds: list[Round] = []
    rejected: list[Rejected] = []
    restarts, sharpened, in_circles = 0, False, False
    before = set[frozenset[tuple[str, str]]]()  # sets of effects that were in the model
    while True:
        try:
            round_ = setting.first_screened(baseline, len(rounds))
        except GapError as error:  # the last effect is taken back, the earlier ones stand
            if not findings:
                raise
            label = findings.pop().candidate.hypothesis.label
            rejected.append(Rejected(label, f"the model with it cannot be examined: {error}"))
            break
        if len(findings) == setting.options.most or in_circles:
            rounds.append(round_.with_enough_nulls)
            rest = Remainder(rounds[-1])
            break
        setting.tell(f"round {len(rounds) + 1}: full fits", setting.options.progress(len(rounds) + 1))
        round_, rest, choice = weighed(round_)
        rounds.append(round_)
        deeper_base = _better_base(setting, round_, choice) if restarts < DEEPER else None
        if deeper_base is not None:
            baseline, restarts = deeper_base, restarts + 1
            rounds.pop()
            continue
        restarts = 0
        finding, refused = accept(setting, round_, choice, rest, partial(shape_gain, setting, round_))
        sharper = sharper_base(round_, choice) if finding is None and not sharpened else None
        sharpened = sharper is not None
        if sharper is not None:
            baseline = sharper
            rounds.pop()
            continue
        rejected += [*choice.rejected, *refused]
        if finding is None:
            break
        findings.append(finding)
        findings, fallen = _standing(setting, findings)
        rejected += fallen
        effects = frozenset(f.candidate.hypothesis.key for f in findings)
        in_circles = effects in before
        before.add(effects)
        baseline = findings[-1].child
        round_.tangent.forget()
    return SearchState(tuple(findings), tuple(rounds), rest.omnibus, tuple(rejected))
