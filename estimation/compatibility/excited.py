"""The part of a long record that its instrument factors are estimated from.

Factors and noise come of some hundred runs of the filter; five minutes of flight that move tell them, and three hours no better
than drift and temperature allow. So a long record is cut into even pieces, and of each of as many equal spans of it the piece
that moves most is taken: what excites is used, and no hour of the flight is left out. What is shown is of the whole record.
"""

from collections.abc import Sequence

import numpy as np

from estimation.compatibility.kalman import FilterRecord
from groundstation.flight import Array

LONG_SAMPLES = 30_000
"""Of a flight, up to which factors are estimated from all of it: 10 minutes at 50 Hz."""
MOST_SAMPLES = 15_000
"""Of a longer one, from which they are estimated: 5 minutes at 50 Hz that move most (docs/compatibility.md)."""
PIECE_SAMPLES = 1_500
SHORTEST_PIECE_S, LONGEST_PIECE_S = 20.0, 60.0
"""[s] of a piece: several periods of what moves; errors of the attitude filter come and go within some 20 s."""
FEWEST_PIECES = 5


def excited_pieces(records: list[FilterRecord]) -> tuple[list[FilterRecord], str]:
    """Records to estimate from, all of them in a flight of up to LONG_SAMPLES, and a note where it is."""
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
    """Even pieces of a record, none much longer than so many samples."""
    return record.parts(max(1, round(len(record.time) / length)))


def _movement(pieces: Sequence[FilterRecord]) -> Array:
    """(pieces,) how much each moves: the mean over channels of its place among the others, so that a fault of one channel,
    however large, does not decide."""
    spread = np.array([_spread(np.hstack([r.u, r.z])) for r in pieces])
    places = np.argsort(np.argsort(spread[:, np.ptp(spread, axis=0) > 0.0], axis=0), axis=0)
    return np.asarray(places.mean(axis=1)) if places.size else np.zeros(len(pieces))


def _spread(values: Array) -> Array:
    """Standard deviation of the measured samples of each channel (N, n), 0 where there are none."""
    measured = np.isfinite(values)
    count = np.maximum(measured.sum(axis=0), 1)
    mean = np.where(measured, values, 0.0).sum(axis=0) / count
    return np.asarray(np.sqrt((np.where(measured, values - mean, 0.0) ** 2).sum(axis=0) / count))
