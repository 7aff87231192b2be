"""Errors of controls that no spectrum describes: their paths between two samples at a step, and slow errors.

A servo may step anywhere within a sample interval. The path of the surface through the middle of that interval moves the aircraft
as much as many a hidden effect does. Therefore, in every interval in which a control moves much, its value half-way gets an
unknown displacement with a prior in proportion to the step; the proportion, called freedom, is estimated from the flights.

An output that shows a control at once (side acceleration the rudder) jumps with the step; one whose rate does (roll rate the
ailerons) has a kink there. The sample next to it depends on the milliseconds between the two, on the instrument's filter and on
how the samples were brought to one time base. This sample, too, gets a displacement, in proportion to the jump or to the change
that the kink makes in one interval.

A slow mode (a phugoid of ten seconds) rings for longer than a record lasts, and changes with speed on the way. Driven by the
error of a control it spreads over neighbouring frequencies, while the spectral matrix has one mixture of the channels at every
frequency. With that alone, nulls scatter up to four times too far along slow signatures (a thrust line off the centre of
gravity). Below half a hertz the error of a control is therefore written as cosines of known size, each simulated over a record.

The whitener marginalises over both as its slack, a correction of low rank.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.fft import idct
from scipy.linalg import expm
from scipy.ndimage import correlate1d

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.gap.criteria import Criteria
from estimation.gap.fit.linear_motion import Linear
from estimation.gap.fit.noise import NoiseSource, Shapes
from estimation.gap.fit.whitener import Slack, Whitener, spectrum_of
from estimation.gap.records.sampling import smallest_step
from estimation.models.base import Model
from estimation.models.dependence import names_reached

SLIGHT = 1e-2  # whitened energy of a displacement below which it is ignored: it would change energies by at most 1 %
RUNAWAY = 1e6  # a response that grows so far is no small motion any more
SLOW = 0.5  # Hz, below which the error of a control is written as cosines
MOST_STEPS = 400  # a record, of controls that never rest: memory and work grow with them; they have 300 in 30 s
FREEST = 0.5  # steps: a path between two samples that stays between them is off their middle by half a step at most
MOST = 40  # cosines for each control and record: a record that has more slow ones is long compared with its modes


@dataclass(frozen=True)
class SurfaceSteps:
    """The m displacements that steps of surfaces leave unknown in one record.

    name: (m,) the control that is displaced half-way between two samples, or the output of which one sample is displaced; at:
    (m,) index of the sample before the displaced point, or of the displaced sample; step: (m,) size of the control's step [rad]
    or of the output's jump [unit of the output]; response: (N, ny, m) change of the outputs by a displacement of one step, zero
    where not measured. jumping: the outputs among the names.
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

    def scatter(self, freedom: Mapping[str, float], weights: Array) -> Array:
        """(N, ny) standard deviations that the displacements leave in a weighted sum of neighbouring samples of the outputs.
        freedom: as in `NoiseModel`; weights: (odd,) of the samples before, at and behind each."""
        weighted = correlate1d(self.response, weights, axis=0, mode="nearest")
        return np.asarray(np.sqrt(weighted**2 @ self.spread(freedom) ** 2))

    def spread(self, freedom: Mapping[str, float]) -> Array:
        """(m,) prior standard deviations of the displacements, in steps. freedom: as in `NoiseModel`."""
        return np.array([freedom.get(n, usual_freedom(n in self.jumping, self.criteria)) for n in self.name])


def usual_freedom(jumping: bool, criteria: Criteria) -> float:
    """Scatter of a displacement in steps where flights do not tell. jumping: of an output's sample next to a jump.

    That is half as free as the path of a surface, for it is off only by as much as the two channels are apart in time. As free as
    a path it left an unknown on random steps of the sticks with nothing hidden (6.35 of 5.42, in place of 5.03 of 5.40).
    """
    return criteria.surface_freedom * (criteria.halfway if jumping else 1.0)


