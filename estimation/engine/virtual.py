"""The back end that needs no compiler: the same scheme as `loop.c`, on CasADi's virtual machine.

Variational Runge-Kutta written in MX around SX rates and Jacobians, mapped over samples by mapaccum, called through
`Function.buffer()` (the ordinary call triples the cost). A built function serves any segment: long ones go through it
in blocks, the last block padded with steps of zero length.
"""

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from estimation.engine.kernel import Array, Columns, Drive, Motion
from estimation.engine.trace import Pattern, Traced, constant_names, trace
from estimation.models.base import Model

BLOCKS = (16, 64, 128, 256, 640, 1280)
LIMIT = 1e12


class VirtualKernel:
    """See `estimation.engine.kernel`; no compiler, any platform."""

    label = "virtual machine"

    def __init__(self, model: Model) -> None:
        self._traced = trace(model)
        parameters = len(model.parameters) + len(constant_names(model))
        self.sizes = (len(model.states), len(model.inputs), parameters, len(model.outputs))

    def run(
        self,
        drive: Drive,
        p: Array,
        x0: Array,
        substeps: int,
        columns: Columns | None = None,
        gain: Array | None = None,
    ) -> Motion:
        nx, _, _, ny = self.sizes
        count = drive.dt.size
        n = columns.count if columns is not None else 0
        block = next((b for b in BLOCKS if b >= count), BLOCKS[-1])
        stepper = self._stepper(block, substeps, columns, drive.du.shape[2], gain is not None)
        x, y, dy = np.zeros((count, nx)), np.zeros((count, ny)), np.zeros((count, ny, n))
        state = np.concatenate([x0, _initial(nx, columns).ravel(order="F")])
        for first in range(0, count, block):
            part = slice(first, min(first + block, count))
            state = stepper.advance(drive, part, p, gain, state, x, y, dy)
            bad = ~np.all(np.isfinite(x[part]) & (np.abs(x[part]) < LIMIT), axis=1)
            if bad.any():
                reached = first + int(np.argmax(bad))
                x[reached:], y[reached:], dy[reached:] = 0.0, 0.0, 0.0
                return Motion(x, y, dy if columns is not None else None, reached)
        return Motion(x, y, dy if columns is not None else None, count)

    def _stepper(self, block: int, substeps: int, columns: Columns | None, transforms: int, gain: bool) -> "_Stepper":
        key: tuple[Any, ...] = ()
        if columns is not None:
            key = (
                columns.count, tuple(columns.parameter.tolist()), tuple(columns.transform.tolist()),
                tuple(map(tuple, columns.gain.tolist())),
            )  # fmt: skip
        return _stepper(self._traced, block, substeps, key, transforms if columns is not None else 0, gain)

    def evaluate(self, x: Array, u: Array, p: Array) -> tuple[Array, Array, Array, Array]:
        nx, _, np_, ny = self.sizes
        count = x.shape[0]
        traced = self._traced
        arguments = (ca.DM(x.T), ca.DM(u.T), ca.repmat(ca.DM(p), 1, count))
        f, _, _, fp = (np.array(v) for v in traced.rates_jacobian.map(count)(*arguments))
        y, _, _, yp = (np.array(v) for v in traced.outputs_jacobian.map(count)(*arguments))
        return (
            f.T.copy(), _spread(fp, traced.patterns["f_p"], (count, nx, np_)),
            y.T.copy(), _spread(yp, traced.patterns["y_p"], (count, ny, np_)),
        )  # fmt: skip


def _spread(nonzeros: Array, pattern: Pattern, shape: tuple[int, int, int]) -> Array:
    full = np.zeros(shape)
    rows, columns = pattern
    full[:, list(rows), list(columns)] = nonzeros.T
    return full


def _initial(nx: int, columns: Columns | None) -> Array:
    if columns is None:
        return np.zeros((nx, 0))
    s = np.zeros((nx, columns.count))
    for i, column in enumerate(columns.state.tolist()):
        if column >= 0:
            s[i, column] = 1.0
    return s


