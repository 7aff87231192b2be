"""The noise of the residuals, estimated from the flights given, and the operator that whitens them.

Output-error residuals are coloured: gusts and leftover jitter of the surfaces pass through the aircraft's own modes.
Their spectral matrix is written as a sum of parts of known shape and unknown strength,

    S(f) = R + sum_j v_j g_j(f) g_j(f)^H,

R diagonal (sensor noise), g_j the linearised response of all outputs to process noise on one force equation or to sample
noise on one control. What taking the noise off a control leaves wrong has a known size and colour: its strength is not free,
else process noise stands for it and the nulls, which have both, scatter twice too far. Where an attitude is itself the output
of a filter, two more: gyro noise, which the rate shows and the attitude integrates, and the slow wandering of the attitude
alone. All other strengths are estimated by maximum likelihood in the frequency domain (Whittle 1953); nothing is assumed of the
sensors or the weather. Multiplying by S(f)^(-1/2) makes residuals white and keeps them aligned in time and channel.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import solve_triangular

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.gap.criteria import Criteria
from estimation.gap.effects.sizes import REFERENCE
from estimation.gap.records.nuisance import RATE_OF
from estimation.gap.records.steady import steady_outputs, steady_state
from estimation.models.base import Model
from estimation.models.dependence import force_states

Complex = NDArray[np.complex128]

ITERATIONS = 60  # multiplicative steps: strengths of recorded flights settle to some 1 % in them
FOLLOWING = 20  # steps from an earlier estimate
LOWEST = 0.25  # of a record's own frequency, in place of none at all: it knows no lower than a part of its own
BEGIN = 0.3  # of the measurement noise: where the strength of every part starts, from which the steps find their way
SPAN = REFERENCE["b"]
FLOOR = 1e-7  # smallest share of the total a part keeps, so that the spectral matrix stays regular


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
class Slack:
    """What the whitener is to forgive. rows: (rows, m) white rows of what unknowns of one standard deviation each do.

    Marginalised over them the rows have the covariance I + E E' with E = rows, whose inverse is I - E (I + E'E)^-1 E'.
    """

    rows: Array

    @cached_property
    def _information(self) -> Array:
        """(m, m) I + E'E."""
        return self.rows.T @ self.rows + np.eye(self.rows.shape[1])

    @cached_property
    def _lower(self) -> Array:
        """(m, m) lower, its product with its transpose I + E'E.

        Columns that are as good as equal and large, as of a motion that grows, round the I away: no eigenvalue is below 1.
        """
        try:
            return np.asarray(np.linalg.cholesky(self._information))
        except np.linalg.LinAlgError:
            values, vectors = np.linalg.eigh(self._information)
            return np.asarray(np.linalg.qr((vectors * np.sqrt(np.maximum(values, 1.0))).T)[1].T)

    @cached_property
    def mix(self) -> Array:
        """(m, m) B for which I - E B E' is the symmetric root of that inverse: 1/(1 + v + sqrt(1 + v)), v eigenvalues of E'E."""
        values, vectors = np.linalg.eigh(self._information)
        values = np.maximum(values, 1.0)
        return np.asarray((vectors / (values + np.sqrt(values))) @ vectors.T)

    def forgiven(self, rows: Array) -> Array:
        """(m, k) whose inner products come off those of white rows (rows, k)."""
        along = rows.T @ self.rows  # in this order the many rows are read as they lie
        return np.asarray(solve_triangular(self._lower, along.T, lower=True, check_finite=False))


@dataclass(frozen=True)
class White:
    """White columns of a record, of which only inner products are asked: those corrected for what is forgiven are never made.

    rows: (rows, k) with nothing forgiven; forgiven: (m, k) as of `Slack.forgiven`, or None.
    """

    rows: Array
    forgiven: Array | None = None

    def products(self, other: "White") -> Array:
        """(own columns, columns of the other)."""
        made = self.rows.T @ other.rows
        if self.forgiven is not None and other.forgiven is not None:
            made -= self.forgiven.T @ other.forgiven
        return np.asarray(made)

    def squares(self) -> Array:
        """(columns,) the product of each with itself."""
        made = np.einsum("ij,ij->j", self.rows, self.rows)
        if self.forgiven is not None:
            made -= np.einsum("ij,ij->j", self.forgiven, self.forgiven)
        return np.asarray(made)

    def some(self, columns: NDArray[np.intp]) -> "White":
        """Some of the columns."""
        return White(self.rows[:, columns], None if self.forgiven is None else self.forgiven[:, columns])


