"""An instrument that holds its values for so long that they are far from the motion: told where nothing else is left."""

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.answer.result import EffectStep, Gap, Where
from estimation.gap.answer.shape import HeldInstrument
from estimation.gap.criteria import Criteria
from estimation.gap.likelihood.baseline import Baseline
from estimation.gap.records.flight_records import FlightRecords


def held_back(baseline: Baseline, prepared: FlightRecords) -> HeldInstrument | None:
    """The stale output that is farthest from the model where it repeats; None where none is too far."""
    problem, fit = baseline.problem, baseline.fit
    modelled = [problem.modelled(i, fit.values, local) for i, local in enumerate(fit.locals)]
    seen = [(r, y) for r, y in zip(problem.records, modelled, strict=True) if y is not None and r.apart is not None]
    step = max(float(np.median(np.diff(r.time))) for r in problem.records)
    found = []
    for c, signal in enumerate(problem.model.outputs):
        if signal.source in prepared.stale and seen:
            far = np.concatenate([r.apart[:, c] - y[:, c] for r, y in seen if r.apart is not None])
            near = np.concatenate([r.z[:, c] - y[:, c] for r, y in seen])
            held = judged(signal.source, far[np.isfinite(far)], near[np.isfinite(near)], step, baseline.criteria)
            found += [held] if held is not None else []
    return max(found, key=lambda h: h.ratio, default=None)


def judged(channel: str, far: Array, near: Array, step: float, criteria: Criteria) -> HeldInstrument | None:
    """Residuals of a channel where it repeats a value, (n,), against those at new values, (m,), of records sampled every `step`
    [s]; None where the former are little farther."""
    usual = float(np.sqrt(np.mean(near**2))) if near.size else 0.0
    if not far.size or usual <= 0.0:
        return None
    ratio = float(np.sqrt(np.mean(far**2))) / usual
    if ratio <= criteria.held_ratio:
        return None
    share = far.size / (far.size + near.size)
    return HeldInstrument(channel, step / (1.0 - share), share, ratio, criteria.held_ratio)


def held_step(held: HeldInstrument, gap: Gap) -> EffectStep:
    """The step of an unknown that is an instrument's."""
    return EffectStep(
        effect="unknown", title="an instrument that holds its values", form="", confidence=0.0, members=(),
        separate_by=f"read {held.channel} at the rate of the other channels, and repeat the flight", estimates={}, units={},
        score=held.ratio, threshold=held.threshold,
        where=Where(held.channel, (held.channel,), (), "where it repeats a value"),
        gap=gap, holdout=None, migrated={}, shape=held,
    )  # fmt: skip