class _Stepper:
    """A mapaccum function with its buffers: state and sensitivities through one block of samples."""

    def __init__(self, function: ca.Function, block: int, sizes: tuple[int, int, int, int], n: int, nt: int) -> None:
        nx, nu, np_, ny = sizes
        self.block, self.n, self.nt, self.sizes = block, n, nt, sizes
        widths = (nu, nu, nu, nu * nt, nu * nt, nu * nt, 1, ny, ny, np_, nx * ny)
        self.state = np.zeros(nx + nx * n)
        self.inputs = [np.zeros((block, w)) for w in widths]
        # results in the order of the step function: state after each step, x, y, dy at each sample
        self.results = [np.zeros((block, w)) for w in (nx + nx * n, nx, ny, ny * n)]
        self._function = function
        self._buffer, self._call = function.buffer()
        for i, array in enumerate([self.state, *self.inputs]):
            self._buffer.set_arg(i, memoryview(array))  # type: ignore[call-arg,arg-type]
        for i, array in enumerate(self.results):
            self._buffer.set_res(i, memoryview(array))  # type: ignore[call-arg,arg-type]

    def advance(
        self, drive: Drive, part: slice, p: Array, gain: Array | None, state: Array, x: Array, y: Array, dy: Array
    ) -> Array:
        size = part.stop - part.start
        _, nu, _, ny = self.sizes
        self.state[:] = state
        samples = [drive.u, drive.u_begin, drive.u_end]
        if self.nt:
            samples += [
                a.transpose(0, 2, 1).reshape(-1, self.nt * nu) for a in (drive.du, drive.du_begin, drive.du_end)
            ]
        else:
            samples += [np.zeros((drive.dt.size, 0))] * 3
        known = np.isfinite(drive.z)
        samples += [drive.dt[:, None], np.where(known, drive.z, 0.0), known.astype(float)]
        for array, values in zip(self.inputs, samples, strict=False):
            array[:size] = values[part]
            array[size:] = values[part][-1]
        self.inputs[6][size:] = 0.0
        if part.stop == drive.dt.size:
            self.inputs[6][size - 1 :] = 0.0
        self.inputs[9][:] = p
        if gain is not None:
            self.inputs[10][:] = gain.ravel(order="F")
        self._call()
        after, xs, ys, dys = self.results
        x[part], y[part] = xs[:size], ys[:size]
        dy[part] = dys[:size].reshape(size, self.n, ny).transpose(0, 2, 1)
        return after[size - 1].copy()


@lru_cache(maxsize=64)
def _stepper(traced: Traced, block: int, substeps: int, key: tuple[Any, ...], nt: int, with_gain: bool) -> _Stepper:
    nx, nu, np_, ny = traced.sizes
    n, parameter, transform, gain_columns = key or (0, (-1,) * np_, (), ())
    variation = _Variation(traced, n, parameter, transform, nt)
    state = ca.MX.sym("state", nx + nx * n)
    u, ua, ub = (ca.MX.sym(k, nu) for k in ("u", "ua", "ub"))
    d, da, db = (ca.MX.sym(k, nu * nt) for k in ("d", "da", "db"))
    dt, z, known = ca.MX.sym("dt"), ca.MX.sym("z", ny), ca.MX.sym("known", ny)
    p, gain = ca.MX.sym("p", np_), ca.MX.sym("gain", nx * ny)
    x, s = state[:nx], ca.reshape(state[nx:], nx, n)
    y, dy = variation.outputs(x, s, u, ca.reshape(d, nu, nt), p)
    if with_gain:
        x, s = _corrected(x, s, y, dy, known * (z - y), known, ca.reshape(gain, nx, ny), gain_columns, n)
    x_here = x
    h = dt / substeps
    for j in range(substeps):
        a, m, b = (j / substeps, (j + 0.5) / substeps, (j + 1) / substeps)
        us = [ua + t * (ub - ua) for t in (a, m, b)]
        ds = [ca.reshape(da + t * (db - da), nu, nt) for t in (a, m, b)]
        x, s = variation.step(x, s, h, us, ds, p)
    after = ca.vertcat(x, ca.vec(s))
    results = [after, x_here, y, ca.vec(dy)]
    step = ca.Function("step", [state, u, ua, ub, d, da, db, dt, z, known, p, gain], results)
    return _Stepper(step.mapaccum(block), block, traced.sizes, n, nt)