@dataclass(frozen=True)
class Whitener:
    """Applies S^(-1/2) to residual-like columns of one record. root: (frequencies, ny, ny)."""

    root: Complex
    count: int
    slack: Slack | None = None

    @cached_property
    def _scale(self) -> Array:
        """(frequencies,) what makes rows of a real spectrum count as often as its samples do."""
        scale = np.full(self.root.shape[0], np.sqrt(2.0 / self.count))
        scale[0] = np.sqrt(1.0 / self.count)
        if self.count % 2 == 0:
            scale[-1] = np.sqrt(1.0 / self.count)
        return scale

    @cached_property
    def _real_root(self) -> Array:
        """(frequencies, 2 ny, 2 ny) the scaled root as it acts on real parts over imaginary ones."""
        root = self.root * self._scale[:, None, None]
        return np.block([[root.real, -root.imag], [root.imag, root.real]])

    @cached_property
    def _slack_series(self) -> Array:
        """(N ny, m) what is forgiven as white series."""
        assert self.slack is not None
        ny, m = self.root.shape[1], self.slack.rows.shape[1]
        parts = self.slack.rows.reshape(-1, 2, ny, m) / self._scale[:, None, None, None]
        return np.asarray(np.fft.irfft(parts[:, 0] + 1j * parts[:, 1], n=self.count, axis=0).reshape(-1, m))

    def strict(self, spectrum: Array) -> Array:
        """(frequencies, 2 ny, k) from `spectrum_of` -> (rows, k): white rows of unit variance with nothing forgiven."""
        white = self._real_root @ spectrum
        return np.asarray(white.reshape(white.shape[0] * white.shape[1], white.shape[2]))

    def rows(self, columns: Array) -> Array:
        """(N, ny, k) or (N, ny) -> (rows, k): whitened, as real rows of unit variance."""
        rows = self.strict(spectrum_of(columns))
        if self.slack is not None:
            rows -= self.slack.rows @ (self.slack.mix @ (self.slack.rows.T @ rows))
        return rows

    def white(self, columns: Array) -> White:
        """Columns (N, ny, k) or (N, ny), for their inner products."""
        rows = self.strict(spectrum_of(columns))
        return White(rows, None if self.slack is None else self.slack.forgiven(rows))

    def gram(self, columns: Array) -> Array:
        """(N, ny, k) or (N, ny) -> (k, k): inner products of the white rows."""
        white = self.white(columns)
        return white.products(white)

    def energy(self, residual: Array) -> float:
        """Sum of squares of the white rows of residuals (N, ny)."""
        return float(self.gram(residual)[0, 0])

    def series(self, residual: Array) -> Array:
        """(N, ny) residuals, or (N, ny, k) many of them -> white series of the same shape, aligned in time and channel."""
        block = residual[:, :, None] if residual.ndim == 2 else residual
        spectrum = np.fft.rfft(zero_filled(block), axis=0)
        series = np.fft.irfft(self.root @ spectrum, n=self.count, axis=0)
        if self.slack is not None:
            flat = series.reshape(-1, block.shape[2])
            forgiven = self._slack_series @ (self.slack.mix @ (self._slack_series.T @ flat))
            series -= forgiven.reshape(series.shape)
        return series.reshape(residual.shape)


def zero_filled(values: Array) -> Array:
    """`values` with zero where nothing was measured; the very same where everything was."""
    return values if np.isfinite(np.sum(values)) else np.nan_to_num(values)


def spectrum_of(columns: Array) -> Array:
    """(N, ny, k) or (N, ny) -> (frequencies, 2 ny, k): real parts of the spectra of all channels over imaginary ones. NaN counts
    as zero."""
    block = zero_filled(columns[:, :, None] if columns.ndim == 2 else columns)
    count, ny, k = block.shape
    there = rfft(block.reshape(count, ny * k), axis=0)
    made = np.empty((there.shape[0], 2, ny * k))
    made[:, 0], made[:, 1] = there.real, there.imag
    return made.reshape(there.shape[0], 2 * ny, k)