def find_surface_steps(
    model: Model, linear: Linear, segment: Segment, criteria: Criteria, restless: frozenset[str] = frozenset()
) -> SurfaceSteps:
    """The displacements at the largest steps of all controls in a record, and at all of those that never rest (`restless`):
    half-way, and of outputs that jump or bend there."""
    found: list[tuple[float, str, int, float]] = []
    for j, control in enumerate(linear.inputs):
        step = np.diff(segment.u[:, model.input_names.index(control)])
        power = float(np.abs(linear.C @ linear.B[:, j] / linear.scale).max())
        for k in np.flatnonzero(np.abs(step) > smallest_step(step, criteria)):
            found.append((power * abs(float(step[k])), control, int(k), float(step[k])))
    found.sort(reverse=True)
    resting = [e for e in found if e[1] not in restless][: criteria.surface_steps_most]
    moving = [e for e in found if e[1] in restless][:MOST_STEPS]
    largest = sorted([*resting, *moving], key=lambda e: (e[1], e[2]))
    N, ny = len(segment), linear.C.shape[0]
    responses = {c: _response(linear, linear.inputs.index(c), N) for c in {e[1] for e in largest}}
    moves = [(control, k, step) for _, control, k, step in largest]
    # (ny, controls) by unit step: the jump of an output, and the change that a kink makes in one interval
    jump_by_step = np.abs(linear.D) + linear.dt * np.abs(linear.C @ linear.B)
    places, outputs = list(moves), []
    for i, output in enumerate(model.output_names):
        jumps = _sample_jumps(dict(zip(linear.inputs, jump_by_step[i], strict=True)), moves, N)
        if jumps.max() > criteria.negligible * linear.scale[i]:
            outputs.append(output)
            places += [(output, int(k), float(jumps[k])) for k in np.flatnonzero(jumps)]
    response = np.zeros((N, ny, len(places)))
    for m, (name, sample, size) in enumerate(places):
        if name in responses:
            response[sample + 1 :, :, m] = size * responses[name][: N - sample - 1]
        else:
            response[sample, model.output_names.index(name), m] = size
    response[~np.isfinite(segment.z)] = 0.0
    instants = np.array([sample for _, sample, _ in places], dtype=int)
    sizes = np.array([size for _, _, size in places], dtype=float)
    return SurfaceSteps(tuple(name for name, _, _ in places), instants, sizes, response, criteria, frozenset(outputs))


def jumping_outputs(model: Model) -> tuple[str, ...]:
    """Outputs on which a control acts directly and not by way of a state (side acceleration: C_Y delta_r)."""
    controls = {s.name for s in model.inputs if s.control}
    return tuple(n for n in model.output_names if names_reached(model, [n]) & controls)


def _sample_jumps(change: Mapping[str, float], steps: Sequence[tuple[str, int, float]], count: int) -> Array:
    """(count,) size of the jumps of an output next to every sample, several combined as a root sum of squares.

    change: control -> change of the output by a unit step. steps: (control, sample before, size) of each step.
    """
    jumps = np.zeros(count)
    for control, k, step in steps:
        jumps[k : k + 2] = np.hypot(jumps[k : k + 2], change[control] * step)
    return jumps


def _response(linear: Linear, control: int, count: int) -> Array:
    """(count, ny) outputs at the samples after an interval in whose middle the control was 1 off a straight line; zero from where
    the motion runs away."""
    h = linear.dt
    # the triangle of width h acts as an impulse at its middle, half an interval before the first sample
    x = expm(linear.A * (0.5 * h)) @ linear.B[:, control] * (0.5 * h)
    states, advance = x[:, None], expm(linear.A * h)
    with np.errstate(over="ignore", invalid="ignore"):
        while states.shape[1] < count:  # every turn doubles the samples that are known
            states, advance = np.concatenate([states, advance @ states], axis=1), advance @ advance
    states = states[:, :count]
    small = np.logical_and.accumulate(np.abs(states).max(axis=0) < RUNAWAY)
    return np.where(small[:, None], (linear.C @ np.where(small, states, 0.0)).T, 0.0)


def loosened(
    whitener: Whitener, steps: SurfaceSteps, freedom: Mapping[str, float], others: Array | None = None
) -> Whitener:
    """`whitener` with the displacements at steps as slack, and `others`: (N, ny, m) changes of the outputs by one prior standard
    deviation of m further unknowns. Effects too small to matter are left out."""
    blocks = []
    if steps.name:
        blocks.append(whitener.strict(steps.spectrum))
        blocks[0] *= steps.spread(freedom)
    if others is not None:
        blocks.append(whitener.strict(spectrum_of(others)))
    visible = [rows[:, np.einsum("ij,ij->j", rows, rows) > SLIGHT] for rows in blocks]
    if not any(rows.shape[1] for rows in visible):  # a short stretch in which hardly anything moves
        return whitener
    return replace(whitener, slack=Slack(np.concatenate(visible, axis=1)))