def _corrected(
    x: ca.MX,
    s: ca.MX,
    y: ca.MX,
    dy: ca.MX,
    e: ca.MX,
    known: ca.MX,
    gain: ca.MX,
    gain_columns: tuple[tuple[int, ...], ...],
    n: int,
) -> tuple[ca.MX, ca.MX]:
    ny, nx = y.shape[0], x.shape[0]
    used = gain * ca.repmat(known.T, nx, 1)
    x = x + ca.mtimes(used, e)
    if n:
        s = s - ca.mtimes(used, dy)
        for i in range(nx):
            for c in range(ny):
                column = gain_columns[i][c]
                if column >= 0:
                    s[i, column] += e[c]
    return x, s


class _Variation:
    """Rates and outputs with the sensitivity columns, as MX expressions."""

    def __init__(self, traced: Traced, n: int, parameter: tuple[int, ...], transform: tuple[int, ...], nt: int) -> None:
        self.traced, self.n, self.nt = traced, n, nt
        np_ = traced.sizes[2]
        self.select = ca.DM.zeros(np_, n)
        for i, column in enumerate(parameter):
            if column >= 0:
                self.select[i, column] = 1
        self.place = ca.DM.zeros(nt, n)
        for t, column in enumerate(transform):
            if column >= 0:
                self.place[t, column] = 1
        self.select, self.place = ca.sparsify(self.select), ca.sparsify(self.place)

    def _matrix(self, key: str, nonzeros: ca.MX, rows: int, columns: int) -> ca.MX:
        r, c = self.traced.patterns[key]
        sparsity = ca.Sparsity.triplet(rows, columns, list(r), list(c))
        return ca.MX(sparsity, nonzeros) if r else ca.MX(rows, columns)

    def _total(self, key: str, parts: Any, rows: int, s: ca.MX, d: ca.MX) -> ca.MX:
        nx, nu, np_, _ = self.traced.sizes
        total = ca.mtimes(self._matrix(f"{key}_x", parts[0], rows, nx), s)
        total += ca.mtimes(self._matrix(f"{key}_p", parts[2], rows, np_), self.select)
        if self.nt:
            total += ca.mtimes(ca.mtimes(self._matrix(f"{key}_u", parts[1], rows, nu), d), self.place)
        return ca.densify(total)

    def rates(self, x: ca.MX, s: ca.MX, u: ca.MX, d: ca.MX, p: ca.MX) -> tuple[ca.MX, ca.MX]:
        if not self.n:
            return self.traced.rates(x, u, p), ca.MX(x.shape[0], 0)
        f, *parts = self.traced.rates_jacobian(x, u, p)
        return f, self._total("f", parts, self.traced.sizes[0], s, d)

    def outputs(self, x: ca.MX, s: ca.MX, u: ca.MX, d: ca.MX, p: ca.MX) -> tuple[ca.MX, ca.MX]:
        if not self.n:
            return self.traced.outputs(x, u, p), ca.MX(self.traced.sizes[3], 0)
        y, *parts = self.traced.outputs_jacobian(x, u, p)
        return y, self._total("y", parts, self.traced.sizes[3], s, d)

    def step(self, x: ca.MX, s: ca.MX, h: ca.MX, us: list[ca.MX], ds: list[ca.MX], p: ca.MX) -> tuple[ca.MX, ca.MX]:
        k1, v1 = self.rates(x, s, us[0], ds[0], p)
        k2, v2 = self.rates(x + h / 2 * k1, s + h / 2 * v1, us[1], ds[1], p)
        k3, v3 = self.rates(x + h / 2 * k2, s + h / 2 * v2, us[1], ds[1], p)
        k4, v4 = self.rates(x + h * k3, s + h * v3, us[2], ds[2], p)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), s + h / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
