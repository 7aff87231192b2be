"""Kinds of intervals between scans, by how far a prediction over them can be trusted.

How long they are, whether surfaces moved in them, and whether it is known how. Where a surface moved in a long one and nobody
knows how, the prediction says nothing of the model, and what it got wrong would stay in the predictor for a second: such an
interval is blind, and so are the two after it, whose innovations whitening compares with its own.
"""

import numpy as np
from numpy.typing import NDArray

from daq.identification.monitor.surfaces import GUESSED, LEVELS, SurfaceBetween
from daq.identification.servo import LONG

LENGTHS = np.array([0.06, 0.11, 0.16])  # s
BLIND = 2 * (len(LENGTHS) + 1) * LEVELS**2
KINDS = BLIND + 1
"""All kinds; the last one is `BLIND`."""

Kinds = NDArray[np.intp]
Pair = tuple[SurfaceBetween, SurfaceBetween]


def guessed(surfaces: Pair) -> NDArray[np.bool_]:
    """(flights,) where either surface moved and it is not known when."""
    return np.asarray((surfaces[0].level >= GUESSED) | (surfaces[1].level >= GUESSED))


def kind_of(seconds: float, surfaces: Pair, before: Pair | None) -> Kinds:
    """(flights,) kind of an interval, and of the one before: what that got wrong is there for a while."""
    length = int(np.searchsorted(LENGTHS, seconds))
    kind = length + (len(LENGTHS) + 1) * (surfaces[0].level + LEVELS * surfaces[1].level)
    if before is not None:
        kind = kind + BLIND // 2 * guessed(before)
    return np.where(guessed(surfaces), BLIND, kind) if seconds > LONG else kind
