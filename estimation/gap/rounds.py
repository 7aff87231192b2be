"""Rounds of nulls, screen, full fits and acceptance, until nothing is significant."""

from estimation.gap.accept import accept
from estimation.gap.baseline import Baseline, Round
from estimation.gap.omnibus import examine
from estimation.gap.question import questioned_again
from estimation.gap.result import Rejected
from estimation.gap.select import choose
from estimation.gap.trail import Finding, Setting, Trail

MARGIN = 1.3  # over the null threshold from which a nameless rest is called an unknown effect


def run_rounds(setting: Setting, baseline: Baseline) -> Trail:
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
        choice = choose(round_, setting.bench)
        finding, words = accept(setting, round_, choice, omnibus)
        rejected += [*choice.rejected, *words]
        if finding is None:
            break
        findings.append(finding)
        if len(findings) > 1:
            questioned = questioned_again(setting, findings)
            if questioned is not None:
                findings, said = questioned
                rejected += said
        baseline = findings[-1].child
    unknown = omnibus.score > MARGIN * omnibus.threshold
    return Trail(tuple(findings), tuple(rounds), omnibus, unknown, tuple(rejected))
