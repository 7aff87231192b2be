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
from estimation.gap.likelihood.whitening import NoiseSource, Shapes

SLOW = 0.5  # Hz, up to which
RUNAWAY = 1e6  # a change that grows so far is no small one any more
MOST = 40  # cosines a control and record: a record in which more of them are slow is long beside its modes


@dataclass(frozen=True)
class SlowErrors:
    """response: (N, ny, m) of the outputs by what is slowly wrong with the controls, each of one standard deviation, zero where
    they were not measured. below: [Hz] what a spectrum no longer has to describe."""

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
    courses = np.zeros((count, len(simulator.model.inputs), cosines * len(names)))
    for k, name in enumerate(names):
        size = np.sqrt(np.interp(at, frequencies, left[name]))
        mine = slice(k * cosines, (k + 1) * cosines)
        courses[:, simulator.model.input_names.index(name), mine] = (basis * size[:, None]).T
    between = np.concatenate([0.5 * (courses[1:] + courses[:-1]), courses[-1:]])
    response = simulator.response(segment, values, segment.x0, courses, between)
    if not np.abs(response).max() < RUNAWAY:
        return nothing
    response[~np.isfinite(segment.z)] = 0.0
    return SlowErrors(response, 0.5 * (cosines - 0.5) / (count * step))  # half-way to the next one


def without_slow(shapes: Shapes, below: float) -> Shapes:
    """The shapes with nothing slower than `below` [Hz] in what is wrong with the controls."""
    fast = (np.fft.rfftfreq(shapes.count, shapes.step) >= below)[:, None]
    parts = {n: p * fast if n.source is NoiseSource.PREPARED else p for n, p in shapes.parts.items()}
    return replace(shapes, parts=parts)