@dataclass(frozen=True)
class Linear:
    """Small motion of one record about its mean inputs: x' = A x + B u, y = C x + D u over `controls`, dt [s] between samples;
    scale: (ny,) rms of the measured outputs about their steady values."""

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
        scale=np.maximum(np.sqrt(np.nanmean((segment.z - steady_outputs(model, segment)) ** 2, axis=0)), 1e-9),
    )


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
        moved = np.asarray(reply @ linear.B[:, j] + linear.D[:, j], complex)
        parts[NoisePart(NoiseSource.CONTROL, name)] = moved
        # of every record, for one flight's control may be too coarse to have its noise taken off, and the next one's not
        parts[NoisePart(NoiseSource.PREPARED, name)] = moved * np.sqrt(left.get(name, np.zeros(s.size)))[:, None]
    for i, name in enumerate(model.output_names):
        if name in RATE_OF:
            before = np.exp(-s * linear.dt)  # one sample ago: a filter adds up sampled rates by straight lines
            summed = (linear.dt / (1.0 - np.exp(-linear.dt / criteria.filter_memory) * before))[:, None] * np.eye(ny)[i]
            parts[NoisePart(NoiseSource.WANDERING, name)] = summed
            if RATE_OF[name] in model.output_names:
                own = np.eye(ny)[model.output_names.index(RATE_OF[name])]
                parts[NoisePart(NoiseSource.GYRO, name)] = own + 0.5 * (1.0 + before)[:, None] * summed
    return Shapes({k: v.reshape(-1, ny) for k, v in parts.items()}, count, linear.dt)


def twist_memory(model: Model, criteria: Criteria) -> float:
    """Correlation time [s] of gusts that differ from wing tip to wing tip. By Froude's law as the square root of the span, where
    the model states it: sqrt(L b)/(2.6 V) of MIL-F-8785C with speeds and lengths of gusts that suit the size."""
    span = model.constants.get("b", SPAN)
    return criteria.twist_memory * float(np.sqrt(span / SPAN)) if 0.0 < span < np.inf else criteria.twist_memory


def as_seen(shapes: Shapes, measured: Array) -> Shapes:
    """The shapes of a record of which some samples were not measured, and count as zero: of white noise a share of the power is
    seen, of what has a course that share of its amplitude. measured: (N, ny)."""
    seen = measured.mean(axis=0)
    if (seen[seen > 0.0] == 1.0).all():
        return shapes
    seen = np.where(seen > 0.0, seen, 1.0)
    louder = seen if shapes.louder is None else shapes.louder * seen
    return replace(shapes, parts={n: p * seen for n, p in shapes.parts.items()}, louder=louder)


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
    made = np.zeros((shapes.count // 2 + 1, ny, len(names)), complex)
    for j, name in enumerate(names):
        made[:, :, j] = shapes.parts[name]
    return made


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
    turned = [np.ascontiguousarray(g.conj().transpose(0, 2, 1)) for g in blocks]
    every = np.arange(ny)
    for _ in range(turns):
        up_R, down_R = np.zeros(ny), np.zeros(ny)
        up, down = np.zeros(len(names)), np.zeros(len(names))
        for shape, w, g, g_turned, both in zip(shapes, weights, blocks, turned, columns, strict=True):
            own = 1.0 if shape.louder is None else shape.louder
            S = (g * v) @ g_turned
            S[:, every, every] += R * own
            inverse = np.linalg.inv(S)
            through = inverse @ both
            a = through[:, :, 0]
            up_R += own * (w @ (a.real**2 + a.imag**2))
            down_R += own * (w @ inverse[:, every, every].real)
            shown = (g_turned @ a[:, :, None])[:, :, 0]
            up += w @ (shown.real**2 + shown.imag**2)
            down += w @ np.sum(g_turned.transpose(0, 2, 1) * through[:, :, 1:], axis=1).real
        R = np.maximum(R * np.sqrt(up_R / down_R), floor)
        v[free] = np.maximum(v * np.sqrt(up / down), FLOOR / power)[free]
    return NoiseModel(R, dict(zip(names, (float(x) for x in v), strict=True)))
