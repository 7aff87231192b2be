"""Long records cut into stretches, each with an initial state of its own.

Simulated from one initial state a slow mode that grows, or that gusts drive, has left the record after a minute or two, whatever
is right about the model; and what is asked of a record (slow errors, events in time) grows with the square of its length. The
cut is made where the controls rest: a step is then seen whole by one stretch.
"""

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment
from estimation.gap.criteria import Criteria

NEAR = 0.1  # of a stretch, to either side of an even cut, in which the controls may be at rest
ROUNDING = 1e-6
AROUND = 0.5  # s, to either side of a cut, in which they should be


def stretches(segment: Segment, controls: list[int], criteria: Criteria) -> list[slice]:
    """Samples of a segment in stretches of equal length but for the rest of the controls. controls: their columns in `u`."""
    count = len(segment)
    step = float(np.median(np.diff(segment.time)))
    parts = int(np.ceil((count - 1) * step / criteria.longest_record - ROUNDING))
    if parts < 2:
        return [slice(0, count)]
    moved = movement(segment.u[:, controls], max(round(AROUND / step), 1))
    length = count / parts
    cuts = [0]
    for k in range(1, parts):
        even = round(k * length)
        near = np.arange(max(even - int(NEAR * length), 1), min(even + int(NEAR * length), count - 1) + 1)
        cuts.append(int(min(near, key=lambda i: (moved[i], abs(i - even)))))
    return [slice(a, b) for a, b in zip(cuts, [*cuts[1:], count], strict=True)]


def movement(controls: Array, reach: int) -> Array:
    """(N,) how far the controls (N, controls) go within `reach` samples of each, in units of what they do in all."""
    moved = np.zeros(len(controls))
    for course in controls.T:
        whole = float(np.ptp(course))
        if whole > 0.0:
            padded = np.pad(course, reach, mode="edge")
            windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
            moved += np.round(np.ptp(windows, axis=1) / whole, 2)
    return moved
