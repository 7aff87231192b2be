"""Stale, clipped and missing samples of the channels a model needs, in words."""

from collections.abc import Sequence

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from groundstation.flight import Flight
from groundstation.flight.arrays import longest_run


def sample_notes(flights: Sequence[Flight], columns: Sequence[str], criteria: Criteria) -> list[str]:
    """One sentence for each channel of each flight that is stale, clipped or has holes."""
    said = []
    for flight in flights:
        for name in columns:
            if not flight.measured(name):
                continue
            said += [f"{flight.name}: {words}" for words in _channel(name, flight.columns[name], criteria)]
    return said


def stale_channels(flights: Sequence[Flight], columns: Sequence[str], criteria: Criteria) -> tuple[str, ...]:
    """Channels that repeat their last value in many samples of some flight."""
    return tuple(
        n for n in columns if any(f.measured(n) and _repeats(f.columns[n]) > criteria.stale_share for f in flights)
    )


def _repeats(values: Array) -> float:
    """Share of the samples that repeat the one before, its ends apart: a clipped channel rests there."""
    seen = values[np.isfinite(values)]
    if seen.size < 2:
        return 0.0
    return float(np.mean((np.diff(seen) == 0.0) & (seen[1:] < seen.max()) & (seen[1:] > seen.min())))


def _channel(name: str, values: Array, criteria: Criteria) -> list[str]:
    seen = values[np.isfinite(values)]
    said = []
    if seen.size < (1.0 - criteria.missing_share) * values.size:
        said.append(f"{name} is missing in {1 - seen.size / values.size:.0%} of the samples")
    if seen.size < criteria.fewest_samples or float(np.ptp(seen)) == 0.0:
        return said
    ends = (float(seen.max()), float(seen.min()))
    stuck = _repeats(seen)
    if stuck > criteria.stale_share:
        said.append(f"{name} repeats its last value in {stuck:.0%} of the samples: stale or coarsely rounded")
        return said
    for end, word in zip(ends, ("upper", "lower"), strict=True):
        run = longest_run(seen == end)
        if run >= criteria.clipped_run:
            said.append(f"{name} stands at its {word} end {end:.4g} for {run} samples in a row: clipped")
    return said
