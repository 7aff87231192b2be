"""The spectral matrix S(f) of the residuals, estimated from these residuals.

Output-error residuals are coloured: gusts and the noise of the controls pass through the aircraft's own modes. Their spectral
matrix is written as a sum of parts of known shape and unknown strength,

    S(f) = R + sum_j v_j g_j(f) g_j(f)^H,

where R is diagonal (sensor noise), and g_j is the linearised response of all outputs to process noise on one force equation or to
sample noise on one control. The error that remains on a control after its noise was removed has a known spectrum, so that its
strength is fixed at 1; were it free, process noise would be estimated for it as well, and the nulls, which have both, would
scatter twice too far. An attitude that is the output of a filter adds two parts: gyro noise, which the rate shows and the
attitude integrates, and the slow wandering of the attitude alone.

The free strengths are estimated by maximum likelihood in the frequency domain (Whittle 1953); nothing is assumed about the
sensors or the weather.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType

import numpy as np

from estimation.engine.kernel import Array
from estimation.gap.criteria import Criteria
from estimation.gap.effects.catalogue import REFERENCE
from estimation.gap.fit.linear_motion import Linear
from estimation.gap.fit.whitener import Complex, Whitener
from estimation.gap.records.candidate_model import RATE_OF
from estimation.models.base import Model
from estimation.models.dependence import force_states

ITERATIONS = 60  # multiplicative steps: strengths of recorded flights settle to some 1 % in them
FOLLOWING = 20  # steps from an earlier estimate
LOWEST = 0.25  # of 1 / length of the record: in place of zero frequency, where an integrating response is infinite
BEGIN = 0.3  # of the measurement noise: power with which every part starts
SPAN = REFERENCE["b"]  # m, span for which `twist_memory` is stated
FLOOR = 1e-7  # of the power of the measurement noise: the least that a part keeps, as a strength of zero could never grow again


class NoiseSource(Enum):
    """Where noise enters."""

    RATE = "rate of a state"  # white, or with a memory the derivative of first-order noise, as of gusts
    TWIST = "rate of a state, fading"  # first-order noise, as of gusts that vary across the span
    CONTROL = "control"  # white from sample to sample
    PREPARED = "control as prepared"  # error left by removing a control's noise, of known strength
    WANDERING = "error of an attitude filter"  # white noise on the rate of an error that decays within `filter_memory`
    GYRO = "gyro of an attitude filter"  # white from sample to sample; the filter integrates it with the same decay


ON_FORCES = (NoiseSource.RATE, NoiseSource.TWIST)


@dataclass(frozen=True, slots=True)
class NoisePart:
    """One way in which noise enters. of: name of the state, control or attitude; memory: correlation time [s], 0 if white."""

    source: NoiseSource
    of: str
    memory: float = 0.0


@dataclass(frozen=True)
class NoiseModel:
    """Strengths of all parts, shared by the flights.

    measurement: (ny,) variances of the outputs' own noise, the diagonal of R. process: part -> strength v_j. freedom: control or
    output -> standard deviation of its displacement between two samples, in steps (see `surface_steps`).
    """

    measurement: Array
    process: Mapping[NoisePart, float]
    freedom: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Shapes:
    """Responses of one record. parts: part -> (frequencies, ny) response g_j; count: samples; step: sample interval [s]; louder:
    (ny,) variance of the outputs' own noise on this record over the usual one, or None where usual."""

    parts: Mapping[NoisePart, Complex]
    count: int
    step: float
    louder: Array | None = None


