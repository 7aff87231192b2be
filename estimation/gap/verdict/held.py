"""An instrument that holds its values for so long that they are far from the motion: told where nothing else is left."""

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.answer.result import Gap, Step, Where
from estimation.gap.answer.shape import Held
from estimation.gap.criteria import Criteria
from estimation.gap.likelihood.baseline import Baseline
from estimation.gap.records.flight_records import FlightRecords


def held_back(baseline: Baseline, prepared: FlightRecords) -> tuple[Held, ...]:
    """The stale outputs that are too far from the model where they repeat, the farthest first."""
    problem, fit, criteria = baseline.problem, baseline.fit, baseline.criteria
    far: dict[str, list[Array]] = {name: [] for name in prepared.stale}
    near: dict[str, list[Array]] = {name: [] for name in prepared.stale}
    steps = [float(np.median(np.diff(r.time))) for r in problem.records]
    for index, record in enumerate(problem.records):
        modelled = problem.modelled(index, fit.values, fit.locals[index])
        if modelled is None or record.apart is None:
            continue
        for c, signal in enumerate(problem.model.outputs):
            if signal.source in far:
                off, at = record.apart[:, c] - modelled[:, c], fit.residuals[index][:, c]
                far[signal.source].append(off[np.isfinite(off)])
                near[signal.source].append(at[np.isfinite(at)])
    found = [judged(n, np.concatenate(far[n]), np.concatenate(near[n]), max(steps), criteria) for n in far if far[n]]
    return tuple(sorted((h for h in found if h is not None), key=lambda h: -h.ratio))


def judged(channel: str, far: Array, near: Array, step: float, criteria: Criteria) -> Held | None:
    """Residuals of a channel where it repeats a value, (n,), against those at new values, (m,), of records sampled every `step`
    [s]; None where the former are little farther."""
    usual = float(np.sqrt(np.mean(near**2))) if near.size else 0.0
    if not far.size or usual <= 0.0:
        return None
    ratio = float(np.sqrt(np.mean(far**2))) / usual
    if ratio <= criteria.held_ratio:
        return None
    share = far.size / (far.size + near.size)
    return Held(channel, step / (1.0 - share), share, ratio, criteria.held_ratio)


def held_step(held: Held, gap: Gap) -> Step:
    """The step of an unknown that is an instrument's."""
    return Step(
        effect="unknown", title="an instrument that holds its values", form="", confidence=0.0, members=(),
        separate_by=f"read {held.channel} at the rate of the other channels, and repeat the flight", estimates={}, units={},
        score=held.ratio, threshold=held.threshold,
        where=Where(held.channel, (held.channel,), (), "where it repeats a value"),
        gap=gap, holdout=None, migrated={}, shape=held,
    )  # fmt: skip
