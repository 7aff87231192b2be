"""The noise of the residuals, estimated from the flights given.

Output-error residuals are coloured: gusts and leftover jitter of the surfaces pass through the aircraft's own modes.
Their spectral matrix is written as a sum of parts of known shape and unknown strength,

    S(f) = R + sum_j v_j g_j(f) g_j(f)^H,

R diagonal (sensor noise), g_j the linearised response of all outputs to process noise on one force equation or to sample
noise on one control. What taking the noise off a control leaves wrong has a known size and colour: its strength is not free,
else process noise stands for it and the nulls, which have both, scatter twice too far. Where an attitude is itself the output
of a filter, two more: gyro noise, which the rate shows and the attitude integrates, and the slow wandering of the attitude
alone. All other strengths are estimated by maximum likelihood in the frequency domain (Whittle 1953); nothing is assumed of the
sensors or the weather. The motion is linearised about steady flight: a lateral one about zero, a longitudinal one about a
trimmed speed, angle and load.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType

import numpy as np

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.gap.criteria import Criteria
from estimation.gap.effects.catalogue import REFERENCE
from estimation.gap.fit.whitener import Complex, Whitener
from estimation.gap.records.candidate_model import RATE_OF
from estimation.models.base import Model, Signal
from estimation.models.dependence import force_states

STEADY = frozenset({"V", "alpha", "theta", "u", "w", "ax", "az"})
"""Quantities that have a value in straight and level flight; all others are zero there."""
ITERATIONS = 60  # multiplicative steps: strengths of recorded flights settle to some 1 % in them
FOLLOWING = 20  # steps from an earlier estimate
LOWEST = 0.25  # of a record's own frequency, in place of none at all: it knows no lower than a part of its own
BEGIN = 0.3  # of the measurement noise: where the strength of every part starts, from which the steps find their way
SPAN = REFERENCE["b"]
FLOOR = 1e-7  # smallest share of the total a part keeps, so that the spectral matrix stays regular


def steady_state(model: Model, segment: Segment) -> Array:
    """(nx,) state about which a record moves: the median of what was measured, zero for states that level flight has none of.

    A state that no output shows (a lag of a vane or of the flow) rests where the signal that it starts from does.
    """
    levels = {n: level for n, level in zip(model.output_names, steady_outputs(model, segment), strict=True) if level}
    return np.array([_rest(s, levels, segment.x0[i]) for i, s in enumerate(model.states)])


def steady_outputs(model: Model, segment: Segment) -> Array:
    """(ny,) values of the outputs about which a record moves."""
    levels = np.zeros(len(model.outputs))
    for i, signal in enumerate(model.outputs):
        measured = segment.z[np.isfinite(segment.z[:, i]), i]
        if signal.name in STEADY and measured.size:
            levels[i] = np.median(measured)
    return levels


def _rest(state: Signal, known: dict[str, float], first: float) -> float:
    for name in (state.name, state.column, state.start):
        if isinstance(name, str) and name in known:
            return known[name]
    return float(first) if state.name in STEADY else 0.0


class NoiseSource(Enum):
    """Where noise enters."""

    RATE = "rate of a state"  # white, or with a memory: the derivative of coloured noise, as gusts have it
    TWIST = "rate of a state, fading"  # coloured itself, as what gusts across the span do to it
    CONTROL = "control"  # of one sample
    PREPARED = "control as prepared"  # what taking its noise off left wrong, of known strength
    WANDERING = (
        "error of an attitude filter"  # white noise on the rate of an error that is forgotten in `filter_memory`
    )
    GYRO = "gyro of an attitude filter"  # of one sample on the attitude's rate, integrated with the same forgetting


ON_FORCES = (NoiseSource.RATE, NoiseSource.TWIST)


@dataclass(frozen=True, slots=True)
class NoisePart:
    """One way in which noise enters. of: the state, control or attitude; memory: correlation time [s], 0 where white."""

    source: NoiseSource
    of: str
    memory: float = 0.0


@dataclass(frozen=True)
class NoiseModel:
    """Strengths of all parts, shared by the flights.

    measurement: (ny,) variances of the outputs' own noise. process: part -> variance intensity.
    freedom: control -> how far it strays half-way
    between two samples, in steps (see `surface_steps`).
    """

    measurement: Array
    process: Mapping[NoisePart, float]
    freedom: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Shapes:
    """Responses g_j of one record: part -> (frequencies, ny) complex, with the sample interval and count. louder: (ny,) variance
    of the outputs' own noise over the usual one, or None."""

    parts: Mapping[NoisePart, Complex]
    count: int
    step: float
    louder: Array | None = None