def shapes_of(
    model: Model,
    linear: Linear,
    count: int,
    criteria: Criteria,
    states: Sequence[str] | None = None,
    control_errors: Mapping[str, Array] = MappingProxyType({}),
) -> Shapes:
    """Responses of a record of `count` samples to noise. states: where process noise may enter, by default `force_states`.
    control_errors: control -> (frequencies,) variance per sample of the error that its preparation left."""
    nx, ny = len(model.states), len(model.outputs)
    gust, twist = criteria.gust_memory, twist_memory(model, criteria)
    s = 2j * np.pi * np.fft.rfftfreq(count, linear.dt)
    s[0] = 2j * np.pi * LOWEST / (count * linear.dt)
    by_rates = linear.C @ np.linalg.inv(s[:, None, None] * np.eye(nx) - linear.A)  # (frequencies, ny, nx)
    parts: dict[NoisePart, Complex] = {}
    for name in force_states(model) if states is None else states:
        response = by_rates[:, :, model.state_names.index(name)]
        parts[NoisePart(NoiseSource.RATE, name)] = response
        parts[NoisePart(NoiseSource.RATE, name, gust)] = response * (s / (s + 1 / gust))[:, None]
        parts[NoisePart(NoiseSource.TWIST, name, twist)] = response / (1 + s * twist)[:, None]
    for j, name in enumerate(linear.inputs):
        response = np.asarray(by_rates @ linear.B[:, j] + linear.D[:, j], complex)
        parts[NoisePart(NoiseSource.CONTROL, name)] = response
        # also where there is no error: all records need the same parts, and only on some could the noise be removed
        error = control_errors.get(name, np.zeros(s.size))
        parts[NoisePart(NoiseSource.PREPARED, name)] = response * np.sqrt(error)[:, None]
    for i, name in enumerate(model.output_names):
        if name in RATE_OF:
            delay = np.exp(-s * linear.dt)  # by one sample: the filter sums sampled rates by the trapezoidal rule
            summed = (linear.dt / (1.0 - np.exp(-linear.dt / criteria.filter_memory) * delay))[:, None] * np.eye(ny)[i]
            parts[NoisePart(NoiseSource.WANDERING, name)] = summed
            if RATE_OF[name] in model.output_names:
                rate_axis = np.eye(ny)[model.output_names.index(RATE_OF[name])]
                parts[NoisePart(NoiseSource.GYRO, name)] = rate_axis + 0.5 * (1.0 + delay)[:, None] * summed
    return Shapes({k: v.reshape(-1, ny) for k, v in parts.items()}, count, linear.dt)


def twist_memory(model: Model, criteria: Criteria) -> float:
    """Correlation time [s] of gusts that differ from wing tip to wing tip.

    sqrt(L b)/(2.6 V) of MIL-F-8785C. Where the model states its span b, the time goes with the square root of b (Froude's law:
    speed and gust length that suit the size).
    """
    span = model.constants.get("b", SPAN)
    return criteria.twist_memory * float(np.sqrt(span / SPAN)) if 0.0 < span < np.inf else criteria.twist_memory


def as_seen(shapes: Shapes, measured: Array) -> Shapes:
    """The shapes of a record in which samples that were not measured count as zero. measured: (N, ny).

    Of an output measured in a share of the samples that share remains: of the power of white noise, and of the amplitude of the
    responses, which are correlated from sample to sample.
    """
    share = measured.mean(axis=0)
    if (share == 1.0).all():
        return shapes
    # an output that is never measured has noise of its own alone, and so shows nothing
    white = np.where(share > 0.0, share, 1.0)
    louder = white if shapes.louder is None else shapes.louder * white
    return replace(shapes, parts={n: p * share for n, p in shapes.parts.items()}, louder=louder)


