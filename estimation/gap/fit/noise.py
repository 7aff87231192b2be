"""The noise of the flights: of every channel, found before any fit, and the spectral matrix S(f) of the residuals of a fit,
estimated from these residuals.

Output-error residuals are coloured: gusts and the noise of the controls pass through the aircraft's own modes. Their spectral
matrix is written as a sum of parts of known shape and unknown strength,

    S(f) = R + sum_j v_j g_j(f) g_j(f)^H,

where R is diagonal (sensor noise), and g_j is the linearised response of all outputs to process noise on one force equation or
to sample noise on one control. The error that remains on a control after its noise was removed has a known spectrum, so that
its strength is fixed at 1; were it free, process noise would be estimated for it as well, and the nulls, which have both,
would scatter twice too far. An attitude that is the output of a filter, which its smoothness shows, adds two parts: gyro
noise, which the rate shows and the attitude integrates, and the slow wandering of the attitude alone.

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
from estimation.gap.records.flight_records import FlightRecord
from estimation.gap.records.sampling import MOTION, white_share
from estimation.models.base import Model
from estimation.models.dependence import force_states
from estimation.signals.denoise import noise_level
from groundstation.flight.arrays import integral
from groundstation.flight.kinematics import EULER_RATES

KNOWN = 0.2  # share of the steps from sample to sample that must be measured to represent all of them
QUIETEST = 1e-4  # of the range of a channel: the least noise, as a coarsely rounded channel shows no scatter at all
SMALLEST_RANGE = 1e-9  # [unit of the channel] of one that never changes
ITERATIONS = 60  # multiplicative steps: strengths of recorded flights settle to some 1 % in them
FOLLOWING = 20  # steps from an earlier estimate
LOWEST = 0.25  # of 1 / length of the record: in place of zero frequency, where an integrating response is infinite
BEGIN = 0.3  # of the measurement noise: power with which every part starts
SPAN = REFERENCE["b"]  # m, span for which `twist_memory` is stated
FLOOR = 1e-7  # of the power of the measurement noise: the least that a part keeps, as a strength of zero could never grow again


# ---- of every channel
def channel_noise(records: Sequence[FlightRecord]) -> Array:
    """(ny,) standard deviation of the white part of every output, median over the records; 1 of an output that none has
    measured."""
    levels = np.array([[noise_level(column) for column in record.z.T] for record in records])
    spans = [np.fmax.reduce(record.z) - np.fmin.reduce(record.z) for record in records]
    span = np.fmax.reduce(spans)  # NaN where no record has measured an output
    least = QUIETEST * np.maximum(span, SMALLEST_RANGE)
    return np.where(np.isnan(span), 1.0, np.maximum(np.median(levels, axis=0), least))


def filtered_attitudes(
    records: Sequence[FlightRecord], outputs: Sequence[str], white: Array, criteria: Criteria
) -> tuple[str, ...]:
    """Those attitudes among the outputs that come from a filter which integrates the gyro. white: (ny,) noise of the outputs.

    From sample to sample they are smoother than the gyro's noise integrated over one step, as no independent measurement can be;
    or their difference from the integrated rates is not white, as the noise of a measurement would be.
    """
    step = float(np.median(np.concatenate([np.diff(record.time) for record in records])))
    attitudes = []
    for attitude, rate in RATE_OF.items():
        if attitude in outputs:
            input_levels = [record.input_noise.get(rate, 0.0) for record in records]
            noise = white[outputs.index(rate)] if rate in outputs else float(np.median(input_levels))
            smooth = white[outputs.index(attitude)] <= noise * step
            if smooth or _white_share(records, outputs, attitude) < criteria.halfway:
                attitudes.append(attitude)
    return tuple(attitudes)


def _white_share(records: Sequence[FlightRecord], outputs: Sequence[str], attitude: str) -> float:
    """Median over the records of the share of an attitude's steps against the integrated gyros that is white noise; 1 where there
    are no gyros."""
    shares = []
    for record in records:
        motion = _motion(record, outputs)
        if motion[RATE_OF[attitude]].any():
            rate = np.nan_to_num(EULER_RATES[attitude](motion))
            shares.append(white_share(_measured(record, outputs, attitude), integral(record.time, rate)))
    return float(np.median(shares)) if shares else 1.0


def bank_error(records: Sequence[FlightRecord], outputs: Sequence[str], scatter: Array, criteria: Criteria) -> Array:
    """`scatter` (ny,) with the noise of the bank angle raised to its slow error where the bank angle comes from a filter.

    An attitude filter integrates the gyro and corrects slowly, so that its angle is smooth from sample to sample. Its error shows
    only in its difference from the integrated rates over the record (`slow_error`).
    """
    return _with_slow_error("phi", ("p", "r"), ("q", "theta"), records, outputs, scatter, criteria)


def pitch_error(records: Sequence[FlightRecord], outputs: Sequence[str], scatter: Array, criteria: Criteria) -> Array:
    """`scatter` (ny,) with the noise of the pitch attitude raised to its slow error where it comes from a filter, as in
    `bank_error`."""
    return _with_slow_error("theta", ("q",), (), records, outputs, scatter, criteria)


def _with_slow_error(
    attitude: str,
    gyros: Sequence[str],
    others: Sequence[str],
    records: Sequence[FlightRecord],
    outputs: Sequence[str],
    scatter: Array,
    criteria: Criteria,
) -> Array:
    """`scatter` (ny,) with the noise of a filter's attitude raised to the median of its slow errors. gyros: outputs without which
    none is known; others: outputs or inputs without which that of a record is not."""
    if not {*gyros} <= set(outputs) or attitude not in filtered_attitudes(records, outputs, scatter, criteria):
        return scatter
    errors = []
    for record in records:
        if {*others} <= {*record.inputs, *outputs}:
            motion = _motion(record, outputs)
            # as measured: zero for a gyro that was off would be a wrong rate
            motion |= {n: record.z[:, outputs.index(n)] for n in (attitude, *gyros)}
            errors.append(slow_error(record.time, motion[attitude], EULER_RATES[attitude](motion)))
    wider = scatter.copy()
    if known_errors := [e for e in errors if e is not None]:
        column = outputs.index(attitude)
        wider[column] = max(scatter[column], float(np.median(known_errors)))
    return wider


def slow_error(time: Array, angle: Array, rate: Array) -> float | None:
    """Rms difference of a measured angle (N,) from its integrated rate (N,), without a constant and a drift.

    Steps of which a sample is missing (NaN) are taken to be as wrong as the others; None where fewer than `KNOWN` are left.
    """
    dt = np.diff(time)
    difference = np.diff(angle) - 0.5 * dt * (rate[1:] + rate[:-1])
    measured = np.isfinite(difference)
    if np.mean(measured) < KNOWN:
        return None
    error = np.concatenate([[0.0], np.cumsum(np.where(measured, difference, 0.0))]) / np.mean(measured)
    return float(np.std(error - np.polyval(np.polyfit(time, error, 1), time)))


def _motion(record: FlightRecord, outputs: Sequence[str]) -> dict[str, Array]:
    """Rates and attitudes (N,) of a record, as of `_measured`."""
    return {n: _measured(record, outputs, n) for n in MOTION}


def _measured(record: FlightRecord, outputs: Sequence[str], name: str) -> Array:
    """(N,) an output or an input; zero where the flight has neither, or the output was never measured."""
    zeros = np.zeros(len(record))
    if name not in outputs:
        return record.inputs.get(name, zeros)
    output = record.z[:, outputs.index(name)]
    return output if np.isfinite(output).any() else zeros


# ---- of the residuals
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