def displaced(
    whitener: Whitener, steps: SurfaceSteps, freedom: Mapping[str, float], residual: Array
) -> tuple[Array, Array]:
    """(mean (m,), variance (m,)) of the displacements [steps], given a residual (N, ny). whitener: without slack.

    Displacements that hardly show in the outputs keep their prior.
    """
    spread = steps.spread(freedom)
    mean, variance = np.zeros(spread.size), spread**2
    E = whitener.strict(steps.spectrum)
    information, projections = E.T @ E, E.T @ whitener.strict(spectrum_of(residual))[:, 0]
    visible = np.flatnonzero(np.diag(information) * variance > SLIGHT)
    inverse = np.linalg.inv(information[np.ix_(visible, visible)] + np.diag(1.0 / variance[visible]))
    mean[visible], variance[visible] = inverse @ projections[visible], np.diag(inverse)
    return mean, variance


def freedom_of(steps: Sequence[SurfaceSteps], displacements: Sequence[tuple[Array, Array]]) -> dict[str, float]:
    """Control or jumping output -> rms of its displacements in steps, over all records and one step as usual. displacements:
    (mean, variance) of those of each record, from `displaced`."""
    squares: dict[str, list[float]] = {}
    for e, (mean, variance) in zip(steps, displacements, strict=True):
        for name, m, v in zip(e.name, mean, variance, strict=True):
            squares.setdefault(name, []).append(float(m * m + v))
    jumping, criteria = frozenset[str]().union(*(e.jumping for e in steps)), steps[0].criteria
    usual = {n: usual_freedom(n in jumping, criteria) for n in squares}
    return {n: min(float(np.sqrt(np.mean([usual[n] ** 2, *s]))), FREEST) for n, s in squares.items()}


@dataclass(frozen=True)
class SlowErrors:
    """Slow errors of the controls of one record. response: (N, ny, m) changes of the outputs by m cosines of one standard
    deviation each, zero where not measured. below: frequency [Hz] below which they stand in place of the spectrum."""

    response: Array
    below: float


def slow_errors(
    simulator: Simulator, values: Mapping[str, float], segment: Segment, control_errors: Mapping[str, Array]
) -> SlowErrors:
    """The slow errors of all controls in a record. control_errors: control -> (frequencies,) variance per sample of its error.

    Without cosines, so that the spectrum stands for all errors, where no control has one or the motion runs away.
    """
    count, step = len(segment), float(np.median(np.diff(segment.time)))
    names = [n for n in simulator.model.input_names if n in control_errors]
    none = SlowErrors(np.zeros((count, len(simulator.model.outputs), 0)), 0.0)
    if not names:
        return none
    motion = simulator.run(segment, values, segment.x0)
    if not motion.finite:  # it runs away from the guessed initial state; then the spectrum has to suffice
        return none
    cosines = min(int(2.0 * SLOW * count * step) + 1, MOST, count)
    basis = idct(np.eye(count)[:cosines], axis=1, norm="ortho")
    cosine_frequencies, frequencies = 0.5 * np.arange(cosines) / (count * step), np.fft.rfftfreq(count, step)
    courses = np.zeros((count, len(simulator.model.inputs), cosines * len(names)))
    for k, name in enumerate(names):
        size = np.sqrt(np.interp(cosine_frequencies, frequencies, control_errors[name]))
        columns = slice(k * cosines, (k + 1) * cosines)
        courses[:, simulator.model.input_names.index(name), columns] = (basis * size[:, None]).T
    mid_courses = np.concatenate([0.5 * (courses[1:] + courses[:-1]), courses[-1:]])
    response = simulator.response(segment, values, segment.x0, courses, mid_courses)
    if not np.abs(response).max() < RUNAWAY:
        return none
    response[~np.isfinite(segment.z)] = 0.0
    return SlowErrors(response, 0.5 * (cosines - 0.5) / (count * step))  # half-way to the next cosine


def without_slow(shapes: Shapes, below: float) -> Shapes:
    """The shapes without the errors of the controls below `below` [Hz]."""
    fast = (np.fft.rfftfreq(shapes.count, shapes.step) >= below)[:, None]
    parts = {n: p * fast if n.source is NoiseSource.PREPARED else p for n, p in shapes.parts.items()}
    return replace(shapes, parts=parts)
