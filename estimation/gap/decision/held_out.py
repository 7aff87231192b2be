"""A held-out flight that the model does not predict, though nothing is significant on the training flights.

Held-out flights confirm names. Without a name they are still compared with the model: a flight with a wrong instrument or
control, or in another configuration, is far from any prediction.
"""

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.answer.result import EffectStep, Gap, Where
from estimation.gap.answer.shape import NotPredicted
from estimation.gap.decision.location import SPANS, channels_that_gain, spans_of
from estimation.gap.decision.steps import nameless_step
from estimation.gap.fit.baseline import Baseline
from estimation.gap.records.flight_records import FlightRecords
from estimation.gap.significance.measure import Floors, plain_residuals, rms_over_noise


def not_predicted(baseline: Baseline, prepared: FlightRecords, floor: Floors) -> NotPredicted | None:
    """The held-out flight farthest from the model, where the gap of all is too large; None otherwise, without held-out flights,
    and where the model runs away on them."""
    if baseline.held_out is None or baseline.held_out[1].diverged:
        return None
    problem, fit = baseline.held_out
    gap = rms_over_noise(problem, fit, baseline.scatter)
    if gap <= baseline.criteria.another_flight * floor.highest:
        return None
    squares = [
        (plain_residuals(problem, fit, i, baseline.scatter) / baseline.scatter) ** 2 for i in range(len(fit.residuals))
    ]
    worst = max(range(len(squares)), key=lambda i: _mean(squares[i]))
    record, parts = problem.records[worst], np.nan_to_num(squares[worst])
    order = channels_that_gain(parts.sum(axis=0), baseline.criteria)
    return NotPredicted(
        flight=prepared.names[record.flight],
        channels=tuple(baseline.model.output_names[i] for i in order),
        segments=tuple(spans_of(record.time, parts.sum(axis=1), baseline.criteria)[:SPANS]),
        gap=gap,
        highest=floor.highest,
    )


def _mean(squares: Array) -> float:
    """Mean of the finite values; 0 without any."""
    compared = squares[np.isfinite(squares)]
    return float(compared.mean()) if compared.size else 0.0


def held_out_step(unlike: NotPredicted, gap: Gap, floor: Floors) -> EffectStep:
    """The step of an unknown that only a held-out flight shows. gap: on the training flights."""
    return nameless_step(
        "a held-out flight that the model does not predict",
        Where(" and ".join(unlike.channels), unlike.channels, unlike.segments, f"on {unlike.flight}"),
        unlike.gap,
        floor.criteria.another_flight * unlike.highest,
        gap,
        f"look at the instruments and the configuration of {unlike.flight}, or hold another flight out",
        Gap(unlike.gap, unlike.gap, floor.holdout_median or unlike.highest, unlike.highest),
        unlike,
    )