@dataclass(frozen=True)
class Linear:
    """Small motion of one record about its mean inputs: x' = A x + B u, y = C x + D u over `controls`, dt [s] between samples;
    scale: (ny,) rms of the measured outputs about their steady values, infinite of one that is not measured."""

    A: Array
    B: Array
    C: Array
    D: Array
    controls: tuple[str, ...]
    dt: float
    scale: Array


def linear_motion(model: Model, simulator: Simulator, segment: Segment, values: Mapping[str, float]) -> Linear:
    """Linearise a model at the mean inputs of a record and small motion about its steady state."""
    p = simulator.vector(values)
    nx = len(model.states)
    u0 = segment.u.mean(axis=0)
    controls = [i for i, s in enumerate(model.inputs) if s.control]
    step = 1e-4  # rad, rad/s, m/s: rounding 1e-12 of the motion, curvature as little
    points_x = steady_state(model, segment) + np.concatenate(
        [np.zeros((1, nx)), step * np.eye(nx), -step * np.eye(nx), np.zeros((2 * len(controls), nx))]
    )
    points_u = np.repeat(u0[None], points_x.shape[0], axis=0)
    for j, i in enumerate(controls):
        points_u[1 + 2 * nx + 2 * j, i] += step
        points_u[2 + 2 * nx + 2 * j, i] -= step
    f, _, y, _ = simulator.kernel.evaluate(points_x, points_u, p)
    first = 1 + 2 * nx

    def by_controls(values: Array) -> Array:
        return np.asarray((values[first::2] - values[first + 1 :: 2]).T / (2 * step))

    return Linear(
        A=(f[1 : 1 + nx] - f[1 + nx : first]).T / (2 * step),
        B=by_controls(f),
        C=(y[1 : 1 + nx] - y[1 + nx : first]).T / (2 * step),
        D=by_controls(y),
        controls=tuple(model.inputs[i].name for i in controls),
        dt=float(np.median(np.diff(segment.time))),
        scale=np.maximum(rms_measured(segment.z - steady_outputs(model, segment)), 1e-9),
    )


def rms_measured(values: Array) -> Array:
    """(ny,) rms of each column of (N, ny) where it is finite; infinite of one that nowhere is: nothing stands out of that."""
    finite = np.isfinite(values)
    counts, squares = finite.sum(axis=0), np.sum(np.where(finite, values, 0.0) ** 2, axis=0)
    return np.sqrt(np.divide(squares, counts, out=np.full(counts.shape, np.inf), where=counts > 0))


