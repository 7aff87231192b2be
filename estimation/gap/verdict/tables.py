"""What these flights can tell at all: scores, detectable sizes, ties, effects that could not have been seen."""

import numpy as np
from scipy.stats import norm

from estimation.gap.answer.result import Tie
from estimation.gap.criteria import Criteria
from estimation.gap.effects.base import Effect
from estimation.gap.tests_of_fit.calibration import Round


def undetectable(round_: Round) -> list[Effect]:
    """Effects of which not even a multiple of the usual size would have passed the threshold on these flights."""
    projected = round_.screen.projected()
    seen: dict[str, float] = {}
    effects = {h.effect.name: h.effect for h in round_.screen.hypotheses}
    for c, column in enumerate(round_.screen.columns):
        name = round_.screen.hypotheses[column.hypothesis].effect.name
        power = (
            np.sqrt(max(float(projected.B[c, c]), 0.0) / round_.inflation[column.hypothesis]) * column.parameter.typical
        )
        seen[name] = max(seen.get(name, 0.0), float(power))
    size, threshold = round_.criteria.blind_size, round_.threshold
    return [effects[n] for n, power in seen.items() if size * power < threshold and not effects[n].tied_to]


def effect_scores(round_: Round) -> dict[str, float]:
    scores: dict[str, float] = {}
    for h, value in enumerate(round_.standardised()):
        name = round_.screen.hypotheses[h].effect.name
        scores[name] = max(scores.get(name, 0.0), float(value))
    return dict(sorted(scores.items(), key=lambda item: -item[1]))


def detectable_sizes(round_: Round) -> dict[str, float]:
    """Smallest size of each parameter that would have passed the threshold on these flights."""
    projected = round_.screen.projected()
    sizes = {}
    for c, column in enumerate(round_.screen.columns):
        information = max(float(projected.B[c, c]), 1e-300) / round_.inflation[column.hypothesis]
        name = round_.screen.hypotheses[column.hypothesis].effect.name
        key = (
            name
            if name not in sizes and len(round_.screen.hypotheses[column.hypothesis].effect.forms) == 1
            else column.parameter.name
        )
        sizes[key] = round_.threshold / float(np.sqrt(information)) if information > 0.0 else np.inf
    return sizes


def ties_of(round_: Round) -> tuple[Tie, ...]:
    cosines = round_.screen.projected().cosines()
    found = []
    columns = round_.screen.columns
    for i in range(len(columns)):
        for j in range(i + 1, len(columns)):
            a, b = round_.screen.hypotheses[columns[i].hypothesis], round_.screen.hypotheses[columns[j].hypothesis]
            if a.effect.name != b.effect.name and abs(cosines[i, j]) >= round_.criteria.tie:
                found.append(Tie(a.label, b.label, float(abs(cosines[i, j]))))
    return tuple(sorted(found, key=lambda t: -t.cosine))


def nominal_threshold(hypotheses: int, criteria: Criteria) -> float:
    """What the largest |z| of so many hypotheses would stay below were the noise model exact (Bonferroni, two-sided)."""
    return float(norm.isf(criteria.nominal_alarm / 2 / max(hypotheses, 1)))
