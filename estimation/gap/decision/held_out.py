"""A held-out flight that the model does not predict, though nothing stands out on the training flights.

Held-out flights confirm names; where none is found nobody had asked whether they look like the training flights at all. A flight
on which an instrument or a control is wrong, or that another configuration flew, is far from any prediction.
"""

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.answer.result import EffectStep, Gap, Where
from estimation.gap.answer.shape import NotPredicted
from estimation.gap.decision.location import SPANS, channels_that_gain, spans_of
from estimation.gap.fit.baseline import Baseline
from estimation.gap.records.flight_records import FlightRecords
from estimation.gap.significance.measure import Floors, plain_residuals, rms_over_noise

FAR = 3.0
"""Of the largest gap that nothing hidden leaves: a held-out flight farther off is another one. Seven sets with nothing hidden lay
at 0.83 to 1.06, one with four times the gusts on that flight at 1.6, a dead aileron at 7.7, one of the wrong sign
at 14 (2026-11-28)."""


def not_predicted(baseline: Baseline, prepared: FlightRecords, floor: Floors) -> NotPredicted | None:
    """The held-out flight that is farthest from the model, where all of them are too far; None where there is none, or where the
    model runs away, which nothing can be told of."""
    if baseline.held_out is None or baseline.held_out[1].diverged:
        return None
    problem, fit = baseline.held_out
    gap = rms_over_noise(problem, fit, baseline.scatter)
    if gap <= FAR * floor.highest:
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
    """Of what is compared; 0 where nothing is."""
    compared = squares[np.isfinite(squares)]
    return float(compared.mean()) if compared.size else 0.0


def held_out_step(found: NotPredicted, gap: Gap, floor: Floors) -> EffectStep:
    """The step of an unknown that only a held-out flight shows. gap: on the training flights."""
    held = Gap(found.gap, found.gap, floor.holdout_median or found.highest, found.highest)
    return EffectStep(
        effect="unknown", title="a held-out flight that the model does not predict", form="", confidence=0.0, members=(),
        separate_by=f"look at the instruments and the configuration of {found.flight}, or hold another flight out",
        estimates={}, units={}, score=found.gap, threshold=FAR * found.highest,
        where=Where(" and ".join(found.channels), found.channels, found.segments, f"on {found.flight}"),
        gap=gap, holdout=held, migrated={}, shape=found,
    )  # fmt: skip