def shapes_of(
    model: Model,
    linear: Linear,
    count: int,
    criteria: Criteria,
    states: Sequence[str] | None = None,
    left: Mapping[str, Array] = MappingProxyType({}),
) -> Shapes:
    """Responses of a record of `count` samples to noise. states: where process noise may enter. left: control -> (frequencies,)
    variance per sample of what its preparation left wrong."""
    nx, ny = len(model.states), len(model.outputs)
    lasting, fading = criteria.gust_memory, twist_memory(model, criteria)
    s = 2j * np.pi * np.fft.rfftfreq(count, linear.dt)
    s[0] = 2j * np.pi * LOWEST / (count * linear.dt)
    resolvent = np.linalg.inv(s[:, None, None] * np.eye(nx) - linear.A)
    reply = linear.C @ resolvent  # (frequencies, ny, nx)
    parts: dict[NoisePart, Complex] = {}
    for name in force_states(model) if states is None else states:
        i = model.state_names.index(name)
        parts[NoisePart(NoiseSource.RATE, name)] = reply[:, :, i]
        parts[NoisePart(NoiseSource.RATE, name, lasting)] = reply[:, :, i] * (s / (s + 1 / lasting))[:, None]
        parts[NoisePart(NoiseSource.TWIST, name, fading)] = reply[:, :, i] / (1 + s * fading)[:, None]
    for j, name in enumerate(linear.controls):
        response = np.asarray(reply @ linear.B[:, j] + linear.D[:, j], complex)
        parts[NoisePart(NoiseSource.CONTROL, name)] = response
        # of every record, for one flight's control may be too coarse to have its noise taken off, and the next one's not
        parts[NoisePart(NoiseSource.PREPARED, name)] = response * np.sqrt(left.get(name, np.zeros(s.size)))[:, None]
    for i, name in enumerate(model.output_names):
        if name in RATE_OF:
            delay = np.exp(-s * linear.dt)  # one sample ago: a filter adds up sampled rates by straight lines
            summed = (linear.dt / (1.0 - np.exp(-linear.dt / criteria.filter_memory) * delay))[:, None] * np.eye(ny)[i]
            parts[NoisePart(NoiseSource.WANDERING, name)] = summed
            if RATE_OF[name] in model.output_names:
                rate_axis = np.eye(ny)[model.output_names.index(RATE_OF[name])]
                parts[NoisePart(NoiseSource.GYRO, name)] = rate_axis + 0.5 * (1.0 + delay)[:, None] * summed
    return Shapes({k: v.reshape(-1, ny) for k, v in parts.items()}, count, linear.dt)


def twist_memory(model: Model, criteria: Criteria) -> float:
    """Correlation time [s] of gusts that differ from wing tip to wing tip. By Froude's law as the square root of the span, where
    the model states it: sqrt(L b)/(2.6 V) of MIL-F-8785C with speeds and lengths of gusts that suit the size."""
    span = model.constants.get("b", SPAN)
    return criteria.twist_memory * float(np.sqrt(span / SPAN)) if 0.0 < span < np.inf else criteria.twist_memory


def as_seen(shapes: Shapes, measured: Array) -> Shapes:
    """The shapes of a record of which some samples were not measured, and count as zero: of white noise a share of the power is
    seen, of what has a course that share of its amplitude. measured: (N, ny)."""
    share = measured.mean(axis=0)
    if (share[share > 0.0] == 1.0).all():
        return shapes
    share = np.where(share > 0.0, share, 1.0)
    louder = share if shapes.louder is None else shapes.louder * share
    return replace(shapes, parts={n: p * share for n, p in shapes.parts.items()}, louder=louder)


