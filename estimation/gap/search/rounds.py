"""Rounds of nulls, screen, full fits and acceptance, until nothing is significant."""

from functools import partial

from estimation.gap.answer.result import Rejected
from estimation.gap.errors import GapError
from estimation.gap.form.places import ModelMotion, places_of
from estimation.gap.form.screen import rank
from estimation.gap.likelihood.baseline import Baseline, deeper, fit_baseline
from estimation.gap.search.accept import accept
from estimation.gap.search.backward_check import backward_check
from estimation.gap.search.search_state import AcceptedEffect, SearchState, Setting
from estimation.gap.search.select import Choice, choose
from estimation.gap.tests_of_fit.calibration import Round
from estimation.gap.tests_of_fit.omnibus import examine

DEEPER = 2  # better valleys of the base that one round is asked again for


def shape_gain(setting: Setting, round_: Round) -> float:
    """What the best function of one variable without a name gains about a fitted model (twice the log-likelihood); nothing where
    none stands out of the nulls."""
    flown = ModelMotion.of(round_.baseline.problem, round_.baseline.fit)
    return rank(flown, round_, places_of(setting.base)).best_gain


def _better_base(setting: Setting, round_: Round, choice: Choice) -> Baseline | None:
    """The round's base in the better valley to which the best significant candidate leads, or None: what is gained there without
    the candidate is not its own, and the round has to be asked again."""
    best = choice.best
    if best is None or best.score < round_.threshold:
        return None
    found, base = deeper(round_.baseline, best.fit), round_.baseline
    if found is None:
        return None
    try:
        return fit_baseline(base.model, base.clean, setting.prepared, setting.scatter, found, base.noise)
    except GapError:  # better with the noise it has only
        return None


def run_rounds(setting: Setting, baseline: Baseline) -> SearchState:
    """Add one effect after the other to `baseline` as long as one is accepted; what is left is examined at the end."""
    findings: list[AcceptedEffect] = []
    rounds: list[Round] = []
    rejected: list[Rejected] = []
    again = 0
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
        better = _better_base(setting, round_, choice) if again < DEEPER else None
        if better is not None:
            baseline, again = better, again + 1
            rounds.pop()
            continue
        again = 0
        finding, words = accept(setting, round_, choice, omnibus, partial(shape_gain, setting, round_))
        rejected += [*choice.rejected, *words]
        if finding is None:
            break
        findings.append(finding)
        if len(findings) > 1:
            questioned = backward_check(setting, findings)
            if questioned is not None:
                findings, said = questioned
                rejected += said
        baseline = findings[-1].child
    return SearchState(tuple(findings), tuple(rounds), omnibus, tuple(rejected))
