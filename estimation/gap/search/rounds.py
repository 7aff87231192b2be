"""Rounds of nulls, screen, full fits and acceptance, until nothing is significant."""

from estimation.gap.answer.result import Rejected
from estimation.gap.likelihood.baseline import Baseline
from estimation.gap.search.accept import accept
from estimation.gap.search.backward_check import backward_check
from estimation.gap.search.search_state import Finding, SearchState, Setting
from estimation.gap.search.select import choose
from estimation.gap.tests_of_fit.calibration import Round
from estimation.gap.tests_of_fit.omnibus import examine


def run_rounds(setting: Setting, baseline: Baseline) -> SearchState:
    """Add one effect after the other to `baseline` as long as one is accepted; what is left is examined at the end."""
    findings: list[Finding] = []
    rounds: list[Round] = []
    rejected: list[Rejected] = []
    while True:
        round_ = setting.screened(baseline, len(rounds))
        rounds.append(round_)
        omnibus = examine(round_)
        if len(findings) == setting.options.most:
            break
        setting.tell(f"round {len(rounds)}: full fits", 0.1 + 0.8 * len(rounds) / (setting.options.most + 1))
        choice = choose(round_, setting.prepared)
        finding, words = accept(setting, round_, choice, omnibus)
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
