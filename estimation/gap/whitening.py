"""The noise of the residuals, estimated from the flights given, and the operator that whitens them.

Output-error residuals are coloured: gusts and leftover jitter of the surfaces pass through the aircraft's own modes.
Their spectral matrix is written as a sum of parts of known shape and unknown strength,

    S(f) = R + sum_j v_j g_j(f) g_j(f)^H,

R diagonal (sensor noise), g_j the linearised response of all outputs to process noise on one force equation or to
sample noise on one control. All strengths are estimated by maximum likelihood in the frequency domain (Whittle 1953);
nothing is assumed of the sensors or the weather. Multiplying by S(f)^(-1/2) makes residuals white and keeps them aligned
in time and channel.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.engine.kernel import Array
from estimation.engine.simulate import Segment, Simulator
from estimation.models.base import Model
from estimation.models.expressions import names_in

Complex = NDArray[np.complex128]

ITERATIONS = 60
FLOOR = 1e-7  # smallest share of the total a part keeps, so that the spectral matrix stays regular


@dataclass(frozen=True)
class NoiseModel:
    """Strengths of all parts, shared by the flights.

    measurement: (ny,) variances of the outputs' own noise. process: part name -> variance intensity; names are
    `<state>` (white noise on the rate of a state), `<state>:<seconds>` (the derivative of coloured noise with that
    correlation time, as gusts have it) and `<control>` (noise of one sample).
    """

    measurement: Array
    process: Mapping[str, float]


@dataclass(frozen=True)
class Shapes:
    """Responses g_j of one record: name -> (frequencies, ny) complex, with the sample interval and count."""

    parts: Mapping[str, Complex]
    count: int
    step: float


@dataclass(frozen=True)
class Whitener:
    """Applies S^(-1/2) to residual-like columns of one record. root: (frequencies, ny, ny)."""

    root: Complex
    count: int

    def rows(self, columns: Array) -> Array:
        """(N, ny, k) or (N, ny) -> (rows, k): whitened, as real rows of unit variance."""
        block = columns[:, :, None] if columns.ndim == 2 else columns
        spectrum = self.root @ np.fft.rfft(np.nan_to_num(block), axis=0)
        scale = np.full(spectrum.shape[0], np.sqrt(2.0 / self.count))
        scale[0] = np.sqrt(1.0 / self.count)
        if self.count % 2 == 0:
            scale[-1] = np.sqrt(1.0 / self.count)
        spectrum *= scale[:, None, None]
        n = spectrum.shape[0] * spectrum.shape[1]
        return np.concatenate([spectrum.real.reshape(n, -1), spectrum.imag.reshape(n, -1)])

    def series(self, residual: Array) -> Array:
        """(N, ny) residuals -> (N, ny) white series, aligned in time and channel."""
        spectrum = np.fft.rfft(np.nan_to_num(residual), axis=0)[:, :, None]
        return np.fft.irfft((self.root @ spectrum)[:, :, 0], n=self.count, axis=0)


def force_states(model: Model) -> tuple[str, ...]:
    """States whose rate depends on a parameter: forces and moments act there, not in mere kinematics."""
    parameters = set(model.parameter_names)

    def reach(symbol: str, seen: set[str]) -> set[str]:
        for name in names_in(model.definitions[symbol]) if symbol in model.definitions else ():
            if name not in seen:
                seen.add(name)
                reach(name, seen)
        return seen

    return tuple(s for s in model.state_names if reach(f"{s}_dot", set()) & parameters)


def shapes_of(
    model: Model,
    simulator: Simulator,
    segment: Segment,
    values: Mapping[str, float],
    states: Sequence[str] | None = None,
) -> Shapes:
    """Linearised responses at the mean inputs of a record and small motion. states: where process noise may enter."""
    p = simulator.vector(values)
    nx, ny = len(model.states), len(model.outputs)
    u0 = segment.u.mean(axis=0)
    controls = [i for i, s in enumerate(model.inputs) if s.control]
    step = 1e-4
    points_x = np.concatenate(
        [np.zeros((1, nx)), step * np.eye(nx), -step * np.eye(nx), np.zeros((2 * len(controls), nx))]
    )
    points_u = np.repeat(u0[None], points_x.shape[0], axis=0)
    for j, i in enumerate(controls):
        points_u[1 + 2 * nx + 2 * j, i] += step
        points_u[2 + 2 * nx + 2 * j, i] -= step
    f, _, y, _ = simulator.kernel.evaluate(points_x, points_u, p)
    A = (f[1 : 1 + nx] - f[1 + nx : 1 + 2 * nx]).T / (2 * step)
    C = (y[1 : 1 + nx] - y[1 + nx : 1 + 2 * nx]).T / (2 * step)
    dt = float(np.median(np.diff(segment.time)))
    count = len(segment)
    s = 2j * np.pi * np.fft.rfftfreq(count, dt)
    s[0] = 2j * np.pi * 0.25 / (count * dt)  # a record knows no lower frequency than a part of its own
    resolvent = np.linalg.inv(s[:, None, None] * np.eye(nx) - A)
    reply = C @ resolvent  # (frequencies, ny, nx)
    parts: dict[str, Complex] = {}
    for name in force_states(model) if states is None else states:
        i = model.state_names.index(name)
        parts[name] = reply[:, :, i]
        for tau in (1.0,):
            parts[f"{name}:{tau:g}"] = reply[:, :, i] * (s / (s + 1 / tau))[:, None]
    for j, i in enumerate(controls):
        a, b = 1 + 2 * nx + 2 * j, 2 + 2 * nx + 2 * j
        B, D = (f[a] - f[b]) / (2 * step), (y[a] - y[b]) / (2 * step)
        parts[model.inputs[i].name] = reply @ B + D
    return Shapes({k: v.reshape(-1, ny) for k, v in parts.items()}, count, dt)


def spectral_matrix(noise: NoiseModel, shapes: Shapes) -> Complex:
    """S(f), (frequencies, ny, ny); unit: output unit squared per sample."""
    ny = noise.measurement.size
    S = np.zeros(
        (next(iter(shapes.parts.values())).shape[0] if shapes.parts else shapes.count // 2 + 1, ny, ny), complex
    )
    S += np.diag(noise.measurement)
    for name, strength in noise.process.items():
        g = shapes.parts[name]
        S += strength * g[:, :, None] * g[:, None, :].conj()
    return S


def whitener(noise: NoiseModel, shapes: Shapes) -> Whitener:
    """The operator S^(-1/2) of one record."""
    values, vectors = np.linalg.eigh(spectral_matrix(noise, shapes))
    root = (vectors / np.sqrt(values)[:, None, :]) @ vectors.conj().transpose(0, 2, 1)
    return Whitener(root, shapes.count)


def estimate_noise(residuals: Sequence[Array], shapes: Sequence[Shapes], start: Array, floor: Array) -> NoiseModel:
    """Maximum-likelihood strengths of all parts from output residuals.

    residuals: per record (N, ny), NaN where not measured. start: (ny,) first guess of the measurement variances;
    floor: (ny,) smallest ones allowed. Multiplicative minorise-maximise steps (monotone in likelihood).
    """
    names = list(shapes[0].parts)
    ny = start.size
    spectra = [np.fft.rfft(np.nan_to_num(r), axis=0) / np.sqrt(r.shape[0]) for r in residuals]
    weights = [np.concatenate([[0.5], np.ones(s.shape[0] - 1)]) for s in spectra]
    R = start.copy()
    # each part begins with the strength at which it alone would double the measurement noise
    power = {
        n: np.mean([np.mean(np.sum(np.abs(sh.parts[n]) ** 2 / start, axis=1)) for sh in shapes]) / ny for n in names
    }
    names = [n for n in names if power[n] > 0.0]
    v = {n: 0.3 / power[n] for n in names}
    for _ in range(ITERATIONS):
        up_R, down_R = np.zeros(ny), np.zeros(ny)
        up, down = dict.fromkeys(names, 0.0), dict.fromkeys(names, 0.0)
        for spectrum, shape, w in zip(spectra, shapes, weights, strict=True):
            inverse = np.linalg.inv(spectral_matrix(NoiseModel(R, v), shape))
            a = (inverse @ spectrum[:, :, None])[:, :, 0]
            up_R += w @ (np.abs(a) ** 2)
            down_R += w @ np.einsum("fii->fi", inverse).real
            for n in names:
                g = shape.parts[n]
                up[n] += float(w @ np.abs(np.sum(g.conj() * a, axis=1)) ** 2)
                down[n] += float(w @ np.einsum("fi,fij,fj->f", g.conj(), inverse, g).real)
        R = np.maximum(R * np.sqrt(up_R / down_R), floor)
        v = {n: max(v[n] * np.sqrt(up[n] / down[n]), FLOOR / power[n]) for n in names}
    return NoiseModel(R, v)