def spectral_matrix(noise: NoiseModel, shapes: Shapes) -> Complex:
    """S(f), (frequencies, ny, ny); unit: output unit squared per sample."""
    ny = noise.measurement.size
    S = np.zeros((shapes.count // 2 + 1, ny, ny), complex)
    S += np.diag(noise.measurement if shapes.louder is None else noise.measurement * shapes.louder)
    for name, strength in noise.process.items():
        g = shapes.parts[name]
        S += strength * g[:, :, None] * g[:, None, :].conj()
    return S


def whitener(noise: NoiseModel, shapes: Shapes) -> Whitener:
    """The operator S^(-1/2) of one record, without slack."""
    values, vectors = np.linalg.eigh(spectral_matrix(noise, shapes))
    root = (vectors / np.sqrt(values)[:, None, :]) @ vectors.conj().transpose(0, 2, 1)
    return Whitener(root, shapes.count)


def estimate_noise(
    residuals: Sequence[Array],
    shapes: Sequence[Shapes],
    start: Array,
    floor: Array,
    without: Collection[NoisePart] = (),
    known: Mapping[NoisePart, float] = MappingProxyType({}),
    earlier: NoiseModel | None = None,
) -> NoiseModel:
    """Maximum-likelihood strengths of all parts from output residuals.

    residuals: per record (N, ny), NaN where not measured. start: (ny,) first guess of the measurement variances;
    floor: (ny,) smallest ones allowed. without: parts to leave out. known: first guesses of some strengths. earlier: an estimate
    to go on from. Multiplicative minorise-maximise steps (monotone in likelihood).
    """
    names = [n for n in shapes[0].parts if n not in without]
    ny = start.size
    spectra = [np.fft.rfft(np.nan_to_num(r), axis=0) / np.sqrt(r.shape[0]) for r in residuals]
    weights = [np.concatenate([[0.5], np.ones(s.shape[0] - 1)]) for s in spectra]
    # of each part at strength 1, over the measurement noise
    power = np.array(
        [np.mean([np.mean(np.sum(np.abs(sh.parts[n]) ** 2 / start, axis=1)) for sh in shapes]) / ny for n in names]
    )
    names, power = [n for n, p in zip(names, power, strict=True) if p > 0.0], power[power > 0.0]
    R, v, iterations = start.copy(), BEGIN / power, ITERATIONS
    v = np.array([known.get(n, x) for n, x in zip(names, v, strict=True)])
    free = np.array([n.source is not NoiseSource.PREPARED for n in names], dtype=bool)
    v[~free] = 1.0
    if earlier is not None and all(n in earlier.process for n in names):
        R, v, iterations = earlier.measurement.copy(), np.array([earlier.process[n] for n in names]), FOLLOWING
    # (frequencies, ny, 1 + parts) residuals and responses of every record
    columns = [np.stack([s, *(sh.parts[n] for n in names)], axis=2) for s, sh in zip(spectra, shapes, strict=True)]
    blocks = [np.ascontiguousarray(c[:, :, 1:]) for c in columns]
    adjoints = [np.ascontiguousarray(g.conj().transpose(0, 2, 1)) for g in blocks]
    diagonal = np.arange(ny)
    for _ in range(iterations):
        # of every part, its power in the residuals (numerator) and the power that S predicts for it (denominator)
        R_numerator, R_denominator = np.zeros(ny), np.zeros(ny)
        v_numerator, v_denominator = np.zeros(len(names)), np.zeros(len(names))
        for shape, w, g, g_adjoint, block_columns in zip(shapes, weights, blocks, adjoints, columns, strict=True):
            level = 1.0 if shape.louder is None else shape.louder
            S = (g * v) @ g_adjoint
            S[:, diagonal, diagonal] += R * level
            inverse = np.linalg.inv(S)
            solved_columns = inverse @ block_columns
            a = solved_columns[:, :, 0]
            R_numerator += level * (w @ (a.real**2 + a.imag**2))
            R_denominator += level * (w @ inverse[:, diagonal, diagonal].real)
            projected = (g_adjoint @ a[:, :, None])[:, :, 0]
            v_numerator += w @ (projected.real**2 + projected.imag**2)
            v_denominator += w @ np.sum(g_adjoint.transpose(0, 2, 1) * solved_columns[:, :, 1:], axis=1).real
        R = np.maximum(R * np.sqrt(R_numerator / R_denominator), floor)
        v[free] = np.maximum(v * np.sqrt(v_numerator / v_denominator), FLOOR / power)[free]
    return NoiseModel(R, dict(zip(names, (float(x) for x in v), strict=True)))
