"""The part of a long record that its instrument factors are estimated from.

An estimate of factors and noise takes about a hundred runs of the filter. Five minutes of motion suffice, and in three hours
temperature and drift move the factors themselves. So a long record is cut into even pieces and divided into equal spans, and
the piece that moves most is taken from each span: all of the flight is represented. Fit and motion are shown for the full record.
"""

from collections.abc import Sequence

import numpy as np

from estimation.compatibility.kalman import FilterRecord
from groundstation.flight import Array

LONG_SAMPLES = 30_000
"""Longest flight of which all samples are used: 10 minutes at 50 Hz."""
MOST_SAMPLES = 15_000
"""Samples that are used of a longer flight: 5 minutes at 50 Hz (docs/compatibility.md)."""
PIECE_SAMPLES = 1_500
SHORTEST_PIECE_S, LONGEST_PIECE_S = 20.0, 60.0
"""[s] of a piece: several periods of the motion; errors of an attitude filter come and go within about 20 s."""
FEWEST_PIECES = 5  # whatever the sample rate


def excited_pieces(records: list[FilterRecord]) -> tuple[list[FilterRecord], str]:
    """Records to estimate from, and a note for a flight of more than LONG_SAMPLES; a shorter one is used as it is."""
    total = sum(len(r.time) for r in records)
    step = records[0].step
    length = round(float(np.clip(PIECE_SAMPLES * step, SHORTEST_PIECE_S, LONGEST_PIECE_S)) / step)
    spans = max(FEWEST_PIECES, MOST_SAMPLES // length)
    if total <= max(LONG_SAMPLES, spans * length):
        return records, ""
    pieces = [piece for r in records for piece in even_parts(r, length)]
    movement = _movement(pieces)
    chosen = [
        pieces[max(span, key=lambda i: movement[i])]
        for span in np.array_split(np.arange(len(pieces)), spans)
        if span.size
    ]
    size = sum(len(r.time) for r in chosen)
    note = (
        f"factors, their bounds and noise are from {size} of {total} samples: of each of {len(chosen)} equal spans the "
        f"{length * step:.0f} s that move most; fit and motion are of all samples"
    )
    return chosen, note


def even_parts(record: FilterRecord, length: int) -> list[FilterRecord]:
    """Pieces of equal length of a record, about `length` samples each."""
    return record.parts(max(1, round(len(record.time) / length)))


def _movement(pieces: Sequence[FilterRecord]) -> Array:
    """(pieces,) movement of each: mean over channels of its rank among the pieces, which a fault of one channel does not
    decide."""
    spread = np.array([_spread(np.hstack([r.u, r.z])) for r in pieces])
    ranks = np.argsort(np.argsort(spread[:, np.ptp(spread, axis=0) > 0.0], axis=0), axis=0)
    return np.asarray(ranks.mean(axis=1)) if ranks.size else np.zeros(len(pieces))


def _spread(values: Array) -> Array:
    """(n,) standard deviation of the measured samples of each channel (N, n), 0 where there are none."""
    measured = np.isfinite(values)
    count = np.maximum(measured.sum(axis=0), 1)
    mean = np.where(measured, values, 0.0).sum(axis=0) / count
    return np.asarray(np.sqrt((np.where(measured, values - mean, 0.0) ** 2).sum(axis=0) / count))