def spectral_matrix(noise: NoiseModel, shapes: Shapes) -> Complex:
    """S(f), (frequencies, ny, ny); unit: output unit squared per sample."""
    ny = noise.measurement.size
    S = np.zeros(
        (next(iter(shapes.parts.values())).shape[0] if shapes.parts else shapes.count // 2 + 1, ny, ny), complex
    )
    S += np.diag(noise.measurement if shapes.louder is None else noise.measurement * shapes.louder)
    for name, strength in noise.process.items():
        g = shapes.parts[name]
        S += strength * g[:, :, None] * g[:, None, :].conj()
    return S


def whitener(noise: NoiseModel, shapes: Shapes) -> Whitener:
    """The operator S^(-1/2) of one record."""
    values, vectors = np.linalg.eigh(spectral_matrix(noise, shapes))
    root = (vectors / np.sqrt(values)[:, None, :]) @ vectors.conj().transpose(0, 2, 1)
    return Whitener(root, shapes.count)


def _stacked(shapes: Shapes, names: Sequence[NoisePart], ny: int) -> Complex:
    """(frequencies, ny, parts) responses of one record to the named parts."""
    stack = np.zeros((shapes.count // 2 + 1, ny, len(names)), complex)
    for j, name in enumerate(names):
        stack[:, :, j] = shapes.parts[name]
    return stack


def estimate_noise(
    residuals: Sequence[Array],
    shapes: Sequence[Shapes],
    start: Array,
    floor: Array,
    without: Collection[NoisePart] = (),
    known: Mapping[NoisePart, float] = MappingProxyType({}),
    begin: NoiseModel | None = None,
) -> NoiseModel:
    """Maximum-likelihood strengths of all parts from output residuals.

    residuals: per record (N, ny), NaN where not measured. start: (ny,) first guess of the measurement variances;
    floor: (ny,) smallest ones allowed. without: parts that are none. known: first guesses of strengths. begin: an earlier
    estimate to go on from. Multiplicative minorise-maximise steps (monotone in likelihood).
    """
    names = [n for n in shapes[0].parts if n not in without]
    ny = start.size
    spectra = [np.fft.rfft(np.nan_to_num(r), axis=0) / np.sqrt(r.shape[0]) for r in residuals]
    weights = [np.concatenate([[0.5], np.ones(s.shape[0] - 1)]) for s in spectra]
    # each part begins with the strength at which it alone would double the measurement noise
    power = np.array(
        [np.mean([np.mean(np.sum(np.abs(sh.parts[n]) ** 2 / start, axis=1)) for sh in shapes]) / ny for n in names]
    )
    names, power = [n for n, p in zip(names, power, strict=True) if p > 0.0], power[power > 0.0]
    R, v, turns = start.copy(), BEGIN / power, ITERATIONS
    v = np.array([known.get(n, x) for n, x in zip(names, v, strict=True)])
    free = np.array([n.source is not NoiseSource.PREPARED for n in names], dtype=bool)
    v[~free] = 1.0
    if begin is not None and all(n in begin.process for n in names):
        R, v, turns = begin.measurement.copy(), np.array([begin.process[n] for n in names]), FOLLOWING
    blocks = [_stacked(sh, names, ny) for sh in shapes]
    columns = [np.concatenate([s[:, :, None], g], axis=2) for s, g in zip(spectra, blocks, strict=True)]
    adjoints = [np.ascontiguousarray(g.conj().transpose(0, 2, 1)) for g in blocks]
    diagonal = np.arange(ny)
    for _ in range(turns):
        up_R, down_R = np.zeros(ny), np.zeros(ny)
        process_up, process_down = np.zeros(len(names)), np.zeros(len(names))
        for shape, w, g, g_turned, block_columns in zip(shapes, weights, blocks, adjoints, columns, strict=True):
            level = 1.0 if shape.louder is None else shape.louder
            S = (g * v) @ g_turned
            S[:, diagonal, diagonal] += R * level
            inverse = np.linalg.inv(S)
            solved_columns = inverse @ block_columns
            a = solved_columns[:, :, 0]
            up_R += level * (w @ (a.real**2 + a.imag**2))
            down_R += level * (w @ inverse[:, diagonal, diagonal].real)
            projected = (g_turned @ a[:, :, None])[:, :, 0]
            process_up += w @ (projected.real**2 + projected.imag**2)
            process_down += w @ np.sum(g_turned.transpose(0, 2, 1) * solved_columns[:, :, 1:], axis=1).real
        R = np.maximum(R * np.sqrt(up_R / down_R), floor)
        v[free] = np.maximum(v * np.sqrt(process_up / process_down), FLOOR / power)[free]
    return NoiseModel(R, dict(zip(names, (float(x) for x in v), strict=True)))
