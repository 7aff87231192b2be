"""The back end without a compiler: the same scheme as `loop.c`, on CasADi's virtual machine.

Variational Runge-Kutta written in MX around SX rates and Jacobians, mapped over samples by mapaccum, called through
`Function.buffer()` (the ordinary call takes three times as long). A built function serves segments of any length: they are cut
into blocks, the last padded with steps of zero length. Blocks are short because the time to build one is proportional to its
length.
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from estimation.engine.kernel import Array, SegmentInputs, SegmentMotion, SensitivityColumns
from estimation.engine.trace import Pattern, Traced, rk4, trace
from estimation.models.parts import ModelStructure

BLOCKS = (128, 16)  # samples: long blocks for speed, short ones for little padding
LIMIT = 1e12  # of a state: beyond it the motion has diverged


class VirtualKernel:
    """See `estimation.engine.kernel`; no compiler, any platform."""

    label = "virtual machine"

    def __init__(self, structure: ModelStructure) -> None:
        self._traced = trace(structure)
        self.sizes = structure.sizes

    def run(
        self,
        drive: SegmentInputs,
        p: Array,
        x0: Array,
        substeps: int,
        columns: SensitivityColumns | None = None,
        gain: Array | None = None,
    ) -> SegmentMotion:
        nx, _, _, ny = self.sizes
        count = drive.dt.size
        n = columns.count if columns is not None else 0
        x, y, dy = np.zeros((count, nx)), np.zeros((count, ny)), np.zeros((count, ny, n))
        state = np.concatenate([x0, _initial(nx, columns).ravel(order="F")])
        transforms = drive.du.shape[2] if columns is not None else 0
        samples, key = _samples(drive, p, transforms, gain), _key(columns)
        for part, block in _parts(count):
            stepper = _stepper(self._traced, block, substeps, key, transforms, gain is not None)
            state = stepper.advance(samples, part, state, x, y, dy)
            runaway = ~np.all(np.isfinite(x[part]) & (np.abs(x[part]) < LIMIT), axis=1)
            if runaway.any():
                finite_samples = part.start + int(np.argmax(runaway))
                x[finite_samples:], y[finite_samples:], dy[finite_samples:] = 0.0, 0.0, 0.0
                return SegmentMotion(x, y, dy if columns is not None else None, finite_samples)
        return SegmentMotion(x, y, dy if columns is not None else None, count)

    def evaluate(self, x: Array, u: Array, p: Array) -> tuple[Array, Array, Array, Array]:
        nx, _, np_, ny = self.sizes
        count = x.shape[0]
        traced = self._traced
        arguments = (ca.DM(x.T), ca.DM(u.T), ca.repmat(ca.DM(p), 1, count))
        f, _, fp = (np.array(v) for v in traced.rates_jacobian.map(count)(*arguments))
        y, _, yp = (np.array(v) for v in traced.outputs_jacobian.map(count)(*arguments))
        return (
            f.T.copy(),
            _spread(fp, traced.patterns["f_p"], (count, nx, np_)),
            y.T.copy(),
            _spread(yp, traced.patterns["y_p"], (count, ny, np_)),
        )


def _spread(nonzeros: Array, pattern: Pattern, shape: tuple[int, int, int]) -> Array:
    """Dense matrices (N, rows, columns) from their non-zeros (nonzeros, N)."""
    full = np.zeros(shape)
    rows, columns = pattern
    full[:, list(rows), list(columns)] = nonzeros.T
    return full


def _key(columns: SensitivityColumns | None) -> tuple[Any, ...]:
    """The sensitivity columns as a key to built functions."""
    if columns is None:
        return ()
    return (
        columns.count,
        tuple(columns.parameter.tolist()),
        tuple(columns.transform.tolist()),
        tuple(map(tuple, columns.gain.tolist())),
    )


def _samples(drive: SegmentInputs, p: Array, transforms: int, gain: Array | None) -> list[Array]:
    """Arguments of the step function after the state, in its order: (N, width) by sample, or (width,) the same at all."""
    samples = [drive.u, drive.u_mid, drive.u_end]
    if transforms:
        width = transforms * drive.u.shape[1]
        samples += [a.transpose(0, 2, 1).reshape(-1, width) for a in (drive.du, drive.du_mid, drive.du_end)]
    dt = drive.dt.copy()
    dt[-1] = 0.0
    samples += [dt[:, None], p]
    if gain is not None:
        measured = np.isfinite(drive.z)
        samples += [np.where(measured, drive.z, 0.0), measured.astype(float), gain.ravel(order="F")]
    return samples


def _parts(count: int) -> Iterator[tuple[slice, int]]:
    """(samples, length of the block) of each block of `count` samples."""
    first = 0
    while first < count:
        remaining = count - first
        block = next((b for b in BLOCKS if b <= remaining), BLOCKS[-1])
        yield slice(first, min(first + block, count)), block
        first += block


def _initial(nx: int, columns: SensitivityColumns | None) -> Array:
    """(nx, n) sensitivities at the start: 1 for the initial states that have a column."""
    if columns is None:
        return np.zeros((nx, 0))
    s = np.zeros((nx, columns.count))
    for i, column in enumerate(columns.state.tolist()):
        if column >= 0:
            s[i, column] = 1.0
    return s


class _Stepper:
    """A mapaccum function with its buffers: state and sensitivities through one block of samples."""

    def __init__(self, function: ca.Function, block: int, n: int, step_length: int) -> None:
        self.n, self.step_length = n, step_length
        self.state = np.zeros(function.numel_in(0))
        self.inputs = [np.zeros((block, function.numel_in(i))) for i in range(1, function.n_in())]
        # results in the order of the step function: state after each step, x, y, dy at each sample
        self.results = [np.zeros((block, function.numel_out(i))) for i in range(function.n_out())]
        self._function = function.mapaccum(block)
        self._buffer, self._call = self._function.buffer()
        for i, array in enumerate([self.state, *self.inputs]):
            self._buffer.set_arg(i, memoryview(array))  # type: ignore[call-arg,arg-type]
        for i, array in enumerate(self.results):
            self._buffer.set_res(i, memoryview(array))  # type: ignore[call-arg,arg-type]

    def advance(self, samples: list[Array], part: slice, state: Array, x: Array, y: Array, dy: Array) -> Array:
        """Fill x, y, dy of one part; return the state at the begin of the next."""
        size = part.stop - part.start
        self.state[:] = state
        for array, values in zip(self.inputs, samples, strict=True):
            if values.ndim == 1:
                array[:] = values
            else:
                array[:size] = values[part]
                array[size:] = values[part.stop - 1]
        self.inputs[self.step_length][size:] = 0.0
        self._call()
        final_states, xs, ys, dys = self.results
        x[part], y[part] = xs[:size], ys[:size]
        dy[part] = dys[:size].reshape(size, self.n, ys.shape[1]).transpose(0, 2, 1)
        return final_states[size - 1].copy()


@lru_cache(maxsize=64)
def _stepper(traced: Traced, block: int, substeps: int, key: tuple[Any, ...], nt: int, with_gain: bool) -> _Stepper:
    """The step function of a model for blocks of samples. key: as of `_key`; nt: number of transform parameters."""
    nx, nu, np_, ny = traced.sizes
    n, parameter, transform, gain_columns = key or (0, (-1,) * np_, (), ())
    variation = _Variation(traced, n, parameter, transform, nt)
    state = ca.MX.sym("state", nx + nx * n)
    u, um, ub = (ca.MX.sym(k, nu) for k in ("u", "um", "ub"))
    d, dm, db = (ca.MX.sym(k, nu * nt) for k in ("d", "dm", "db"))
    dt, p = ca.MX.sym("dt"), ca.MX.sym("p", np_)
    z, measured, gain = ca.MX.sym("z", ny), ca.MX.sym("measured", ny), ca.MX.sym("gain", nx * ny)
    x, s = state[:nx], ca.reshape(state[nx:], nx, n)
    y, dy = variation.outputs(x, s, u, ca.reshape(d, nu, nt), p)
    if with_gain:
        x, s = _corrected(x, s, y, dy, measured * (z - y), measured, ca.reshape(gain, nx, ny), gain_columns, n)
    x_sample = x
    h = dt / substeps
    for j in range(substeps):
        a, m, b = (j / substeps, (j + 0.5) / substeps, (j + 1) / substeps)
        inputs = [(_path(t, u, um, ub), ca.reshape(_path(t, d, dm, db), nu, nt)) for t in (a, m, b)]
        x, s = rk4(
            lambda motion, driven: variation.rates(motion[0], motion[1], driven[0], driven[1], p), (x, s), inputs, h
        )
    results = [ca.vertcat(x, ca.vec(s)), x_sample, y, ca.vec(dy)]
    arguments = [state, u, um, ub, *([d, dm, db] if nt else []), dt, p, *([z, measured, gain] if with_gain else [])]
    return _Stepper(ca.Function("step", arguments, results), block, n, 6 if nt else 3)


def _path(fraction: float, begin: ca.MX, middle: ca.MX, end: ca.MX) -> ca.MX:
    """Input at a fraction of the interval: straight to its middle, straight on to its end."""
    if fraction in (0.0, 0.5, 1.0):
        return {0.0: begin, 0.5: middle, 1.0: end}[fraction]
    if fraction < 0.5:
        return begin + 2.0 * fraction * (middle - begin)
    return middle + (2.0 * fraction - 1.0) * (end - middle)


def _corrected(
    x: ca.MX,
    s: ca.MX,
    y: ca.MX,
    dy: ca.MX,
    e: ca.MX,
    measured: ca.MX,
    gain: ca.MX,
    gain_columns: tuple[tuple[int, ...], ...],
    n: int,
) -> tuple[ca.MX, ca.MX]:
    """State and sensitivities after the correction x + gain e; e: prediction error (ny,), zero where nothing is measured."""
    ny, nx = y.shape[0], x.shape[0]
    masked_gain = gain * ca.repmat(measured.T, nx, 1)
    x = x + ca.mtimes(masked_gain, e)
    if n:
        s = s - ca.mtimes(masked_gain, dy)
        for i in range(nx):
            for c in range(ny):
                column = gain_columns[i][c]
                if column >= 0:
                    s[i, column] += e[c]
    return x, s


class _Variation:
    """Rates and outputs with the sensitivity columns, as MX expressions."""

    def __init__(self, traced: Traced, n: int, parameter: tuple[int, ...], transform: tuple[int, ...], nt: int) -> None:
        self.traced, self.n, self.nt, self.parameter = traced, n, nt, parameter
        selection = ca.DM.zeros(nt, n)  # 1 where a transform's parameter has its column
        for t, column in enumerate(transform):
            if column >= 0:
                selection[t, column] = 1
        self.selection = ca.sparsify(selection)

    def _matrix(self, key: str, nonzeros: ca.MX, rows: int, columns: int) -> ca.MX:
        r, c = self.traced.patterns[key]
        sparsity = ca.Sparsity.triplet(rows, columns, list(r), list(c))
        return ca.MX(sparsity, nonzeros) if r else ca.MX(rows, columns)

    def _by_column(self, key: str, nonzeros: ca.MX, rows: int) -> ca.MX:
        """(rows, n) dense derivatives by p, each in the sensitivity column of its parameter."""
        r, c = self.traced.patterns[key]
        entries = sorted(
            (self.parameter[col], row, i)
            for i, (row, col) in enumerate(zip(r, c, strict=True))
            if self.parameter[col] >= 0
        )
        if not entries:
            return ca.MX.zeros(rows, self.n)
        sparsity = ca.Sparsity.triplet(rows, self.n, [row for _, row, _ in entries], [col for col, _, _ in entries])
        return ca.densify(ca.MX(sparsity, nonzeros[[i for _, _, i in entries]]))

    def _total(self, key: str, by_state: ca.MX, by_parameter: ca.MX, rows: int, s: ca.MX) -> ca.MX:
        """(rows, n) derivatives through the state and directly by the parameters."""
        nx = self.traced.sizes[0]
        return ca.mac(self._matrix(f"{key}_x", by_state, rows, nx), s, self._by_column(f"{key}_p", by_parameter, rows))

    def _through_inputs(self, key: str, by_input: ca.MX, rows: int, d: ca.MX) -> ca.MX:
        """(rows, n) dense derivatives by the parameters of input transforms, through the inputs."""
        nu = self.traced.sizes[1]
        return ca.densify(ca.mtimes(ca.mtimes(self._matrix(f"{key}_u", by_input, rows, nu), d), self.selection))

    def rates(self, x: ca.MX, s: ca.MX, u: ca.MX, d: ca.MX, p: ca.MX) -> tuple[ca.MX, ca.MX]:
        """f (nx,) and its derivatives (nx, n) by the sensitivity columns."""
        if not self.n:
            return self.traced.rates(x, u, p), ca.MX(x.shape[0], 0)
        f, by_state, by_parameter = self.traced.rates_jacobian(x, u, p)
        total = self._total("f", by_state, by_parameter, self.traced.sizes[0], s)
        if self.nt:
            total += self._through_inputs("f", self.traced.rates_by_input(x, u, p), self.traced.sizes[0], d)
        return f, total

    def outputs(self, x: ca.MX, s: ca.MX, u: ca.MX, d: ca.MX, p: ca.MX) -> tuple[ca.MX, ca.MX]:
        """y (ny,) and its derivatives (ny, n) by the sensitivity columns."""
        if not self.n:
            return self.traced.outputs(x, u, p), ca.MX(self.traced.sizes[3], 0)
        y, by_state, by_parameter = self.traced.outputs_jacobian(x, u, p)
        total = self._total("y", by_state, by_parameter, self.traced.sizes[3], s)
        if self.nt:
            total += self._through_inputs("y", self.traced.outputs_by_input(x, u, p), self.traced.sizes[3], d)
        return y, total
