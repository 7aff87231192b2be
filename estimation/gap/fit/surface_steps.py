"""What is wrong with controls at one time: paths of steps between two samples, and slow errors. No spectrum describes either.

A servo's step falls anywhere within an interval. Which way the surface went through the middle of that interval moves the
aircraft as much as many a hidden effect does. The middle of every interval in which a control moves much is given a prior
displacement in proportion to the step; the proportion is estimated from the flights. An output that shows a control at once
(side acceleration the rudder) jumps with it, one whose rate does (rolling with the ailerons) has a kink there, and what a
sample next to it shows depends on the milliseconds between the two, on the instrument's filter and on how samples were brought
to one time base: it too is given a displacement in proportion to the jump, or to what the kink makes in one interval.

A slow mode (a phugoid of ten seconds) rings for longer than a record lasts, and changes with speed on the way. The spectrum of
what a noisy control makes of it is smeared over neighbouring frequencies, where the spectral matrix knows one mixture of the
channels at every frequency: whitened with that alone, nulls scatter up to four times too far along slow signatures (a thrust
line off the centre of gravity). Below half a hertz the error is therefore written as cosines of known size, each flown through
the model along the record.

Both are marginalised over by a correction of low rank behind the whitener.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.fft import idct
from scipy.linalg import expm

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.gap.criteria import Criteria
from estimation.gap.fit.spectra import Linear, NoiseSource, Shapes
from estimation.gap.fit.whitener import Slack, Whitener, spectrum_of
from estimation.models.base import Model
from estimation.models.expressions import names_in

GAUSSIAN = 1.4826  # standard deviation over median absolute deviation of normal noise
SLIGHT = 1e-2  # energy of a displacement [variance of the noise]: of weaker ones a hundredth at most would be forgiven
RUNAWAY = 1e6  # a change that grows so far is no small one any more
SLOW = 0.5  # Hz, up to which
MOST = 40  # cosines a control and record: a record in which more of them are slow is long beside its modes


@dataclass(frozen=True)
class SurfaceSteps:
    """What steps of surfaces leave open in one record.

    name: (m,) the control whose middle of an interval is meant, or the output that jumps or bends with it and of which one
    sample is meant; at: (m,) index of the sample before the middle, or of that sample; step: (m,) [rad] or [unit of the
    output]; response: (N, ny, m) change of the outputs by a displacement of one step, zero where they were not measured.
    jumping: the outputs among the names.
    """

    name: tuple[str, ...]
    at: Array
    step: Array
    response: Array
    criteria: Criteria
    jumping: frozenset[str] = frozenset()

    @cached_property
    def spectrum(self) -> Array:
        """(frequencies, 2 ny, m) of the responses."""
        return spectrum_of(self.response)

    def spread(self, freedom: Mapping[str, float]) -> Array:
        """(m,) prior standard deviations in steps."""
        c = self.criteria
        return np.array([freedom.get(n, c.jump_freedom if n in self.jumping else c.surface_freedom) for n in self.name])


def find_surface_steps(model: Model, linear: Linear, segment: Segment, criteria: Criteria) -> SurfaceSteps:
    """The largest steps of all controls in a record and what a displacement half-way, or of a jump, does to the outputs."""
    largest: list[tuple[float, str, int, float]] = []
    for j, signal in enumerate(model.inputs):
        if not signal.control or signal.name not in linear.controls:
            continue
        step = np.diff(segment.u[:, j])
        scatter = GAUSSIAN * float(np.median(np.abs(step)))
        power = float(np.abs(linear.C @ linear.B[:, linear.controls.index(signal.name)] / linear.scale).max())
        for k in np.flatnonzero(np.abs(step) > criteria.surface_step * scatter):
            largest.append((power * abs(float(step[k])), signal.name, int(k), float(step[k])))
    largest = sorted(sorted(largest, reverse=True)[: criteria.surface_steps_most], key=lambda e: (e[1], e[2]))
    N, ny = len(segment), linear.C.shape[0]
    replies = {c: _reply(linear, linear.controls.index(c), N) for c in {e[1] for e in largest}}
    places = [(control, k, step) for _, control, k, step in largest]
    sharp = np.abs(linear.D) + linear.dt * np.abs(
        linear.C @ linear.B
    )  # by unit step: the jump, the kink over one interval
    outputs = []
    for i, output in enumerate(model.output_names):
        jumps = sample_jumps(sharp[i], linear.controls, places, N)
        if jumps.max() > criteria.visible_jump * linear.scale[i]:
            outputs.append(output)
            places += [(output, int(k), float(jumps[k])) for k in np.flatnonzero(jumps)]
    response = np.zeros((N, ny, len(places)))
    for m, (name, sample, size) in enumerate(places):
        if name in replies:
            response[sample + 1 :, :, m] = size * replies[name][: N - sample - 1]
        else:
            response[sample, model.output_names.index(name), m] = size
    response[~np.isfinite(segment.z)] = 0.0
    instants = np.array([sample for _, sample, _ in places], dtype=int)
    sizes = np.array([size for _, _, size in places], dtype=float)
    return SurfaceSteps(tuple(name for name, _, _ in places), instants, sizes, response, criteria, frozenset(outputs))


def jumping_outputs(model: Model) -> tuple[str, ...]:
    """Outputs that a control reaches in the same instant, and not by way of a state (side acceleration: C_Y delta_r)."""
    controls = {s.name for s in model.inputs if s.control}

    def reaches(symbol: str, seen: set[str]) -> bool:
        if symbol in controls:
            return True
        if symbol in seen or symbol not in model.definitions or symbol in model.state_names:
            return False
        return any(reaches(name, seen | {symbol}) for name in names_in(model.definitions[symbol]))

    return tuple(n for n in model.output_names if reaches(n, set()))


def sample_jumps(through: Array, controls: Sequence[str], steps: Sequence[tuple[str, int, float]], count: int) -> Array:
    """(count,) size of the jumps of an output next to every sample.

    through: (controls,) its change by each control. steps: (control, sample before, size) of each step, others are ignored.
    """
    jumps = np.zeros(count)
    for control, k, step in steps:
        if control not in controls:
            continue
        size = through[controls.index(control)] * step
        jumps[k : k + 2] = np.hypot(jumps[k : k + 2], size)
    return jumps


def _reply(linear: Linear, control: int, count: int) -> Array:
    """(count, ny) outputs at the samples after an interval in whose middle the control stood 1 off a straight line."""
    h = linear.dt
    x = expm(linear.A * (0.5 * h)) @ linear.B[:, control] * (0.5 * h)  # a triangle of width h: its area, at its middle
    course, advance = x[:, None], expm(linear.A * h)
    with np.errstate(over="ignore", invalid="ignore"):
        while course.shape[1] < count:  # what is there, as far again ahead
            course, advance = np.concatenate([course, advance @ course], axis=1), advance @ advance
    course = course[:, :count]
    small = np.logical_and.accumulate(np.abs(course).max(axis=0) < RUNAWAY)
    return np.where(small[:, None], (linear.C @ np.where(small, course, 0.0)).T, 0.0)


def loosened(
    whitener: Whitener, steps: SurfaceSteps, freedom: Mapping[str, float], others: Array | None = None
) -> Whitener:
    """`whitener` that also marginalises over the steps, and over `others` (N, ny, m): outputs by unknowns of one standard
    deviation each."""
    rows = whitener.strict(steps.spectrum) * steps.spread(freedom) if steps.name else None
    if others is not None and others.shape[2]:
        extra_rows = whitener.strict(spectrum_of(others))
        rows = extra_rows if rows is None else np.concatenate([rows, extra_rows], axis=1)
    if rows is None:
        return whitener
    visible = np.einsum("ij,ij->j", rows, rows) > SLIGHT
    if not visible.any():  # a short stretch in which hardly anything moves
        return whitener
    return replace(whitener, slack=Slack(rows[:, visible]))


def displaced(
    whitener: Whitener, steps: SurfaceSteps, freedom: Mapping[str, float], residual: Array
) -> tuple[Array, Array]:
    """(mean (m,), variance (m,)) of the displacements [steps] that a residual (N, ny) tells; `whitener` without slack.

    Of those that hardly show it tells nothing.
    """
    spread = steps.spread(freedom)
    mean, variance = np.zeros(spread.size), spread**2
    E = whitener.strict(steps.spectrum)
    visible = np.flatnonzero(np.einsum("ij,ij->j", E, E) * variance > SLIGHT)
    E, r = E[:, visible], whitener.strict(spectrum_of(residual))[:, 0]
    inverse = np.linalg.inv(E.T @ E + np.diag(1.0 / variance[visible]))
    mean[visible], variance[visible] = inverse @ (E.T @ r), np.diag(inverse)
    return mean, variance


def freedom_of(steps: Sequence[SurfaceSteps], told: Sequence[tuple[Array, Array]]) -> dict[str, float]:
    """Typical displacement of every control and of every jumping output in steps, from what all records tell."""
    squares: dict[str, list[float]] = {}
    jumping = frozenset[str]().union(*(e.jumping for e in steps))
    for e, (mean, variance) in zip(steps, told, strict=True):
        for name, m, v in zip(e.name, mean, variance, strict=True):
            squares.setdefault(name, []).append(float(m * m + v))
    c = steps[0].criteria
    jump, move = (c.jump_freedom_least, c.jump_freedom_most), (c.surface_freedom_least, c.surface_freedom_most)
    return {n: float(np.clip(np.sqrt(np.mean(s)), *(jump if n in jumping else move))) for n, s in squares.items()}


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
    none = SlowErrors(np.zeros((count, len(simulator.model.outputs), 0)), 0.0)
    if not names:
        return none
    motion = simulator.run(segment, values, segment.x0)
    if not motion.finite:  # from where it is guessed to begin it runs away: the spectrum has to do
        return none
    cosines = min(int(2.0 * SLOW * count * step) + 1, MOST, count)
    basis = idct(np.eye(count)[:cosines], axis=1, norm="ortho")
    cosine_frequencies, frequencies = 0.5 * np.arange(cosines) / (count * step), np.fft.rfftfreq(count, step)
    courses = np.zeros((count, len(simulator.model.inputs), cosines * len(names)))
    for k, name in enumerate(names):
        size = np.sqrt(np.interp(cosine_frequencies, frequencies, left[name]))
        columns = slice(k * cosines, (k + 1) * cosines)
        courses[:, simulator.model.input_names.index(name), columns] = (basis * size[:, None]).T
    mid_courses = np.concatenate([0.5 * (courses[1:] + courses[:-1]), courses[-1:]])
    response = simulator.response(segment, values, segment.x0, courses, mid_courses)
    if not np.abs(response).max() < RUNAWAY:
        return none
    response[~np.isfinite(segment.z)] = 0.0
    return SlowErrors(response, 0.5 * (cosines - 0.5) / (count * step))  # half-way to the next one


def without_slow(shapes: Shapes, below: float) -> Shapes:
    """The shapes with nothing slower than `below` [Hz] in what is wrong with the controls."""
    fast = (np.fft.rfftfreq(shapes.count, shapes.step) >= below)[:, None]
    parts = {n: p * fast if n.source is NoiseSource.PREPARED else p for n, p in shapes.parts.items()}
    return replace(shapes, parts=parts)
