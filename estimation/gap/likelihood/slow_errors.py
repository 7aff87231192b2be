"""What is slowly wrong with a control as prepared: an uncertainty with a beginning, which no stationary spectrum describes.

A slow mode (a phugoid of ten seconds) rings for longer than a record lasts, and changes with speed on the way. The spectrum of
what a noisy control makes of it is smeared over neighbouring frequencies, each with a mixture of the channels of its own, where
the spectral matrix knows one mixture at every frequency: whitened with that alone, nulls scatter up to four times too far along
slow signatures (a thrust line off the centre of gravity). Below half a hertz the error is therefore written as cosines of known
size, each flown through the model along the record, and marginalised over by the correction of low rank that steps of surfaces
have too.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import idct

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.gap.likelihood.whitening import Shapes, Source

SLOW = 0.5  # Hz, up to which
MOST = 40  # cosines a control and record: a record in which more of them are slow is long beside its modes
SMALL = 0.3  # standard deviations: a change so small that the motion is linear in it


@dataclass(frozen=True)
class SlowErrors:
    """response: (N, ny, m) of the outputs by what is slowly wrong with the controls, each of one standard deviation. below: [Hz]
    what a spectrum no longer has to describe."""

    response: Array
    below: float


def slow_errors(
    simulator: Simulator, values: Mapping[str, float], segment: Segment, left: Mapping[str, Array]
) -> SlowErrors:
    """Cosines of all controls in a record. left: control -> (frequencies,) variance per sample of its error."""
    count, step = len(segment), float(np.median(np.diff(segment.time)))
    names = [n for n in simulator.model.input_names if n in left]
    nothing = SlowErrors(np.zeros((count, len(simulator.model.outputs), 0)), 0.0)
    if not names:
        return nothing
    motion = simulator.run(segment, values, segment.x0)
    if not motion.finite:  # from where it is guessed to begin it runs away: the spectrum has to do
        return nothing
    cosines = min(int(2.0 * SLOW * count * step) + 1, MOST, count)
    basis = idct(np.eye(count)[:cosines], axis=1, norm="ortho")
    at, frequencies = 0.5 * np.arange(cosines) / (count * step), np.fft.rfftfreq(count, step)
    found = []
    for name in names:
        size = np.sqrt(np.interp(at, frequencies, left[name]))
        for course in basis * size[:, None]:
            u = segment.u.copy()
            u[:, simulator.model.input_names.index(name)] += SMALL * course
            moved = simulator.run(replace(segment, u=u), values, segment.x0)
            found.append(np.nan_to_num((moved.y - motion.y) / SMALL) if moved.finite else np.zeros_like(motion.y))
    return SlowErrors(np.stack(found, axis=2), 0.5 * (cosines - 0.5) / (count * step))  # half-way to the next one


def without_slow(shapes: Shapes, below: float) -> Shapes:
    """The shapes with nothing slower than `below` [Hz] in what is wrong with the controls."""
    fast = (np.fft.rfftfreq(shapes.count, shapes.step) >= below)[:, None]
    parts = {n: p * fast if n.source is Source.PREPARED else p for n, p in shapes.parts.items()}
    return replace(shapes, parts=parts)
